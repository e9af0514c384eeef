"""Motion estimated from colour: found where it is known, of any size, and the same every time."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.domain.colour import SRGB
from exwarp_cli.domain.frame import Image, KeyFrame, Window
from exwarp_cli.synthesis.look_ahead import LookAhead
from exwarp_cli.synthesis.motion_fields import reproject
from exwarp_cli.synthesis.optical_flow import (
    _better,
    estimate_flow,
    finest_level,
    invert_flow,
    shown_colour,
    with_estimated_motion,
)
from exwarp_cli.synthesis.trajectory import displacement
from exwarp_cli.synthesis.warp import Mover


def texture(height: int, width: int, seed: int = 0) -> np.ndarray:
    """Smooth noise of several sizes, scene-linear."""
    rng = np.random.default_rng(seed)
    out = np.zeros((height, width, 3))
    for size in (2, 4, 8, 16):
        coarse = rng.random((height // size + 2, width // size + 2, 3))
        rows, columns = np.arange(height) / size, np.arange(width) / size
        i, j = rows.astype(int), columns.astype(int)
        v, u = (rows - i)[:, None, None], (columns - j)[None, :, None]
        top = coarse[i][:, j] * (1 - u) + coarse[i][:, j + 1] * u
        below = coarse[i + 1][:, j] * (1 - u) + coarse[i + 1][:, j + 1] * u
        out += size * (top * (1 - v) + below * v)
    return (out / 30).astype(np.float32)


def shifted(dx: int, dy: int, height: int = 96, width: int = 128) -> tuple[np.ndarray, np.ndarray]:
    """Two views of one texture; what is at x in the first is at x + (dx, dy) in the second."""
    whole = texture(height + 40, width + 40)
    before = whole[20 : 20 + height, 20 : 20 + width]
    after = whole[20 - dy : 20 - dy + height, 20 - dx : 20 - dx + width]
    return np.ascontiguousarray(before), np.ascontiguousarray(after)


def key(number: int, pixels: np.ndarray) -> KeyFrame:
    window = Window(0, 0, pixels.shape[1], pixels.shape[0])
    return KeyFrame(number, Image(pixels, window, window), None)


class TestEstimate:
    @pytest.mark.parametrize(("dx", "dy"), [(0, 0), (3, 0), (0, -5), (11, 7), (-16, 4)])
    def test_a_shift_is_found_both_ways(self, dx, dy):
        there, back = estimate_flow(*shifted(dx, dy))
        inside = np.s_[20:-20, 20:-20]
        assert np.abs(there.motion[inside] - (dx, dy)).max() < 0.25
        assert np.abs(back.motion[inside] + (dx, dy)).max() < 0.25
        assert there.mismatch[inside].max() < 0.02

    def test_an_object_moves_before_a_background_that_stands(self):
        back, thing = texture(96, 128), texture(40, 40, seed=9) * (1.4, 0.7, 0.5)
        before, after = back.copy(), back.copy()
        before[30:70, 30:70] = thing
        after[34:74, 42:82] = thing
        there, _ = estimate_flow(before, after)
        assert np.abs(np.median(there.motion[36:64, 36:64], axis=(0, 1)) - (12, 4)).max() < 0.2
        assert np.abs(there.motion[:20]).max() < 0.5
        covered = there.mismatch[40:60, 74:80].mean()  # which the second picture does not show
        assert covered > 5 * there.mismatch[:20].mean()

    @pytest.mark.parametrize("shape", [(1, 1), (5, 9), (16, 200), (70, 64)])
    def test_any_size(self, shape):
        before = texture(*shape)
        for flow in estimate_flow(before, before):
            assert flow.motion.shape == (*shape, 2) and flow.mismatch.shape == shape
            assert flow.motion.dtype == flow.mismatch.dtype == np.float32
            assert np.abs(flow.motion).max() < 0.5 and flow.mismatch.max() < 0.01

    def test_it_is_the_same_every_time_and_leaves_its_input(self):
        before, after = shifted(6, 2)
        copies = before.copy(), after.copy()
        first, second = estimate_flow(before, after), estimate_flow(before, after)
        for one, other in zip(first, second, strict=True):
            assert np.array_equal(one.motion, other.motion)
        assert np.array_equal(before, copies[0]) and np.array_equal(after, copies[1])

    def test_the_two_directions_change_places_with_the_pictures(self):
        before, after = shifted(6, 2)
        one, other = estimate_flow(before, after), estimate_flow(after, before)
        assert np.array_equal(one[0].motion, other[1].motion)
        assert np.array_equal(one[1].motion, other[0].motion)

    def test_alpha_light_beyond_white_and_broken_pixels(self):
        before, after = shifted(4, 0)
        alpha = np.ones((*before.shape[:2], 1), np.float32)
        before, after = (np.concatenate([p * 3, alpha], axis=-1) for p in (before, after))
        before[40, 40] = np.nan
        after[50, 60], after[51, 60] = np.inf, -np.inf
        before[10, 10, :3] = -5
        for flow in estimate_flow(before, after):
            assert np.isfinite(flow.motion).all()
            assert 0 <= flow.mismatch.min() <= flow.mismatch.max() <= 1

    def test_a_hole_in_the_pictures_is_no_black_spot(self):
        before, after = shifted(5, 0)
        before[40:46, 60:66] = after[40:46, 60:66] = np.nan
        there, _ = estimate_flow(before, after)
        assert there.mismatch[40:46, 60:66].max() < 0.3
        assert np.abs(there.motion[42, 62] - (5, 0)).max() < 3

    def test_of_two_flows_the_one_that_fits_is_taken(self):
        before, after = (shown_colour(picture) for picture in shifted(5, 0))
        right = np.full((96, 128, 2), (5, 0), np.float32)
        half = right.copy()
        half[:, 64:] = -3, 9
        other = np.where(half == right, np.float32(np.nan), right)
        for first, second in ((half, right), (right, half), (half, other)):
            found = _better(before, after, first, second)
            assert np.abs(found[8:-8, 8:-12] - (5, 0)).max() == 0

    def test_the_search_goes_no_finer_than_pays(self):
        assert finest_level(540, 960) == finest_level(1, 1) == 0
        assert finest_level(1080, 1920) == 1
        assert finest_level(2160, 3840) == 2


class TestInverted:
    def test_a_constant_flow(self):
        flow = np.full((20, 30, 2), (3, -2), np.float32)
        back = invert_flow(flow)
        assert np.isnan(back[:, :2]).all() and np.isnan(back[-1:]).all()
        assert np.allclose(back[:17, 4:], (-3, 2), atol=1e-5)


def blended(before: KeyFrame, after: KeyFrame, time: float) -> np.ndarray:
    assert before.gbuffer is not None and after.gbuffer is not None
    fields = reproject(before.gbuffer, time), reproject(after.gbuffer, time - 1)
    return LookAhead((Mover(fields[0]), Mover(fields[1])), time).make(
        before.image.pixels, after.image.pixels
    )


class TestMoving:
    def test_the_slot_between_shows_the_texture_on_its_way(self):
        before, after = shifted(8, 4)
        there, back = estimate_flow(before, after)
        first, second = (
            with_estimated_motion(key(1, before), None, there),
            with_estimated_motion(key(2, after), back, None),
        )
        assert (first.number, second.number) == (1, 2)
        middle, truth = blended(first, second, 0.5), shifted(4, 2)[1]
        inside = np.s_[20:-20, 20:-20]
        assert np.abs(middle - truth)[inside].max() < 0.02
        assert np.abs(middle - truth).mean() < np.abs(0.5 * (before + after) - truth).mean() / 5

    def test_with_both_neighbours_motion_speeds_up(self):
        # At 0, 2 and 8: halfway between the last two it was at 4.5, not at 5.
        whole = [shifted(dx, 0)[1] for dx in (0, 2, 8)]
        one, two = estimate_flow(whole[0], whole[1]), estimate_flow(whole[1], whole[2])
        frame = with_estimated_motion(key(2, whole[1]), one[1], two[0])
        assert frame.gbuffer is not None
        went = displacement(frame.gbuffer, 0.5)[20:-20, 20:-20, 0]
        assert abs(float(np.median(went)) - 2.5) < 0.1

    def test_what_is_not_known_is_left_out(self):
        there, back = estimate_flow(*shifted(3, 0))
        frame = key(1, shifted(3, 0)[0])
        only = with_estimated_motion(frame, back, None).gbuffer
        assert only is not None and only.to_next is None and only.to_previous is back.motion
        other = with_estimated_motion(frame, None, there).gbuffer
        assert other is not None and other.to_previous is None and other.to_next is there.motion
        assert (
            with_estimated_motion(with_estimated_motion(frame, back, there), None, None).gbuffer
            is None
        )

    def test_vectors_to_where_a_surface_is_hidden_are_dropped(self):
        here, _ = shifted(0, 0)
        hiding = here.copy()
        hiding[30:60, 40:80] = texture(30, 40, seed=7) * (0.2, 1.5, 0.2)
        there, back = estimate_flow(here, hiding)[0], estimate_flow(here, here)[0]
        buffer = with_estimated_motion(key(1, here), back, there).gbuffer
        assert buffer is not None and buffer.to_next is not None
        lost = np.isnan(buffer.to_next[..., 0])
        assert lost[36:54, 46:74].all() and not lost[:20].any() and not lost[:, :30].any()
        assert buffer.to_previous is not None and np.isfinite(buffer.to_previous).all()
        assert np.abs(displacement(buffer, 0.5)[36:54, 46:74]).max() < 0.25

    def test_what_was_followed_better_counts_as_nearer(self):
        before, after = shifted(0, 0)
        after[40:60, 40:60] = 0
        there, back = estimate_flow(before, after)
        window = Window(0, 0, before.shape[1], before.shape[0])
        frame = KeyFrame(1, Image(before, window, window), None)
        buffers = [
            with_estimated_motion(frame, *flows).gbuffer
            for flows in ((None, there), (back, None), (back, there))
        ]
        depth, backward, both = (buffer.depth for buffer in buffers)
        assert depth.dtype == np.float32 and depth.min() >= 1
        assert depth[45:55, 45:55].mean() > depth[:20].mean() + 0.02
        mean = (np.log(depth) + np.log(backward)) / 2
        assert np.allclose(np.log(both), mean, atol=1e-6)


class TestShownColour:
    def test_it_is_srgb_and_finite(self):
        light = np.array([[[0.5, -1, 7], [np.nan, np.inf, -np.inf]]], np.float32)
        expected = np.array([[[0.735357, 0, 1], [0, 1, 0]]])
        assert np.allclose(shown_colour(light), expected, atol=1e-5)
        assert SRGB.to_linear(shown_colour(light))[0, 0, 0] == pytest.approx(0.5, abs=1e-6)


class TestExposure:
    def test_a_scene_too_bright_for_a_display_moves_all_the_same(self):
        before, after = shifted(3, 1)
        there, _ = estimate_flow(8 * before, 8 * after)
        expected, _ = estimate_flow(before, after)
        inside = (slice(8, -8), slice(8, -8))
        assert np.abs(there.motion[inside] - expected.motion[inside]).mean() < 0.1

    def test_one_lamp_darkens_nothing(self):
        before, after = shifted(3, 1)
        after[40:60, 40:60] = 0
        plain, _ = estimate_flow(before, after)
        before[:4, :4] = after[:4, :4] = 1000.0
        lit, _ = estimate_flow(before, after)
        assert np.abs(lit.motion - plain.motion)[16:, 16:].mean() < 0.1
        mismatch, expected = (flow.mismatch[16:, 16:].mean() for flow in (lit, plain))
        assert mismatch == pytest.approx(expected, rel=0.1)
