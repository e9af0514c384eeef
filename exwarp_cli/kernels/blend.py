"""Blending two warped key frames by depth and time."""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels.jit import parallel, serial

F32 = npt.NDArray[np.float32]
B8 = npt.NDArray[np.bool_]
Side = tuple[F32, F32, B8, B8]

NEARNESS = 10
"""Exponent of the depth weight: a surface twice as near outweighs the other 1000 to 1."""

LEAST_RATIO = np.float32(1e-3)

FRINGE_WEIGHT = np.float32(0.02)
"""Weight of a ghost outline: used where the other side sees nothing (worth 0.2 dB)."""


@serial
def importance(depth: np.float32, nearest: np.float32, hole: bool, fringe: bool) -> np.float32:
    """Return (nearest / depth) ** NEARNESS, less for a fringe, 0 for a hole."""
    if hole or math.isnan(depth):
        return np.float32(0)
    ratio = np.float32(1)
    if depth != nearest:
        ratio = max(nearest / depth, LEAST_RATIO)
    weight = np.float32(1)
    for _ in range(NEARNESS):
        weight *= ratio
    return weight * FRINGE_WEIGHT if fringe else weight


def blend_text(before: Side, after: Side, time: np.float32, out: F32, depth: F32, hole: B8) -> None:
    """Blend what two key frames show at a slot.

    Parameters
    ----------
    before, after
        Pixels float32 [H, W, C], depth float32 [H, W] (+inf background, NaN unknown), hole and
        fringe bool [H, W] of the key frames on both sides, warped to the slot.
    time
        Of the slot in the key interval, 0 < time < 1.
    out
        float32 [H, W, C], written; in holes that of `before`.
    depth
        float32 [H, W], written: the nearer of both depths.
    hole
        bool [H, W], written: neither side sees the surface.

    Notes
    -----
    Niklaus and Liu, Softmax Splatting, CVPR 2020, equation 14, with log depth for importance.
    """
    height, width, channels = out.shape
    for row in numba.prange(height):
        i = np.int64(row)
        for j in range(width):
            near = after[1][i, j]
            if before[1][i, j] < near or math.isnan(near):
                near = before[1][i, j]
            depth[i, j] = near
            a = importance(before[1][i, j], near, before[2][i, j], before[3][i, j])
            b = importance(after[1][i, j], near, after[2][i, j], after[3][i, j])
            a *= np.float32(1) - time
            b *= time
            hole[i, j] = not a + b > 0
            share = np.float32(0) if hole[i, j] else b / (a + b)
            for c in range(channels):
                first, second = before[0][i, j, c], after[0][i, j, c]
                # From the heavier side: exact where it counts alone, whatever stands in the other.
                if share < np.float32(0.5):
                    out[i, j, c] = first + share * (second - first)
                else:
                    out[i, j, c] = second + (np.float32(1) - share) * (first - second)


blend = parallel(blend_text)
blend_serial = serial(blend_text)
