"""Choosing the pixel that a slot's pixel shows, and sampling within a surface."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference import nearest as naive
from tests.unit import kernel_cases as cases
from tests.unit.kernel_calls import adopted, chosen, surface_sampled
from tests.unit.kernel_cases import NOTHING

SHAPE = (6, 9)
PIXELS = np.arange(SHAPE[0] * SHAPE[1]).reshape(SHAPE)


def side(x: float = 0.0, y: float = 0.0, depth: float = 5.0) -> tuple[np.ndarray, ...]:
    """A key frame of one flat surface that moves as a whole."""
    field = np.broadcast_to(np.float32([x, y]), (*SHAPE, 2)).copy()
    near = np.full(SHAPE, depth, np.float32)
    return field, near, near.copy(), np.zeros(SHAPE, bool), np.zeros(SHAPE, bool)


class TestChoose:
    @pytest.mark.parametrize("seed", [60, 64])
    @pytest.mark.parametrize("time", [0.25, 0.5, 0.75])
    def test_equals_the_naive_twin(self, seed, time):
        sides = cases.seen_by(seed), cases.seen_by(seed + 2)
        found = chosen(*sides, time)
        for mine, expected in zip(found, naive.choose(list(sides), time), strict=True):
            np.testing.assert_array_equal(mine, expected.astype(mine.dtype))

    def test_with_one_key_frame_equals_the_naive_twin(self):
        one = cases.seen_by(68)
        found = chosen(one, NOTHING, 0.0)
        for mine, expected in zip(found, naive.choose([one], 0.0), strict=True):
            np.testing.assert_array_equal(mine, expected.astype(mine.dtype))

    @pytest.mark.parametrize(("time", "later"), [(0.25, False), (0.5, False), (0.75, True)])
    def test_the_key_frame_nearer_in_time_wins(self, time, later):
        found = chosen(side(1), side(-1), time)
        assert (found[1][:, 1:-1] == later).all()
        np.testing.assert_array_equal(found[0][:, 1:-1], PIXELS[:, :-2] if later else PIXELS[:, 2:])

    def test_who_does_not_see_it_does_not_count(self):
        before, after = side(), side()
        before[3][2:4] = True
        pixel, later, _, hole = chosen(before, after, 0.25)
        np.testing.assert_array_equal(later, before[3])
        np.testing.assert_array_equal(pixel, PIXELS)
        assert not hole.any()

    def test_a_ghost_outline_counts_only_where_nothing_else_is_seen(self):
        before, after = side(), side()
        before[4][:3] = True
        after[3][0] = True
        later = chosen(before, after, 0.25)[1]
        np.testing.assert_array_equal(later[:, 0], [False, True, True, False, False, False])

    def test_beside_an_edge_the_pixel_of_the_same_surface_is_taken(self):
        before = side(0.52)  # nearest is the next pixel, which shows another surface
        before[2][:, 4:] = 50
        pixel = chosen(before, NOTHING, 0.0)[0]
        assert (pixel[:, 3] == PIXELS[:, 3]).all()
        assert (pixel[:, 2] == PIXELS[:, 3]).all()

    @pytest.mark.parametrize("far", [np.inf, 50.0])
    def test_background_is_like_background_only(self, far):
        before = side(0.52, depth=far)
        before[2][:, 4:] = 5
        pixel = chosen(before, NOTHING, 0.0)[0]
        assert (pixel[:, 3] == PIXELS[:, 3]).all()

    def test_what_lies_outside_is_a_hole(self):
        pixel, _, _, hole = chosen(side(-2.5), NOTHING, 0.0)
        np.testing.assert_array_equal(hole.all(axis=0), [True] * 2 + [False] * 7)
        assert (pixel[hole] == -1).all()


class TestAdopt:
    @pytest.mark.parametrize("seed", [60, 64])
    @pytest.mark.parametrize("reach", [2, 20])
    def test_equals_the_naive_twin(self, seed, reach):
        found = chosen(cases.seen_by(seed), cases.seen_by(seed + 2), 0.5)
        pixel, later = adopted(*found, (12.0, reach))
        expected, side_expected = naive.adopt(found, 12.0, reach)
        np.testing.assert_array_equal(pixel, expected)
        np.testing.assert_array_equal(later, side_expected)

    def around_a_hole(self, wanted: float) -> np.ndarray:
        """Source columns in a hole with something near on its left and far on its right."""
        before = side()
        before[1][:, :3], before[1][:, 3:] = 2, 20
        before[3][:, 3:7] = True
        before[1][before[3]] = wanted
        before[2][...] = before[1]
        found = chosen(before, NOTHING, 0.0)
        return adopted(*found, (40.0, 9))[0][3, 3:7] % SHAPE[1]

    def test_a_hole_shows_what_lies_behind(self):
        np.testing.assert_array_equal(self.around_a_hole(np.nan), [7, 7, 7, 7])

    def test_a_hole_of_known_depth_shows_its_own_surface(self):
        np.testing.assert_array_equal(self.around_a_hole(2.1), [2, 2, 2, 2])

    def test_where_nothing_is_seen_the_key_frame_stays(self):
        before = side()
        before[3][...] = True
        found = chosen(before, (*side()[:3], before[3], before[4]), 0.75)
        pixel, later = adopted(*found, (12.0, 9))
        np.testing.assert_array_equal(pixel, PIXELS)
        assert not later.any()


class TestSampleSurface:
    @pytest.mark.parametrize("seed", [70, 72])
    def test_equals_the_naive_twin(self, seed):
        image = np.nan_to_num(cases.image(seed), nan=1.0)
        depth, field = cases.depth(seed), cases.field(seed + 1)
        (found,) = surface_sampled(image, depth, field)
        expected = naive.sample_surface(image, depth, field)
        np.testing.assert_allclose(found, expected, rtol=2e-5, atol=2e-4)

    def test_other_surfaces_are_not_mixed_in(self):
        image = np.zeros((*SHAPE, 1), np.float32)
        image[:, 4:] = 100
        depth = np.where(image[..., 0] > 0, np.float32(9), np.float32(3))
        field = np.full((*SHAPE, 2), 0.4, np.float32)
        (found,) = surface_sampled(image, depth, field)
        assert set(np.unique(found[:-1, :-1])) == {0, 100}
