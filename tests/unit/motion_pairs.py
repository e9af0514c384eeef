"""Pairs of frames of a known scene, with vectors in any convention."""

from __future__ import annotations

import functools
from dataclasses import replace
from itertools import pairwise

import numpy as np

from exwarp_cli.domain.motion import PRESETS, AxisMap, MotionConvention
from exwarp_cli.synthesis.calibration_samples import FrameSamples, MotionFrame, sample_frame
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


def instants(convention: MotionConvention, count: int, **without: None) -> list[MotionFrame]:
    out = []
    for number, view in enumerate(views()):
        colour = None if "colour" in without else view.colour
        buffer = replace(
            view.gbuffer(motion=False), **{k: v for k, v in without.items() if k != "colour"}
        )
        out.append(MotionFrame(number, buffer, raw_of(view, convention, count), colour))
    return out


def pairs_of(frames: list[MotionFrame]) -> list[tuple[FrameSamples, FrameSamples]]:
    return list(pairwise(map(sample_frame, frames)))


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
