"""Projection by cameras: motion of static points, and the equations of a camera's fit."""

from __future__ import annotations

import math

import numpy as np

from exwarp_cli.kernels._compile import ParallelKernel, inline, kernel
from exwarp_cli.kernels._row_bands import Band, band_range
from exwarp_cli.kernels.array_types import B8, F32, F64


@inline
def rigid_displacement(
    position: F32, depth: F32, camera: F64, at_infinity: F64, i: int, j: int
) -> tuple[np.float32, np.float32]:
    """Return how pixel (i, j) moves if its point is static; NaN if it is behind the camera.

    Arrays are those of `write_rigid_motion`.
    """
    x, y = np.float64(j), np.float64(i)
    if math.isinf(depth[i, j]):
        u = at_infinity[0, 0] * x + at_infinity[0, 1] * y + at_infinity[0, 2]
        v = at_infinity[1, 0] * x + at_infinity[1, 1] * y + at_infinity[1, 2]
        w = at_infinity[2, 0] * x + at_infinity[2, 1] * y + at_infinity[2, 2]
    else:
        a, b, c, d = x, y, 1.0, 1.0 / np.float64(depth[i, j])
        if position.shape[0] > 0:
            a = np.float64(position[i, j, 0])
            b = np.float64(position[i, j, 1])
            c = np.float64(position[i, j, 2])
            d = np.float64(1.0)
        u = camera[0, 0] * a + camera[0, 1] * b + camera[0, 2] * c + camera[0, 3] * d
        v = camera[1, 0] * a + camera[1, 1] * b + camera[1, 2] * c + camera[1, 3] * d
        w = camera[2, 0] * a + camera[2, 1] * b + camera[2, 2] * c + camera[2, 3] * d
    if w > 0:
        return np.float32(u / w - x), np.float32(v / w - y)
    return np.float32(np.nan), np.float32(np.nan)


@ParallelKernel
def write_rigid_motion(
    position: F32,  # [H, W, 3], world space; or [0, 0, 3], then depth places the points
    depth: F32,  # [H, W], along the camera's axis; +inf is background, at infinity
    camera: F64,  # [3, 4]: projects (X, Y, Z, 1), or without positions (x, y, 1, 1/depth) in pixels
    at_infinity: F64,  # [3, 3]: projects (x, y, 1) of a background pixel
    selected: B8,  # [H, W]: the pixels that are written; [0, 0] for all
    # keep_unseen: pixels keep their motion where the point is behind the other camera, else they
    # become NaN
    keep_unseen: bool,
    out: F32,  # [H, W, 2] px, written
    band: Band,
) -> None:
    """Write the displacement of pixels to another camera's frame, if their points are static."""
    height, width = depth.shape
    has_selection = selected.shape[0] > 0
    for i in band_range(height, band):
        for j in range(width):
            if has_selection and not selected[i, j]:
                continue
            x, y = rigid_displacement(position, depth, camera, at_infinity, i, j)
            if not (keep_unseen and math.isnan(x)):
                out[i, j, 0], out[i, j, 1] = x, y


@kernel
def write_equations(
    points: F64,  # [N, 4], homogeneous
    pixels: F64,  # [N, 2]
    weights: F64,  # [N]; points without a weight above 0 are left out
    scaled: F64,  # [4 N], the first M points written: the others times their weight
    rows: F64,  # [24 N], 2 M rows of 12 written: those of x, then those of y
) -> int:
    """Write the weighted equations of the direct linear transform of M points; return M."""
    # Rows are flat, of a constant length: otherwise this took twice as long.
    count = 0
    for n in range(len(weights)):
        if weights[n] > 0:
            for c in range(4):
                scaled[4 * count + c] = points[n, c] * weights[n]
            count += 1
    row = 0
    for n in range(len(weights)):
        if weights[n] > 0:
            right, down, first = 12 * row, 12 * (count + row), 4 * row
            for c in range(4):
                value = scaled[first + c]
                rows[right + c], rows[right + 4 + c] = value, 0.0
                rows[right + 8 + c] = -pixels[n, 0] * value
                rows[down + c], rows[down + 4 + c] = 0.0, value
                rows[down + 8 + c] = -pixels[n, 1] * value
            row += 1
    return count
