"""Vectors of frames that were rendered in steps: over one frame of the scene, or over the step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from exwarp_cli.domain.motion import AxisMap, MotionConvention
from exwarp_cli.synthesis.calibration import calibrate
from exwarp_cli.synthesis.calibration_samples import FrameSamples, MotionFrame
from tests.matrix import combinations
from tests.unit.motion_pairs import BLENDER, XYZW, both, pairs_of, raw_of
from tests.unit.scenes import town

STEP = 4


def stepped(
    span: float, slower: float = 1.0, noise: float = 0.0, **without: None
) -> list[tuple[FrameSamples, FrameSamples]]:
    """Every fourth frame of a shot, with vectors over a part of the step."""
    rng = np.random.default_rng(3)
    frames = []
    for index in range(3):
        seen = town().view(index / slower)
        raw = raw_of(seen, BLENDER, 4, span / slower)
        raw += rng.normal(0, 0.3 * noise, raw.shape).astype(np.float32) * (raw != 0)
        colour = (seen.colour + rng.normal(0, noise, seen.colour.shape)).astype(np.float32)
        buffer = replace(seen.gbuffer(motion=False), **without)
        frames.append(MotionFrame(1 + STEP * index, buffer, raw, colour))
    return pairs_of(frames)


WITHOUT = {
    "positions": {},
    "depth and colour": {"position": None},
    "colour": {"position": None, "depth": None},
}


@pytest.mark.parametrize(
    ("without", "slower", "noise"),
    combinations(list(WITHOUT.values()), [4.0, 1.0], [0.03, 0.1, 0.0]),
)
class TestBothDirectionsSpanTheSame:
    def test_vectors_over_one_frame_of_the_scene(self, without, slower, noise):
        found = calibrate(stepped(1 / STEP, slower, noise, **without), BLENDER, XYZW, step=STEP)
        assert found.convention.describe(XYZW) == "previous=4*X,-4*Y next=-4*Z,4*W"
        assert "vectors span one frame of the 4 from key frame to key frame" in found.evidence

    def test_vectors_over_the_whole_step(self, without, slower, noise):
        found = calibrate(stepped(1.0, slower, noise, **without), BLENDER, XYZW, step=STEP)
        assert found.convention == BLENDER
        assert "span" not in found.evidence


@pytest.mark.parametrize("span", [1 / STEP, 1.0])
def test_names_that_say_nothing(span):
    found = calibrate(stepped(span, 4.0, position=None), None, XYZW, step=STEP)
    assert found.convention == BLENDER.scaled(1 / span)


def test_numbers_without_steps_have_one_span_for_both_too():
    """A renumbered shot that slows down: each direction by itself is nearer to another span."""
    scene = town()
    camera = replace(scene.camera, acceleration=-0.35 * scene.camera.velocity)
    slowing = replace(scene, camera=camera)
    frames = []
    for number in range(3):
        seen = slowing.view(float(number))
        raw = raw_of(seen, BLENDER, 4, 1 / STEP)
        frames.append(MotionFrame(number, seen.gbuffer(motion=False), raw, seen.colour))
    found = calibrate(pairs_of(frames), BLENDER, XYZW).convention
    assert found.to_previous is not None and found.to_next is not None
    assert abs(found.to_previous.x_scale) == abs(found.to_next.x_scale)


def test_directions_that_are_clearly_apart_stay_apart():
    truth = both(AxisMap(0, 1, 1.0, -1.0), AxisMap(2, 3, -4.0, 4.0))
    frames = []
    for number in range(3):
        seen = town().view(float(number))
        frames.append(
            MotionFrame(number, seen.gbuffer(motion=False), raw_of(seen, truth, 4), seen.colour)
        )
    assert calibrate(pairs_of(frames), None, XYZW).convention == MotionConvention(
        truth.to_previous, truth.to_next
    )
