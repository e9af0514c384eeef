"""Kernels that read files' bytes: the pixels that a plain twin made the bytes of."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exwarp_cli.kernels.exr_filters import predict, read_lines, read_predicted
from exwarp_cli.kernels.raw_channels import write_depths
from tests.reference import exr as naive
from tests.unit.half_cases import by_numpy, edges_rounded, rounded, some_bits
from tests.unit.interpreted import same_when_interpreted

SETTINGS = settings(derandomize=True, max_examples=60, deadline=None)
SIZES = st.one_of(st.integers(1, 4), st.integers(1, 90))
KINDS = st.lists(st.sampled_from(["f2", "f4", "u4"]), min_size=1, max_size=4)
SEEDS = st.integers(0, 2**32 - 1)
FULL = {"f2": 2, "f4": 4, "u4": 4}


def some(rng: np.random.Generator, kinds: list[str], shape: tuple[int, int]) -> naive.Planes:
    return [
        rng.integers(0, 256, (*shape, np.dtype(kind).itemsize), np.uint8).view(kind)[..., 0]
        for kind in kinds
    ]


def decoded(kernel: Any, data: bytes, sizes: list[int], places: list[int], shape: Any) -> Any:
    out = np.full((*shape, max(places) + 1), 0xDEADBEEF, np.uint32)
    kernel(np.frombuffer(data, np.uint8), np.array([sizes, places], np.int64).T.copy(), out)
    return out


@SETTINGS
@given(SIZES, SIZES, KINDS, SEEDS)
def test_lines_and_halves(height, width, kinds, seed):
    rng = np.random.default_rng(seed)
    planes, sizes = some(rng, kinds, (height, width)), [FULL[kind] for kind in kinds]
    places = rng.permutation(len(kinds)).tolist()
    data, expected = naive.lines(planes), naive.singles(planes)
    for kernel, stored in ((read_lines, data), (read_predicted, naive.halves(data))):
        out = decoded(kernel, stored, sizes, places, (height, width))
        np.testing.assert_array_equal(out[..., places], expected)


@SETTINGS
@given(SIZES, SIZES, KINDS, SEEDS)
def test_what_is_not_wanted_is_passed_over(height, width, kinds, seed):
    rng = np.random.default_rng(seed)
    planes, sizes = some(rng, kinds, (height, width)), [FULL[kind] for kind in kinds]
    wanted = int(rng.integers(len(kinds)))
    places = [0 if k == wanted else -1 for k in range(len(kinds))]
    data, expected = naive.lines(planes), naive.singles(planes)[..., wanted]
    for kernel, stored in ((read_lines, data), (read_predicted, naive.halves(data))):
        out = decoded(kernel, stored, sizes, places, (height, width))
        np.testing.assert_array_equal(out[..., 0], expected)


def test_every_half():
    halves = np.arange(2**16, dtype=np.uint16).view(np.float16).reshape(256, 256)
    out = decoded(read_lines, halves.tobytes(), [2], [0], (256, 256))
    np.testing.assert_array_equal(out[..., 0], naive.singles([halves])[..., 0])
    finite = np.isfinite(halves)
    values = out[..., 0].view(np.float32)
    np.testing.assert_array_equal(values[finite], halves[finite].astype(np.float32))


class TestPredict:
    @pytest.mark.parametrize(("size", "block"), [(2, 2), (2, 64), (96, 32), (100, 32), (34, 32)])
    def test_blocks_are_filtered_as_the_twin_does(self, size, block):
        lines = np.random.default_rng(0).integers(0, 256, size, np.uint8)
        out = np.empty_like(lines)
        predict(lines.view(np.uint16), block // 2, out)
        blocks = (lines[start : start + block] for start in range(0, size, block))
        assert out.tobytes() == b"".join(naive.halves(one.tobytes()) for one in blocks)


@pytest.mark.parametrize("bounded", [False, True])
class TestRoundingToHalf:
    def test_it_is_numpy_s(self, bounded):
        bits = some_bits()[None]
        np.testing.assert_array_equal(rounded(bits, bounded), by_numpy(bits, bounded))

    def test_rows_without_nan(self, bounded):
        bits = some_bits()
        bits = bits[bits & 0x7FFFFFFF <= 0x7F800000][None]
        np.testing.assert_array_equal(rounded(bits, bounded), by_numpy(bits, bounded))


def test_rounding_to_half_interpreted(tmp_path):
    found = edges_rounded()
    same_when_interpreted("tests.unit.half_cases", tmp_path / "x.npz", found, "RuntimeWarning")


@given(st.lists(st.floats(width=32), min_size=1, max_size=40), st.sampled_from([1e9, 5.0]))
def test_depths_that_are_known(values, far):
    depth = np.array([*values, far, 0.0, -0.0, np.nan], np.float32)
    out = np.empty_like(depth)
    write_depths(depth, np.zeros(0, np.float32), np.float32(far), out)
    expected = [value if 0 < value < far else np.inf for value in depth.tolist()]
    assert out.tolist() == expected
