"""Forward splatting of displacements into a backward motion field, with a depth test.

Every source pixel is a small patch of surface. Its displacement's gradient says how the patch is
stretched and turned, so the target pixels that it covers, and where in the source each of them
comes from, are exact to first order: no cracks where the image grows, no rounding to whole pixels.
"""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels.jit import parallel, serial

F32 = npt.NDArray[np.float32]
I32 = npt.NDArray[np.int32]

SAME_SURFACE = np.float32(0.5)
"""Largest change of displacement between neighbours of one surface, pixels per pixel."""

OVERLAP = np.float32(0.54)
"""Half the side of a patch: a little over 0.5, so that neighbours leave no gaps."""

ROWS_PER_BAND = 32


@serial
def slope(displacement: F32, i: int, j: int, axis: int, c: int) -> np.float32:
    """Return the change of component c per row (axis 0) or column (axis 1) at a pixel.

    From neighbours of the same surface, 0 where there are none; NaN neighbours count as another
    surface, and so does what lies outside the frame.
    """
    dy, dx = (1, 0) if axis == 0 else (0, 1)
    height, width, _ = displacement.shape
    here = displacement[i, j, c]
    left, right = np.float32(np.nan), np.float32(np.nan)
    if i >= dy and j >= dx:
        left = here - displacement[i - dy, j - dx, c]
    if i + dy < height and j + dx < width:
        right = displacement[i + dy, j + dx, c] - here
    left_same = abs(left) < SAME_SURFACE
    right_same = abs(right) < SAME_SURFACE
    if left_same and right_same:
        return np.float32(0.5) * (left + right)
    if left_same:
        return left
    if right_same:
        return right
    return np.float32(0.0)


@serial
def splat_pixel(
    i: int, j: int, displacement: F32, depth: F32, rows: tuple[int, int], field: F32, near: F32
) -> None:
    """Write one source pixel's patch into the target rows [rows[0], rows[1])."""
    dx, dy = displacement[i, j, 0], displacement[i, j, 1]
    # Jacobian of x -> x + d(x), from neighbours of the same surface.
    a = np.float32(1) + slope(displacement, i, j, 1, 0)
    b = slope(displacement, i, j, 0, 0)
    c = slope(displacement, i, j, 1, 1)
    d = np.float32(1) + slope(displacement, i, j, 0, 1)
    determinant = a * d - b * c
    if not determinant > np.float32(0.05):
        return  # turned over or edge-on: it shows nothing
    x, y = np.float32(j) + dx, np.float32(i) + dy
    reach_x = OVERLAP * (abs(a) + abs(b))
    reach_y = OVERLAP * (abs(c) + abs(d))
    first_row = max(math.ceil(y - reach_y), rows[0])
    last_row = min(math.floor(y + reach_y), rows[1] - 1)
    first_column = max(math.ceil(x - reach_x), 0)
    last_column = min(math.floor(x + reach_x), field.shape[1] - 1)
    for row in range(first_row, last_row + 1):
        for column in range(first_column, last_column + 1):
            rx, ry = np.float32(column) - x, np.float32(row) - y
            u = (d * rx - b * ry) / determinant
            v = (a * ry - c * rx) / determinant
            if abs(u) > OVERLAP or abs(v) > OVERLAP:
                continue
            # Strictly nearer wins, so an equal depth keeps the earlier source pixel, whatever
            # the number of threads.
            if depth[i, j] < near[row, column] or math.isnan(near[row, column]):
                near[row, column] = depth[i, j]
                field[row, column, 0] = np.float32(j) + u - np.float32(column)
                field[row, column, 1] = np.float32(i) + v - np.float32(row)


def splat_text(displacement: F32, depth: F32, reach: F32, field: F32, near: F32) -> None:
    """Splat displacements forward with a depth test.

    Parameters
    ----------
    displacement
        float32 [H, W, 2], pixels, +x right, +y down, from a source pixel to the target; NaN where
        unknown.
    depth
        float32 [H, W], smaller is nearer; +inf for background, which everything hides.
    reach
        float32 [H, 2]: the least and greatest target row that a source row touches, from
        :func:`row_reach`.
    field
        float32 [H, W, 2], written: from a target pixel to its source; NaN where nothing lands.
    near
        float32 [H, W], written: depth of what landed; NaN where nothing did.

    Notes
    -----
    Target rows are dealt out in bands and each band visits the source rows that can reach it, in
    order; so the result is that of one thread, bit for bit.
    """
    height, width, _ = displacement.shape
    for band in numba.prange((height + ROWS_PER_BAND - 1) // ROWS_PER_BAND):
        begin = np.int64(band) * ROWS_PER_BAND
        end = min(begin + ROWS_PER_BAND, height)
        field[begin:end] = np.nan
        near[begin:end] = np.nan
        for i in range(height):
            if reach[i, 1] < begin or reach[i, 0] > end - 1:
                continue
            for j in range(width):
                y = np.float32(i) + displacement[i, j, 1]
                if y > np.float32(begin) - 2 and y < np.float32(end) + 2:
                    splat_pixel(i, j, displacement, depth, (begin, end), field, near)


def row_reach_text(displacement: F32, reach: F32) -> None:
    """Write for each source row the least and greatest row that it touches, float32 [H, 2]."""
    height, width, _ = displacement.shape
    for row in numba.prange(height):
        i = np.int64(row)
        low, high = np.float32(np.inf), np.float32(-np.inf)
        for j in range(width):
            y = np.float32(i) + displacement[i, j, 1]
            if y < low:
                low = y
            if y > high:
                high = y
        # A patch reaches OVERLAP times its stretch, at most 1 + 2 * SAME_SURFACE, to either side.
        reach[i, 0] = low - np.float32(2)
        reach[i, 1] = high + np.float32(2)


splat = parallel(splat_text)
splat_serial = serial(splat_text)
row_reach = parallel(row_reach_text)
row_reach_serial = serial(row_reach_text)
