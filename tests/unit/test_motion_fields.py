"""Motion fields of slots against a scene whose motion is known exactly."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from exwarp_cli.domain.frame import GBuffer, Window
from exwarp_cli.kernels.holes import FOOTPRINTS
from exwarp_cli.kernels.splat import PATCH_REACH, REACH_SPAN
from exwarp_cli.synthesis.motion_fields import (
    SlotField,
    compose,
    depth_of,
    reproject,
    settle_motion,
)
from exwarp_cli.synthesis.trajectory import displacement, stencil_of
from tests.unit.kernel_calls import reached
from tests.unit.scenes import SKY, View, town

TIMES = (0.25, 0.5, 0.75)
STEP = 0.25


@functools.cache
def view(time: float) -> View:
    return town().view(time)


@functools.cache
def settled(time: float, step: float = 1.0) -> GBuffer:
    return settle_motion(view(time).gbuffer(step=step))


def visible(slot: View, key: View, reach: int = 3) -> np.ndarray:
    """Pixels well inside a surface at the slot whose source is well inside it too."""
    x, y = np.rint(slot.pixels_at(key.time)).astype(int).transpose(2, 0, 1)
    height, width = key.surface.shape
    known = (x >= 0) & (y >= 0) & (x < width) & (y < height)
    well = key.inside(reach)[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
    return slot.inside(reach) & known & well & (slot.source_surface(key) == slot.surface)


def assert_exact(found: SlotField, slot: View, key: View, tolerance: float = 0.05) -> None:
    """The field is the analytic one inside surfaces, on every surface and on the sky."""
    seen = visible(slot, key)
    assert not found.hole[seen].any()
    gap = np.linalg.norm(found.field - slot.motion_to(key.time), axis=-1)
    for surface in (SKY, 0, 1, 2, 3):
        mine = seen & (slot.surface == surface)
        assert mine.sum() > 100
        assert gap[mine].max() < tolerance, surface
    np.testing.assert_allclose(
        found.depth[seen & (slot.surface != SKY)],
        slot.depth[seen & (slot.surface != SKY)],
        rtol=0.1,
    )


def hidden(slot: View, key: View) -> np.ndarray:
    """Pixels of the static scene that the box hid, and not only at its rim."""
    out = (slot.source_surface(key) != slot.surface) & ~np.isin(slot.surface, (3, 4))
    out &= slot.source_surface(key) != -2
    grown = np.pad(out, 1)
    core = np.ones_like(out)
    for dy in range(3):
        for dx in range(3):
            core &= grown[dy : dy + out.shape[0], dx : dx + out.shape[1]]
    return core


class TestReproject:
    @pytest.mark.parametrize("time", TIMES)
    def test_from_the_key_frame_before(self, time):
        assert_exact(reproject(settled(0.0), time), view(time), view(0.0))

    @pytest.mark.parametrize("time", TIMES)
    def test_from_the_key_frame_after(self, time):
        assert_exact(reproject(settled(1.0), time - 1), view(time), view(1.0))

    def test_time_zero_is_the_key_frame_itself(self):
        found = reproject(settled(0.0), 0.0)
        np.testing.assert_array_equal(found.field, 0)
        np.testing.assert_array_equal(found.depth, settled(0.0).depth)
        assert not found.hole.any() and not found.fringe.any()

    @pytest.mark.parametrize(("key", "time"), [(0.0, 0.75), (1.0, -0.75)])
    def test_what_the_box_hid_is_a_hole(self, key, time):
        slot = view(key + time)
        covered = hidden(slot, view(key))
        assert covered.sum() > 10
        assert reproject(settled(key), time).hole[covered].all()

    def test_what_comes_into_the_frame_is_a_hole(self):
        slot = view(0.75)
        x, y = np.moveaxis(slot.pixels_at(0.0), -1, 0)
        height, width = slot.surface.shape
        outside = (x < -1.6) | (y < -1.6) | (x > width + 0.6) | (y > height + 0.6)
        assert outside.sum() > 20
        assert reproject(settled(0.0), 0.75).hole[outside].all()

    def test_holes_are_few(self):
        found = reproject(settled(0.0), 0.5)
        assert 0 < found.hole.mean() < 0.06

    @pytest.mark.parametrize("time", [0.25, 0.75])
    def test_at_silhouettes_no_point_is_between_two_surfaces(self, time):
        slot = view(time)
        found = reproject(settled(0.0), time)
        rim = ~slot.inside(1) & ~found.hole & (slot.surface != SKY)
        rim &= np.isfinite(found.field).all(axis=-1)
        own = np.linalg.norm(found.field - slot.motion_to(0.0), axis=-1)
        others = [own]
        for dy, dx in ((0, 1), (1, 0), (0, -1), (-1, 0)):
            moved = np.roll(slot.motion_to(0.0), (dy, dx), (0, 1))
            others.append(np.linalg.norm(found.field - moved, axis=-1))
        # Either the pixel's own motion or, within a pixel, that of the surface beside it.
        assert np.quantile(np.min(others, axis=0)[rim], 0.98) < 0.35
        # Where the box covers the wall, the box wins.
        box = np.isin(slot.surface, (3, 4)) & slot.inside(1)
        assert (found.depth[box] < 6).all()


class TestSettleMotion:
    def test_the_sky_follows_the_camera(self):
        raw, found = view(0.0).gbuffer(), settled(0.0)
        sky = view(0.0).surface == SKY
        assert raw.to_next is not None and found.to_next is not None
        assert (raw.to_next[sky] == 0).all()
        np.testing.assert_allclose(
            found.to_next[sky], view(0.0).motion_to(1.0)[sky], rtol=0, atol=1e-3
        )

    def test_filtered_vectors_at_silhouettes_are_undone(self):
        seen = view(0.0)
        exact = seen.motion_to(1.0, sky=False)
        mixed = exact.copy()
        for axis in (0, 1):
            mixed = (np.roll(mixed, 1, axis) + 2 * mixed + np.roll(mixed, -1, axis)) / 4
        mixed[[0, -1]], mixed[:, [0, -1]] = exact[[0, -1]], exact[:, [0, -1]]
        found = settle_motion(replace(seen.gbuffer(), to_next=mixed, to_previous=None))
        assert found.to_next is not None and found.to_previous is None
        truth = seen.motion_to(1.0)
        before = np.linalg.norm(mixed - truth, axis=-1)
        after = np.linalg.norm(found.to_next - truth, axis=-1)
        surfaces = seen.surface != SKY
        assert before[surfaces].max() > 2
        assert after[np.isin(seen.surface, (0, 1, 2, SKY))].max() < 0.05  # static: exact
        assert np.quantile(after[seen.surface == 3], 0.98) < 0.3  # moving: its own inside

    def test_without_geometry_the_vectors_stay(self):
        seen = view(0.0)
        vectors = seen.motion_to(1.0)
        bare = GBuffer(seen.scene.window, to_next=vectors)
        np.testing.assert_array_equal(settle_motion(bare).to_next, vectors)

    def test_without_motion_nothing_happens(self):
        bare = view(0.0).gbuffer(motion=False)
        assert settle_motion(bare) is bare


class TestDisplacement:
    WINDOW = Window(0, 0, 2, 1)

    def field(self, *values: float) -> np.ndarray:
        return np.array(values, np.float32).reshape(1, 2, 2)

    def test_the_parabola_through_both_neighbours(self):
        n, p = self.field(4, -2, 1, 1), self.field(-2, 3, 5, -1)
        both = GBuffer(self.WINDOW, to_previous=p, to_next=n)
        for time in (-1.0, -0.25, 0.0, 0.5, 1.0):
            expected = time * (n - p) / 2 + time**2 * (n + p) / 2
            np.testing.assert_allclose(displacement(both, time), expected, atol=1e-6)
        np.testing.assert_array_equal(displacement(both, 1.0), n)
        np.testing.assert_array_equal(displacement(both, -1.0), p)

    @pytest.mark.parametrize("way", [-1, 1])
    def test_a_jerk_at_a_key_frame_does_not_bend_the_interval_beside_it(self, way):
        calm, jerk = self.field(2, -3, 0, 0), self.field(-80, 10, 70, 60)
        before, after = (calm, jerk) if way < 0 else (jerk, calm)
        both = GBuffer(self.WINDOW, to_previous=before, to_next=after)
        for share in (0.25, 0.5, 0.75, 1.0):
            np.testing.assert_allclose(displacement(both, way * share), share * calm, atol=0.2)
        # The other interval has room for it.
        halfway = displacement(both, -way * 0.5)
        np.testing.assert_allclose(halfway, 0.5 * jerk - (jerk + calm) / 8, atol=1e-5)

    def test_one_neighbour_means_constant_velocity(self):
        n = self.field(4, -2, 1, 1)
        np.testing.assert_array_equal(displacement(GBuffer(self.WINDOW, to_next=n), 0.25), n / 4)
        np.testing.assert_array_equal(
            displacement(GBuffer(self.WINDOW, to_previous=n), 0.25), -n / 4
        )

    def test_where_one_is_unknown_the_other_counts(self):
        nan = np.nan
        n, p = self.field(4, -2, nan, nan), self.field(nan, nan, 6, 8)
        both = GBuffer(self.WINDOW, to_previous=p, to_next=n)
        np.testing.assert_array_equal(displacement(both, 0.5), self.field(2, -1, -3, -4))
        assert displacement(both, 0.5).dtype == np.float32

    def test_where_both_are_unknown_it_is_unknown(self):
        unknown = self.field(*[np.nan] * 4)
        both = GBuffer(self.WINDOW, to_previous=unknown, to_next=unknown)
        assert np.isnan(displacement(both, 0.5)).all()

    @pytest.mark.parametrize("width", [1, 63, 64, 97, 200])
    @pytest.mark.parametrize("given", ["both", "to_next", "to_previous"])
    def test_the_rows_that_it_leads_to_are_found(self, given, width):
        """Those of every span and of the whole row; of a row without motion, none."""
        rng = np.random.default_rng(width)
        n, p = rng.normal(0, 20, (2, 7, width, 2)).astype(np.float32)
        n[rng.random((7, width)) < 0.3] = p[rng.random((7, width)) < 0.3] = np.nan
        n[4] = p[4] = np.nan
        ways = {"to_next": n, "to_previous": p}
        ways = ways if given == "both" else {given: ways[given]}
        gbuffer = GBuffer(Window(0, 0, width, 7), **ways)
        motion = displacement(gbuffer, 0.75)
        (reach,) = reached(motion)
        for i, row in enumerate(motion):
            spans = [*np.split(row, range(REACH_SPAN, width, REACH_SPAN)), row]
            assert len(reach[i]) == len(spans)
            for (low, high), span in zip(reach[i], spans, strict=True):
                led = (np.float32(i) + span[:, 1])[~np.isnan(span[:, 1])]
                near = (low + PATCH_REACH, high - PATCH_REACH)
                assert near == (pytest.approx((led.min(), led.max())) if len(led) else near)
                assert (low > high) == (len(led) == 0)


def slots() -> list[GBuffer]:
    return [settled(time, STEP) for time in TIMES]


def composed_back(each: list[GBuffer], key: GBuffer) -> list[SlotField]:
    return [compose(each[:count], key, -1) for count in range(1, len(each) + 1)]


class TestCompose:
    def test_back_to_the_key_frame(self):
        fields = composed_back(slots(), settled(0.0, STEP))
        assert len(fields) == 3
        for found, time in zip(fields, TIMES, strict=True):
            assert_exact(found, view(time), view(0.0))

    def test_forward_to_the_next_key_frame(self):
        fields = [compose(slots()[i:][::-1], settled(1.0, STEP), 1) for i in range(3)]
        assert len(fields) == 3
        for found, time in zip(fields, TIMES, strict=True):
            assert_exact(found, view(time), view(1.0))

    @pytest.mark.parametrize("index", range(3))
    def test_what_the_box_hid_is_a_hole(self, index):
        slot = view(TIMES[index])
        covered = hidden(slot, view(0.0))
        found = compose(slots()[: index + 1], settled(0.0, STEP), -1)
        np.testing.assert_array_equal(found.depth, slot.depth.astype(np.float32))
        assert found.hole.mean() < 0.08
        assert index < 2 or found.hole[covered].mean() > 0.5
        # What escapes the test shows a neighbouring point: within so many footprints on each axis.
        gap = np.linalg.norm(found.field - slot.motion_to(0.0), axis=-1)
        assert (gap[covered & ~found.hole] < 2 * FOOTPRINTS).all()

    def test_holes_are_found_with_whatever_there_is(self):
        slot, key = view(0.75), view(0.0)
        covered = hidden(slot, key)
        for absent in ("position", "normal", "stencil", "depth"):
            less = [replace(buffer, **{absent: None}) for buffer in slots()]
            found = compose(less, replace(settled(0.0, STEP), **{absent: None}), -1)
            assert found.hole[covered].mean() > 0.5, absent
            assert not found.hole[visible(slot, key)].any(), absent

    def test_both_settings_agree(self):
        composed = composed_back(slots(), settled(0.0, STEP))
        for found, time in zip(composed, TIMES, strict=True):
            direct = reproject(settled(0.0), time)
            seen = visible(view(time), view(0.0))
            gap = np.linalg.norm(found.field - direct.field, axis=-1)
            assert gap[seen].max() < 0.05
            assert (found.hole == direct.hole).mean() > 0.93


class TestWithoutDepth:
    def test_positions_tell_the_background(self):
        seen = view(0.0)
        bare = replace(seen.gbuffer(), depth=None)
        np.testing.assert_array_equal(np.isinf(depth_of(bare)), seen.surface == SKY)

    def test_nothing_known_is_one_flat_surface(self):
        bare = GBuffer(Window(0, 0, 4, 3))
        assert (depth_of(bare) == 1).all() and stencil_of(bare).shape == (0, 0)
