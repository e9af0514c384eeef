"""Residual motion between two warped key frames: of shadows, reflections and highlights.

Motion vectors are those of surfaces. A shadow on still ground has none, so both key frames show it
where it was, and their mixture shows two of half its darkness. What is left of motion between the
two warped pictures is searched as optical flow, and followed as far as it makes them agree.
"""

from __future__ import annotations

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.synthesis.geometry import SlotField
from exwarp_cli.synthesis.optical_flow import box_mean, flow_between
from exwarp_cli.synthesis.warp import Warped, as_shown, sampled

SIDE = 5
"""Side of the square, pixels, over which two pictures are compared; 9 gained nothing."""

GAIN = np.float32(2)
"""The flow counts in full where it takes away one in so many of the disagreement."""

LEAST = np.float32(1 / 255)
"""Least disagreement that anything is divided by: a step of 8 bits."""


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
    seen = _seen(before, after), _seen(after, before)
    return flow_between(*(map(as_shown, seen) if linear else seen))


def along(plain: Warped, source: SlotField, flow: Float32) -> SlotField:
    """Return the motion field of a slot whose light moves along a flow, too.

    Parameters
    ----------
    plain
        A key frame warped without the flow.
    source
        From the slot to the key frame.
    flow
        float32 [H, W, 2], pixels: from the slot's picture to that of `plain`.
    """
    motion, _ = sampled(source.field, flow)
    motion += flow
    hidden, _ = sampled(plain.hole.astype(np.float32)[..., None], flow)
    hole: Bool = plain.hole | (hidden[..., 0] > 0)
    return SlotField(motion, source.depth, hole)


def agreement(plain: tuple[Warped, Warped], shifted: tuple[Warped, Warped]) -> Float32:
    """Return by how much a flow makes two pictures agree, float32 [H, W], 0 to 1.

    Parameters
    ----------
    plain, shifted
        The key frames before and after, warped without the flow and along it.
    """
    before, after = plain
    apart = _apart(_seen(before, after), _seen(after, before))
    gain = (apart - _apart(shifted[0].pixels, shifted[1].pixels)) / np.maximum(apart, LEAST)
    weight: Float32 = np.clip(GAIN * gain, np.float32(0), np.float32(1))
    weight[shifted[0].hole | shifted[1].hole] = 0
    return weight


def _seen(side: Warped, other: Warped) -> Float32:
    """Return the colour of one side, of the other where it sees nothing."""
    return np.where(side.hole[..., None], other.pixels, side.pixels)


def _apart(first: Float32, second: Float32) -> Float32:
    """Return the mean difference of two pictures' colours around each pixel, float32 [H, W]."""
    apart = np.abs(first[..., :3] - second[..., :3])
    # Added by hand: numpy's mean over a last axis of three is slow.
    return box_mean((apart[..., 0] + apart[..., 1] + apart[..., 2]) / np.float32(3), SIDE)
