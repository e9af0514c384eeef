"""Blending two warped key frames, and projecting static points."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.kernels.blend import FRINGE_WEIGHT, LEAST_RATIO, NEARNESS
from tests.reference import blend as naive
from tests.reference import project as naive_project
from tests.unit.kernel_calls import Side, blended, projected

SHAPE = (13, 16)
CONSTANTS = (NEARNESS, float(LEAST_RATIO), float(FRINGE_WEIGHT))


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
