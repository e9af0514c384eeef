"""Sampling along a motion field, and chaining fields."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exwarp_cli.kernels.gather import gather_bilinear
from tests.reference import gather as naive
from tests.unit.kernel_calls import gathered


def random_image(shape: tuple[int, int, int], seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(1, 3, shape).astype(np.float32)


def random_field(shape: tuple[int, int], seed: int = 0, spread: float = 4) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, spread, (*shape, 2)).astype(np.float32)


def uniform(shape: tuple[int, int], x: float, y: float) -> np.ndarray:
    return np.broadcast_to(np.array([x, y], np.float32), (*shape, 2)).copy()


class TestGather:
    @pytest.mark.parametrize(
        "shape", [(1, 1, 3), (1, 9, 4), (17, 13, 3), (20, 31, 4), (3, 257, 3), (2, 600, 4)]
    )
    def test_equals_the_naive_twin(self, shape):
        image, field = random_image(shape), random_field(shape[:2])
        expected, hole = naive.gather_bilinear(image, field)
        found, found_hole = gathered(image, field)
        np.testing.assert_array_equal(found_hole, hole)
        np.testing.assert_allclose(found, expected, rtol=0, atol=5e-6)

    def test_equals_the_naive_twin_with_values_that_are_no_numbers(self):
        image, field = random_image((15, 18, 3), 1), random_field((15, 18), 1, 2)
        rng = np.random.default_rng(2)
        image[rng.random((15, 18)) < 0.05] = np.nan
        image[rng.random((15, 18)) < 0.05, 1] = np.inf
        field[rng.random((15, 18)) < 0.1] = np.nan
        field[0, :4] = np.inf, -np.inf
        field[1, :4, 0] = 3e7
        expected, hole = naive.gather_bilinear(image, field)
        found, found_hole = gathered(image, field)
        np.testing.assert_array_equal(found_hole, hole)
        np.testing.assert_allclose(found, expected, rtol=0, atol=5e-6)
        assert np.isfinite(found).all()
        assert (found[np.isnan(field).any(axis=-1)] == 0).all()

    @pytest.mark.parametrize("channels", [1, 2, 3, 4, 5])
    def test_equals_the_naive_twin_with_any_number_of_channels(self, channels):
        image, field = random_image((15, 18, channels)), random_field((15, 18), 1, 2)
        for c in range(channels):
            image[3 * c, 4:6, c] = np.nan, np.inf  # seen in whichever channel
        field[:, 3:9] = np.round(field[:, 3:9])
        expected, hole = naive.gather_bilinear(image, field)
        found, found_hole = gathered(image, field)
        np.testing.assert_array_equal(found_hole, hole)
        np.testing.assert_allclose(found, expected, rtol=0, atol=5e-6)

    @pytest.mark.parametrize("way", [-1, 1])
    @pytest.mark.parametrize("axis", [0, 1])
    def test_the_border_joins_the_inside_without_a_seam(self, way, axis):
        image, field = random_image((8, 9, 3)), uniform((8, 9), 0, 0)
        place = np.indices((8, 9), np.float32)[1 - axis]
        edge = np.float32(0 if way < 0 else image.shape[1 - axis] - 1)
        for at in (edge, *(np.nextafter(edge, edge + side) for side in np.float32([-1, 1]))):
            field[..., axis] = at - place
            expected, hole = naive.gather_bilinear(image, field)
            found, found_hole = gathered(image, field)
            np.testing.assert_array_equal(found_hole, hole)
            np.testing.assert_allclose(found, expected, rtol=0, atol=5e-6)

    def test_the_target_may_have_another_size(self):
        image, field = random_image((9, 12, 4)), random_field((5, 20))
        expected, hole = naive.gather_bilinear(image, field)
        found, found_hole = gathered(image, field)
        np.testing.assert_array_equal(found_hole, hole)
        np.testing.assert_allclose(found, expected, rtol=0, atol=5e-6)

    def test_no_motion_gives_the_image_bit_for_bit(self):
        image = random_image((12, 15, 4)) * np.float32(1e4)
        image[3, 4] = -0.0, 1e-42, 65504.0, -7e30
        found, hole = gathered(image, uniform((12, 15), 0, 0))
        assert found.tobytes() == image.tobytes()
        assert not hole.any()

    @pytest.mark.parametrize(("x", "y"), [(1, 0), (-2, 3), (0, -5)])
    def test_whole_pixels_are_copied_and_the_rest_is_outside(self, x, y):
        image = random_image((12, 15, 3))
        found, hole = gathered(image, uniform((12, 15), x, y))
        rows, columns = np.mgrid[0:12, 0:15]
        inside = (rows + y >= 0) & (rows + y < 12) & (columns + x >= 0) & (columns + x < 15)
        np.testing.assert_array_equal(hole, ~inside)
        np.testing.assert_array_equal(
            found[inside], image[(rows + y)[inside], (columns + x)[inside]]
        )

    @pytest.mark.parametrize("channels", [3, 4])
    @pytest.mark.parametrize("width", [9, 259, 520])
    def test_whole_pixels_are_copied_bit_for_bit(self, width, channels):
        image = random_image((4, width, channels))
        image[::2, ::3] = -0.0
        image[:, 2::5] = 0.0
        found, hole = gathered(image, uniform((4, width), 1, 1))
        assert found[:-1, :-1].tobytes() == image[1:, 1:].tobytes()
        assert not hole[:-1, :-1].any()

    @pytest.mark.parametrize("channels", [3, 4])
    def test_nothing_is_written_behind_a_row(self, channels):
        image = random_image((6, 41, channels))
        field = np.round(8 * random_field((6, 41))) / 8  # any sum is exact
        expected, _ = gathered(image, field)
        around = np.full((6 * 41 + 2) * channels, 7, np.float32)
        out, hole = around[channels:-channels].reshape(image.shape), np.ones((6, 41), np.bool_)
        for rows in (slice(3, 6), slice(0, 3)):  # the lower ones first
            moved = field[rows] + np.float32([0, rows.start])
            gather_bilinear(image, moved, out[rows], hole[rows])
        assert out.tobytes() == expected.tobytes()
        assert (around[:channels] == 7).all() and (around[-channels:] == 7).all()

    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
    def test_a_pixel_that_is_no_number_stays_one_pixel(self, bad):
        image = random_image((12, 15, 4))
        image[5, 6, 3] = bad
        found, hole = gathered(image, uniform((12, 15), 0, 0))
        assert np.argwhere(hole).tolist() == [[5, 6]]
        assert (found[5, 6] == 0).all()

    def test_between_pixels_it_reaches_no_further_than_its_neighbours(self):
        image = random_image((12, 15, 4))
        image[5, 6, 0] = np.nan
        _, hole = gathered(image, uniform((12, 15), 0.25, -0.25))
        inside = hole[1:-1, 1:-1]
        assert np.argwhere(inside).tolist() == [[4, 4], [4, 5], [5, 4], [5, 5]]

    def test_half_a_pixel_outside_still_counts_and_shows_the_edge(self):
        image = random_image((6, 7, 3))
        found, hole = gathered(image, uniform((6, 7), -0.5, 0))
        assert not hole.any()
        np.testing.assert_array_equal(found[:, 0], image[:, 0])
        _, hole = gathered(image, uniform((6, 7), -0.51, 0))
        assert hole[:, 0].all() and not hole[:, 1:].any()

    @settings(derandomize=True, max_examples=25)
    @given(
        st.integers(0, 99),
        st.integers(1, 16),
        st.integers(1, 16),
        st.floats(-1e6, 1e6, width=32),
    )
    def test_a_constant_image_stays_constant(self, seed, height, width, value):
        image = np.full((height, width, 3), value, np.float32)
        found, hole = gathered(image, random_field((height, width), seed))
        # Weights sum to 1 within a rounding of each of the three interpolations.
        np.testing.assert_allclose(found, image, rtol=5e-7)
        assert found.shape == image.shape and hole.dtype == np.bool_

    @settings(derandomize=True, max_examples=25)
    @given(st.integers(0, 99), st.floats(0, 6))
    def test_nothing_leaves_the_range_of_the_image(self, seed, spread):
        image = random_image((9, 10, 3), seed)
        found, _ = gathered(image, random_field((9, 10), seed, spread))
        slack = 1e-5
        assert found.min() >= image.min() - slack and found.max() <= image.max() + slack
