"""A slot's layers from the key frames', on a scene that is known exactly at every time."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from exwarp_cli.domain.decision import HOLD, WARP
from exwarp_cli.domain.frame import Float32, GBuffer, KeyFrame, Window
from exwarp_cli.domain.motion import AxisMap, MotionConvention
from exwarp_cli.domain.results import FrameKind
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.layer_retiming import (
    LayerMotion,
    LayerRetimer,
    lead_points,
    make_retimer,
    unmoved_sources,
)
from exwarp_cli.synthesis.methods import METHODS, Predicted
from exwarp_cli.synthesis.motion_fields import depth_of, settle_motion
from tests.matrix import combinations
from tests.unit.scenes import SKY, View, town

SLOTS = (1, 2, 3)
BLENDER = MotionConvention(AxisMap(0, 1, 1.0, -1.0), AxisMap(2, 3, -1.0, 1.0))
FAR = np.float32(1e10)
BOX = 3
"""Id of what moves."""


@functools.cache
def view(time: float) -> View:
    return town().view(time)


@functools.cache
def key(index: int) -> KeyFrame:
    frame = view(float(index)).key(1001 + index)
    return replace(frame, gbuffer=settle_motion(geometry(frame)))


def geometry(frame: KeyFrame) -> GBuffer:
    assert frame.gbuffer is not None
    return frame.gbuffer


def interval(lookahead: bool) -> Interval:
    return Interval(key(0), key(1) if lookahead else None, linear=True)


def retimed(name: str, slot: int) -> tuple[LayerRetimer, Predicted]:
    """A slot of a method that needs no network, and its beauty."""
    given = interval(METHODS[name].lookahead)
    shown = METHODS[name].predict(given, slot)
    return make_retimer(given, slot, shown), shown


@functools.cache
def course(lookahead: bool) -> LayerMotion:
    if lookahead:
        return LayerMotion(geometry(key(0)), geometry(key(1)))
    return LayerMotion(geometry(key(0)), None, geometry(key(-1)))


def pair(name: str, layer: str) -> tuple[np.ndarray, np.ndarray | None]:
    """A layer of the key frames that a method sees."""
    keys = key(0), key(1)
    first, second = (np.asarray(getattr(geometry(frame), layer)) for frame in keys)
    return first, second if METHODS[name].lookahead else None


def inner(slot: int, reach: int = 2) -> np.ndarray:
    """bool [H, W]: away from edges, where the truth leaves no doubt."""
    return view(slot / 4).inside(reach)


def moved(name: str, slot: int, layer: str, fixed: bool) -> Float32:
    """Values [H, W, C] of a layer that are brought to the slot's time."""
    made, _ = retimed(name, slot)
    lookahead = METHODS[name].lookahead
    keys = [key(0), key(1) if lookahead else None, None if lookahead else key(-1)]
    layers = tuple(None if k is None else at_least_3d(getattr(geometry(k), layer)) for k in keys)
    return made.moved(course(lookahead), layers, fixed)


def at_least_3d(values: np.ndarray) -> Float32:
    """Channels last, and the sky as renderers write it."""
    out = values if values.ndim == 3 else values[..., None]
    return np.where(np.isinf(out), FAR, out)


class TestColour:
    @pytest.mark.parametrize(
        ("name", "slot"), combinations(["s6", "softsplat", "blend", "hold"], SLOTS)
    )
    def test_the_beauty_as_a_layer_is_the_beauty(self, name, slot):
        made, shown = retimed(name, slot)
        found = made.colour(key(0).image.pixels, key(1).image.pixels)
        assert found.tobytes() == shown.pixels.tobytes()

    @pytest.mark.parametrize("name", ["s6", "softsplat"])
    def test_layers_that_add_up_to_the_beauty_still_do(self, name):
        made, shown = retimed(name, 2)
        share = np.random.default_rng(3).random(key(0).image.pixels.shape).astype(np.float32)
        keys = [frame.image.pixels for frame in (key(0), key(1))]
        one = made.colour(*(share * pixels for pixels in keys))
        other = made.colour(*((1 - share) * pixels for pixels in keys))
        np.testing.assert_allclose(one + other, shown.pixels, atol=2e-6)

    def test_a_layer_of_one_channel_goes_like_the_alpha(self):
        made, shown = retimed("softsplat", 1)
        alphas = [frame.image.pixels[..., 3:] for frame in (key(0), key(1))]
        assert made.colour(*alphas).tobytes() == shown.pixels[..., 3:].tobytes()


class TestManner:
    def of(self, path: str, slot: int) -> LayerRetimer:
        """Retiming of a slot of one of the paper's paths, as if a network had been there."""
        pixels, maker = key(0).image.pixels, HOLD if (path, slot) == ("s1", 1) else WARP
        shown = Predicted(pixels, FrameKind.GENERATED, path, (1001,), maker)
        return make_retimer(interval(lookahead=False), slot, shown)

    def test_a_dropped_slot_repeats_the_key_frame(self):
        made = self.of("s1", 1)
        assert made.warp is None and made.time == 0
        np.testing.assert_array_equal(made.sources.pixel, unmoved_sources((80, 128)).pixel)

    def test_a_dropped_slot_repeats_the_slot_before(self):
        made = self.of("s1", 3)
        assert made.warp is not None and made.time == 0.5

    @pytest.mark.parametrize("path", ["s2", "s3", "s6"])
    def test_where_a_network_made_the_beauty_layers_are_moved(self, path):
        made = self.of(path, 3)
        assert made.warp is not None and made.time == 0.75

    def test_a_warp_goes_beyond_the_slots_of_the_paper(self):
        times = tuple(i / 8 for i in range(1, 8))
        given = replace(interval(lookahead=False), times=times)
        shown = Predicted(key(0).image.pixels, FrameKind.GENERATED, "s6", (1001,), WARP)
        made = make_retimer(given, 7, shown)
        assert made.warp is not None and made.time == 7 / 8

    @pytest.mark.parametrize(("slot", "later"), [(1, False), (2, False), (3, True)])
    def test_a_cross_fade_takes_ids_from_the_nearer_key_frame(self, slot, later):
        made, _ = retimed("blend", slot)
        ids = [geometry(frame).stencil for frame in (key(0), key(1))]
        np.testing.assert_array_equal(made.sources.take(*ids), ids[later])
        assert made.warp is None and made.mixer is None and made.time == slot / 4

    def test_a_network_that_interpolates_goes_with_blended_layers(self):
        given = interval(lookahead=True)
        shown = Predicted(key(0).image.pixels, FrameKind.GENERATED, "onnx", (1, 2), "interpolate")
        assert make_retimer(given, 2, shown).mixer is not None

    def test_without_motion_its_layers_are_cross_faded(self):
        given = replace(
            interval(lookahead=True),
            key=key(0).without("to_previous", "to_next"),
            following=key(1).without("to_previous", "to_next"),
        )
        shown = Predicted(key(0).image.pixels, FrameKind.GENERATED, "onnx", (1, 2), "interpolate")
        made = make_retimer(given, 2, shown)
        assert made.warp is None and made.mixer is None and made.time == 0.5


class TestData:
    @pytest.mark.parametrize(("name", "slot"), combinations(["s6", "softsplat"], SLOTS))
    def test_ids_are_those_of_the_surfaces(self, name, slot):
        made, _ = retimed(name, slot)
        found, true = made.sources.take(*pair(name, "stencil")), view(slot / 4).gbuffer().stencil
        assert set(np.unique(found)) <= {0, BOX}
        assert (found != true).mean() < 0.01
        assert (found[inner(slot)] == true[inner(slot)]).mean() > 0.999

    def test_ids_above_float32_keep_every_bit(self):
        made, _ = retimed("softsplat", 2)
        ids = np.arange(80 * 128, dtype=np.uint32).reshape(80, 128) + np.uint32(2**31 + 1)
        found = made.sources.take(ids, ids + np.uint32(20000))
        assert found.dtype == np.uint32
        expected = made.sources.pixel + np.uint32(2**31 + 1) + 20000 * made.sources.later
        np.testing.assert_array_equal(found, expected)

    @pytest.mark.parametrize("name", ["s6", "softsplat"])
    def test_all_channels_and_layers_come_from_one_pixel(self, name):
        made, _ = retimed(name, 3)
        rng = np.random.default_rng(5)
        rank = [rng.random((80, 128, 4)).astype(np.float32) for _ in range(2)]
        found = made.sources.take(*rank)
        pixels = {tuple(p): k for k in range(2) for p in rank[k].reshape(-1, 4)}
        sides = np.array([pixels[tuple(p)] for p in found.reshape(-1, 4)]).reshape(80, 128)
        np.testing.assert_array_equal(sides, made.sources.later)

    @pytest.mark.parametrize(("name", "slot"), combinations(["s6", "softsplat"], SLOTS))
    def test_normals_keep_their_length(self, name, slot):
        made, _ = retimed(name, slot)
        normals = made.sources.take(*pair(name, "normal"))
        lengths = np.linalg.norm(normals, axis=-1)
        assert np.isclose(lengths, 1, atol=1e-5).sum() + (lengths == 0).sum() == lengths.size

    def test_holes_of_a_causal_slot_show_what_lies_behind(self):
        made, _ = retimed("s6", 3)
        ids = made.sources.take(*pair("s6", "stencil"))
        assert made.sources.hole.sum() > 20
        assert (ids[made.sources.hole] == BOX).mean() < 0.1

    def test_values_that_are_no_numbers_are_copied_too(self):
        made, _ = retimed("s6", 1)
        layer = np.full((80, 128, 1), np.nan, np.float32)
        assert np.isnan(made.sources.take(layer)).all()


class TestMoved:
    @pytest.mark.parametrize("name", ["s6", "softsplat"])
    @pytest.mark.parametrize("slot", SLOTS)
    def test_static_points_stay_exactly_where_they_are(self, name, slot):
        made, _ = retimed(name, slot)
        found, source = (
            moved(name, slot, "position", True),
            made.sources.take(*pair(name, "position")),
        )
        static = made.sources.take(*pair(name, "stencil")) == 0
        np.testing.assert_array_equal(found[static], source[static])

    @pytest.mark.parametrize("name", ["s6", "softsplat"])
    @pytest.mark.parametrize("slot", SLOTS)
    def test_moving_points_are_where_they_are_at_the_slot(self, name, slot):
        made, _ = retimed(name, slot)
        box = inner(slot, 3) & (made.sources.take(*pair(name, "stencil")) == BOX)
        box &= view(slot / 4).gbuffer().stencil == BOX
        true = view(slot / 4).world(slot / 4)
        away = np.linalg.norm(moved(name, slot, "position", True) - true, axis=-1)[box]
        left = np.linalg.norm(made.sources.take(*pair(name, "position")) - true, axis=-1)[box]
        assert box.sum() > 100
        assert np.median(away) < 0.03 < 0.06 < np.median(left)

    @pytest.mark.parametrize("name", ["s6", "softsplat"])
    def test_depth_is_that_of_the_slot(self, name):
        made, _ = retimed(name, 2)
        true, where = view(0.5).depth, inner(2, 3) & np.isfinite(view(0.5).depth)
        found = moved(name, 2, "depth", False)[..., 0]
        keys = [at_least_3d(geometry(k).depth)[..., 0] for k in (key(0), key(1))]
        source = made.sources.take(*keys)
        error, still = (np.abs(d / true - 1)[where] for d in (found, source))
        assert np.median(error) < 0.5 * np.median(still)

    def test_the_sky_keeps_its_depth(self):
        sky = inner(2, 3) & (view(0.5).surface == SKY)
        found = moved("softsplat", 2, "depth", False)[..., 0]
        assert sky.sum() > 500 and (found[sky] == FAR).all()

    def test_without_an_older_key_frame_points_stay_as_in_the_source(self):
        made, _ = retimed("s6", 3)
        position = geometry(key(0)).position
        found = made.moved(LayerMotion(geometry(key(0))), (position, None, None), True)
        np.testing.assert_array_equal(found, made.sources.take(position))

    def test_a_repeat_changes_nothing(self):
        made, _ = retimed("hold", 2)
        position = geometry(key(0)).position
        found = made.moved(course(True), (position, geometry(key(1)).position, None), True)
        np.testing.assert_array_equal(found, position)

    def test_what_the_other_key_frame_does_not_show_stays(self):
        passage, _ = course(True).across
        assert passage.lost.any()
        here, there = (geometry(key(k)).position for k in (0, 1))
        assert (passage.change(here, there, True)[passage.lost] == 0).all()

    def test_a_thin_wire_is_not_taken_for_what_is_behind_it(self):
        columns = np.broadcast_to(np.arange(9, dtype=np.float32), (6, 9))
        rows = np.broadcast_to(np.arange(6, dtype=np.float32)[:, None], (6, 9))

        def frame(wire: int) -> GBuffer:
            depth = np.full((6, 9), 20, np.float32)
            depth[:, wire] = 10
            position = np.stack([columns * depth / 9, rows * depth / 9, depth], -1)
            still = np.zeros((6, 9, 2), np.float32)
            ids = np.zeros((6, 9), np.int32)
            return GBuffer(Window(0, 0, 9, 6), depth, None, position, ids, still, still)

        here, there = frame(4), frame(1)
        lost = lead_points(here, there, 1)
        change = lost.change(here.depth[..., None], there.depth[..., None], False)
        assert lost.lost[:, 4].all()
        assert (change == 0).all()


def raw_vectors(index: int) -> Float32:
    """The motion channels as Blender writes them; 0 in the sky."""
    gbuffer = view(float(index)).gbuffer()
    before, after = gbuffer.to_previous, gbuffer.to_next
    return np.stack([before[..., 0], -before[..., 1], -after[..., 0], after[..., 1]], -1)


class TestVectors:
    @pytest.mark.parametrize("name", ["s6", "softsplat"])
    @pytest.mark.parametrize("slot", SLOTS)
    def test_they_lead_from_the_slot_one_key_interval_either_way(self, name, slot):
        made, _ = retimed(name, slot)
        both = METHODS[name].lookahead
        layers = raw_vectors(0), raw_vectors(1) if both else None
        time = slot / 4
        where = inner(slot, 3) & (view(time).surface != SKY) & ~made.sources.hole
        found = made.vectors(BLENDER, *layers)
        true = view(time).motion_to(time - 1), view(time).motion_to(time + 1)
        for axes, wanted in zip((BLENDER.to_previous, BLENDER.to_next), true, strict=True):
            error, left = (
                np.abs(axes.apply(raw) - wanted).max(axis=-1)[where]
                for raw in (found, made.sources.take(*layers))
            )
            assert np.median(error) < 0.05
            assert error.mean() < 0.6 * left.mean()

    def test_the_sky_keeps_its_zeros(self):
        made, _ = retimed("softsplat", 2)
        found = made.vectors(BLENDER, raw_vectors(0), raw_vectors(1))
        sky = inner(2, 3) & (view(0.5).surface == SKY)
        assert (found[sky] == 0).all()

    def test_vectors_one_way_stay_at_constant_velocity(self):
        made, _ = retimed("softsplat", 2)
        raw = [raw_vectors(k) for k in (0, 1)]
        found = made.vectors(MotionConvention(to_next=BLENDER.to_next), *raw)
        np.testing.assert_array_equal(found, made.sources.take(*raw))

    def test_vectors_at_constant_velocity_keep_every_bit(self):
        made, _ = retimed("softsplat", 2)
        rng = np.random.default_rng(7)
        raw = [rng.uniform(0.01, 0.19, (80, 128, 2)).astype(np.float32) for _ in range(2)]
        found = made.vectors(
            MotionConvention(AxisMap(0, 1, 3.7, -3.7, 0.1), AxisMap(0, 1, -3.7, 3.7, 0.1)), *raw
        )
        np.testing.assert_array_equal(found, made.sources.take(*raw))

    def test_unusable_vectors_stay(self):
        made, _ = retimed("s6", 2)
        raw = raw_vectors(0)
        raw[::2] = np.nan
        found = made.vectors(BLENDER, raw)
        np.testing.assert_array_equal(np.isnan(found), np.isnan(made.sources.take(raw)))

    @pytest.mark.parametrize(
        "convention",
        [
            MotionConvention(AxisMap(0, 1, 64, -40, still=0.5), AxisMap(2, 3, -64, 40, still=0.5)),
            MotionConvention(AxisMap(0, 1, 128, 80), AxisMap(2, 3, 0.5, -0.5)),
        ],
    )
    def test_any_convention_is_written_as_it_is_read(self, convention):
        made, _ = retimed("softsplat", 1)
        frames = [view(float(k)).gbuffer() for k in (0, 1)]
        blank = np.zeros((80, 128, 4), np.float32)
        raw = [
            convention.to_next.write(g.to_next, convention.to_previous.write(g.to_previous, blank))
            for g in frames
        ]
        found = made.vectors(convention, *raw)
        blender = made.vectors(BLENDER, raw_vectors(0), raw_vectors(1))
        for way in ("to_previous", "to_next"):
            mine, wanted = getattr(convention, way), getattr(BLENDER, way)
            np.testing.assert_allclose(mine.apply(found), wanted.apply(blender), atol=2e-4)


def test_sources_do_not_depend_on_depth_being_known():
    frame = key(0).without("depth")
    given = Interval(frame)
    shown = METHODS["s6"].predict(given, 2)
    made = make_retimer(given, 2, shown)
    assert (depth_of(geometry(frame)) > 0).all()
    ids = made.sources.take(geometry(frame).stencil)
    assert (ids == view(0.5).gbuffer().stencil)[inner(2)].mean() > 0.98
