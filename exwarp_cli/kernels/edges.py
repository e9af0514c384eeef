"""Motion at silhouettes: renderers write a filtered mixture there, surfaces do not move so."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels.jit import parallel, serial

F32 = npt.NDArray[np.float32]
I32 = npt.NDArray[np.int32]
B8 = npt.NDArray[np.bool_]
Line = npt.NDArray[Any]

SAME_DEPTH = np.float32(0.05)
"""Relative difference of depth below which neighbours lie on one surface."""

SEARCH = 2
"""How far to look for an unmixed pixel of the same surface, pixels."""

AROUND = tuple(
    sorted(
        itertools.product(range(-SEARCH, SEARCH + 1), repeat=2),
        key=lambda step: step[0] ** 2 + step[1] ** 2,
    )
)
"""Steps (rows, columns) to the pixels so far around, the nearest first; equally near ones row by
row."""

ROWS_PER_BAND = 16


@serial
def same_surface(depth: F32, stencil: I32, i: int, j: int, y: int, x: int) -> bool:
    """Whether two pixels lie on one surface, by depth and id."""
    if stencil.shape[0] > 0 and stencil[i, j] != stencil[y, x]:
        return False
    a, b = depth[i, j], depth[y, x]
    if math.isinf(a) or math.isinf(b):
        return math.isinf(a) == math.isinf(b)
    return bool(abs(a - b) <= SAME_DEPTH * max(a, b))


@serial
def write_extremes(above: Line, here: Line, below: Line, low: Line, high: Line) -> None:
    """Write the least and greatest of three rows [W] to [1 : W + 1] of `low` and `high` [W + 2].

    The ends repeat the pixels beside them. NaN spreads.
    """
    width = here.size
    for j in range(width):
        low[j + 1] = np.minimum(above[j], np.minimum(here[j], below[j]))
        high[j + 1] = np.maximum(above[j], np.maximum(here[j], below[j]))
    low[0], high[0] = low[1], high[1]
    low[width + 1], high[width + 1] = low[width], high[width]


@serial
def mark_steps(depth: F32, low: F32, high: F32, edge: B8) -> None:
    """Mark the pixels of a row whose nearest or farthest neighbour is another surface.

    The others lie between those two, so :func:`same_surface` holds for them if it holds for both.
    """
    infinite = np.float32(np.inf)
    for j in range(depth.size):
        least = np.minimum(low[j], np.minimum(low[j + 1], low[j + 2]))
        most = np.maximum(high[j], np.maximum(high[j + 1], high[j + 2]))
        same = depth[j] - least <= SAME_DEPTH * depth[j]
        same &= (most - depth[j] <= SAME_DEPTH * most) & (most < infinite)
        edge[j] = not (same | (least == infinite))


@serial
def mark_ids(low: I32, high: I32, edge: B8) -> None:
    """Mark the pixels of a row that have another id among their neighbours as well."""
    for j in range(edge.size):
        least = min(low[j], min(low[j + 1], low[j + 2]))
        most = max(high[j], max(high[j + 1], high[j + 2]))
        edge[j] |= least != most


@serial
def find_band(depth: F32, stencil: I32, rows: tuple[int, int], edge: B8) -> None:
    """Find the edges in rows [rows[0], rows[1])."""
    height, width = depth.shape
    low, high = np.empty(width + 2, np.float32), np.empty(width + 2, np.float32)
    low_id, high_id = np.empty(width + 2, np.int32), np.empty(width + 2, np.int32)
    for i in range(rows[0], rows[1]):
        above, below = max(i - 1, 0), min(i + 1, height - 1)
        write_extremes(depth[above], depth[i], depth[below], low, high)
        mark_steps(depth[i], low, high, edge[i])
        if stencil.shape[0] > 0:
            write_extremes(stencil[above], stencil[i], stencil[below], low_id, high_id)
            mark_ids(low_id, high_id, edge[i])


def find_edges_text(depth: F32, stencil: I32, edge: B8) -> None:
    """Mark pixels with another surface among their eight neighbours.

    Parameters
    ----------
    depth
        float32 [H, W], not negative; +inf background.
    stencil
        int32 [H, W], or [0, 0] when unknown.
    edge
        bool [H, W], written.

    Notes
    -----
    Least and greatest of three rows, then of three columns, without branches: 0.3 times cv2.remap.
    Asking :func:`same_surface` about nine pixels each took 19 times.
    """
    height, _ = depth.shape
    for band in numba.prange((height + ROWS_PER_BAND - 1) // ROWS_PER_BAND):
        begin = np.int64(band) * ROWS_PER_BAND
        end = min(begin + ROWS_PER_BAND, height)
        find_band(depth, stencil, (begin, end), edge)


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
    known_ids = stencil.shape[0] > 0
    for row in numba.prange(height):
        i = np.int64(row)
        for j in range(width):
            # Few pixels are edges; calling for all of them took ten times as long.
            if edge[i, j]:
                unmix_edge(i, j, (vectors, rigid), depth, stencil, edge, tolerance, out)
                continue
            dx = vectors[i, j, 0] - rigid[i, j, 0]
            dy = vectors[i, j, 1] - rigid[i, j, 1]
            moving = known_ids and stencil[i, j] > 0
            static = not moving and dx * dx + dy * dy <= tolerance * tolerance
            static = math.isfinite(rigid[i, j, 0]) and (static or math.isinf(depth[i, j]))
            for c in range(2):
                out[i, j, c] = rigid[i, j, c] if static else vectors[i, j, c]


@serial
def unmix_edge(
    i: int,
    j: int,
    motions: tuple[F32, F32],
    depth: F32,
    stencil: I32,
    edge: B8,
    tolerance: float,
    out: F32,
) -> None:
    """Settle a pixel at an edge; `motions` are vectors and rigid of :func:`unmix_text`."""
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
    for k in range(len(AROUND)):
        y, x = i + AROUND[k][0], j + AROUND[k][1]
        if y < 0 or x < 0 or y >= height or x >= width:
            continue
        if edge[y, x] or not math.isfinite(vectors[y, x, 0]):
            continue
        if same_surface(depth, stencil, i, j, y, x):
            return y, x
    return -1, -1


@serial
def mark_rim(depth: F32, i: int, rim: B8) -> None:
    """Mark the pixels of row i with a clearly nearer surface among their four neighbours.

    `rim` is bool [W], written. NaN is not nearer, and nothing is nearer than NaN.
    """
    height, width = depth.shape
    nothing = np.full(width + 2, np.inf, np.float32)  # as seen beyond the frame
    padded = nothing.copy()
    padded[1:-1] = depth[i]
    left, right = padded[:-2], padded[2:]
    above = depth[i - 1] if i > 0 else nothing[2:]
    below = depth[i + 1] if i + 1 < height else nothing[2:]
    for j in range(width):
        limit = depth[i, j] * (np.float32(1) - SAME_DEPTH)
        beside = (left[j] < limit) | (right[j] < limit)
        rim[j] = beside | (above[j] < limit) | (below[j] < limit)


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
    # All rims at once, in loops without branches: 0.8 times cv2.remap. Looking at the neighbours of
    # each target pixel's source took 2.4.
    rim = np.empty((height, width), np.bool_)
    for row in numba.prange(height):
        i = np.int64(row)
        mark_rim(depth, i, rim[i])
    for row in numba.prange(height):
        i = np.int64(row)
        still_beside = fringe[i]
        mark_rim(near, i, still_beside)
        for j in range(width):
            x = np.float32(j) + field[i, j, 0]
            y = np.float32(i) + field[i, j, 1]
            if x >= -0.5 and y >= -0.5 and x <= width - 0.5 and y <= height - 0.5:
                source_x = min(int(x + np.float32(0.5)), width - 1)
                source_y = min(int(y + np.float32(0.5)), height - 1)
                fringe[i, j] = rim[source_y, source_x] and not still_beside[j]
            else:
                fringe[i, j] = False


find_edges = parallel(find_edges_text)
find_edges_serial = serial(find_edges_text)
unmix = parallel(unmix_text)
unmix_serial = serial(unmix_text)
find_fringe = parallel(find_fringe_text)
find_fringe_serial = serial(find_fringe_text)
