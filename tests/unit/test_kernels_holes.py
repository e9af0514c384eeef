"""Finding holes."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.kernels.holes import DEPTH_TOLERANCE, FOOTPRINTS
from tests.reference import holes as naive
from tests.unit.kernel_calls import marked

SHAPE = (14, 17)
CONSTANTS = (float(FOOTPRINTS), float(DEPTH_TOLERANCE), 0.98)
STILL = np.zeros((*SHAPE, 2), np.float32)
WALL = np.full(SHAPE, 5, np.float32)


def plane_positions(shift: float = 0.0, pixel: float = 0.1) -> np.ndarray:
    """World positions of a wall at depth 5 whose pixels are `pixel` wide."""
    rows, columns = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]]
    return np.stack([columns * pixel + shift, rows * pixel, np.full(SHAPE, 5.0)], -1).astype(
        np.float32
    )


def up() -> np.ndarray:
    return np.broadcast_to(np.array([0, 0, 1], np.float32), (*SHAPE, 3)).copy()


def turned(cosine: float) -> np.ndarray:
    normal = np.array([np.sqrt(1 - cosine**2), 0, cosine], np.float32)
    return np.broadcast_to(normal, (*SHAPE, 3)).copy()


class TestMark:
    def random_case(self, seed: int) -> dict:
        rng = np.random.default_rng(seed)
        field = rng.normal(0, 1.5, (*SHAPE, 2)).astype(np.float32)
        field[rng.random(SHAPE) < 0.1] = np.nan
        depths = tuple(rng.uniform(4.5, 5.5, SHAPE).astype(np.float32) for _ in range(2))
        for depth in depths:
            depth[rng.random(SHAPE) < 0.15] = np.inf
        stencils = tuple(rng.integers(-1, 3, SHAPE).astype(np.int32) for _ in range(2))
        positions = tuple(
            (plane_positions() + rng.normal(0, 0.03, (*SHAPE, 3))).astype(np.float32)
            for _ in range(2)
        )
        normals = tuple(
            (up() + rng.normal(0, 0.1, (*SHAPE, 3))).astype(np.float32) for _ in range(2)
        )
        return {
            "field": field,
            "depths": depths,
            "stencils": stencils,
            "positions": positions,
            "normals": normals,
        }

    @pytest.mark.parametrize("seed", [0, 1])
    @pytest.mark.parametrize(
        "known",
        [
            (),
            ("stencils",),
            ("positions",),
            ("stencils", "normals"),
            ("stencils", "positions", "normals"),
        ],
        ids=lambda known: "+".join(known) or "depth alone",
    )
    def test_equals_the_naive_twin(self, seed, known):
        case = self.random_case(seed)
        given = {name: case[name] for name in known}
        (found,) = marked(case["field"], case["depths"], **given)
        absent = dict.fromkeys(("stencils", "positions", "normals")) | given
        expected = naive.mark(case["field"], case["depths"], **absent, constants=CONSTANTS)
        np.testing.assert_array_equal(found, expected)
        assert 0 < found.sum() < found.size

    @pytest.mark.parametrize("known", [(), ("stencils", "positions", "normals")])
    @pytest.mark.parametrize("steps", [(0.6, 0, 0.002), (0, 0.03, 0.01)])
    def test_equals_the_naive_twin_where_values_are_rounded(self, known, steps):
        case = self.random_case(2)
        given = {name: case[name] for name in known}
        (found,) = marked(case["field"], case["depths"], **given, steps=steps)
        absent = dict.fromkeys(("stencils", "positions", "normals")) | given
        twin = naive.mark(case["field"], case["depths"], **absent, constants=CONSTANTS, steps=steps)
        np.testing.assert_array_equal(found, twin)
        assert (found != marked(case["field"], case["depths"], **given)[0]).any()

    @pytest.mark.parametrize(
        ("steps", "hole"),
        [((0, 0, 0), True), ((0.9, 0, 0), True), ((1, 0, 0), False), ((0, 0.06, 0), False)],
    )
    def test_a_step_of_rounding_is_no_other_surface(self, steps, hole):
        other = WALL - np.float32(1)
        assert (marked(STILL, (WALL, other), steps=steps)[0] == hole).all()

    @pytest.mark.parametrize(("step", "hole"), [(0, True), (2.0**-10, False)])
    def test_positions_far_from_the_origin_may_differ_by_their_rounding(self, step, hole):
        here = plane_positions(1000.0)
        there = here + np.float32([0.8, 0, 0])
        found = marked(STILL, (WALL, WALL), None, (here, there), steps=(0, 0, step))[0]
        assert (found == hole).all()

    def test_what_stays_is_seen(self):
        same = (plane_positions(), plane_positions())
        ids = (np.ones(SHAPE, np.int32),) * 2
        assert not marked(STILL, (WALL, WALL))[0].any()
        assert not marked(STILL, (WALL, WALL), None, same)[0].any()
        assert not marked(STILL, (WALL, WALL), ids, same, (up(), up()))[0].any()

    def test_no_source_and_outside_are_holes(self):
        field = STILL.copy()
        field[2, 3] = np.nan
        field[:, 0, 0] = -0.6
        field[-1, :, 1] = 0.6
        expected = np.zeros(SHAPE, bool)
        expected[2, 3] = expected[:, 0] = expected[-1] = True
        np.testing.assert_array_equal(marked(field, (WALL, WALL))[0], expected)

    @pytest.mark.parametrize("value", [np.nan, np.inf, 1e30, -1e30])
    def test_absurd_motion_is_a_hole(self, value):
        assert marked(np.full_like(STILL, value), (WALL, WALL))[0].all()

    def test_background_meets_background_only(self):
        sky = np.full(SHAPE, np.inf, np.float32)
        assert not marked(STILL, (sky, sky))[0].any()
        assert marked(STILL, (sky, WALL))[0].all()
        assert marked(STILL, (WALL, sky))[0].all()

    @pytest.mark.parametrize(("ratio", "hole"), [(0.9, False), (1.1, True)])
    def test_without_positions_depth_decides(self, ratio, hole):
        other = (WALL * (1 - ratio * DEPTH_TOLERANCE)).astype(np.float32)
        assert (marked(STILL, (WALL, other))[0] == hole).all()
        assert (marked(STILL, (other, WALL))[0] == hole).all()

    @pytest.mark.parametrize("scale", [1e-3, 1, 1e4])
    @pytest.mark.parametrize(("ratio", "hole"), [(0.9, False), (1.1, True)])
    def test_positions_may_differ_by_some_footprints_in_any_unit(self, ratio, hole, scale):
        pixel = 0.1 * scale
        apart = ratio * float(FOOTPRINTS) * 2 * pixel  # one pixel on each axis
        positions = (plane_positions(0, pixel), plane_positions(apart, pixel))
        assert (marked(STILL, (WALL, WALL), None, positions)[0] == hole).all()

    def test_a_silhouette_does_not_widen_the_footprint(self):
        here = plane_positions()
        here[:, 8:] += 50  # another surface far away
        there = here + np.float32([float(FOOTPRINTS) * 2 * 0.1 * 1.2, 0, 0])
        assert marked(STILL, (WALL, WALL), None, (here, there.astype(np.float32)))[0].all()

    @pytest.mark.parametrize(
        ("now", "then", "hole"),
        [(3, 3, False), (3, 4, True), (0, 3, True), (-1, 3, False), (3, -1, False)],
    )
    def test_ids_must_agree_where_both_are_known(self, now, then, hole):
        ids = (np.full(SHAPE, now, np.int32), np.full(SHAPE, then, np.int32))
        assert (marked(STILL, (WALL, WALL), ids)[0] == hole).all()

    @pytest.mark.parametrize(("cosine", "hole"), [(0.99, False), (0.97, True), (-1.0, True)])
    def test_a_dynamic_surface_may_not_turn(self, cosine, hole):
        moving = (np.ones(SHAPE, np.int32),) * 2
        still = (np.zeros(SHAPE, np.int32),) * 2
        normals = (up() * np.float32(7), turned(cosine))  # length does not matter
        assert (marked(STILL, (WALL, WALL), moving, None, normals)[0] == hole).all()
        assert not marked(STILL, (WALL, WALL), still, None, normals)[0].any()
        over_more_slots = marked(STILL, (WALL, WALL), moving, None, normals, least_cosine=0.9)[0]
        assert (over_more_slots == (cosine < 0.9)).all()

    def test_a_dynamic_surface_may_go_anywhere(self):
        moving = (np.ones(SHAPE, np.int32),) * 2
        positions = (plane_positions(), plane_positions(40.0))
        assert not marked(STILL, (WALL, WALL * np.float32(3)), moving, positions)[0].any()
