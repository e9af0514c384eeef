"""Finding the convention of motion vectors by measuring."""

from __future__ import annotations

import functools
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from exwarp_cli.domain.motion import AxisMap, MotionConvention
from exwarp_cli.errors import MotionError
from exwarp_cli.io.producers import PRESETS
from exwarp_cli.synthesis.calibration import Instant, calibrate
from tests.unit.scenes import View, town

XY, XYZW = ("X", "Y"), ("X", "Y", "Z", "W")
BLENDER = PRESETS["blender"]


@functools.cache
def views() -> tuple[View, ...]:
    return tuple(town().view(float(time)) for time in range(3))


def raw_of(view: View, convention: MotionConvention, count: int, span: float = 1.0) -> np.ndarray:
    """Write exact motion as a renderer of this convention would: the inverse of reading it."""
    raw = np.zeros((*view.surface.shape, count), np.float32)
    for axis_map, step in ((convention.to_previous, -span), (convention.to_next, span)):
        if axis_map is not None:
            motion = view.motion_to(view.time + step, sky=False)
            raw[..., axis_map.x_channel] = motion[..., 0] / np.float32(axis_map.x_scale)
            raw[..., axis_map.y_channel] = motion[..., 1] / np.float32(axis_map.y_scale)
    return raw


def instants(convention: MotionConvention, count: int, **without: None) -> list[Instant]:
    out = []
    for number, view in enumerate(views()):
        colour = None if "colour" in without else view.colour
        buffer = replace(
            view.gbuffer(motion=False), **{k: v for k, v in without.items() if k != "colour"}
        )
        out.append(Instant(number, buffer, raw_of(view, convention, count), colour))
    return out


def pairs_of(frames: list[Instant]) -> list[tuple[Instant, Instant]]:
    return list(pairwise(frames))


def pairs(convention: MotionConvention, count: int = 2, **without: None):
    return pairs_of(instants(convention, count, **without))


def both(before: AxisMap, after: AxisMap) -> MotionConvention:
    return MotionConvention(before, after)


WIDTH, HEIGHT = views()[0].scene.size
SIGNS = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
SCALES = {
    "pixels": (1, 1),
    "four frames' worth": (4, 4),
    "a quarter": (0.25, 0.25),
    "of width and height": (WIDTH, HEIGHT),
    "of half of each": (WIDTH / 2, HEIGHT / 2),
    "of width": (WIDTH, WIDTH),
    "of twice the width and height": (2 * WIDTH, 2 * HEIGHT),
}

POSITION_ONLY = {"depth": None, "colour": None}
DEPTH_ONLY = {"position": None, "colour": None}
COLOUR_ONLY = {"position": None, "depth": None}


class TestRecovery:
    @pytest.mark.parametrize("signs", SIGNS)
    @pytest.mark.parametrize("scale", SCALES.values(), ids=SCALES)
    def test_every_sign_and_scale(self, signs, scale):
        truth = MotionConvention(AxisMap(0, 1, signs[0] * scale[0], signs[1] * scale[1]))
        found = calibrate(pairs(truth)[:1], None, XY)
        assert (found.convention, found.source) == (truth, "calibrated")

    @pytest.mark.parametrize("signs", SIGNS)
    def test_vectors_to_the_next_frame(self, signs):
        truth = MotionConvention(None, AxisMap(0, 1, *map(float, signs)))
        assert calibrate(pairs(truth)[:1], None, XY).convention == truth

    @pytest.mark.parametrize("signs", SIGNS)
    def test_swapped_axes(self, signs):
        truth = MotionConvention(to_previous=AxisMap(1, 0, *map(float, signs)))
        assert calibrate(pairs(truth), None, XY).convention == truth

    @pytest.mark.parametrize(
        "truth",
        [
            BLENDER,
            PRESETS["forward+backward"],
            both(AxisMap(2, 3, 1, -1), AxisMap(0, 1, -1, 1)),
            both(AxisMap(1, 0, 1, 1), AxisMap(3, 2, 4, 4)),
        ],
    )
    def test_both_directions(self, truth):
        found = calibrate(pairs(truth, 4), None, XYZW)
        assert found.convention == truth

    @pytest.mark.parametrize(
        "without",
        [POSITION_ONLY, COLOUR_ONLY, {"position": None}],
        ids=["positions", "colour", "depth and colour"],
    )
    @pytest.mark.parametrize("truth", [BLENDER, PRESETS["forward+backward"]])
    def test_whatever_there_is_to_judge_by(self, without, truth):
        assert calibrate(pairs(truth, 4, **without)[:1], None, XYZW).convention == truth

    @pytest.mark.parametrize("truth", [BLENDER, PRESETS["forward+backward"]])
    def test_depth_alone_confirms_what_the_names_say(self, truth):
        found = calibrate(pairs(truth, 4, **DEPTH_ONLY), truth, XYZW)
        assert (found.convention, found.source) == (truth, "calibrated")

    @pytest.mark.parametrize("truth", [BLENDER, PRESETS["forward+backward"]])
    def test_depth_alone_on_plain_walls_is_too_little_to_contradict_them(self, truth):
        wrong = both(AxisMap(0, 1, 1, 1), AxisMap(2, 3, 1, 1))
        with pytest.raises(MotionError, match=r"names say previous=X,Y next=Z,W.*give --motion"):
            calibrate(pairs(truth, 4, **DEPTH_ONLY), wrong, XYZW)
        with pytest.raises(MotionError, match=r"names are not known; give --motion"):
            calibrate(pairs(truth, 4, **DEPTH_ONLY), None, XYZW)

    def test_all_data_rounded_to_half(self):
        def half(array: np.ndarray) -> np.ndarray:
            return array.astype(np.float16).astype(np.float32)

        frames = []
        for frame in instants(BLENDER, 4):
            buffer = frame.gbuffer
            assert buffer.depth is not None and buffer.position is not None
            rounded = replace(buffer, depth=half(buffer.depth), position=half(buffer.position))
            assert frame.colour is not None
            frames.append(Instant(frame.number, rounded, half(frame.motion), half(frame.colour)))
        assert calibrate(pairs_of(frames), None, XYZW).convention == BLENDER

    def test_unusable_pixels_do_not_matter(self):
        frames = instants(BLENDER, 4)
        rng = np.random.default_rng(0)
        for frame in frames:
            frame.motion[rng.random(frame.motion.shape[:2]) < 0.2] = np.nan
            assert frame.colour is not None
            frame.colour[rng.random(frame.motion.shape[:2]) < 0.05] = np.inf
        assert calibrate(pairs_of(frames), None, XYZW).convention == BLENDER

    def test_one_pair_is_enough(self):
        assert calibrate(pairs(BLENDER, 4)[:1], None, XYZW).convention == BLENDER

    def test_channels_beyond_the_pairs_are_left_out(self):
        truth = MotionConvention(to_previous=AxisMap(0, 1, 1.0, -1.0))
        found = calibrate(pairs(truth, 3), None, ("X", "Y", "Z"))
        assert found.convention == truth


class TestFreeScale:
    """Vectors normalised by what only the artist knows."""

    @pytest.mark.parametrize("scale", [37.0, 150.0, 0.13, 0.9 * WIDTH / 2])
    @pytest.mark.parametrize("aspect", [1.0, HEIGHT / WIDTH])
    def test_it_is_fitted_and_it_is_said(self, scale, aspect):
        truth = AxisMap(0, 1, scale, -scale * aspect)
        found = calibrate(pairs(MotionConvention(None, truth)), None, XY)
        read = found.convention.to_next
        assert read is not None and found.convention.to_previous is None
        assert read.x_scale == pytest.approx(truth.x_scale, rel=0.01)
        assert read.y_scale == pytest.approx(truth.y_scale, rel=0.01)
        assert "the factor is none of the usual ones and was fitted" in found.evidence
        assert found.error is not None and found.error < 0.3

    def test_a_usual_one_is_not(self):
        assert "fitted" not in calibrate(pairs(BLENDER, 4), None, XYZW).evidence

    def test_both_directions(self):
        truth = both(AxisMap(0, 1, -19.0, 19.0), AxisMap(2, 3, 19.0, -19.0))
        found = calibrate(pairs(truth, 4), BLENDER, XYZW)
        assert found.source == "corrected" and "was fitted" in found.evidence
        for read, true in (
            (found.convention.to_previous, truth.to_previous),
            (found.convention.to_next, truth.to_next),
        ):
            assert read is not None and true is not None
            assert (read.x_channel, read.y_channel) == (true.x_channel, true.y_channel)
            assert read.x_scale == pytest.approx(true.x_scale, rel=0.01)
            assert read.y_scale == pytest.approx(true.y_scale, rel=0.01)

    def test_at_an_even_speed_the_direction_of_the_names_stands(self):
        # Vectors there and back are then the same but for their sign.
        scene = town()
        camera = replace(scene.camera, acceleration=np.zeros(3), yaw=0, pitch=0)
        quads = tuple(replace(quad, velocity=np.zeros(3)) for quad in scene.quads)
        even = replace(scene, camera=camera, quads=quads)
        truth = MotionConvention(to_next=AxisMap(0, 1, 23.0, -23.0))
        frames = [
            Instant(n, (seen := even.view(float(n))).gbuffer(motion=False), raw_of(seen, truth, 2),
                    seen.colour)
            for n in range(2)
        ]  # fmt: skip
        found = calibrate(pairs_of(frames), PRESETS["forward"], XY).convention
        assert found.to_next is not None and found.to_previous is None
        assert found.to_next.x_scale == pytest.approx(23, rel=0.02)


def test_premultiplied_vectors_are_told_by_their_alpha():
    truth = MotionConvention(to_previous=AxisMap(0, 1, 1.0, -1.0, alpha=2))
    rng = np.random.default_rng(4)
    frames = []
    for frame in instants(MotionConvention(AxisMap(0, 1, 1.0, -1.0)), 3):
        alpha = rng.uniform(0.3, 1, frame.motion.shape[:2]).astype(np.float32)
        raw = frame.motion * alpha[..., None]
        raw[..., 2] = alpha
        frames.append(replace(frame, motion=raw))
    assert calibrate(pairs_of(frames), None, ("R", "G", "A")).convention == truth


class TestAgainstTheNames:
    def test_names_that_are_right_are_confirmed(self):
        found = calibrate(pairs(BLENDER, 4), BLENDER, XYZW)
        assert (found.convention, found.source) == (BLENDER, "calibrated")
        assert "measured on frames 0-1, 1-2" in found.evidence
        assert "names say" not in found.evidence
        assert found.error is not None and found.runner_up_error is not None
        assert found.still_error is not None
        assert found.error < 0.5 * found.runner_up_error and found.error < found.still_error

    @pytest.mark.parametrize(
        "truth",
        [
            both(AxisMap(0, 1, 1, 1), AxisMap(2, 3, -1, -1)),
            both(AxisMap(0, 1, -1, -1), AxisMap(2, 3, -1, 1)),
            both(AxisMap(2, 3, 1, -1), AxisMap(0, 1, -1, 1)),
        ],
        ids=["y flipped", "previous flipped", "pairs exchanged"],
    )
    def test_names_that_are_wrong_are_corrected_and_both_are_told(self, truth):
        found = calibrate(pairs(truth, 4), BLENDER, XYZW)
        assert (found.convention, found.source) == (truth, "corrected")
        assert truth.describe(XYZW) in found.evidence
        assert f"the names say {BLENDER.describe(XYZW)}" in found.evidence

    @pytest.mark.parametrize(("slower", "source"), [(30, "calibrated"), (60, "untested")])
    def test_a_slow_motion_does_not_unseat_the_names(self, slower, source):
        # Sixty times slower, signs can hardly be told; the names then stand.
        scene = town()
        slow = [
            Instant(
                number,
                (seen := scene.view(number / slower)).gbuffer(motion=False),
                raw_of(seen, BLENDER, 4, 1 / slower),
                seen.colour,
            )
            for number in range(2)
        ]
        found = calibrate(pairs_of(slow), BLENDER, XYZW)
        assert (found.convention, found.source) == (BLENDER, source)

    def test_what_moves_does_not_count_where_ids_tell_it(self):
        # Most of the frame moves by itself, as leaves in the wind: world positions cannot follow.
        moving = []
        for frame in instants(BLENDER, 4):
            g = frame.gbuffer
            assert g.stencil is not None and g.position is not None
            blown = np.zeros(g.stencil.shape, bool)
            blown[:, : g.stencil.shape[1] * 7 // 10] = True
            stencil = np.where(blown, 5, g.stencil).astype(np.int32)
            shift = np.where(blown[..., None], 0.7 * frame.number, 0).astype(np.float32)
            away = replace(g, stencil=stencil, position=g.position + shift)
            moving.append(replace(frame, gbuffer=away, colour=None))
        found = calibrate(pairs_of(moving), BLENDER, XYZW)
        assert (found.convention, found.source) == (BLENDER, "calibrated")
        assert found.error is not None and found.error < 0.2


def still_pairs() -> list[tuple[Instant, Instant]]:
    seen = town().still().view(0.0)
    raw = np.zeros((*seen.surface.shape, 4), np.float32)
    frames = [Instant(n, seen.gbuffer(motion=False), raw, seen.colour) for n in (7, 8)]
    return pairs_of(frames)


class TestUntested:
    def test_without_motion_the_names_stand(self):
        found = calibrate(still_pairs(), BLENDER, XYZW)
        assert (found.convention, found.source) == (BLENDER, "untested")
        assert found.error is None and "7-8 hold too little motion" in found.evidence

    def test_one_frame_alone(self):
        found = calibrate([], BLENDER, XYZW)
        assert (found.convention, found.source) == (BLENDER, "untested")
        assert "one frame alone" in found.evidence

    @pytest.mark.parametrize("given", [[], still_pairs()], ids=["one frame", "stills"])
    def test_without_names_either_it_is_an_error(self, given):
        with pytest.raises(MotionError, match=r"is unknown: .*; give --motion"):
            calibrate(given, None, XYZW)


def with_values(frames: list[Instant], channels: slice, value: float) -> list[Instant]:
    """Put a value into channels of every frame."""
    out = []
    for frame in frames:
        motion = frame.motion.copy()
        motion[..., channels] = value
        out.append(replace(frame, motion=motion))
    return out


class TestHalfWritten:
    """Passes of which a part holds no vectors: it is never read as no motion."""

    @pytest.mark.parametrize("value", [0.0, np.nan])
    @pytest.mark.parametrize(
        ("channels", "lost", "expected"),
        [
            (slice(2, 4), "Z,W", MotionConvention(BLENDER.to_previous)),
            (slice(0, 2), "X,Y", MotionConvention(None, BLENDER.to_next)),
        ],
    )
    def test_one_direction_alone_is_used_and_it_is_said(self, value, channels, lost, expected):
        frames = with_values(instants(BLENDER, 4), channels, value)
        found = calibrate(pairs_of(frames), BLENDER, XYZW)
        assert (found.convention, found.source) == (expected, "calibrated")
        assert found.evidence.endswith(f"; {lost} hold no vectors and are left out")

    @pytest.mark.parametrize("bad", [0, 1])
    def test_a_first_or_last_frame_without_vectors(self, bad):
        frames = instants(BLENDER, 4)[:2]
        frames[bad] = replace(frames[bad], motion=np.full_like(frames[bad].motion, np.nan))
        found = calibrate(pairs_of(frames), BLENDER, XYZW)
        assert (found.convention, found.source) == (BLENDER, "calibrated")
        wrong = both(AxisMap(0, 1, 1, 1), AxisMap(2, 3, -1, -1))
        corrected = calibrate(pairs_of(frames), wrong, XYZW)
        one = BLENDER.to_next if bad else BLENDER.to_previous
        assert one in (corrected.convention.to_previous, corrected.convention.to_next)
        assert None in (corrected.convention.to_previous, corrected.convention.to_next)

    def test_garbage_in_one_direction_is_no_small_error(self):
        rng = np.random.default_rng(11)
        frames = instants(BLENDER, 4)
        for frame in frames:
            frame.motion[..., 2:] = rng.normal(0, 9, frame.motion[..., 2:].shape)
        with pytest.raises(MotionError, match=r"explains the motion .* one of the two directions"):
            calibrate(pairs_of(frames), BLENDER, XYZW)

    @pytest.mark.parametrize("guess", [None, BLENDER])
    def test_no_numbers_at_all(self, guess):
        frames = with_values(instants(BLENDER, 4), slice(None), np.nan)
        with pytest.raises(MotionError, match=r"X, Y, Z, W of frames 0-1, 1-2 hold no numbers"):
            calibrate(pairs_of(frames), guess, XYZW)

    def test_nothing_to_measure_by(self):
        frames = instants(BLENDER, 4, depth=None, position=None, colour=None)
        found = calibrate(pairs_of(frames), BLENDER, XYZW)
        assert found.source == "untested" and "nothing to measure by" in found.evidence


class TestErrors:
    @pytest.mark.parametrize("guess", [None, BLENDER])
    def test_garbage_vectors(self, guess):
        rng = np.random.default_rng(5)
        frames = [
            replace(f, motion=rng.normal(0, 9, f.motion.shape).astype(np.float32))
            for f in instants(BLENDER, 4)
        ]
        with pytest.raises(MotionError, match="no reading of the motion channels explains"):
            calibrate(pairs_of(frames), guess, XYZW)

    @pytest.mark.parametrize("guess", [None, BLENDER])
    def test_empty_vectors_in_a_moving_shot(self, guess):
        frames = [replace(f, motion=np.zeros_like(f.motion)) for f in instants(BLENDER, 4)]
        with pytest.raises(MotionError, match="no reading of the motion channels explains"):
            calibrate(pairs_of(frames), guess, XYZW)

    @pytest.mark.parametrize("letters", [("R", "G"), ("R", "G", "B"), ("R", "G", "A")])
    def test_garbage_between_0_and_1(self, letters):
        rng = np.random.default_rng(8)
        frames = [
            replace(f, motion=rng.random((*f.motion.shape[:2], len(letters))).astype(np.float32))
            for f in instants(BLENDER, 4)
        ]
        with pytest.raises(MotionError, match="no reading of the motion channels explains"):
            calibrate(pairs_of(frames), None, letters)

    @pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
    def test_one_value_everywhere_in_a_moving_shot(self, value):
        frames = [
            replace(f, motion=np.full_like(f.motion[..., :2], value)) for f in instants(BLENDER, 4)
        ]
        with pytest.raises(MotionError, match="no reading of the motion channels explains"):
            calibrate(pairs_of(frames), None, XY)

    def test_random_directions_with_a_length(self):
        rng = np.random.default_rng(9)
        frames = []
        for frame in instants(BLENDER, 4):
            turn = rng.uniform(0, 7, frame.motion.shape[:2])
            raw = np.stack([np.cos(turn), np.sin(turn), rng.uniform(0, 9, turn.shape)], -1)
            frames.append(replace(frame, motion=raw.astype(np.float32)))
        with pytest.raises(MotionError, match="no reading of the motion channels explains"):
            calibrate(pairs_of(frames), PRESETS["arnold"], ("R", "G", "B"))

    def test_unknown_names_and_nothing_that_separates_the_readings(self):
        # Everything is one grey: any reading explains it as well as any other.
        rng = np.random.default_rng(6)
        frames = []
        for frame in instants(BLENDER, 4, **COLOUR_ONLY):
            assert frame.colour is not None
            noise = rng.random(frame.colour.shape).astype(np.float32)
            frames.append(replace(frame, colour=noise))
        with pytest.raises(MotionError, match="--motion"):
            calibrate(pairs_of(frames), None, XYZW)

    def test_axis_that_does_not_move_and_no_names(self):
        # A purely horizontal motion says nothing of the sign of y.
        scene = town()
        camera = replace(
            scene.camera, velocity=np.array([0.3, 0, 0]), acceleration=np.zeros(3), yaw=0, pitch=0
        )
        quads = tuple(replace(quad, velocity=np.zeros(3)) for quad in scene.quads)
        across = replace(scene, camera=camera, quads=quads)
        truth = MotionConvention(to_previous=AxisMap(0, 1, 1.0, -1.0))
        frames = []
        for number in range(2):
            seen = across.view(float(number))
            raw = raw_of(seen, truth, 2)
            frames.append(Instant(number, seen.gbuffer(motion=False), raw, seen.colour))
        found = calibrate(pairs_of(frames), truth, XY)
        assert found.convention == truth
        # Without names either sign gives the same vectors, so either will do.
        blind = calibrate(pairs_of(frames), None, XY).convention.to_previous
        assert blind is not None
        applied = blind.apply(frames[1].motion)
        np.testing.assert_allclose(applied, truth.to_previous.apply(frames[1].motion), atol=1e-5)
