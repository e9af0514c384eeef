"""Elements and rows of arrays in compiled functions: those that Python finds, and no copies."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numba.core.runtime import _nrt_python
from numba.core.runtime.nrt import rtsys

from exwarp_cli.compiled import builds

pytestmark = pytest.mark.usefixtures("uncached")


def element(values: np.ndarray, at: Any) -> Any:
    return values[at]


def write(values: np.ndarray, at: Any, value: Any) -> None:
    values[at] = value


CUBE = np.arange(60, dtype=np.float32).reshape(3, 4, 5)
SHIFTED = np.frombuffer(b"x" + CUBE.tobytes(), np.uint8)[1:]
ARRAYS = {
    "rows": CUBE,
    "columns": np.asfortranarray(CUBE),
    "steps": np.arange(480, dtype=np.float32).reshape(6, 8, 10)[::2, ::-2, 1::2],
    "flags": CUBE % 3 == 0,
    "complex": CUBE + 1j * CUBE[::-1],
    "unaligned": SHIFTED.view(np.float32).reshape(3, 4, 5),
    "none of them": np.zeros((3, 4, 5, 0), np.int16),
}
INDICES = [1, -1, np.uint8(2), np.uint64(1), np.int32(-2), (1, 2), (-1, -3), (np.uint64(2), 0)]
INDICES += [(2, 3, 4), (-3, -4, -5), (np.uint16(1), np.int8(-1), 2), (0, slice(1, 3)), slice(-2, 3)]


class TestElements:
    @pytest.mark.parametrize("name", ARRAYS)
    @pytest.mark.parametrize("at", INDICES, ids=str)
    def test_they_are_those_of_numpy(self, name, at):
        values = ARRAYS[name]
        found, expected = builds.compiled(element)(values, at), values[at]
        assert np.array_equal(found, expected) and np.shape(found) == np.shape(expected)
        if isinstance(expected, np.ndarray):
            assert found.strides == expected.strides
            assert np.shares_memory(found, values) == (expected.size > 0)

    @pytest.mark.parametrize("name", [name for name in ARRAYS if name != "unaligned"])
    @pytest.mark.parametrize("at", INDICES, ids=str)
    def test_they_are_written_where_numpy_writes(self, name, at):
        written, expected = ARRAYS[name].copy("K"), ARRAYS[name].copy("K")
        builds.compiled(write)(written, at, 7)
        expected[at] = 7
        assert np.array_equal(written, expected)

    def test_new_axes_and_arrays_of_no_dimension_are_numbas(self):
        assert builds.compiled(lambda x: x[None])(CUBE).shape == (1, 3, 4, 5)
        assert builds.compiled(lambda x: x[()])(np.array(3.5)) == 3.5
        chosen = builds.compiled(lambda x, k: x[k])(CUBE, np.array([2, 0]))
        assert chosen.tolist() == CUBE[[2, 0]].tolist()

    def test_values_become_those_of_the_array(self):
        values = np.zeros(3, np.int16)
        builds.compiled(write)(values, 1, 2.75)
        builds.compiled(write)(values, 2, True)
        assert values.tolist() == [0, 2, 1]

    def test_fields_have_names(self):
        table = np.array([(1, 2.5), (3, 4.5)], [("count", np.int32), ("share", np.float64)])
        assert builds.compiled(lambda rows: rows[1]["share"] + rows["count"][0])(table) == 5.5


def test_rows_keep_their_array():
    def kept(count: int) -> Any:
        values = np.ones((count, 4))
        row = values[count - 1]
        values = np.zeros((count, 4))
        return row + values[0]

    compiled = builds.compiled(kept)
    _nrt_python.memsys_enable_stats()
    before = rtsys.get_allocation_stats()
    assert compiled(5).tolist() == [1, 1, 1, 1]
    after = rtsys.get_allocation_stats()
    assert after.alloc - before.alloc == after.free - before.free
