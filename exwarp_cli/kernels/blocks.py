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


FOUR = 4
"""Blocks whose sums are added up beside each other, as each waits for the one before it."""


@part
def all_of(shown: B8) -> bool:
    """Whether all pixels [N] count; all are asked, as then the compiler takes many at once."""
    every = True
    for j in range(shown.size):
        every &= shown[j]
    return every


@part
def any_of(shown: B8) -> bool:
    """Whether any pixel [N] counts; all are asked, as in `all_of`."""
    some = False
    for j in range(shown.size):
        some |= shown[j]
    return some


@part
def add_four(row: F32, size: int, sums: F64) -> None:
    """Add part of a row [8 size] to the sums [8] of the four blocks that it goes through."""
    x0, y0, x1, y1 = sums[0], sums[1], sums[2], sums[3]
    x2, y2, x3, y3 = sums[4], sums[5], sums[6], sums[7]
    step = 2 * size
    one, two, three, four = row[:step], row[step:], row[2 * step :], row[3 * step :]
    for k in range(size):
        x, y = np.uint64(2 * k), np.uint64(2 * k + 1)  # no test for counting from the end
        x0 += np.float64(one[x])
        y0 += np.float64(one[y])
        x1 += np.float64(two[x])
        y1 += np.float64(two[y])
        x2 += np.float64(three[x])
        y2 += np.float64(three[y])
        x3 += np.float64(four[x])
        y3 += np.float64(four[y])
    sums[0], sums[1], sums[2], sums[3] = x0, y0, x1, y1
    sums[4], sums[5], sums[6], sums[7] = x2, y2, x3, y3


@part
def add_rows(motion: F32, shown: B8, size: int, sums: F64, whole: B8) -> None:
    """Add up the values of the rows of a row of blocks, by fours, as long as all pixels count.

    Parameters
    ----------
    motion, shown, size
        As of `block_means`, of these rows.
    sums
        float64 [8 N], written: x and y of each block, where its four are whole.
    whole
        bool [N], written: whether all pixels of four blocks count, if they are finite.
    """
    for k in range(sums.size):
        sums[k] = 0
    for four in range(whole.size):
        whole[four] = True
    step = FOUR * size
    for i in range(motion.shape[0]):
        row = motion[i].reshape(-1)
        for four in range(whole.size):
            left = four * step
            if shown.size > 0 and whole[four]:
                whole[four] = all_of(shown[i][left : left + step])
            if whole[four]:
                add_four(row[2 * left : 2 * (left + step)], size, sums[8 * four : 8 * (four + 1)])


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
    fours = width // (FOUR * size)
    sums, whole = np.empty(2 * FOUR * fours), np.empty(fours, np.bool_)
    for block_row in turns(out.shape[0], share):
        top, bottom = block_row * size, min((block_row + 1) * size, height)
        add_rows(motion[top:bottom], shown[top:bottom], size, sums, whole)
        for block in range(out.shape[1]):
            x, y = np.inf, np.inf
            if block < FOUR * fours and whole[block // FOUR]:
                x, y = sums[2 * block], sums[2 * block + 1]
            if math.isfinite(x + y):  # and so are all that were added
                count = size * (bottom - top)
                out[block_row, block, 0], out[block_row, block, 1] = x / count, y / count
            else:
                left, right = block * size, min((block + 1) * size, width)
                pixels = motion[top:bottom, left:right]
                mean_of(pixels, shown[top:bottom, left:right], out[block_row, block])
