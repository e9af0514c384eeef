"""Frames between two key frames, judged by pictures whose truth is known exactly."""

from __future__ import annotations

import math

import numpy as np
import pytest

from exwarp_cli.domain.frame import GBuffer, Window
from exwarp_cli.synthesis.look_ahead import LookAhead
from exwarp_cli.synthesis.motion_fields import reproject, settle_motion
from exwarp_cli.synthesis.warp import Mover, fill_holes, mix_by_depth, srgb_to_linear
from tests.matrix import combinations, spread
from tests.unit.opaque_shapes import FINE, HEIGHT, WIDTH, View, bar, cut_out, disc, grid, mean

TIMES = (0.25, 0.5, 0.75)


def mixed(pair: tuple[View, View], time: float) -> np.ndarray:
    """Make the frame at a time between two views."""
    fields = reproject(pair[0].gbuffer, time), reproject(pair[1].gbuffer, time - 1)
    return LookAhead((Mover(fields[0]), Mover(fields[1])), time).make(
        pair[0].pixels, pair[1].pixels
    )


@pytest.mark.parametrize(
    ("angle", "distance", "shape"),
    combinations(spread(np.arange(0, 360, 30), 6), (3.3, 9.7, 17.1), (disc, bar)),
)
def test_an_opaque_shape_stays_opaque(shape, angle, distance):
    motion = distance * math.cos(math.radians(angle)), distance * math.sin(math.radians(angle))
    first = (WIDTH / 2 - motion[0] / 2 + 0.3, HEIGHT / 2 - motion[1] / 2 + 0.2)
    last = (first[0] + motion[0], first[1] + motion[1])
    pair = cut_out(shape, first, motion), cut_out(shape, last, motion)
    for time in TIMES:
        at = (first[0] + time * motion[0], first[1] + time * motion[1])
        truth, alpha = cut_out(shape, at, motion), mixed(pair, time)[..., 3]
        assert (alpha[truth.cover > 0.999] > 0.5).all()
        assert alpha[truth.cover > 0.999].mean() > 0.99
        assert alpha.min() >= 0 and alpha.max() <= 1
        assert alpha[truth.cover == 0].mean() < 0.002


RADIUS = 20.0


def ball(at: tuple[float, float], turned: float, turn: float, motion: tuple[float, float]) -> View:
    """Return a ball on nothing that turns about its vertical axis by an angle a key interval."""

    def paint(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        z = np.sqrt(np.maximum(1 - x * x - y * y, 0))
        angle = np.arctan2(
            x * math.cos(turned) - z * math.sin(turned), x * math.sin(turned) + z * math.cos(turned)
        )
        return np.stack([0.5 + 0.3 * np.sin(9 * angle), 0.5 + 0.3 * np.sin(12 * y)], axis=-1)

    y, x = grid(FINE)
    x, y = (x - at[0]) / RADIUS, (y - at[1]) / RADIUS
    inside = (x * x + y * y < 1)[..., None]
    colour, cover = mean(paint(x, y) * inside), mean(inside)
    y, x = grid()
    x, y = (x - at[0]) / RADIUS, (y - at[1]) / RADIUS
    inside, z = x * x + y * y < 1, np.sqrt(np.maximum(1 - x * x - y * y, 0))

    def vectors(way: int) -> np.ndarray:
        across = x * math.cos(way * turn) + z * math.sin(way * turn) - x
        moved = np.stack([RADIUS * across + way * motion[0], way * motion[1] + 0 * x], axis=-1)
        return np.where(inside[..., None], moved, 0).astype(np.float32)

    gbuffer = GBuffer(
        Window(0, 0, WIDTH, HEIGHT),
        depth=np.where(inside, 100 - RADIUS * z, np.inf).astype(np.float32),
        stencil=inside.astype(np.int32),
        to_next=vectors(1),
        to_previous=vectors(-1),
    )
    pixels = np.concatenate([colour, 0.4 * cover, cover], axis=-1).astype(np.float32)
    return View(pixels, settle_motion(gbuffer), cover[..., 0])


@pytest.mark.parametrize(
    ("turn", "motion"), combinations([0.2, 0.5, 0.0], [(0.0, 0.0), (7.0, 3.0), (20.0, 0.0)])
)
def test_a_turning_ball_has_no_pinholes_and_no_ghost(turn, motion):
    first = WIDTH / 2 - motion[0] / 2, HEIGHT / 2 - motion[1] / 2
    last = first[0] + motion[0], first[1] + motion[1]
    pair = ball(first, 0, turn, motion), ball(last, turn, turn, motion)
    for time in TIMES:
        at = first[0] + time * motion[0], first[1] + time * motion[1]
        truth, alpha = ball(at, time * turn, turn, motion), mixed(pair, time)[..., 3]
        inside = truth.cover > 0.999
        assert (alpha[inside] < 0.5).sum() <= 2
        assert alpha[inside].mean() > 0.99
        y, x = grid()
        far = (x - at[0]) ** 2 + (y - at[1]) ** 2 > (RADIUS + 3) ** 2
        assert alpha[far].max() < 0.05


def lit_ground(at: tuple[float, float]) -> View:
    """Return still ground with the shadow of something that is not in the picture."""
    y, x = grid()
    ground = 0.5 + 0.1 * np.sin(x * 1.3) * np.sin(y * 0.9 + x * 0.2)
    light = np.where(mean(disc(grid(FINE)[1] - at[0], grid(FINE)[0] - at[1]))[..., 0] > 0.5, 0.2, 1)
    still = np.zeros((HEIGHT, WIDTH, 2), np.float32)
    gbuffer = GBuffer(
        Window(0, 0, WIDTH, HEIGHT),
        depth=np.full((HEIGHT, WIDTH), 5, np.float32),
        to_next=still,
        to_previous=still.copy(),
    )
    pixels = (ground * light)[..., None].repeat(3, axis=-1).astype(np.float32)
    return View(pixels, gbuffer, light)


@pytest.mark.parametrize("linear", [False, True])
@pytest.mark.parametrize("time", TIMES)
def test_a_shadow_on_still_ground_moves_as_one(time, linear):
    pair, truth = (
        (lit_ground((40, 30)), lit_ground((50, 33))),
        lit_ground((40 + 10 * time, 30 + 3 * time)),
    )
    fields = reproject(pair[0].gbuffer, time), reproject(pair[1].gbuffer, time - 1)
    sides = Mover(fields[0], linear), Mover(fields[1], linear)
    made = LookAhead(sides, time).make(pair[0].pixels, pair[1].pixels)
    movers = [Mover(field) for field in fields]
    sides = [mover.warp(mover.codes(view.pixels)) for mover, view in zip(movers, pair, strict=True)]
    faded = srgb_to_linear(fill_holes(*mix_by_depth(*sides, time)))
    error, plain = (np.abs(frame - truth.pixels).mean() for frame in (made, faded))
    assert error < 0.55 * plain
    assert made[28:34, 40 + round(10 * time)].mean() < 0.15, "the shadow's middle is dark"


def test_a_layer_that_is_made_first_follows_the_light_of_the_beauty():
    pair = lit_ground((40, 30)), lit_ground((50, 33))
    fields = reproject(pair[0].gbuffer, 0.5), reproject(pair[1].gbuffer, -0.5)
    beauty = [view.pixels for view in pair]
    layer = [np.ascontiguousarray(pixels[::-1]) for pixels in beauty]  # shadows elsewhere
    first, second = (
        LookAhead((Mover(fields[0], True), Mover(fields[1], True)), 0.5) for _ in range(2)
    )
    second.make(*beauty)
    expected = second.make(*layer)
    np.testing.assert_array_equal(first.make(*layer, beauty), expected)
