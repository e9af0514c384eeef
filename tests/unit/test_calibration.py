"""Finding the convention of motion vectors by measuring."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from exwarp_cli.domain.motion import PRESETS, AxisMap, MotionConvention
from exwarp_cli.errors import MotionError
from exwarp_cli.synthesis.calibration import calibrate
from exwarp_cli.synthesis.calibration_samples import MotionFrame
from tests.matrix import combinations, spread
from tests.unit.motion_pairs import (
    BLENDER,
    COLOUR_ONLY,
    DEPTH_ONLY,
    HEIGHT,
    POSITION_ONLY,
    SCALES,
    SIGNS,
    WIDTH,
    XY,
    XYZW,
    both,
    instants,
    pairs,
    pairs_of,
    raw_of,
)
from tests.unit.scenes import town


def at_even_speed(truth: MotionConvention) -> list[MotionFrame]:
    """Two frames whose vectors there and back are the same but for their sign."""
    scene = town()
    camera = replace(scene.camera, acceleration=np.zeros(3), yaw=0, pitch=0)
    quads = tuple(replace(quad, velocity=np.zeros(3)) for quad in scene.quads)
    even = replace(scene, camera=camera, quads=quads)
    views = [even.view(float(time)) for time in range(2)]
    return [
        MotionFrame(n, view.gbuffer(motion=False), raw_of(view, truth, 2), view.colour)
        for n, view in enumerate(views)
    ]


class TestRecovery:
    @pytest.mark.parametrize(("scale", "signs"), combinations(list(SCALES.values()), SIGNS))
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
        ("without", "truth"),
        combinations(
            [POSITION_ONLY, COLOUR_ONLY, {"position": None}], [BLENDER, PRESETS["forward+backward"]]
        ),
    )
    def test_whatever_there_is_to_judge_by(self, without, truth):
        assert calibrate(pairs(truth, 4, **without)[:1], None, XYZW).convention == truth

    @pytest.mark.parametrize("truth", spread([BLENDER, PRESETS["forward+backward"]], 1))
    def test_depth_alone_confirms_what_the_names_say(self, truth):
        found = calibrate(pairs(truth, 4, **DEPTH_ONLY), truth, XYZW)
        assert (found.convention, found.source) == (truth, "calibrated")

    @pytest.mark.parametrize("truth", spread([PRESETS["forward+backward"], BLENDER], 1))
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
            frames.append(
                MotionFrame(frame.number, rounded, half(frame.motion), half(frame.colour))
            )
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

    @pytest.mark.parametrize(
        ("scale", "aspect"), combinations([37.0, 150.0, 0.13, 0.9 * WIDTH / 2], [1, HEIGHT / WIDTH])
    )
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
        truth = MotionConvention(to_next=AxisMap(0, 1, 23.0, -23.0))
        found = calibrate(pairs_of(at_even_speed(truth)), PRESETS["forward"], XY).convention
        assert found.to_next is not None and found.to_previous is None
        assert found.to_next.x_scale == pytest.approx(23, rel=0.02)


class TestClear:
    """Whether a pair tells all: any doubt has further pairs measured."""

    def test_as_named_and_nothing_else_comes_near(self):
        assert calibrate(pairs(BLENDER, 4)[:1], BLENDER, XYZW).clear
        before = MotionConvention(AxisMap(0, 1, 1, -1))
        assert calibrate(pairs(before)[:1], before, XY).clear

    def test_names_that_say_nothing_or_are_wrong(self):
        wrong = both(AxisMap(0, 1, 1, 1), AxisMap(2, 3, -1, -1))
        assert not calibrate(pairs(BLENDER, 4)[:1], None, XYZW).clear
        assert not calibrate(pairs(BLENDER, 4)[:1], wrong, XYZW).clear

    @pytest.mark.parametrize("value", [0.0, np.nan])
    @pytest.mark.parametrize("channels", [slice(2, 4), slice(0, 2)])
    def test_channels_that_hold_nothing_yet(self, channels, value):
        frames = instants(BLENDER, 4)[:2]
        for frame in frames:
            frame.motion[..., channels] = value
        assert not calibrate(pairs_of(frames), BLENDER, XYZW).clear

    @pytest.mark.parametrize("bad", [0, 1])
    def test_a_frame_that_holds_nothing(self, bad):
        frames = instants(BLENDER, 4)[:2]
        frames[bad] = replace(frames[bad], motion=np.full_like(frames[bad].motion, np.nan))
        assert not calibrate(pairs_of(frames), BLENDER, XYZW).clear

    def test_an_even_speed_which_does_not_tell_there_from_back(self):
        forward = PRESETS["forward"]
        found = calibrate(pairs_of(at_even_speed(forward)), forward, XY)
        assert (found.source, found.clear) == ("calibrated", False)
        uneven = calibrate(pairs(forward)[:1], forward, XY)
        assert uneven.clear

    def test_too_little_motion(self):
        scene = town()
        still = [
            MotionFrame(n, (v := scene.view(n / 60)).gbuffer(motion=False), raw, v.colour)
            for n, raw in enumerate([raw_of(scene.view(0.0), BLENDER, 4, 1 / 60)] * 2)
        ]
        assert not calibrate(pairs_of(still), BLENDER, XYZW).clear


def test_premultiplied_vectors_are_recognised_by_their_alpha():
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
    def test_names_that_are_wrong_are_corrected_and_both_are_named(self, truth):
        found = calibrate(pairs(truth, 4), BLENDER, XYZW)
        assert (found.convention, found.source) == (truth, "corrected")
        assert truth.describe(XYZW) in found.evidence
        assert f"the names say {BLENDER.describe(XYZW)}" in found.evidence

    @pytest.mark.parametrize(("slower", "source"), [(30, "calibrated"), (60, "untested")])
    def test_a_slow_motion_does_not_unseat_the_names(self, slower, source):
        # Sixty times slower, signs can hardly be determined; the names then stand.
        scene = town()
        slow = [
            MotionFrame(
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
