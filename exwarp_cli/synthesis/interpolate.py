"""Look-ahead methods: a slot's frame from the key frames on both sides of it."""

from __future__ import annotations

import numpy as np

from exwarp_cli.domain.frame import Float32
from exwarp_cli.synthesis.warp import Warped, fill_background

NEARNESS = np.float32(10.0)
"""Exponent of the depth weight: a surface twice as near outweighs the other 1000 to 1."""


def blend_by_depth(before: Warped, after: Warped, time: float) -> Float32:
    """Blend two warped key frames as softmax splatting does, with the renderer's exact motion.

    Parameters
    ----------
    before, after
        The key frames on both sides, warped to the slot.
    time
        Of the slot in the key interval, 0 < time < 1.

    Returns
    -------
    float32 [H, W, C]
        Each side weighs by its nearness in time, times a softmax over -NEARNESS log(depth); a side
        that does not see the surface weighs nothing, so disocclusions come from the side that sees
        them. What neither sees is filled from the background.

    Notes
    -----
    Niklaus and Liu, Softmax Splatting, CVPR 2020, equation 14, with importance from depth.
    """
    t = np.float32(time)
    nearest = np.fmin(before.depth, after.depth)
    first = (np.float32(1) - t) * _importance(before, nearest)
    second = t * _importance(after, nearest)
    total = first + second
    hole = total <= 0
    share = np.where(hole, np.float32(0), second / np.where(hole, np.float32(1), total))[..., None]
    pixels = before.pixels + share * (after.pixels - before.pixels)
    return fill_background(Warped(pixels.astype(np.float32), nearest, hole))


def _importance(side: Warped, nearest: Float32) -> Float32:
    """float32 [H, W]: (nearest / depth) ** NEARNESS, 0 in holes; background equals background."""
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(np.isinf(side.depth) & np.isinf(nearest), 1, nearest / side.depth)
    weight = np.power(np.maximum(ratio, np.float32(1e-3)), NEARNESS, dtype=np.float32)
    return np.where(side.hole | ~np.isfinite(weight), np.float32(0), weight).astype(np.float32)
