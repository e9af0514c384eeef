"""The methods by name, on a scene whose frames are known at every time."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from exwarp_cli.domain.frame import Float32, KeyFrame, combine_3x3
from exwarp_cli.domain.results import FrameKind
from exwarp_cli.errors import LayoutError
from exwarp_cli.pipeline.key_frames import over_interval
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import EXWARP, METHODS, DecisionSource, Predicted
from exwarp_cli.synthesis.motion_fields import settle_motion
from exwarp_cli.synthesis.warp import Warped, fill_holes, fill_nonfinite, mix_by_depth
from tests.matrix import combinations
from tests.unit.scenes import View, town

SLOTS = (1, 2, 3)
ALONE = [m.name for m in METHODS.values() if not (m.extrapolates or m.interpolates)]
"""Methods that need no network; `test_paths` has those that extrapolate."""


@functools.cache
def view(time: float) -> View:
    return town().view(time)


@functools.cache
def key(index: int) -> KeyFrame:
    frame = view(float(index)).key(1001 + index)
    assert frame.gbuffer is not None
    return replace(frame, gbuffer=settle_motion(frame.gbuffer))


def with_pixels(frame: KeyFrame, pixels: Float32) -> KeyFrame:
    return replace(frame, image=replace(frame.image, pixels=pixels))


def interval(lookahead: bool = True) -> Interval:
    return Interval(key(0), key(1) if lookahead else None)


def predict(name: str, given: Interval, slot: int) -> Predicted:
    return METHODS[name].predict(given, slot)


def error(found: Predicted, slot: int, where: np.ndarray | None = None) -> float:
    """Mean absolute error of colour against the true frame."""
    gap = np.abs(found.pixels - view(slot / 4).colour)
    return float(gap.mean() if where is None else gap[where].mean())


class TestRegistry:
    def test_names_and_needs(self):
        table = {m.name: (m.lookahead, m.needs_motion, m.path, m.judge) for m in METHODS.values()}
        assert table == {
            "exwarp": (True, True, None, None),
            "causal": (False, True, None, DecisionSource.TILES),
            **{f"s{i}": (False, True, f"S{i}", None) for i in range(1, 6)},
            "s6": (False, True, "S6", None),
            "oracle": (False, True, None, DecisionSource.PSNR),
            "oracle-return": (False, True, None, DecisionSource.RETURN),
            "softsplat": (True, True, None, None),
            "lookahead": (True, True, None, None),
            "onnx": (True, False, None, None),
            "blend": (True, False, None, None),
            "hold": (False, False, None, None),
        }
        assert next(iter(METHODS)) == EXWARP

    @pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
    def test_what_takes_a_path_and_what_makes_a_frame_itself(self, method):
        assert method.decides is (
            method.name not in ("exwarp", "softsplat", "lookahead", "onnx", "blend", "hold")
        )
        assert method.interpolates is (method.name == "onnx")
        assert (method.predict is None) is (method.judge is not None)

    @pytest.mark.parametrize(("name", "slot"), combinations(ALONE, SLOTS))
    def test_every_frame_is_whole(self, name, slot):
        given = interval(METHODS[name].lookahead)
        found = predict(name, given, slot)
        assert found.pixels.shape == key(0).image.pixels.shape
        assert found.pixels.dtype == np.float32 and np.isfinite(found.pixels).all()
        assert found.method == name
        assert found.kind is (FrameKind.DROPPED if name == "hold" else FrameKind.GENERATED)
        assert found.sources == ((1001, 1002) if METHODS[name].lookahead else (1001,))

    @pytest.mark.parametrize("name", ALONE)
    def test_key_frames_are_not_touched(self, name):
        before = [key(i).image.pixels.copy() for i in (0, 1)]
        for slot in SLOTS:
            predict(name, interval(), slot)
        for i in (0, 1):
            np.testing.assert_array_equal(key(i).image.pixels, before[i])


class TestQuality:
    @pytest.mark.parametrize("slot", SLOTS)
    def test_motion_beats_none(self, slot):
        hold, blend, s6, softsplat = (
            error(predict(name, interval(), slot), slot)
            for name in ("hold", "blend", "s6", "softsplat")
        )
        assert s6 < 0.5 * hold and softsplat < 0.6 * blend
        assert softsplat < s6

    @pytest.mark.parametrize(("name", "slot"), combinations(["s6", "softsplat"], SLOTS))
    def test_inside_surfaces_only_resampling_is_lost(self, name, slot):
        seen = view(slot / 4)
        inside = seen.inside(4) & (seen.source_surface(view(0.0)) == seen.surface)
        inside &= seen.source_surface(view(1.0)) == seen.surface
        assert inside.mean() > 0.3
        assert error(predict(name, interval(), slot), slot, inside) < 0.006

    def test_colour_is_sampled_once_so_slots_do_not_wear(self):
        errors = []
        for slot in SLOTS:
            seen = view(slot / 4)
            wall = seen.inside(4) & (seen.surface == 1)
            errors.append(error(predict("s6", interval(False), slot), slot, wall))
        assert max(errors) < 3 * min(errors) + 0.002

    def test_disocclusions_come_from_the_side_that_sees_them(self):
        seen = view(0.5)
        wall = seen.surface == 1
        fresh = wall & (seen.source_surface(view(0.0)) == 3)  # the box hid it before
        stale = wall & (seen.source_surface(view(1.0)) == 3)  # the box will hide it
        for where in (fresh, stale):
            assert where.sum() > 8
            assert error(predict("softsplat", interval(), 2), 2, where) < 0.12
        assert error(predict("softsplat", interval(), 2), 2, fresh) < 0.5 * error(
            predict("s6", interval(False), 2), 2, fresh
        )


class TestValues:
    @pytest.mark.parametrize("name", ALONE)
    def test_alpha_high_and_negative_values_survive(self, name):
        truth = view(0.5).colour
        assert truth.max() > 3 and truth.min() < -0.1  # the scene has such
        found = predict(name, interval(), 2).pixels
        assert found.max() > 0.95 * truth.max() and found.min() < 0.95 * truth.min()
        assert found[2, 2, 3] == pytest.approx(0.5, abs=1e-3)  # sky
        assert found[-3, 60, 3] == pytest.approx(1.0, abs=1e-3)  # floor

    @pytest.mark.parametrize("name", ALONE)
    def test_scale_carries_over(self, name):
        scale = np.float32(4096)
        bright = [with_pixels(key(i), key(i).image.pixels * scale) for i in (0, 1)]
        found = predict(name, Interval(*bright), 2).pixels
        plain = predict(name, interval(), 2).pixels
        if name not in ("blend", "hold"):  # which mix colour as shown, where the curve bends
            apart = np.abs(found / scale - plain)
            assert np.median(apart) < 1e-6 and np.quantile(apart, 0.99) < 0.02
        else:
            np.testing.assert_array_equal(found, plain * scale)

    @pytest.mark.parametrize("name", ALONE)
    def test_without_alpha(self, name):
        plain = [with_pixels(key(i), key(i).image.pixels[..., :3].copy()) for i in (0, 1)]
        found = predict(name, Interval(*plain), 2).pixels
        np.testing.assert_allclose(
            found, predict(name, interval(), 2).pixels[..., :3], rtol=0, atol=1e-6
        )

    @pytest.mark.parametrize(("name", "bad"), combinations(ALONE, [np.nan, np.inf]))
    def test_broken_pixels_are_mended_and_do_not_spread(self, name, bad):
        pixels = key(0).image.pixels.copy()
        pixels[60, 60] = bad
        pixels[70, 20, 1] = -bad
        found = predict(name, Interval(with_pixels(key(0), pixels), key(1)), 1).pixels
        assert np.isfinite(found).all()
        clean = predict(name, interval(), 1).pixels
        changed = np.abs(found - clean).max(axis=-1)
        # Where a tap of Lanczos-3 would be broken, colour is bilinear. Places inside the pixels of
        # edges reach a pixel further.
        most = {"s6": 7 * 7 * 2, "blend": 12, "hold": 12}.get(name, 8 * 8 * 2)
        assert 0 < (changed > 1e-3).sum() <= most
        assert np.abs(found - clean).max() < 0.5


class TestFallbacks:
    @pytest.mark.parametrize("name", ["softsplat", "onnx", "blend"])
    def test_past_the_last_key_frame_it_warps(self, name):
        found = predict(name, interval(False), 2)
        assert (found.method, found.kind, found.sources) == ("s6", FrameKind.GENERATED, (1001,))
        np.testing.assert_array_equal(found.pixels, predict("s6", interval(False), 2).pixels)

    def test_there_without_motion_it_repeats(self):
        bare = Interval(replace(key(0), gbuffer=None))
        found = predict("blend", bare, 1)
        assert (found.method, found.kind) == ("hold", FrameKind.DROPPED)
        np.testing.assert_array_equal(found.pixels, key(0).image.pixels)

    @pytest.mark.parametrize("name", ["s6", "softsplat"])
    @pytest.mark.parametrize("motion", [None, "no vectors"])
    def test_without_motion_a_method_that_needs_it_says_so(self, name, motion):
        frames = []
        for i in (0, 1):
            frame = key(i)
            assert frame.gbuffer is not None
            still = replace(frame.gbuffer, to_next=None, to_previous=None) if motion else None
            frames.append(replace(frame, gbuffer=still))
        with pytest.raises(LayoutError, match=r"frame 1001 has no motion vectors.*--method hold"):
            predict(name, Interval(*frames), 1)

    def test_hold_and_blend_need_none(self):
        bare = Interval(*(replace(key(i), gbuffer=None) for i in (0, 1)))
        np.testing.assert_array_equal(predict("hold", bare, 3).pixels, key(0).image.pixels)
        a, b = key(0).image.pixels, key(1).image.pixels
        np.testing.assert_allclose(
            predict("blend", bare, 1).pixels, 0.75 * a + 0.25 * b, rtol=0, atol=1e-6
        )

    def test_hole_masks_are_those_of_the_warp(self):
        given = interval(False)
        mask = given.hole_mask(3)
        assert mask is not None and 0 < mask.mean() < 0.1
        assert Interval(replace(key(0), gbuffer=None)).hole_mask(3) is None


class Faded:
    """A network that cross-fades, and tells what it was given."""

    name, checksum = "fade", "0" * 64

    def __init__(self) -> None:
        self.times: list[float] = []
        self.finite = True

    def __call__(self, before: Float32, after: Float32, time: float) -> Float32:
        self.times.append(time)
        self.finite &= bool(np.isfinite(before).all() and np.isfinite(after).all())
        return before + np.float32(time) * (after - before)


class TestInterpolation:
    def test_a_network_gets_both_frames_and_the_time(self):
        network = Faded()
        for slot in SLOTS:
            bare = Interval(*(replace(key(i), gbuffer=None) for i in (0, 1)), interpolator=network)
            found = predict("onnx", bare, slot)
            np.testing.assert_allclose(
                found.pixels, predict("blend", bare, slot).pixels, rtol=0, atol=1e-6
            )
            assert (found.kind, found.method) == (FrameKind.GENERATED, "onnx")
            assert (found.sources, found.made_by) == ((1001, 1002), "interpolate")
        assert network.times == [0.25, 0.5, 0.75]

    def test_it_never_sees_broken_pixels(self):
        pixels, network = key(1).image.pixels.copy(), Faded()
        pixels[60, 60] = np.nan
        given = Interval(key(0), with_pixels(key(1), pixels), interpolator=network)
        assert np.isfinite(predict("onnx", given, 2).pixels).all() and network.finite


class TestSlotGeometry:
    def slotted(self, lookahead: bool = True) -> Interval:
        buffers = tuple(settle_motion(view(slot / 4).gbuffer(step=0.25)) for slot in SLOTS)
        frames = [
            replace(
                key(i), gbuffer=over_interval(settle_motion(view(float(i)).gbuffer(step=0.25)), 4)
            )
            for i in (0, 1)
        ]
        return Interval(frames[0], frames[1] if lookahead else None, buffers)

    @pytest.mark.parametrize(("name", "slot"), combinations(["s6", "softsplat"], SLOTS))
    def test_both_settings_show_the_same_inside_surfaces(self, name, slot):
        seen = view(slot / 4)
        inside = seen.inside(4) & (seen.source_surface(view(0.0)) == seen.surface)
        inside &= seen.source_surface(view(1.0)) == seen.surface
        # At edges both mix what lies inside a pixel, by vectors that differ there.
        inside = combine_3x3(inside, np.logical_and, mode="edge")
        by_slots = predict(name, self.slotted(), slot).pixels
        by_keys = predict(name, interval(), slot).pixels
        assert np.abs(by_slots - by_keys)[inside].max() < 0.02
        assert error(predict(name, self.slotted(), slot), slot) < 0.03

    def test_without_vectors_to_the_next_slot_the_next_key_frame_is_moved(self):
        given = self.slotted()
        given.slots = tuple(replace(buffer, to_next=None) for buffer in given.slots)
        # The key frame's own vectors lead one slot back; the method needs those of an interval.
        given.following = key(1)
        assert error(predict("softsplat", given, 2), 2) < 0.03


class TestBlendByDepth:
    SHAPE = (4, 5)

    def side(self, value: float, depth: float, **masks: bool) -> Warped:
        flags = {name: np.full(self.SHAPE, masks.get(name, False)) for name in ("hole", "fringe")}
        return Warped(
            np.full((*self.SHAPE, 3), value, np.float32),
            np.full(self.SHAPE, depth, np.float32),
            **flags,
        )

    @pytest.mark.parametrize("time", [0.25, 0.5, 0.75])
    def test_equal_depths_weigh_by_time(self, time):
        for depth in (3.0, np.inf):
            found = fill_holes(*mix_by_depth(self.side(1, depth), self.side(5, depth), time))
            np.testing.assert_allclose(found, 1 + 4 * time, rtol=1e-6)

    def test_the_nearer_surface_wins(self):
        found = fill_holes(*mix_by_depth(self.side(1, 2.0), self.side(5, 4.0), 0.75))
        assert np.abs(found - 1).max() < 0.02
        found = fill_holes(*mix_by_depth(self.side(1, np.inf), self.side(5, 1e8), 0.25))
        np.testing.assert_allclose(found, 5, rtol=1e-6)

    @pytest.mark.parametrize("junk", [0.0, 6e4, -6e4])
    def test_a_side_with_a_hole_counts_for_nothing(self, junk):
        value = 0.0123
        for sides in (
            (self.side(junk, 1.0, hole=True), self.side(value, 9.0)),
            (self.side(value, 9.0), self.side(junk, np.nan, hole=True)),
        ):
            for time in (0.25, 0.75):
                found = fill_holes(*mix_by_depth(*sides, time))
                np.testing.assert_array_equal(found, np.float32(value))

    def test_a_ghost_counts_where_the_other_side_sees_nothing(self):
        ghost = self.side(1, 3.0, fringe=True)
        alone = fill_holes(*mix_by_depth(ghost, self.side(9, 3.0, hole=True), 0.5))
        np.testing.assert_array_equal(alone, 1)
        beaten = fill_holes(*mix_by_depth(ghost, self.side(9, 3.0), 0.5))
        assert (beaten > 8.5).all()

    def test_what_neither_sees_is_filled_from_around(self):
        before, after = self.side(2, 3.0), self.side(2, 3.0)
        before.hole[1, 2] = after.hole[1, 2] = True
        before.pixels[1, 2] = after.pixels[1, 2] = 77
        np.testing.assert_allclose(fill_holes(*mix_by_depth(before, after, 0.5)), 2, rtol=1e-6)


class TestRepair:
    def test_a_sound_frame_is_returned_itself(self):
        pixels = key(0).image.pixels
        assert fill_nonfinite(pixels) is pixels

    def test_only_broken_pixels_change(self):
        pixels = key(0).image.pixels.copy()
        pixels[10:13, 10:13, 2] = np.nan
        found = fill_nonfinite(pixels)
        sound = np.isfinite(pixels).all(axis=-1)
        np.testing.assert_array_equal(found[sound], pixels[sound])
        assert np.isfinite(found).all()

    def test_all_holes_become_black(self):
        shape = (3, 4)
        nothing = np.full(shape, np.nan, np.float32)
        found = fill_holes(np.ones((*shape, 3), np.float32), nothing, np.ones(shape, bool))
        assert (found == 0).all()
