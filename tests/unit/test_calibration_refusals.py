"""What calibration does with vectors that say little or nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from exwarp_cli.domain.motion import PRESETS, AxisMap, MotionConvention
from exwarp_cli.errors import MotionError
from exwarp_cli.synthesis.calibration import calibrate
from exwarp_cli.synthesis.calibration_samples import FrameSamples, MotionFrame
from tests.matrix import spread
from tests.unit.motion_pairs import (
    BLENDER,
    COLOUR_ONLY,
    XY,
    XYZW,
    both,
    instants,
    pairs_of,
    raw_of,
)
from tests.unit.scenes import town


def still_pairs(value: float = 0.0) -> list[tuple[FrameSamples, FrameSamples]]:
    seen = town().still().view(0.0)
    raw = np.full((*seen.surface.shape, 4), value, np.float32)
    frames = [MotionFrame(n, seen.gbuffer(motion=False), raw, seen.colour) for n in (7, 8)]
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

    def test_one_frame_without_names_either_is_an_error(self):
        with pytest.raises(MotionError, match=r"is unknown: .*; give --motion"):
            calibrate([], None, XYZW)

    @pytest.mark.parametrize("value", [0.0, 0.5])
    def test_where_nothing_moves_any_reading_serves_and_it_is_said(self, value):
        found = calibrate(still_pairs(value), None, XYZW)
        assert (found.source, found.resting) == ("untested", True)
        assert "nothing moves in frames 7-8" in found.evidence
        axes = found.convention.to_previous
        assert axes is not None
        np.testing.assert_array_equal(axes.apply(np.full((5, 4), value, np.float32)), 0)

    def test_slow_motion_without_names_is_still_an_error(self):
        frames = []
        for number in range(2):
            seen = town().view(number / 60)
            raw = raw_of(seen, BLENDER, 4, 1 / 60)
            frames.append(MotionFrame(number, seen.gbuffer(motion=False), raw, seen.colour))
        with pytest.raises(MotionError, match=r"is unknown: .*too little motion"):
            calibrate(pairs_of(frames), None, XYZW)


def with_values(frames: list[MotionFrame], channels: slice, value: float) -> list[MotionFrame]:
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
    @pytest.mark.parametrize("guess", spread([BLENDER, None], 1))
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

    @pytest.mark.parametrize("letters", spread([("R", "G"), ("R", "G", "B"), ("R", "G", "A")], 2))
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
            frames.append(MotionFrame(number, seen.gbuffer(motion=False), raw, seen.colour))
        found = calibrate(pairs_of(frames), truth, XY)
        assert found.convention == truth
        # Without names either sign gives the same vectors, so either will do.
        blind = calibrate(pairs_of(frames), None, XY).convention.to_previous
        assert blind is not None
        applied = blind.apply(frames[1].motion)
        np.testing.assert_allclose(applied, truth.to_previous.apply(frames[1].motion), atol=1e-5)


class TestPresetsAreNamed:
    """What is refused says which preset would read the vectors."""

    def test_a_reading_that_fits_one_but_does_not_stand_out(self):
        # In a slow shot, depth alone does not tell the best reading from others.
        frames = []
        for number in range(3):
            seen = town().view(number / 4)
            raw = raw_of(seen, BLENDER, 4, 1 / 4)
            depth_alone = replace(seen.gbuffer(motion=False), position=None)
            frames.append(MotionFrame(number, depth_alone, raw, None))
        with pytest.raises(MotionError, match=r"\(looks like Blender: --motion blender\)$"):
            calibrate(pairs_of(frames), None, XYZW, presets=PRESETS)

    def test_what_the_names_say(self):
        rng = np.random.default_rng(5)
        frames = [
            replace(f, motion=rng.normal(0, 9, (*f.motion.shape[:2], 2)).astype(np.float32))
            for f in instants(BLENDER, 4)
        ]
        with pytest.raises(MotionError, match=r"\(looks like Unreal: --motion unreal\)$"):
            calibrate(pairs_of(frames), PRESETS["unreal"], XY, presets=PRESETS)


class TestWeakEvidence:
    """What tells points apart badly does not refuse a convention that is known by name."""

    @pytest.mark.parametrize("levels", [20, 40, 106])
    def test_coarse_depth(self, levels):
        frames = []
        for number, frame in enumerate(instants(PRESETS["unreal"], 2, position=None, colour=None)):
            depth = frame.gbuffer.depth
            assert depth is not None
            most = depth[np.isfinite(depth)].max()
            coarse = (np.rint(depth / most * levels) / levels * most).astype(np.float32)
            frames.append(
                MotionFrame(number, replace(frame.gbuffer, depth=coarse), frame.motion, None)
            )
        found = calibrate(pairs_of(frames), PRESETS["unreal"], XY)
        assert found.convention == PRESETS["unreal"]

    def test_noise(self):
        rng = np.random.default_rng(7)
        frames = []
        for frame in instants(BLENDER, 4, position=None, depth=None):
            assert frame.colour is not None
            noise = rng.normal(0, 0.15, frame.colour.shape)
            frames.append(replace(frame, colour=(frame.colour + noise).astype(np.float32)))
        assert calibrate(pairs_of(frames), BLENDER, XYZW).convention == BLENDER
        wrong = both(AxisMap(0, 1, 1, 1), AxisMap(2, 3, -1, -1))
        assert calibrate(pairs_of(frames), wrong, XYZW).convention == BLENDER
