"""Look-ahead methods: a slot's frame from the key frames on both sides of it."""

from __future__ import annotations

import numpy as np

from exwarp_cli.domain.curves import SRGB
from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.domain.interpolator import Interpolator
from exwarp_cli.kernels import blend
from exwarp_cli.runtime.frame_pool import pool
from exwarp_cli.synthesis.warp import Warped, fill_holes, repair


def blend_by_depth(before: Warped, after: Warped, time: float) -> Float32:
    """Blend two warped key frames as softmax splatting does, with the renderer's exact motion.

    Parameters
    ----------
    before, after
        The key frames on both sides, warped to the slot. The pixels of the first are changed and
        returned: three frames of 1920x1080 in several threads are memory.
    time
        Of the slot in the key interval, 0 < time < 1.

    Returns
    -------
    float32 [H, W, C]
        Each side weighs by its nearness in time, times a softmax over its depth; a side that does
        not see the surface weighs nothing, so disocclusions come from the side that sees them. What
        neither sees is filled from the background.
    """
    depth: Float32 = pool.empty(before.depth.shape, np.float32)
    hole: Bool = pool.empty(before.hole.shape, np.bool_)
    sides = [(side.pixels, side.depth, side.hole, side.fringe) for side in (before, after)]
    blend.blend(*sides, np.float32(time), before.pixels, depth, hole)
    return fill_holes(before.pixels, depth, hole)


def cross_fade(before: Float32, after: Float32, time: float) -> Float32:
    """Mix two layers [H, W, C] at a time, 0 to 1; what is not finite is filled from around."""
    first, second = repair(before), repair(after)
    with np.errstate(over="ignore", invalid="ignore"):  # of the largest floats
        return (first + np.float32(time) * (second - first)).astype(np.float32)


def as_shown(pixels: Float32) -> Float32:
    """Return scene-linear colour [H, W, 3 or 4] by the sRGB curve, alpha as it is.

    Two key frames along estimated motion seldom show quite the same: half of each looks right where
    it is half of what is seen, worth 0.25 dB. The curve goes on below 0 and above 1.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        return np.concatenate([SRGB.to_code(pixels[..., :3]), pixels[..., 3:]], axis=-1)


def as_light(pixels: Float32) -> Float32:
    """Invert `as_shown`."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.concatenate([SRGB.to_linear(pixels[..., :3]), pixels[..., 3:]], axis=-1)


def between(before: Float32, after: Float32, time: float, network: Interpolator) -> Float32:
    """Have a network make the frame of a slot from the colour of both key frames.

    Parameters
    ----------
    before, after
        float32 [H, W, 3 or 4], scene-linear; pixels that are not finite are filled from around.
    time
        Of the slot in the key interval, 0 < time < 1.
    network
        It sees no motion vectors.

    Returns
    -------
    float32 [H, W, 3 or 4]
        Scene-linear, premultiplied alpha; a new array.
    """
    return pool.copy(network(repair(before), repair(after), time))
