"""Silhouettes: where they are, and the ghosts that they leave behind."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import parallel, part
from exwarp_cli.kernels._row_bands import Share, turns

F32 = npt.NDArray[np.float32]
I32 = npt.NDArray[np.int32]
B8 = npt.NDArray[np.bool_]
Line = npt.NDArray[Any]

SAME_DEPTH = np.float32(0.05)
"""Relative difference of depth below which neighbours lie on one surface."""

JUMP = np.float32(1.1)
"""Factor between the depths of neighbours from which on they may be two surfaces that move."""

APART = np.float32(1 / 8)
"""Pixels by which the motion of neighbours differs from which on they are two surfaces."""

ROWS_PER_BAND = 16


@part
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


@part
def mark_steps(depth: F32, low: F32, high: F32, edge: B8) -> None:
    """Mark the pixels of a row whose nearest or farthest neighbour is another surface.

    The others lie between those two: they are of its surface if both are.
    """
    infinite = np.float32(np.inf)
    for j in range(depth.size):
        least = np.minimum(low[j], np.minimum(low[j + 1], low[j + 2]))
        most = np.maximum(high[j], np.maximum(high[j + 1], high[j + 2]))
        same = depth[j] - least <= SAME_DEPTH * depth[j]
        same &= (most - depth[j] <= SAME_DEPTH * most) & (most < infinite)
        edge[j] = not (same | (least == infinite))


@part
def mark_ids(low: I32, high: I32, edge: B8) -> None:
    """Mark the pixels of a row that have another id among their neighbours as well."""
    for j in range(edge.size):
        least = min(low[j], min(low[j + 1], low[j + 2]))
        most = max(high[j], max(high[j + 1], high[j + 2]))
        edge[j] |= least != most


@part
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


@parallel
def find_edges(depth: F32, stencil: I32, edge: B8, share: Share) -> None:
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
    Comparing each pixel with its eight neighbours took 19 times.
    """
    height, _ = depth.shape
    for band in turns((height + ROWS_PER_BAND - 1) // ROWS_PER_BAND, share):
        begin = band * ROWS_PER_BAND
        end = min(begin + ROWS_PER_BAND, height)
        find_band(depth, stencil, (begin, end), edge)


@part
def mark_rim(above: F32, here: F32, below: F32, rim: B8) -> None:
    """Mark the pixels of a row with a clearly nearer surface among their four neighbours.

    `above`, `here` and `below` are the depths of three rows, float32 [W], `rim` is bool [W],
    written. NaN is not nearer, and nothing is nearer than NaN.
    """
    last = here.size - 1
    for j in range(here.size):
        limit = here[j] * (np.float32(1) - SAME_DEPTH)
        rim[j] = (above[j] < limit) | (below[j] < limit)
    for j in range(last):
        rim[j] |= here[j + 1] < here[j] * (np.float32(1) - SAME_DEPTH)
    for j in range(last):
        rim[j + 1] |= here[j] < here[j + 1] * (np.float32(1) - SAME_DEPTH)


@part
def mark_rim_of(depth: F32, i: int, rim: B8) -> None:
    """Mark the rim in row i; what lies beyond the frame is not nearer."""
    height, width = depth.shape
    if 0 < i < height - 1:
        mark_rim(depth[i - 1], depth[i], depth[i + 1], rim)
        return
    nothing = np.full(width, np.inf, np.float32)
    above = depth[i - 1] if i > 0 else nothing
    below = depth[i + 1] if i + 1 < height else nothing
    mark_rim(above, depth[i], below, rim)


@part
def write_sources(i: int, line: F32, shape: tuple[int, int], source: I32) -> None:
    """Write which pixels a row of a motion field leads to.

    Parameters
    ----------
    i
        The row.
    line
        float32 [2 W], x and y by turns.
    shape
        H, W.
    source
        int32 [W], written: the nearest pixel, counted along the rows; H W where there is none.
    """
    height, width = np.int32(shape[0]), np.int32(shape[1])
    half = np.float32(0.5)
    end_x, end_y = np.float32(shape[1]) - half, np.float32(shape[0]) - half
    for j in range(source.size):
        x, y = np.float32(j) + line[2 * j], np.float32(i) + line[2 * j + 1]
        lies = (x >= -half) & (y >= -half) & (x <= end_x) & (y <= end_y)
        column = min(np.int32(x + half if lies else half), width - np.int32(1))
        row = min(np.int32(y + half if lies else half), height - np.int32(1))
        source[j] = row * width + column if lies else height * width


@parallel
def _mark_rims(depth: F32, rims: B8, share: Share) -> None:
    """Mark the pixels with a clearly nearer surface among their four neighbours.

    Parameters
    ----------
    depth
        float32 [H, W].
    rims
        bool [H W + 1], written but for the last.
    """
    height, width = depth.shape
    for i in turns(height, share):
        mark_rim_of(depth, i, rims[i * width : (i + 1) * width])


@parallel
def _mark_ghosts(field: F32, near: F32, rims: B8, fringe: B8, share: Share) -> None:
    """Mark the pixels that show a rim without being one.

    Parameters
    ----------
    field, near, fringe
        As for :func:`find_fringe`.
    rims
        bool [H W + 1], from :func:`_mark_rims`; the last is where there is no source.
    """
    height, width = near.shape
    source = np.empty(width, np.int32)
    for i in turns(height, share):
        still_beside = fringe[i]
        mark_rim_of(near, i, still_beside)
        write_sources(i, np.ascontiguousarray(field[i]).reshape(-1), (height, width), source)
        for j in range(width):
            still_beside[j] = rims[np.uint64(source[j])] & (not still_beside[j])


def find_fringe(field: F32, near: F32, depth: F32, fringe: B8) -> None:
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

    Notes
    -----
    All rims and sources at once, in loops without branches: 0.5 times cv2.remap. Looking at the
    neighbours of each target pixel's source took 2.4.
    """
    rims = np.empty(depth.size + 1, np.bool_)
    rims[-1] = False
    _mark_rims(depth, rims)  # whole, before any of them is looked up
    _mark_ghosts(field, near, rims, fringe)


@part
def depth_jumps(depth: F32, at: tuple[int, int]) -> bool:
    """Return True if the depths of the 3x3 pixels about a place differ by JUMP; NaN is far."""
    height, width = depth.shape
    nearest, farthest = np.float32(np.inf), np.float32(0)
    for i in range(max(at[0] - 1, 0), min(at[0] + 2, height)):
        for j in range(max(at[1] - 1, 0), min(at[1] + 2, width)):
            z = np.float32(np.inf) if math.isnan(depth[i, j]) else depth[i, j]
            nearest, farthest = min(nearest, z), max(farthest, z)
    return bool(farthest > JUMP * nearest)


@part
def moves_apart(field: F32, at: tuple[int, int]) -> bool:
    """Return True if the motion of the 3x3 pixels about a place differs, or some is unknown."""
    height, width, _ = field.shape
    for axis in range(2):
        least, most, known = np.float32(np.inf), np.float32(-np.inf), True
        for i in range(max(at[0] - 1, 0), min(at[0] + 2, height)):
            for j in range(max(at[1] - 1, 0), min(at[1] + 2, width)):
                way = field[i, j, axis]
                known &= not math.isnan(way)
                least, most = min(least, way), max(most, way)
        if not known or most - least > APART:
            return True
    return False


@parallel
def find_moving_edges(depth: F32, field: F32, fringe: B8, found: B8, share: Share) -> None:
    """Mark, besides those marked, pixels beside another surface that moves otherwise.

    Parameters
    ----------
    depth
        float32 [H, W]; NaN where unknown, +inf background.
    field
        float32 [H, W, 2], pixels; NaN where unknown.
    fringe
        bool [H, W]: pixels that are never marked.
    found
        bool [H, W].
    """
    height, width = depth.shape
    for i in turns(height, share):
        for j in range(width):
            if not (found[i, j] | fringe[i, j]) and depth_jumps(depth, (i, j)):
                found[i, j] = moves_apart(field, (i, j))
