"""Motion of static points and of the background, from recovered cameras."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import inlined, parallel
from exwarp_cli.kernels._row_bands import Share, turns

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
B8 = npt.NDArray[np.bool_]


@inlined
def seen_from(camera: F64, point: tuple[float, float, float, float]) -> tuple[float, float, float]:
    """Return where a camera, float64 [3, 4], sees a homogeneous point: homogeneous, too."""
    a, b, c, d = point
    u = camera[0, 0] * a + camera[0, 1] * b + camera[0, 2] * c + camera[0, 3] * d
    v = camera[1, 0] * a + camera[1, 1] * b + camera[1, 2] * c + camera[1, 3] * d
    w = camera[2, 0] * a + camera[2, 1] * b + camera[2, 2] * c + camera[2, 3] * d
    return u, v, w


@inlined
def away_from(
    x: float, y: float, place: tuple[float, float, float]
) -> tuple[np.float32, np.float32]:
    """Return the way from a pixel to a homogeneous place; NaN for what is behind the camera."""
    u, v, w = place
    if w > 0:
        return np.float32(u / w - x), np.float32(v / w - y)
    return np.float32(np.nan), np.float32(np.nan)


@inlined
def displaced(
    position: F32, depth: F32, camera: F64, at_infinity: F64, i: int, j: int
) -> tuple[np.float32, np.float32]:
    """Return the displacement of pixel (i, j), if its point stands still; NaN where it is unseen.

    Parameters as for :func:`rigid`.
    """
    x, y = np.float64(j), np.float64(i)
    if math.isinf(depth[i, j]):
        u = at_infinity[0, 0] * x + at_infinity[0, 1] * y + at_infinity[0, 2]
        v = at_infinity[1, 0] * x + at_infinity[1, 1] * y + at_infinity[1, 2]
        w = at_infinity[2, 0] * x + at_infinity[2, 1] * y + at_infinity[2, 2]
        place = (u, v, w)
    else:
        a, b, c, d = x, y, 1.0, 1.0 / np.float64(depth[i, j])
        if position.shape[0] > 0:
            a = np.float64(position[i, j, 0])
            b = np.float64(position[i, j, 1])
            c = np.float64(position[i, j, 2])
            d = np.float64(1.0)
        place = seen_from(camera, (a, b, c, d))
    away_x, away_y = away_from(x, y, place)
    return away_x, away_y


@parallel
def rigid(
    position: F32,
    depth: F32,
    camera: F64,
    at_infinity: F64,
    still: B8,
    kept: bool,
    out: F32,
    share: Share,
) -> None:
    """Write the displacement of pixels to another camera's frame, if their points stand still.

    Parameters
    ----------
    position
        float32 [H, W, 3], world space; or [0, 0, 3], then depth places the points.
    depth
        float32 [H, W], along the camera's axis; +inf is background, at infinity.
    camera
        float64 [3, 4]: projects (X, Y, Z, 1) to the other frame, or, without positions,
        (x, y, 1, 1/depth) with x and y this frame's pixel coordinates.
    at_infinity
        float64 [3, 3]: takes (x, y, 1) of a background pixel to the other frame.
    still
        bool [H, W]: the pixels that are written; [0, 0] for all.
    kept
        Whether pixels keep what they have where the point lies behind the other camera or nowhere;
        else they become NaN there.
    out
        float32 [H, W, 2], written, pixels.
    """
    height, width = depth.shape
    chosen = still.shape[0] > 0
    for i in turns(height, share):
        for j in range(width):
            if chosen and not still[i, j]:
                continue
            x, y = displaced(position, depth, camera, at_infinity, i, j)
            if not (kept and math.isnan(x)):
                out[i, j, 0], out[i, j, 1] = x, y


@parallel
def standing(
    position: F32,
    depth: F32,
    camera: F64,
    at_infinity: F64,
    step: F32,
    tolerance: np.float32,
    out: B8,
    share: Share,
) -> None:
    """Find the pixels that move as points do which stand still.

    Parameters
    ----------
    position, depth, camera, at_infinity
        As for :func:`rigid`.
    step
        float32 [H, W, 2], pixels: motion to the other camera's frame; NaN where unknown.
    tolerance
        Pixels by which either of its components may miss.
    out
        bool [H, W], written.
    """
    height, width = depth.shape
    for i in turns(height, share):
        for j in range(width):
            x, y = displaced(position, depth, camera, at_infinity, i, j)
            near_x = np.float32(abs(np.float32(step[i, j, 0] - x))) <= tolerance
            near_y = np.float32(abs(np.float32(step[i, j, 1] - y))) <= tolerance
            out[i, j] = near_x and near_y
