"""Warps from one key frame, where light moves over surfaces whose frames are known exactly."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from exwarp_cli.domain.frame import Float32, GBuffer, Image, KeyFrame, Window
from exwarp_cli.synthesis.history import Past, past_of
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import METHODS
from exwarp_cli.synthesis.retime import retiming

HEIGHT, WIDTH = 72, 112
WINDOW = Window(0, 0, WIDTH, HEIGHT)
Pair = tuple[float, float]
START, STEP = (50.0, 34.0), (8.0, 4.0)
"""Where the shadow is in the older key frame, and how far it moves in a key interval."""


def shadow_at(time: float, step: Pair = STEP) -> Float32:
    """Return the share of light, float32 [H, W], under a soft round shadow."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    x, y = x - START[0] - time * step[0], y - START[1] - time * step[1]
    cover = 1 / (1 + np.exp(np.sqrt(x * x + y * y) - 13))
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
    return Interval(key, past=past_of([key, older]))


def alone(given: Interval) -> Interval:
    return replace(given, past=())


def made(given: Interval, slot: int) -> Float32:
    return METHODS["s6"].predict(given, slot).pixels


def error(found: Float32, slot: int, step: Pair) -> float:
    truth = ground(9, shadow_at(1 + slot / 4, step)).image.pixels
    return float(np.abs(found - truth).mean())


@pytest.mark.parametrize("angle", range(0, 360, 30))
@pytest.mark.parametrize("slot", [1, 2, 3])
def test_a_shadow_on_still_ground_goes_on_at_its_speed(angle, slot):
    turned = math.radians(angle)
    step = (8 * math.cos(turned), 8 * math.sin(turned))
    given = interval(step)
    gain = error(made(given, slot), slot, step) / error(made(alone(given), slot), slot, step)
    print(angle, slot, gain)
    assert gain < 0.5


def test_light_that_adds_up_to_the_beauty_still_does():
    given = replace(interval(), linear=True)
    shown = METHODS["s6"].predict(given, 3)
    how = retiming(given, 3, shown)
    pixels = given.key.image.pixels
    share = np.random.default_rng(3).random(pixels.shape).astype(np.float32)
    parts = how.colour(share * pixels) + how.colour((1 - share) * pixels)
    np.testing.assert_allclose(parts, shown.pixels, atol=2e-6)
    assert np.abs(shown.pixels - made(replace(alone(given), linear=True), 3)).max() > 0.1
