"""Means of motion over blocks of pixels, of which the predictor sees the variance."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.compiled.shares import WHOLE, Share, turns
from exwarp_cli.kernels.jit import parallel, serial

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
B8 = npt.NDArray[np.bool_]


def block_means_text(motion: F32, shown: B8, size: int, out: F64, share: Share = WHOLE) -> None:
    """Write the mean motion of each block.

    Parameters
    ----------
    motion
        float32 [H, W, 2], pixels.
    shown
        bool [H, W]: pixels that count; [0, 0] when all do.
    size
        Side of a block, pixels, at least 1. Blocks at the right and lower edge may be smaller.
    out
        float64 [ceil(H / size), ceil(W / size), 2], written: means over the pixels that count and
        whose components are both finite; NaN where a block has none.
    share
        Which turns are taken: those of :func:`~exwarp_cli.compiled.shares.turns`.
    """
    height, width, _ = motion.shape
    masked = shown.size > 0
    for block_row in turns(out.shape[0], share):
        top = block_row * size
        for block_column in range(out.shape[1]):
            left = block_column * size
            sum_x, sum_y, count = np.float64(0), np.float64(0), 0
            for i in range(top, min(top + size, height)):
                for j in range(left, min(left + size, width)):
                    vx, vy = np.float64(motion[i, j, 0]), np.float64(motion[i, j, 1])
                    # Two float32 cannot add up to infinity here.
                    if (not masked or shown[i, j]) and math.isfinite(vx + vy):
                        sum_x += vx
                        sum_y += vy
                        count += 1
            out[block_row, block_column, 0] = sum_x / count if count > 0 else np.nan
            out[block_row, block_column, 1] = sum_y / count if count > 0 else np.nan


block_means = parallel(block_means_text)
block_means_serial = serial(block_means_text)
