"""Motion at silhouettes: renderers write a filtered mixture there, surfaces do not move so."""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels.gather import clamp
from exwarp_cli.kernels.jit import parallel, serial

F32 = npt.NDArray[np.float32]
I32 = npt.NDArray[np.int32]
B8 = npt.NDArray[np.bool_]

SAME_DEPTH = np.float32(0.05)
"""Relative difference of depth below which neighbours lie on one surface."""

SEARCH = 2
"""How far to look for an unmixed pixel of the same surface, pixels."""


@serial
def same_surface(depth: F32, stencil: I32, i: int, j: int, y: int, x: int) -> bool:
    """Whether two pixels lie on one surface, by depth and id."""
    if stencil.shape[0] > 0 and stencil[i, j] != stencil[y, x]:
        return False
    a, b = depth[i, j], depth[y, x]
    if math.isinf(a) or math.isinf(b):
        return math.isinf(a) == math.isinf(b)
    return bool(abs(a - b) <= SAME_DEPTH * max(a, b))


def find_edges_text(depth: F32, stencil: I32, edge: B8) -> None:
    """Mark pixels with another surface among their eight neighbours.

    Parameters
    ----------
    depth
        float32 [H, W]; +inf background.
    stencil
        int32 [H, W], or [0, 0] when unknown.
    edge
        bool [H, W], written.
    """
    height, width = depth.shape
    for row in numba.prange(height):
        i = np.int64(row)
        for j in range(width):
            edge[i, j] = False
            for y in range(max(i - 1, np.int64(0)), min(i + 2, np.int64(height))):
                for x in range(max(j - 1, 0), min(j + 2, width)):
                    if not same_surface(depth, stencil, i, j, y, x):
                        edge[i, j] = True


def unmix_text(
    vectors: F32, rigid: F32, depth: F32, stencil: I32, edge: B8, tolerance: float, out: F32
) -> None:
    """Give every pixel its own surface's motion.

    Parameters
    ----------
    vectors
        float32 [H, W, 2], pixels: as rendered, mixed at silhouettes; NaN where unusable.
    rigid
        float32 [H, W, 2], pixels: motion of a static point there, from the cameras; NaN unknown.
    depth, stencil, edge
        As in :func:`find_edges_text`; background is where depth is +inf.
    tolerance
        Pixels by which vectors and `rigid` may differ for a pixel to count as static.
    out
        float32 [H, W, 2], written.

    Notes
    -----
    Background follows the cameras. Inside a surface the rendered vector holds; at its edge the
    nearest unmixed pixel of the same surface decides whether it is static (then `rigid`, which is
    exact at the pixel's centre) or moves (then that pixel's vector). Where a surface is all edge,
    thin structures, it counts as static unless an id says that it moves.
    """
    height, width, _ = vectors.shape
    for row in numba.prange(height):
        i = np.int64(row)
        for j in range(width):
            unmix_pixel(i, j, (vectors, rigid), depth, stencil, edge, tolerance, out)


@serial
def unmix_pixel(
    i: int,
    j: int,
    motions: tuple[F32, F32],
    depth: F32,
    stencil: I32,
    edge: B8,
    tolerance: float,
    out: F32,
) -> None:
    """Settle one pixel; `motions` are vectors and rigid of :func:`unmix_text`."""
    vectors, rigid = motions
    known = math.isfinite(rigid[i, j, 0])
    moving = stencil.shape[0] > 0 and stencil[i, j] > 0
    y, x = nearest_unmixed(i, j, depth, stencil, edge, vectors)
    if math.isinf(depth[i, j]):
        static = known
    elif y < 0:
        static = known and not moving
    else:
        dx = vectors[y, x, 0] - rigid[y, x, 0]
        dy = vectors[y, x, 1] - rigid[y, x, 1]
        static = known and not moving and dx * dx + dy * dy <= tolerance * tolerance
    for c in range(2):
        if static:
            out[i, j, c] = rigid[i, j, c]
        elif y < 0:
            out[i, j, c] = vectors[i, j, c]
        else:
            out[i, j, c] = vectors[y, x, c]


@serial
def nearest_unmixed(
    i: int, j: int, depth: F32, stencil: I32, edge: B8, vectors: F32
) -> tuple[int, int]:
    """Return the nearest pixel of the same surface that is not at its edge, (-1, -1) if none."""
    height, width = depth.shape
    if not edge[i, j]:
        return i, j
    best = 1 << 30
    found_y, found_x = -1, -1
    for y in range(max(i - SEARCH, 0), min(i + SEARCH + 1, height)):
        for x in range(max(j - SEARCH, 0), min(j + SEARCH + 1, width)):
            distance = (y - i) ** 2 + (x - j) ** 2
            if edge[y, x] or distance >= best or not math.isfinite(vectors[y, x, 0]):
                continue
            if same_surface(depth, stencil, i, j, y, x):
                best, found_y, found_x = distance, y, x
    return found_y, found_x


@serial
def beside_nearer(depth: F32, i: int, j: int) -> bool:
    """Whether one of the four neighbours shows a surface clearly nearer than the pixel's own."""
    height, width = depth.shape
    limit = depth[i, j] * (np.float32(1) - SAME_DEPTH)
    for dy, dx in ((-1, 0), (0, -1), (0, 1), (1, 0)):
        y, x = i + dy, j + dx
        if 0 <= y < height and 0 <= x < width and depth[y, x] < limit:
            return True
    return False


def find_fringe_text(field: F32, near: F32, depth: F32, fringe: B8) -> None:
    """Mark target pixels that show the rim of a surface which has moved on.

    Colour is filtered over more than a pixel, so a source pixel beside a nearer surface holds part
    of that one's colour. Where the nearer surface is no longer beside it, this is a ghost outline.

    Parameters
    ----------
    field
        float32 [H, W, 2], from target to source; NaN where unknown.
    near
        float32 [H, W], depth at the target; NaN where unknown, +inf background.
    depth
        float32 [H, W], depth at the source.
    fringe
        bool [H, W], written.
    """
    height, width = depth.shape
    for row in numba.prange(height):
        i = np.int64(row)
        for j in range(width):
            fringe[i, j] = False
            x = np.float32(j) + field[i, j, 0]
            y = np.float32(i) + field[i, j, 1]
            if not (x >= -0.5 and y >= -0.5 and x <= width - 0.5 and y <= height - 0.5):
                continue
            source_x = clamp(math.floor(x + np.float32(0.5)), 0, width - 1)
            source_y = clamp(math.floor(y + np.float32(0.5)), 0, height - 1)
            if beside_nearer(depth, source_y, source_x):
                fringe[i, j] = not beside_nearer(near, i, j)


find_edges = parallel(find_edges_text)
find_edges_serial = serial(find_edges_text)
unmix = parallel(unmix_text)
unmix_serial = serial(unmix_text)
find_fringe = parallel(find_fringe_text)
find_fringe_serial = serial(find_fringe_text)
