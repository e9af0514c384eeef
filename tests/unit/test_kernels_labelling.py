"""Areas of connected components: they are scipy's, in the order of first pixels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy import ndimage

from tests.reference.features import components
from tests.unit.kernel_calls import areas_measured

TOUCH = np.ones((3, 3))


def areas_of(stencil: np.ndarray) -> np.ndarray:
    """Return the area of the background, then of each component."""
    (areas,) = areas_measured(stencil)
    return areas


def assert_right(stencil: np.ndarray) -> None:
    """Areas are those of scipy's components of each id, in the order of their first pixels."""
    labels = np.zeros(stencil.shape, np.int64)
    for ident in np.unique(stencil[stencil > 0]):
        parts, _ = ndimage.label(stencil == ident, structure=TOUCH)
        labels = np.where(parts > 0, parts + labels.max(), labels)
    present, first, counts = np.unique(labels, return_index=True, return_counts=True)
    is_object = present > 0
    expected = counts[is_object][np.argsort(first[is_object])]
    np.testing.assert_array_equal(areas_of(stencil), [(labels == 0).sum(), *expected])


def drawn(*rows: str) -> np.ndarray:
    """Digits are ids, a minus is a mixed pixel, a point is static."""
    values = {".": 0, "-": -1}
    return np.array([[values.get(c) if c in values else int(c) for c in r] for r in rows], np.int32)


SHAPES = st.tuples(st.integers(1, 12), st.integers(1, 12))


@settings(derandomize=True, max_examples=300)
@given(arrays.arrays(np.int32, SHAPES, elements=st.integers(-1, 2)))
def test_random_stencils_are_scipys(stencil):
    assert_right(stencil)


@pytest.mark.parametrize("density", [0.1, 0.4, 0.6, 0.9])
@pytest.mark.parametrize("idents", [1, 3])
def test_large_random_stencils_are_scipys(density, idents):
    rng = np.random.default_rng(5)
    stencil = rng.integers(1, idents + 1, (97, 83)) * (rng.random((97, 83)) < density)
    assert_right(stencil.astype(np.int32))


@settings(derandomize=True, max_examples=50)
@given(st.lists(st.tuples(*[st.integers(0, 30)] * 2, st.integers(1, 9), st.integers(-1, 3))))
def test_blobs_are_scipys(discs):
    rows, columns = np.mgrid[0:31, 0:31]
    stencil = np.zeros((31, 31), np.int32)
    for y, x, size, ident in discs:
        stencil[(rows - y) ** 2 + (columns - x) ** 2 < size**2] = ident
    assert_right(stencil)


def test_the_naive_twin_agrees():
    stencil = np.random.default_rng(6).integers(-1, 3, (14, 17)).astype(np.int32)
    assert areas_of(stencil)[1:].tolist() == [len(each) for each in components(stencil)]


def spiral(size: int) -> np.ndarray:
    """A path one pixel wide from the outside in, with gaps of one pixel."""
    out = np.zeros((size, size), np.int32)
    i, j, di, dj = 0, 0, 0, 1
    out[0, 0] = 1

    def free(y: int, x: int) -> bool:
        return 0 <= y < size and 0 <= x < size and out[y, x] == 0

    while True:
        ahead, beyond = (i + di, j + dj), (i + 2 * di, j + 2 * dj)
        blocked = not free(*ahead) or (min(beyond) >= 0 and max(beyond) < size and out[beyond])
        if blocked:
            di, dj = dj, -di
            ahead, beyond = (i + di, j + dj), (i + 2 * di, j + 2 * dj)
            if not free(*ahead) or (max(beyond) < size and out[beyond]):
                return out
        i, j = ahead
        out[i, j] = 1


@pytest.mark.parametrize("turns", range(4))
def test_a_spiral_is_one(turns):
    stencil = np.rot90(spiral(41), turns).copy()
    assert 700 < stencil.sum() < 1000
    assert areas_of(stencil).tolist() == [(stencil == 0).sum(), stencil.sum()]
    both = stencil + 2 * (1 - stencil)  # what is between the arms is a spiral too
    assert_right(both)


def test_combs_are_joined_from_the_last_row():
    stencil = np.zeros((40, 61), np.int32)
    stencil[:, ::2] = 1
    assert len(areas_of(stencil)) == 1 + 31
    stencil[-1] = 1
    assert areas_of(stencil)[1:].tolist() == [stencil.sum()]


def test_objects_of_different_ids_that_touch_are_apart():
    assert areas_of(drawn("1122", "1122", "..33")).tolist() == [2, 4, 4, 2]


def test_a_diagonal_touch_joins():
    assert areas_of(drawn("1.1", ".1.", "1.1")).tolist() == [4, 5]
    assert areas_of(drawn("12", "21")).tolist() == [0, 2, 2]


def test_areas_go_by_first_pixels():
    stencil = drawn("..555", "77555", ".....", "5...9", "....9", "....9", "....9")
    assert areas_of(stencil).tolist() == [22, 6, 2, 1, 4]


def test_background_and_mixed_pixels_are_none():
    assert areas_of(drawn("-.-", "1-1", ".-.")).tolist() == [7, 1, 1]
    assert areas_of(np.zeros((3, 5), np.int32)).tolist() == [15]


def test_ids_use_the_whole_range():
    stencil = np.array([[2**31 - 1, -(2**31), 2**31 - 2]], np.int32)
    assert areas_of(stencil).tolist() == [1, 1, 1]
