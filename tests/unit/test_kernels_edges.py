"""Silhouettes: finding them, and their ghosts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exwarp_cli.kernels.silhouettes import DEPTH_JUMP, MOTION_GAP, SAME_DEPTH
from tests.reference import edges as naive
from tests.unit.kernel_calls import NO_IDS, edges_found, fringe_found, moving_edges_found

SHAPE = (16, 19)
SIZES = [(1, 1), (1, 9), (9, 1), (2, 2), (33, 33)]
SQUARE = (slice(5, 11), slice(6, 13))


def patches(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Depth and ids of overlapping rectangles before background."""
    rng = np.random.default_rng(seed)
    depth = np.full(SHAPE, np.inf, np.float32)
    stencil = np.zeros(SHAPE, np.int32)
    for index in range(6):
        top, left = rng.integers(0, 12, 2)
        height, width = rng.integers(1, 8, 2)
        part = (slice(top, top + height), slice(left, left + width))
        depth[part] = rng.uniform(2, 9) * rng.uniform(0.98, 1.02, depth[part].shape)
        stencil[part] = rng.choice([-1, 0, 0, index])
    return depth, stencil


def square(front: float = 2.0, behind: float = 8.0) -> np.ndarray:
    depth = np.full(SHAPE, behind, np.float32)
    depth[SQUARE] = front
    return depth


def mask_of(rows: slice, columns: slice) -> np.ndarray:
    out = np.zeros(SHAPE, bool)
    out[rows, columns] = True
    return out


class TestEdges:
    @pytest.mark.parametrize("shape", SIZES)
    @pytest.mark.parametrize("with_ids", [False, True])
    def test_equals_the_naive_twin_at_any_size(self, shape, with_ids):
        rng = np.random.default_rng(shape)
        depth = rng.choice([2, 2.04, 2.08, np.inf], shape, p=[0.4, 0.5, 0.05, 0.05])
        depth, stencil = depth.astype(np.float32), np.zeros(shape, np.int32)
        stencil[rng.random(shape) < 0.04] = 1
        (found,) = edges_found(depth, stencil if with_ids else NO_IDS)
        expected = naive.find_edges(depth, stencil if with_ids else None, SAME_DEPTH)
        np.testing.assert_array_equal(found, expected)

    @settings(derandomize=True, max_examples=200)
    @given(st.floats(2.0**-120, 2.0**120, width=32), st.integers(-3, 3))
    def test_the_tolerance_ends_at_the_same_bit(self, near, steps):
        far = np.float32(near) / (np.float32(1) - SAME_DEPTH)  # on the verge of another surface
        for _ in range(abs(steps)):
            far = np.nextafter(far, np.float32(np.inf * np.sign(steps)))
        for depth in ([[near, far]], [[near, near, far], [far, near, near]]):
            pixels = np.array(depth, np.float32)
            expected = naive.find_edges(pixels, None, SAME_DEPTH)
            np.testing.assert_array_equal(edges_found(pixels)[0], expected)

    @pytest.mark.parametrize("seed", range(4))
    @pytest.mark.parametrize("with_ids", [False, True])
    def test_equals_the_naive_twin(self, seed, with_ids):
        depth, stencil = patches(seed)
        depth[3, 3] = np.nan
        (found,) = edges_found(depth, stencil if with_ids else NO_IDS)
        expected = naive.find_edges(depth, stencil if with_ids else None, SAME_DEPTH)
        np.testing.assert_array_equal(found, expected)
        assert 0 < found.sum() < found.size

    def test_one_surface_has_no_edges(self):
        for value in (3.0, np.inf):
            assert not edges_found(np.full(SHAPE, value, np.float32))[0].any()

    def test_a_slope_is_one_surface_and_a_step_is_not(self):
        steps = np.float32(1 + 0.9 * float(SAME_DEPTH)) ** np.arange(SHAPE[1])
        assert not edges_found(np.tile(steps, (SHAPE[0], 1)).astype(np.float32))[0].any()
        steep = np.float32(1 + 1.2 * float(SAME_DEPTH)) ** np.arange(SHAPE[1])
        assert edges_found(np.tile(steep, (SHAPE[0], 1)).astype(np.float32))[0].all()

    def test_both_sides_of_a_silhouette_are_marked(self):
        expected = mask_of(slice(4, 12), slice(5, 14)) & ~mask_of(slice(6, 10), slice(7, 12))
        np.testing.assert_array_equal(edges_found(square())[0], expected)
        np.testing.assert_array_equal(edges_found(square(behind=np.inf))[0], expected)

    def test_ids_separate_what_is_equally_far(self):
        stencil = mask_of(*SQUARE).astype(np.int32)
        flat = square(behind=2.0)
        assert not edges_found(flat)[0].any()
        np.testing.assert_array_equal(edges_found(flat, stencil)[0], edges_found(square())[0])


class TestMovingEdges:
    @pytest.mark.parametrize("shape", SIZES)
    @pytest.mark.parametrize("share", [0.1, 0.9])
    def test_equals_the_naive_twin_at_any_size(self, shape, share):
        rng = np.random.default_rng(shape)
        depth = rng.choice([2, 2.1, 8, np.nan, np.inf], shape, p=[0.6, 0.3, 0.06, 0.02, 0.02])
        field = rng.choice([1, 1.1, 1.3, np.nan], (*shape, 2), p=[0.8, 0.15, 0.04, 0.01])
        fringe = rng.random(shape) < 1 - share
        arrays = depth.astype(np.float32), field.astype(np.float32), fringe
        (found,) = moving_edges_found(*arrays)
        np.testing.assert_array_equal(
            found, naive.find_moving_edges(*arrays, DEPTH_JUMP, MOTION_GAP)
        )

    def test_what_moves_as_one_has_no_edge(self):
        still = np.ones((*SHAPE, 2), np.float32)
        never = np.zeros(SHAPE, np.bool_)
        assert not moving_edges_found(square(), still, never)[0].any()
        still[SQUARE] = 1.2
        (found,) = moving_edges_found(square(), still, never)
        np.testing.assert_array_equal(found, edges_found(square())[0])


class TestFringe:
    @pytest.mark.parametrize("shape", SIZES)
    def test_equals_the_naive_twin_at_any_size(self, shape):
        rng = np.random.default_rng(shape)
        near, depth = (rng.choice([2, 8, np.inf], shape, p=[0.1, 0.8, 0.1]) for _ in range(2))
        field = np.round(rng.normal(0, 1, (*shape, 2)) * 2) / 2  # many halves
        field[rng.random(shape) < 0.05] = np.nan, np.inf
        arrays = [array.astype(np.float32) for array in (field, near, depth)]
        (found,) = fringe_found(*arrays)
        np.testing.assert_array_equal(found, naive.find_fringe(*arrays, SAME_DEPTH))

    @pytest.mark.parametrize("seed", range(4))
    def test_equals_the_naive_twin(self, seed):
        rng = np.random.default_rng(seed)
        near, depth = patches(seed)[0], patches(seed + 10)[0]
        near[rng.random(SHAPE) < 0.05] = np.nan
        field = rng.normal(0, 3, (*SHAPE, 2)).astype(np.float32)
        field[rng.random(SHAPE) < 0.05] = np.nan
        (found,) = fringe_found(field, near, depth)
        np.testing.assert_array_equal(found, naive.find_fringe(field, near, depth, SAME_DEPTH))
        assert 0 < found.sum() < found.size

    def test_nothing_moves_nothing_is_a_ghost(self):
        depth = square()
        assert not fringe_found(np.zeros((*SHAPE, 2), np.float32), depth, depth)[0].any()

    @pytest.mark.parametrize("behind", [8.0, np.inf])
    def test_the_rim_left_behind_is_marked(self, behind):
        depth = square(behind=behind)
        near = np.roll(depth, 4, axis=1)
        field = np.zeros((*SHAPE, 2), np.float32)
        field[near == 2] = (-4, 0)
        (found,) = fringe_found(field, near, depth)
        # The wall beside the square's old place, save where the square's new place is beside it.
        rows, columns = SQUARE
        rim = np.zeros(SHAPE, bool)
        rim[rows, [columns.start - 1]] = True
        rim[[rows.start - 1, rows.stop], columns.start : columns.start + 4] = True
        np.testing.assert_array_equal(found & ~(near == 2), rim)
