"""Filling holes from what is visible around them."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.synthesis.warp import BEYOND, fill_holes, find_hole_neighbours
from tests.reference import fill as naive
from tests.unit.kernel_calls import filled, seen

SHAPE = (14, 17)
WALL = np.full(SHAPE, 5, np.float32)


def scene(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    image = rng.normal(1, 2, (*SHAPE, 4)).astype(np.float32)
    depth = rng.uniform(1, 9, SHAPE).astype(np.float32)
    depth[rng.random(SHAPE) < 0.2] = np.inf
    hole = rng.random(SHAPE) < 0.3
    hole[4:9, 3:12] = True
    depth[hole & (rng.random(SHAPE) < 0.5)] = np.nan
    return image, depth, hole


class TestFill:
    @pytest.mark.parametrize("seed", [0, 1])
    def test_holes_are_listed_as_by_the_naive_twins(self, seed):
        _, depth, hole = scene(seed)
        hole[2], depth[5] = True, np.inf
        found = find_hole_neighbours(depth, hole)
        assert found is not None
        counts, furthest = naive.count_holes(hole, depth)
        assert found.column.tolist() == naive.list_holes(hole)
        assert np.diff(found.first).tolist() == counts
        assert found.cap == np.float32(BEYOND * max(furthest))
        assert find_hole_neighbours(depth, np.zeros_like(hole)) is None

    @pytest.mark.parametrize("seed", [0, 1])
    @pytest.mark.parametrize("reach", [2, 20])
    def test_looking_equals_the_naive_twin(self, seed, reach):
        _, _, hole = scene(seed)
        found = seen(hole, reach)[0]
        np.testing.assert_array_equal(found, naive.look(hole, reach)[:, hole])

    @pytest.mark.parametrize("seed", [0, 1])
    @pytest.mark.parametrize("reach", [2, 20])
    def test_equals_the_naive_twin(self, seed, reach):
        image, depth, hole = scene(seed)
        (found,) = filled(image, depth, hole, 18.0, reach)
        expected = naive.fill(image, depth, hole, (18.0, reach), (4, 2))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5)

    def test_what_is_no_hole_stays_bit_for_bit(self):
        image, depth, hole = scene(2)
        image[0, 0], hole[0, 0] = (-0.0, 1e-41, 65504, -3), False
        (found,) = filled(image, depth, hole, 18.0, 20)
        assert found[~hole].tobytes() == image[~hole].tobytes()

    def test_what_stands_in_a_hole_does_not_matter(self):
        image, depth, hole = scene(3)
        (clean,) = filled(image, depth, hole, 18.0, 20)
        image[hole] = np.nan
        np.testing.assert_array_equal(filled(image, depth, hole, 18.0, 20)[0], clean)
        assert np.isfinite(clean).all()

    def test_constant_surroundings_give_the_constant(self):
        _, depth, hole = scene(4)
        image = np.full((*SHAPE, 3), 3.25, np.float32)
        (found,) = filled(image, depth, hole, 18.0, 20)
        np.testing.assert_allclose(found, image, rtol=1e-6)

    @pytest.mark.parametrize("behind", [40.0, np.inf])
    def test_the_far_side_fills(self, behind):
        image = np.zeros((*SHAPE, 3), np.float32)
        depth = np.full(SHAPE, 2, np.float32)
        image[:, :9], depth[:, :9] = 1, behind
        hole = np.zeros(SHAPE, bool)
        hole[:, 7:11] = True
        depth[hole] = np.nan
        (found,) = filled(image, depth, hole, 40.0, 20)
        # The near side is next to the last column, but weighs (2 / 40) ** 2; the far one is 4 off.
        assert found[hole].min() > 0.94

    @pytest.mark.parametrize(("belongs", "colour"), [(2.0, 0.0), (40.0, 1.0), (np.inf, 1.0)])
    def test_the_surface_that_belongs_there_fills(self, belongs, colour):
        image = np.zeros((*SHAPE, 3), np.float32)
        depth = np.full(SHAPE, 2, np.float32)
        image[:, :9], depth[:, :9] = 1, 40
        hole = np.zeros(SHAPE, bool)
        hole[:, 7:11] = True
        depth[hole] = belongs
        (found,) = filled(image, depth, hole, 40.0, 20)
        np.testing.assert_allclose(found[hole], colour, atol=0.01)

    def test_without_anything_in_reach_it_is_black(self):
        image = np.ones((*SHAPE, 3), np.float32)
        assert (filled(image, WALL, np.ones(SHAPE, bool), 9.0, 20)[0] == 0).all()
        hole = np.ones(SHAPE, bool)
        hole[0, 0] = False
        (found,) = filled(image, WALL, hole, 9.0, 3)
        assert (found[8:, 8:] == 0).all()
        np.testing.assert_allclose(found[0, :4], 1, rtol=1e-6)

    def test_the_nearer_candidate_weighs_more(self):
        image = np.zeros((*SHAPE, 3), np.float32)
        image[:, 12:] = 1
        hole = np.zeros(SHAPE, bool)
        hole[:, 4:12] = True
        (found,) = filled(image, WALL, hole, 9.0, 20)
        row = found[7, 4:12, 0]
        assert (np.diff(row) > 0).all() and row[0] < 0.2 and row[-1] > 0.8


def from_planes(array: np.ndarray) -> np.ndarray:
    """The same values as planes, as networks give them."""
    return np.ascontiguousarray(np.moveaxis(array, -1, 0)).transpose(*range(1, array.ndim), 0)


def from_wider(array: np.ndarray) -> np.ndarray:
    """The same values as a part of a padded frame."""
    around = [(2, 3), (1, 4), (0, 0)][: array.ndim]
    return np.pad(array, around)[2:-3, 1:-4]


class TestFillHoles:
    def test_a_frame_s_own_pixels_are_changed(self):
        image, depth, hole = scene(0)
        before = image.copy()
        assert fill_holes(image, depth, hole) is image
        np.testing.assert_array_equal(image[~hole], before[~hole])
        assert (image[hole] != before[hole]).any(axis=-1).all()

    @pytest.mark.parametrize("view", [from_planes, from_wider])
    def test_views_of_any_layout_give_the_same(self, view):
        image, depth, hole = scene(1)
        views = view(image), view(depth), view(hole)
        assert not any(array.flags.c_contiguous for array in views)
        found = fill_holes(*views)
        np.testing.assert_array_equal(found, fill_holes(image, depth, hole))
