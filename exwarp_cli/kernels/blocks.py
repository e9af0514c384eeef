"""Means of motion over blocks of pixels, of which the predictor sees the variance."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import parallel, part
from exwarp_cli.kernels._row_bands import Share, turns

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
B8 = npt.NDArray[np.bool_]


@part
def any_of(shown: B8) -> bool:
    """Whether any pixel [N] counts. All are asked, so the compiler takes many at once."""
    some = False
    for j in range(shown.size):
        some |= shown[j]
    return some


@part
def mean_of(motion: F32, shown: B8, mean: F64) -> None:
    """Write the mean [2] of what counts of a block's values [R, C, 2]; NaN where nothing does."""
    sum_x, sum_y, count = np.float64(0), np.float64(0), 0
    for i in range(motion.shape[0]):
        if shown.size > 0 and not any_of(shown[i]):
            continue  # as mostly in sky, half of all the time without
        for j in range(motion.shape[1]):
            vx, vy = np.float64(motion[i, j, 0]), np.float64(motion[i, j, 1])
            # Two float32 cannot add up to infinity here.
            if (shown.size == 0 or shown[i, j]) and math.isfinite(vx + vy):
                sum_x += vx
                sum_y += vy
                count += 1
    mean[0] = sum_x / count if count > 0 else np.nan
    mean[1] = sum_y / count if count > 0 else np.nan


@parallel
def block_means(motion: F32, shown: B8, size: int, out: F64, share: Share) -> None:
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
    """
    height, width, _ = motion.shape
    for block_row in turns(out.shape[0], share):
        rows = slice(block_row * size, min((block_row + 1) * size, height))
        for block in range(out.shape[1]):
            columns = slice(block * size, min((block + 1) * size, width))
            mean_of(motion[rows, columns], shown[rows, columns], out[block_row, block])
