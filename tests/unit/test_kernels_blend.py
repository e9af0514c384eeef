"""Blending two warped key frames, and projecting static points."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.kernels.blend import DEPTH_EXPONENT, GHOST_WEIGHT, MIN_DEPTH_RATIO, SAME_DEPTH
from tests.reference import blend as naive
from tests.reference import project as naive_project
from tests.unit.kernel_calls import Seen, Side, blended, mixed, projected, weighed

SHAPE = (13, 16)
CONSTANTS = (DEPTH_EXPONENT, float(MIN_DEPTH_RATIO), float(GHOST_WEIGHT), float(SAME_DEPTH))


def side(seed: int) -> Side:
    rng = np.random.default_rng(seed)
    depth = rng.uniform(1, 4, SHAPE).astype(np.float32)
    depth[rng.random(SHAPE) < 0.2] = np.inf
    hole = rng.random(SHAPE) < 0.3
    depth[hole & (rng.random(SHAPE) < 0.5)] = np.nan
    pixels = rng.normal(1, 2, (*SHAPE, 4)).astype(np.float32)
    return pixels, depth, hole, rng.random(SHAPE) < 0.2


class TestBlend:
    @pytest.mark.parametrize("time", [0.25, 0.5, 0.75])
    def test_equals_the_naive_twin(self, time):
        before, after = side(1), side(2)
        found, depth, hole = blended(before, after, time)
        expected, nearest, expected_hole = naive.blend(before, after, time, CONSTANTS)
        np.testing.assert_array_equal(depth, nearest)
        np.testing.assert_array_equal(hole, expected_hole)
        np.testing.assert_allclose(found[~hole], expected[~hole], rtol=0, atol=1e-5)
        assert 0 < hole.sum() < hole.size
        assert naive.shared_edges(before[1:], after[1:], CONSTANTS).sum() > 5

    def test_equal_sides_stay_bit_for_bit(self):
        pixels, depth, _, fringe = side(3)
        clear = np.zeros(SHAPE, bool)
        depth[np.isnan(depth)] = 2
        found, _, _ = blended((pixels, depth, clear, fringe), (pixels, depth, clear, clear), 0.3)
        assert found.tobytes() == pixels.tobytes()

    @pytest.mark.parametrize("first", [True, False])
    def test_a_side_alone_stays_bit_for_bit(self, first):
        pixels, _, _, _ = side(4)
        depth, clear = np.full(SHAPE, 3, np.float32), np.zeros(SHAPE, bool)
        seen = (pixels, depth, clear, clear)
        junk = np.full((*SHAPE, 4), 65504, np.float32)
        unseen = (junk, depth, ~clear, clear)
        sides = (seen, unseen) if first else (unseen, seen)
        assert blended(*sides, 0.4)[0].tobytes() == pixels.tobytes()


NEAR, FAR = 2.0, np.inf


def step(edge: int, far: float = FAR) -> Seen:
    """Return a side that shows a near surface up to a column, and what is behind it after that."""
    depth = np.full(SHAPE, far, np.float32)
    depth[:, :edge] = NEAR
    return depth, np.zeros(SHAPE, bool), np.zeros(SHAPE, bool)


class TestWeigh:
    @pytest.mark.parametrize("time", [0.25, 0.5, 0.75])
    @pytest.mark.parametrize("seeds", [(1, 2), (5, 6)])
    def test_equals_the_naive_twin(self, time, seeds):
        before, after = (side(seed)[1:] for seed in seeds)
        later, depth, hole = weighed(before, after, time)
        expected, nearest, expected_hole = naive.weigh(before, after, time, CONSTANTS)
        np.testing.assert_array_equal(depth, nearest)
        np.testing.assert_array_equal(hole, expected_hole)
        np.testing.assert_allclose(later, expected, rtol=0, atol=1e-5)
        shared = naive.shared_edges(before, after, CONSTANTS)
        assert shared.sum() > 5
        np.testing.assert_array_equal(later[shared], np.float32(time))

    @pytest.mark.parametrize("far", [FAR, 2.5])
    @pytest.mark.parametrize("edges", [(7, 8), (8, 7)])
    def test_an_edge_a_pixel_apart_is_shared_by_time(self, edges, far):
        before, after = (step(edge, far) for edge in edges)
        later, depth, hole = weighed(before, after, 0.25)
        np.testing.assert_array_equal(later, np.float32(0.25))
        np.testing.assert_array_equal(depth, np.minimum(before[0], after[0]))
        assert not hole.any()

    def test_an_edge_that_is_further_apart_belongs_to_the_nearer_surface(self):
        later, _, _ = weighed(step(7), step(10), 0.25)
        np.testing.assert_array_equal(later[:, 8], 1)  # neither side has its edge beside it
        later, _, _ = weighed(step(10), step(7), 0.25)
        np.testing.assert_allclose(later[:, 8], 0, atol=1e-20)

    def test_one_surface_has_no_edge(self):
        """A tilted one, whose depths differ by less than those of two surfaces."""
        before, after = step(7, NEAR * 1.09), step(8, NEAR * 1.09)
        later, _, _ = weighed(before, after, 0.25)
        assert 0.25 < later[0, 7] < 0.5  # the nearer surface counts more, but not alone

    @pytest.mark.parametrize("unknown", ["hole", "depth"])
    def test_nothing_is_shared_with_what_is_not_seen(self, unknown):
        before, after = step(7), step(8)
        if unknown == "hole":
            before[1][:, 7] = True
        else:
            before[0][:, 7] = np.nan
        later, _, hole = weighed(before, after, 0.25)
        np.testing.assert_array_equal(later[:, 7], 1)
        assert not hole.any()

    def test_a_hole_beside_shows_no_surface(self):
        """The first side shows the near surface, but in holes only, so the second one decides."""
        before, after = step(7), step(8)
        before[1][:, :7] = True
        later, _, _ = weighed(before, after, 0.25)
        np.testing.assert_array_equal(later[:, 7], 1)


class TestMix:
    @pytest.mark.parametrize("channels", [1, 3, 4, 6])
    def test_equals_the_naive_twin(self, channels):
        rng = np.random.default_rng(channels)
        before, after = (rng.normal(1, 2, (*SHAPE, channels)).astype(np.float32) for _ in range(2))
        later = rng.random(SHAPE).astype(np.float32)
        (found,) = mixed(before, after, later)
        np.testing.assert_allclose(found, naive.mix(before, after, later), rtol=0, atol=1e-5)

    @pytest.mark.parametrize("all_of", [0, 1])
    def test_a_picture_alone_stays_bit_for_bit(self, all_of):
        pictures = side(4)[0], np.full((*SHAPE, 4), 65504, np.float32)
        for pair in (pictures, pictures[::-1]):
            (found,) = mixed(*pair, np.full(SHAPE, all_of, np.float32))
            assert found.tobytes() == pair[all_of].tobytes()


class TestProject:
    def camera(self, seed: int) -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng(seed)
        return np.eye(3, 4) + rng.normal(0, 0.05, (3, 4)), np.eye(3) + rng.normal(0, 0.02, (3, 3))

    @pytest.mark.parametrize("seed", [0, 1])
    @pytest.mark.parametrize("placed", [False, True])
    def test_equals_the_naive_twin(self, seed, placed):
        rng = np.random.default_rng(seed)
        depth = rng.uniform(1, 4, SHAPE).astype(np.float32)
        depth[rng.random(SHAPE) < 0.3] = np.inf
        position = None
        if placed:
            position = rng.uniform(-3, 3, (*SHAPE, 3)).astype(np.float32)  # some behind the camera
            position[2, 3] = np.nan
        (found,) = projected(position, depth, *self.camera(seed))
        expected = naive_project.rigid(position, depth, *self.camera(seed))
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)
        assert np.isnan(found).any() or not placed

    def test_the_same_camera_moves_nothing(self):
        depth = np.full(SHAPE, 2, np.float32)
        depth[:4] = np.inf
        (found,) = projected(None, depth, np.eye(3, 4), np.eye(3))
        np.testing.assert_array_equal(found, 0)
