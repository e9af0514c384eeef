"""Pixels beside the edges of what moves, judged by pictures whose truth is known exactly."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from exwarp_cli.domain.frame import Float32, GBuffer, Image, KeyFrame
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.look_ahead import LookAhead
from exwarp_cli.synthesis.methods import METHODS
from exwarp_cli.synthesis.motion_fields import reproject
from exwarp_cli.synthesis.residual_flow import CarriedLight
from exwarp_cli.synthesis.trajectory import displacement
from exwarp_cli.synthesis.warp import Coverage, CoverageSide, Mover
from tests.matrix import combinations, spread
from tests.unit.opaque_shapes import (
    FINE,
    HEIGHT,
    WIDTH,
    Pair,
    Shape,
    View,
    bar,
    cut_out,
    disc,
    over_ground,
)

TIMES = (0.25, 0.5, 0.75)
DRIFT = (1.3, 0.6)
STILL = (0.0, 0.0)
LIMIT = 0.8
"""Of the squared error at outlines: coverage leaves 56 to 75 % of it."""

each_way = pytest.mark.parametrize("sides", [1, 2], ids=["one side", "both sides"])
each_shape_and_way = pytest.mark.parametrize(("shape", "sides"), combinations([disc, bar], [2, 1]))
each_way_and_light = pytest.mark.parametrize(
    ("sides", "linear"), combinations([1, 2], [False, True])
)


class Shot:
    """An opaque shape that moves straight on in a key interval, over ground that drifts."""

    def __init__(self, shape: Shape, motion: Pair, drift: Pair = DRIFT) -> None:
        self.shape, self.motion, self.drift = shape, motion, drift

    def view(self, time: float, fine: int = FINE) -> View:
        """Return the picture at a time; with `fine` of 1 it is not antialiased."""
        x, y = (
            middle + (time - 0.5) * step + off
            for middle, step, off in zip(
                (WIDTH / 2, HEIGHT / 2), self.motion, (0.3, 0.2), strict=True
            )
        )
        return over_ground(self.shape, (x, y), self.motion, self.drift, time, fine)


def make(
    views: tuple[View, ...],
    time: float,
    linear: bool = False,
    covered: bool = True,
    shares: tuple[Float32, ...] = (),
) -> Float32:
    """Make a slot from one or two key frames; with `shares`, as the sum of the beauty's layers."""
    times = (time, time - 1)[: len(views)]
    fields = [reproject(view.gbuffer, at) for view, at in zip(views, times, strict=True)]
    moved = zip(views, times, strict=True)
    sides = [CoverageSide(view.gbuffer, displacement(view.gbuffer, at)) for view, at in moved]
    coverage = Coverage(sides, fields, time, linear) if covered else None
    if len(views) == 1:
        how = CarriedLight(Mover(fields[0], linear), None, coverage)
    else:
        movers = Mover(fields[0], linear), Mover(fields[1], linear)
        how = LookAhead(movers, time, coverage)
    made = how.make(*(view.pixels for view in views))
    if not shares:
        return made
    layers = [how.make(*(share * view.pixels for view in views)) for share in shares]
    return np.sum(layers, axis=0)


def motions(distance: float) -> list[Pair]:
    angles = map(math.radians, (0, 37, 70, 130, 200, 290))
    return [(distance * math.cos(angle), distance * math.sin(angle)) for angle in angles]


@each_shape_and_way
def test_the_outline_of_a_moving_shape_is_antialiased(shape, sides):
    """Of key frames whose pixels have the colour at their centres."""
    hard, covered = [], []
    for motion in spread(motions(2.6) + motions(9.7), 6):
        shot = Shot(shape, motion)
        views = tuple(shot.view(float(i), fine=1) for i in range(sides))
        for time in (0.25, 0.5):
            truth = shot.view(time)
            outline = (truth.cover > 0.02) & (truth.cover < 0.98)
            for errors, is_covered in ((hard, False), (covered, True)):
                found = make(views, time, linear=True, covered=is_covered)
                errors.append(np.square(found - truth.pixels)[outline].mean())
    assert np.mean(covered) < LIMIT * np.mean(hard)


@each_way_and_light
def test_a_still_scene_is_unchanged(sides, linear):
    view = Shot(disc, STILL, STILL).view(0)
    np.testing.assert_allclose(make((view,) * sides, 0.25, linear), view.pixels, atol=1e-6)


@each_way
def test_what_moves_as_one_keeps_its_edges(sides):
    shot = Shot(disc, DRIFT, DRIFT)
    views = tuple(shot.view(float(i)) for i in range(sides))
    inside = np.s_[4:-4, 4:-4]  # the frame's border shows holes
    plain = make(views, 0.5, covered=False)
    np.testing.assert_array_equal(make(views, 0.5)[inside], plain[inside])


@pytest.mark.parametrize(
    ("shape", "sides", "linear"), combinations([disc, bar], [1, 2], [False, True])
)
def test_an_opaque_picture_stays_opaque(shape, sides, linear):
    shot = Shot(shape, (7.3, 4.1))
    views = tuple(shot.view(float(i)) for i in range(sides))
    ones = tuple(replace(view, pixels=np.ones_like(view.pixels)) for view in views)
    for time in TIMES:
        np.testing.assert_allclose(make(ones, time, linear), 1, atol=2e-6)


@each_shape_and_way
def test_no_pinhole_inside_an_opaque_shape(shape, sides):
    for motion in motions(9.7):
        first = WIDTH / 2 - motion[0] / 2, HEIGHT / 2 - motion[1] / 2
        places = [(first[0] + t * motion[0], first[1] + t * motion[1]) for t in (0, 1, 0.5)]
        *views, truth = (cut_out(shape, at, motion) for at in places)
        alpha = make(tuple(views[:sides]), 0.5)[..., 3]
        around = np.lib.stride_tricks.sliding_window_view(np.pad(truth.cover, 1), (3, 3))
        within = around.min(axis=(2, 3)) > 0.999
        assert within.sum() > 20
        assert alpha[within].min() > 0.97  # beside the outline; 1 further inside
        assert alpha.min() >= 0 and alpha.max() <= 1 + 1e-6


@each_way_and_light
def test_no_colour_is_beyond_those_of_the_key_frames(sides, linear):
    shot = Shot(bar, (7.3, 4.1))
    views = tuple(shot.view(float(i)) for i in range(sides))
    ends = [end([end(v.pixels, axis=(0, 1)) for v in views], axis=0) for end in (np.min, np.max)]
    for time in TIMES:
        found = make(views, time, linear)
        assert (found >= ends[0] - 1e-5).all() and (found <= ends[1] + 1e-5).all()


def test_the_largest_floats_stay_finite():
    view = Shot(disc, (7.3, 4.1)).view(0)
    huge = replace(view, pixels=np.full_like(view.pixels, 1.5e38))
    assert np.isfinite(make((huge,), 0.5, linear=True)).all()


@each_shape_and_way
def test_layers_that_add_up_to_the_beauty_still_do(shape, sides):
    shot = Shot(shape, (7.3, 4.1))
    views = tuple(shot.view(float(i)) for i in range(sides))
    share = np.random.default_rng(3).random(views[0].pixels.shape).astype(np.float32)
    layers = make(views, 0.5, linear=True, shares=(share, 1 - share))
    beauty = make(views, 0.5, linear=True)
    np.testing.assert_allclose(layers, beauty, atol=2e-6)
    assert np.abs(beauty - make(views, 0.5, linear=True, covered=False)).max() > 0.05


def key(view: View, number: int) -> KeyFrame:
    window = view.gbuffer.window
    return KeyFrame(number, Image(view.pixels, window, window), view.gbuffer)


@pytest.mark.parametrize(("name", "sides"), [("s6", 1), ("softsplat", 2)])
def test_only_rendered_motion_tells_what_covers_a_pixel(name, sides):
    """Estimated motion has no depth."""
    shot = Shot(disc, (7.3, 4.1))
    views = tuple(shot.view(float(i)) for i in range(sides))
    given = Interval(*(key(view, i) for i, view in enumerate(views, start=1)))
    found = METHODS[name].predict(given, 2).pixels
    np.testing.assert_array_equal(found, make(views, 0.5))
    assert np.abs(found - make(views, 0.5, covered=False)).max() > 0.05
    estimated = METHODS[name].predict(replace(given, estimated=True), 2).pixels
    np.testing.assert_array_equal(estimated, make(views, 0.5, covered=False))


@pytest.mark.parametrize(("name", "sides"), [("s6", 1), ("softsplat", 2)])
def test_motion_through_slots_covers_pixels_as_the_key_frames_own_does(name, sides):
    """What moves evenly ends in the same places, but at edges, where vectors of slots differ."""
    shot = Shot(disc, (7.3, 4.1))
    views = tuple(shot.view(float(i)) for i in range(sides))
    plain = Interval(*(key(view, i) for i, view in enumerate(views, start=1)))
    slots = tuple(slot_steps(shot.view(slot / 4)) for slot in (1, 2, 3))
    by_slots = replace(plain, slots=slots)
    truth = shot.view(0.5).pixels
    found, wanted = (METHODS[name].predict(given, 2).pixels for given in (by_slots, plain))
    assert np.abs(found - truth).mean() < 1.1 * np.abs(wanted - truth).mean()
    assert np.abs(found - make(views, 0.5, covered=False)).max() > 0.05


@pytest.mark.parametrize("slot", [1, 2, 3])
def test_beside_slots_a_key_frame_moves_by_its_vectors_of_that_way(slot):
    shot = Shot(disc, (7.3, 4.1))
    before, after = (shot.view(float(i)) for i in range(2))
    started = replace(before.gbuffer, to_previous=np.zeros_like(before.gbuffer.to_next))
    stopping = replace(after.gbuffer, to_next=np.zeros_like(after.gbuffer.to_next))
    slots = tuple(slot_steps(shot.view(slot / 4)) for slot in (1, 2, 3))
    frames = (replace(before, gbuffer=started), replace(after, gbuffer=stopping))
    given = Interval(*(key(view, i) for i, view in enumerate(frames, start=1)), slots)
    found = METHODS["softsplat"].predict(given, slot).pixels
    assert np.abs(found - shot.view(slot / 4).pixels).mean() < 0.003  # 0.0065 to 0.01 by the other


def slot_steps(view: View) -> GBuffer:
    """Return the geometry of a picture with vectors from slot to slot."""
    ways = {way: getattr(view.gbuffer, way) / 4 for way in ("to_previous", "to_next")}
    return replace(view.gbuffer, **ways)
