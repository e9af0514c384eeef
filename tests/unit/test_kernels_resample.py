"""Sharp sampling along a motion field."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.domain.colour import SRGB
from exwarp_cli.kernels.resample import PHASES, lanczos_weights
from tests.reference import gather, resample
from tests.unit.kernel_calls import as_light, as_shown, resampled, resampled_alike
from tests.unit.test_kernels_gather import random_field, random_image, uniform


def opaque(image: np.ndarray) -> np.ndarray:
    """Return an image whose fourth channel, alpha, is about 1."""
    image[..., 3:4] = 1 + 0.05 * np.tanh(image[..., 3:4])
    return image


SHAPES = [(1, 1, 3), (1, 9, 4), (17, 13, 3), (20, 31, 4), (40, 7, 1)]


class TestHeld:
    @pytest.mark.parametrize("shape", SHAPES)
    def test_equals_the_naive_twin(self, shape):
        image, field = opaque(random_image(shape)), random_field(shape[:2])
        expected, hole, _ = resample.resample(image, field, PHASES)
        found, found_hole = resampled(image, field)
        np.testing.assert_array_equal(found_hole, hole)
        np.testing.assert_allclose(found, expected, rtol=0, atol=3e-5)

    def test_whole_pixels_are_copied(self):
        image, field = random_image((20, 31, 4)), np.round(random_field((20, 31)))
        expected, hole = gather.gather_bilinear(image, field)
        found, _ = resampled(image, field)
        np.testing.assert_array_equal(found[~hole], expected[~hole].astype(np.float32))

    @pytest.mark.parametrize("x", [0.0, 0.3, 0.5, 0.99])
    def test_one_colour_stays(self, x):
        image = np.full((12, 14, 3), 0.7, np.float32)
        found, _ = resampled(image, uniform((12, 14), x, -x))
        np.testing.assert_allclose(found, image, rtol=1e-6)

    def test_a_broken_pixel_is_no_hole_but_where_bilinear_sampling_sees_it(self):
        image, field = random_image((24, 24, 3)), uniform((24, 24), 0.3, 0.6)
        image[12, 12] = np.nan
        image[5, 6, 1] = np.inf
        expected, hole = gather.gather_bilinear(image, field)
        found, found_hole = resampled(image, field)
        np.testing.assert_array_equal(found_hole, hole)
        assert np.isfinite(found).all()
        near = np.zeros(hole.shape, bool)
        near[9:14, 9:14] = True
        np.testing.assert_allclose(found[near], expected[near], rtol=0, atol=5e-6)

    def test_no_colour_where_the_bound_makes_alpha_zero(self):
        image = np.zeros((16, 16, 4), np.float32)
        image[:, 8:] = 0.3, 0.2, 0.1, 1.0
        image[:, 7] = 0.03, 0.02, 0.01, 0.1
        for x in (0.1, 0.3, 0.5, 0.8):
            for found, *_ in (
                resampled(image, uniform((16, 16), x, 0.2)),
                resampled_alike(image, uniform((16, 16), x, 0.2)),
            ):
                assert (found[found[..., 3] == 0] == 0).all()

    def test_a_ramp_stays_a_ramp(self):
        ramp = np.arange(30, dtype=np.float32)[None, :, None].repeat(9, 0)
        found, _ = resampled(ramp, uniform((9, 30), 0.25, 0.0))
        np.testing.assert_allclose(found[:, 5:-5], ramp[:, 5:-5] + 0.25, atol=0.03)


class TestAlike:
    @pytest.mark.parametrize("shape", SHAPES)
    def test_equals_the_naive_twin(self, shape):
        image, field = opaque(random_image(shape)), random_field(shape[:2])
        _, hole, expected = resample.resample(image, field, PHASES)
        found, found_hole, limit = resampled_alike(image, field)
        np.testing.assert_array_equal(found_hole, hole)
        np.testing.assert_allclose(limit[~hole], expected[~hole], rtol=0, atol=2e-3)
        held, _ = resampled(image, field)
        inside = ~hole & (limit == 1)
        np.testing.assert_allclose(found[inside], held[inside], rtol=0, atol=3e-5)

    def test_what_leads_stays_within_its_neighbours(self):
        image, field = random_image((20, 31, 3)), random_field((20, 31))
        found, hole, _ = resampled_alike(image, field)
        for i, j in np.argwhere(~hole):
            x, y = float(j + field[i, j, 0]), float(i + field[i, j, 1])
            _, around = resample.taps(image, x, y, PHASES)
            assert (found[i, j] >= around.min(axis=0) - 1e-5).all()
            assert (found[i, j] <= around.max(axis=0) + 1e-5).all()

    def test_layers_add_up_to_what_leads(self):
        image, field = np.abs(random_image((20, 31, 3))), random_field((20, 31))
        share = np.random.default_rng(5).random(image.shape).astype(np.float32)
        beauty, _, limit = resampled_alike(image, field)
        layers = [resampled_alike(part * image, field, limit)[0] for part in (share, 1 - share)]
        np.testing.assert_allclose(sum(layers), beauty, rtol=0, atol=1e-5)


def test_weights_add_up_to_one():
    np.testing.assert_allclose(lanczos_weights().sum(axis=1), 1, atol=1e-6)


def test_the_curve_is_that_of_displays_and_leaves_alpha():
    pixels = random_image((9, 12, 4))
    (codes,) = as_shown(pixels)
    np.testing.assert_allclose(codes[..., :3], SRGB.to_code(pixels[..., :3]), rtol=0, atol=1e-6)
    np.testing.assert_array_equal(codes[..., 3], pixels[..., 3])
    np.testing.assert_allclose(as_light(codes)[0], pixels, rtol=3e-6, atol=1e-6)


def test_the_curve_s_straight_part_ends_where_the_standard_has_it():
    codes = np.linspace(-0.06, 0.06, 9 * 12 * 3).astype(np.float32).reshape(9, 12, 3)
    size = np.abs(codes.astype(np.float64))
    linear = np.where(size <= 0.04045, size / 12.92, ((size + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(as_light(codes)[0], np.copysign(linear, codes), rtol=3e-6)
