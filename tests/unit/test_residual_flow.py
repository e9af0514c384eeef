"""Warps from one key frame, where light moves over surfaces whose frames are known exactly."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from exwarp_cli.domain.frame import Float32, GBuffer, Image, KeyFrame, Window
from exwarp_cli.synthesis.history import older_key_frames
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.layer_retiming import make_retimer
from exwarp_cli.synthesis.methods import METHODS
from tests.matrix import combinations

HEIGHT, WIDTH = 72, 112
WINDOW = Window(0, 0, WIDTH, HEIGHT)
Pair = tuple[float, float]
START, STEP = (50.0, 34.0), (8.0, 4.0)
"""Where the shadow is in the older key frame, and how far it moves in a key interval."""


def shadow_at(time: float, step: Pair = STEP, radius: float = 13) -> Float32:
    """Return the share of light, float32 [H, W], under a soft round shadow."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    x, y = x - START[0] - time * step[0], y - START[1] - time * step[1]
    cover = 1 / (1 + np.exp(np.sqrt(x * x + y * y) - radius))
    return np.asarray(1 - 0.8 * cover, np.float32)


def ground(number: int, light: Float32, walls: tuple[int, ...] = ()) -> KeyFrame:
    """Return still ground in some light, with nearer columns of pixels in front of it."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    colour = 0.5 + 0.05 * np.sin(x * 0.7) * np.sin(y * 0.5)
    pixels = np.stack([colour * light, 0.8 * colour * light, 0.6 * colour * light], axis=-1)
    depth = np.full((HEIGHT, WIDTH), 5, np.float32)
    for column in walls:
        depth[:, column : column + 6] = 2
        pixels[:, column : column + 6] = 0.9
    still = np.zeros((HEIGHT, WIDTH, 2), np.float32)
    gbuffer = GBuffer(WINDOW, depth=depth, to_next=still, to_previous=still.copy())
    return KeyFrame(number, Image(pixels.astype(np.float32), WINDOW, WINDOW), gbuffer)


def interval(step: Pair = STEP, walls: tuple[int, ...] = ()) -> Interval:
    """Return the interval after the second of two key frames."""
    older, key = (ground(1 + i, shadow_at(i, step), walls) for i in (0, 1))
    return Interval(key, past=older_key_frames([key, older]))


def alone(given: Interval) -> Interval:
    return replace(given, past=())


def made(given: Interval, slot: int) -> Float32:
    return METHODS["s6"].predict(given, slot).pixels


def error(found: Float32, slot: int, step: Pair) -> float:
    truth = ground(9, shadow_at(1 + slot / 4, step)).image.pixels
    return float(np.abs(found - truth).mean())


@pytest.mark.parametrize(("angle", "slot"), combinations(list(range(0, 360, 30)), [1, 2, 3]))
def test_a_shadow_on_still_ground_goes_on_at_its_speed(angle, slot):
    turned = math.radians(angle)
    step = (8 * math.cos(turned), 8 * math.sin(turned))
    given = interval(step)
    assert error(made(given, slot), slot, step) < 0.55 * error(made(alone(given), slot), slot, step)


def test_a_shadow_that_moves_by_more_than_its_width_leaves_nothing_behind():
    lights = [shadow_at(time, (14.0, 0.0), radius=6) for time in (0, 1, 1.75)]
    older, key, truth = (ground(1 + i, light) for i, light in enumerate(lights))
    given = Interval(key, past=older_key_frames([key, older]))
    behind = np.s_[24:45, 50:64]
    carried, plain, true = (
        pixels[behind] for pixels in (made(given, 3), made(alone(given), 3), truth.image.pixels)
    )
    assert np.abs(carried - true).mean() < 0.4 * np.abs(plain - true).mean()


def test_light_that_adds_up_to_the_beauty_still_does():
    given = replace(interval(), linear=True)
    shown = METHODS["s6"].predict(given, 3)
    how = make_retimer(given, 3, shown)
    pixels = given.key.image.pixels
    share = np.random.default_rng(3).random(pixels.shape).astype(np.float32)
    parts = how.colour(share * pixels) + how.colour((1 - share) * pixels)
    np.testing.assert_allclose(parts, shown.pixels, atol=2e-6)
    assert np.abs(shown.pixels - made(replace(alone(given), linear=True), 3)).max() > 0.1


def test_an_alpha_goes_with_its_colour():
    def opaque(frame: KeyFrame) -> KeyFrame:
        alpha = frame.image.pixels[..., :1] / frame.image.pixels[..., :1].max()
        return with_pixels(frame, np.concatenate([frame.image.pixels, alpha], axis=-1))

    given = interval()
    older = replace(given.past[0], frame=opaque(given.past[0].frame))
    found = made(replace(given, key=opaque(given.key), past=(older,)), 3)
    shade = found[..., 0] / opaque(given.key).image.pixels[..., 0].max()
    assert np.abs(found[..., 3] - alone_alpha(given)).max() > 0.2, "the alpha moved, too"
    np.testing.assert_allclose(found[..., 3], shade, atol=0.1)


def alone_alpha(given: Interval) -> Float32:
    red = made(alone(given), 3)[..., 0]
    return np.asarray(red / given.key.image.pixels[..., 0].max(), np.float32)


def with_pixels(frame: KeyFrame, pixels: Float32) -> KeyFrame:
    return replace(frame, image=replace(frame.image, pixels=pixels))


@pytest.mark.parametrize("change", ["after_hold", "estimated"])
def test_light_that_stood_or_whose_surfaces_are_not_known_stays(change):
    given = interval()
    kept = replace(given, **{change: True})
    np.testing.assert_array_equal(made(kept, 2), made(alone(given), 2))
    assert np.abs(made(given, 2) - made(kept, 2)).max() > 0.1


def test_still_light_changes_nothing():
    given = interval((0.0, 0.0))
    np.testing.assert_array_equal(made(given, 3), made(alone(given), 3))


def test_what_is_made_lies_between_what_was_rendered():
    given = interval()
    found, pixels = made(given, 3), given.key.image.pixels
    assert found.min() >= pixels.min() - 1e-6 and found.max() <= pixels.max() + 1e-6


def test_light_of_the_ground_is_not_taken_from_what_stands_before_it():
    """The walls are never in the shadow, and have no shadow's colour about them."""
    walls = (28, 80)
    given = interval(walls=walls)
    for slot in (1, 2, 3):
        found, plain = made(given, slot), made(alone(given), slot)
        for column in walls:
            near = slice(column, column + 6)
            np.testing.assert_allclose(found[:, near], plain[:, near], atol=1e-6)
        truth = ground(9, shadow_at(1 + slot / 4), walls).image.pixels
        assert np.abs(found - truth).mean() < 0.8 * np.abs(plain - truth).mean()


def test_vectors_to_the_next_key_frame_alone_lead_the_older_one():
    """Speed that changes is no light that moves: the older key frame's own vectors tell."""
    given = interval()

    def forward(frame: KeyFrame, step: float) -> KeyFrame:
        vectors = np.full((HEIGHT, WIDTH, 2), (step, 0), np.float32)
        gbuffer = replace(frame.gbuffer, to_previous=None, to_next=vectors)
        return replace(frame, gbuffer=gbuffer)

    picture = given.key
    moved = with_pixels(picture, np.roll(picture.image.pixels, 2, axis=1))
    keys = forward(moved, 6), forward(picture, 2)
    found = Interval(keys[0], past=older_key_frames(keys))
    np.testing.assert_array_equal(made(found, 2)[:, 20:-20], made(alone(found), 2)[:, 20:-20])


def test_nothing_is_followed_in_a_key_frame_without_finite_colour():
    given = interval()
    pixels = given.key.image.pixels.copy()
    pixels[30:40, 50:60] = np.nan
    pixels[10, 10] = np.inf
    found = made(replace(given, key=with_pixels(given.key, pixels)), 3)
    assert np.isfinite(found).all()
