"""Kernels that read files' bytes: the pixels that a plain twin made the bytes of."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exwarp_cli.kernels.depths import known_depths
from exwarp_cli.kernels.exr_rises import from_halves, from_lines, from_planes, from_runs
from tests.reference import exr as naive

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
    for kernel, stored in ((from_lines, data), (from_halves, naive.halves(data))):
        out = decoded(kernel, stored, sizes, places, (height, width))
        np.testing.assert_array_equal(out[..., places], expected)


@SETTINGS
@given(SIZES, SIZES, KINDS, SEEDS)
def test_planes(height, width, kinds, seed):
    rng = np.random.default_rng(seed)
    planes = some(rng, kinds, (height, width))
    sizes = [{"f2": 2, "f4": 3, "u4": 4}[kind] for kind in kinds]
    places = rng.permutation(len(kinds)).tolist()
    out = decoded(from_planes, naive.planes24(planes), sizes, places, (height, width))
    np.testing.assert_array_equal(out[..., places], naive.singles(planes, drop=True))


@pytest.mark.parametrize("kind", ["f2", "f4", "u4"])
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5])
def test_planes_of_one_kind(count, kind):
    rng = np.random.default_rng(count)
    planes = some(rng, [kind] * count, (5, 67))
    sizes, places = [{"f2": 2, "f4": 3, "u4": 4}[kind]] * count, rng.permutation(count).tolist()
    out = decoded(from_planes, naive.planes24(planes), sizes, places, (5, 67))
    np.testing.assert_array_equal(out[..., places], naive.singles(planes, drop=True))


@SETTINGS
@given(SIZES, SIZES, KINDS, SEEDS)
def test_what_is_not_wanted_is_passed_over(height, width, kinds, seed):
    rng = np.random.default_rng(seed)
    planes, sizes = some(rng, kinds, (height, width)), [FULL[kind] for kind in kinds]
    wanted = int(rng.integers(len(kinds)))
    places = [0 if k == wanted else -1 for k in range(len(kinds))]
    data, expected = naive.lines(planes), naive.singles(planes)[..., wanted]
    stored = [(from_lines, data, sizes), (from_halves, naive.halves(data), sizes)]
    if "f4" not in kinds:
        stored.append((from_planes, naive.planes24(planes), sizes))
    for kernel, taken, of in stored:
        out = decoded(kernel, taken, of, places, (height, width))
        np.testing.assert_array_equal(out[..., 0], expected)


def test_every_half():
    halves = np.arange(2**16, dtype=np.uint16).view(np.float16).reshape(256, 256)
    out = decoded(from_lines, halves.tobytes(), [2], [0], (256, 256))
    np.testing.assert_array_equal(out[..., 0], naive.singles([halves])[..., 0])
    finite = np.isfinite(halves)
    values = out[..., 0].view(np.float32)
    np.testing.assert_array_equal(values[finite], halves[finite].astype(np.float32))


class TestRuns:
    @SETTINGS
    @given(st.lists(st.tuples(st.integers(0, 255), st.integers(1, 300)), min_size=1, max_size=20))
    def test_what_the_twin_made(self, pieces):
        data = b"".join(bytes([value]) * count for value, count in pieces)
        out = np.empty(len(data), np.uint8)
        assert from_runs(np.frombuffer(naive.runs(data), np.uint8), out)
        assert out.tobytes() == data

    @pytest.mark.parametrize(
        "packed",
        [[], [3], [3, 7, 0], [4, 7], [2, 7], [253, 1, 2], [252, 1, 2, 3], [3, 7, 0, 1], [0, 1] * 5],
        ids=str,
    )
    def test_not_just_so_many_bytes(self, packed):
        """Four are expected; what lies behind them stays as it is."""
        memory = np.full(8, 99, np.uint8)
        assert not from_runs(np.array(packed, np.uint8), memory[:4])
        assert (memory[4:] == 99).all()


@given(st.lists(st.floats(width=32), min_size=1, max_size=40), st.sampled_from([1e9, 5.0]))
def test_depths_that_are_known(values, far):
    depth = np.array([*values, far, 0.0, -0.0, np.nan], np.float32)
    out = np.empty_like(depth)
    known_depths(depth, np.float32(far), out)
    expected = [value if 0 < value < far else np.inf for value in depth.tolist()]
    assert out.tolist() == expected
