"""Residual motion between two warped key frames: of shadows, reflections and highlights.

Motion vectors are those of surfaces. A shadow on still ground has none, so both key frames show it
where it was, and their mixture shows two of half its darkness. What is left of motion between the
two warped pictures is searched as optical flow, and followed as far as it makes them agree.
"""

from __future__ import annotations

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.synthesis.geometry import SlotField
from exwarp_cli.synthesis.optical_flow import box_mean, flow_between, grey_of, mean_difference
from exwarp_cli.synthesis.warp import Warped, as_shown, sampled

SIDE = 5
"""Side of the square, pixels, over which two pictures are compared; 9 gained nothing."""

GAIN = np.float32(2)
"""The flow counts in full where it takes away one in so many of the disagreement."""

LEAST = np.float32(4 / 255)
"""Disagreement from which on a flow is followed: what is less is noise, or cannot be seen."""


def disagreement(before: Warped, after: Warped) -> Float32:
    """Return the mean difference of two warped key frames around each pixel, float32 [H, W]."""
    mean = mean_difference(before.pixels, after.pixels)
    mean[before.hole | after.hole] = 0
    return box_mean(mean, SIDE)


def flow_of(before: Warped, after: Warped, linear: bool) -> Float32:
    """Return how light moves against the surfaces at a slot.

    Parameters
    ----------
    before, after
        The key frames, warped to the slot.
    linear
        Whether their colour is scene-linear, and not as shown.

    Returns
    -------
    float32 [H, W, 2]
        Pixels, from the picture of `before` to that of `after`.
    """
    one, other = (
        grey_of(as_shown(side.pixels) if linear else side.pixels) for side in (before, after)
    )
    # Where one side sees nothing, it has the colour of the other.
    return flow_between(np.where(before.hole, other, one), np.where(after.hole, one, other))


def along(plain: Warped, source: SlotField, flow: Float32, apart: Float32) -> SlotField:
    """Return the motion field of a slot whose light moves along a flow, too.

    Parameters
    ----------
    plain
        A key frame warped without the flow.
    source
        From the slot to the key frame.
    flow
        float32 [H, W, 2], pixels: from the slot's picture to that of `plain`.
    apart
        From `disagreement`; where it is small, nothing is followed.
    """
    motion, _ = sampled(source.field, flow)
    motion += flow
    motion[apart < LEAST] = np.nan
    hidden, _ = sampled(plain.hole.astype(np.float32)[..., None], flow)
    hole: Bool = plain.hole | (hidden[..., 0] > 0)
    return SlotField(motion, source.depth, hole)


def agreement(apart: Float32, before: Warped, after: Warped) -> Float32:
    """Return by how much a flow makes two pictures agree, float32 [H, W], 0 to 1.

    Parameters
    ----------
    apart
        From `disagreement`, of the key frames warped without the flow.
    before, after
        The key frames warped along it.
    """
    gain = (apart - disagreement(before, after)) / np.maximum(apart, LEAST)
    weight: Float32 = np.clip(GAIN * gain, np.float32(0), np.float32(1))
    weight[before.hole | after.hole] = 0
    return weight
