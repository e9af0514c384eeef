"""Silhouettes: where they are, the ghosts that they leave, and the motion of their pixels.

Renderers write a filtered mixture of vectors at silhouettes; surfaces do not move so.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import ParallelKernel, device_function, inline
from exwarp_cli.kernels._row_bands import Band, band_range
from exwarp_cli.kernels.array_types import B8, F32, F64, I32
from exwarp_cli.kernels.point_motion import rigid_displacement

Line = npt.NDArray[Any]

# Relative difference of depth below which neighbours lie on one surface.
SAME_DEPTH = np.float32(0.05)

# Factor between the depths of neighbours from which on they may be two surfaces that move.
DEPTH_JUMP = np.float32(1.1)

# Pixels by which the motion of neighbours differs from which on they are two surfaces.
MOTION_GAP = np.float32(1 / 8)


@device_function
def _write_extremes(above: Line, current: Line, below: Line, low: Line, high: Line) -> None:
    """Write minimum and maximum of three rows [W] to [1 : W + 1] of `low` and `high` [W + 2].

    The ends repeat the pixels beside them. NaN spreads.
    """
    width = current.size
    for j in range(width):
        low[j + 1] = np.minimum(above[j], np.minimum(current[j], below[j]))
        high[j + 1] = np.maximum(above[j], np.maximum(current[j], below[j]))
    low[0], high[0] = low[1], high[1]
    low[width + 1], high[width + 1] = low[width], high[width]


@ParallelKernel
def find_edges(
    depth: F32,  # [H, W], not negative; +inf background
    stencil: I32,  # [H, W], or [0, 0] if unknown
    edge: B8,  # [H, W], written
    band: Band,
) -> None:
    """Mark pixels with another surface among their eight neighbours."""
    # Minimum and maximum of three rows, then of three columns, without branches: 0.3 times
    # cv2.remap. Comparing each pixel with its eight neighbours took 19 times.
    height, width = depth.shape
    infinite = np.float32(np.inf)
    low, high = np.empty(width + 2, np.float32), np.empty(width + 2, np.float32)
    low_id, high_id = np.empty(width + 2, np.int32), np.empty(width + 2, np.int32)
    for i in band_range(height, band):
        above, below = max(i - 1, 0), min(i + 1, height - 1)
        _write_extremes(depth[above], depth[i], depth[below], low, high)
        row, edges = depth[i], edge[i]
        for j in range(row.size):
            # Neighbours lie between the nearest and the farthest: they are of the pixel's surface
            # if both of these are.
            least = np.minimum(low[j], np.minimum(low[j + 1], low[j + 2]))
            most = np.maximum(high[j], np.maximum(high[j + 1], high[j + 2]))
            same = row[j] - least <= SAME_DEPTH * row[j]
            same &= (most - row[j] <= SAME_DEPTH * most) & (most < infinite)
            edges[j] = not (same | (least == infinite))
        if stencil.shape[0] > 0:
            _write_extremes(stencil[above], stencil[i], stencil[below], low_id, high_id)
            for j in range(edges.size):
                least_id = min(low_id[j], min(low_id[j + 1], low_id[j + 2]))
                most_id = max(high_id[j], max(high_id[j + 1], high_id[j + 2]))
                edges[j] |= least_id != most_id


@device_function
def _mark_rim(above: F32, current: F32, below: F32, rim: B8) -> None:
    """Mark the pixels of a row with a clearly nearer surface among their four neighbours.

    Rows are depths [W], not negative. NaN is not nearer, and nothing is nearer than NaN.
    """
    last = current.size - 1
    for j in range(current.size):
        limit = current[j] * (np.float32(1) - SAME_DEPTH)
        rim[j] = (above[j] < limit) | (below[j] < limit)
    for j in range(last):
        rim[j] |= current[j + 1] < current[j] * (np.float32(1) - SAME_DEPTH)
    for j in range(last):
        rim[j + 1] |= current[j] < current[j + 1] * (np.float32(1) - SAME_DEPTH)


@ParallelKernel
def _mark_rims(
    depth: F32,  # [H, W]
    rims: B8,  # [H W + 1], written but for the last
    band: Band,
) -> None:
    height, width = depth.shape
    for i in band_range(height, band):
        above, below = max(i - 1, 0), min(i + 1, height - 1)
        rim = rims[i * width : (i + 1) * width]
        _mark_rim(depth[above], depth[i], depth[below], rim)


@ParallelKernel
def _mark_ghosts(
    field: F32,  # as `near`, `ghost`: see `find_ghosts`
    near: F32,
    rims: B8,  # [H W + 1], from `_mark_rims`; the last is where there is no source
    ghost: B8,
    band: Band,
) -> None:
    """Mark the pixels that show a rim without being one."""
    height, width = near.shape
    rows, columns, half = np.int32(height), np.int32(width), np.float32(0.5)
    end_x, end_y = np.float32(width) - half, np.float32(height) - half
    source = np.empty(width, np.int32)  # the nearest pixel, counted along the rows
    for i in band_range(height, band):
        ghosts, line = ghost[i], np.ascontiguousarray(field[i]).reshape(-1)
        above, below = max(i - 1, 0), min(i + 1, height - 1)
        _mark_rim(near[above], near[i], near[below], ghosts)
        for j in range(source.size):
            x, y = np.float32(j) + line[2 * j], np.float32(i) + line[2 * j + 1]
            is_inside = (x >= -half) & (y >= -half) & (x <= end_x) & (y <= end_y)
            column = min(np.int32(x + half if is_inside else half), columns - np.int32(1))
            row = min(np.int32(y + half if is_inside else half), rows - np.int32(1))
            source[j] = row * columns + column if is_inside else rows * columns
        for j in range(width):
            ghosts[j] = rims[np.uint64(source[j])] & (not ghosts[j])


def find_ghosts(
    field: F32,  # [H, W, 2], from target to source; NaN where unknown
    near: F32,  # [H, W], depth at the target; NaN where unknown, +inf background
    depth: F32,  # [H, W], depth at the source
    ghost: B8,  # [H, W], written
) -> None:
    """Mark target pixels that show the rim of a surface that has moved on.

    Colour is filtered over more than a pixel, so a pixel beside a nearer surface holds part of that
    one's colour. Where that surface has moved on, this is a ghost of its outline.
    """
    # All rims and sources at once, without branches: 0.5 times cv2.remap. Looking at the neighbours
    # of each target pixel's source took 2.4.
    rims = np.empty(depth.size + 1, np.bool_)
    rims[-1] = False
    _mark_rims(depth, rims)  # whole, before any of them is looked up
    _mark_ghosts(field, near, rims, ghost)


@device_function
def _is_moving_edge(depth: F32, field: F32, at: tuple[int, int]) -> bool:
    """Return whether the 3x3 pixels differ in depth, where NaN is far, and in motion.

    Unknown motion differs from any.
    """
    height, width = depth.shape
    top, bottom = max(at[0] - 1, 0), min(at[0] + 2, height)
    left, right = max(at[1] - 1, 0), min(at[1] + 2, width)
    nearest, farthest = np.float32(np.inf), np.float32(0)
    for i in range(top, bottom):
        for j in range(left, right):
            z = np.float32(np.inf) if math.isnan(depth[i, j]) else depth[i, j]
            nearest, farthest = min(nearest, z), max(farthest, z)
    if not farthest > DEPTH_JUMP * nearest:
        return False
    for axis in range(2):
        least, most, is_known = np.float32(np.inf), np.float32(-np.inf), True
        for i in range(top, bottom):
            for j in range(left, right):
                component = field[i, j, axis]
                is_known &= not math.isnan(component)
                least, most = min(least, component), max(most, component)
        if not is_known or most - least > MOTION_GAP:
            return True
    return False


@ParallelKernel
def find_moving_edges(
    depth: F32,  # [H, W]; NaN where unknown, +inf background
    field: F32,  # [H, W, 2] px; NaN where unknown
    excluded: B8,  # [H, W]: pixels that are never marked
    edge: B8,  # [H, W], changed; marks are kept
    band: Band,
) -> None:
    """Mark pixels beside another surface that moves differently."""
    height, width = depth.shape
    for i in band_range(height, band):
        for j in range(width):
            if not (edge[i, j] | excluded[i, j]):
                edge[i, j] = _is_moving_edge(depth, field, (i, j))


Surfaces = tuple[F32, F32, I32, B8]

SEARCH_RADIUS = 2  # How far to look for an unmixed pixel of the same surface, pixels

# Steps (rows, columns) to the pixels so far around, the nearest first; equally near ones row by
# row.
NEIGHBOUR_STEPS = np.array(
    sorted(
        itertools.product(range(-SEARCH_RADIUS, SEARCH_RADIUS + 1), repeat=2),
        key=lambda step: step[0] ** 2 + step[1] ** 2,
    )
)

NEAR, FAR = 0, 1  # Which camera is for points, and which for the background


@device_function
def _place_row(i: int, position: F32, depth: F32, points: F64) -> None:
    """Write the points of a row as four coordinates [4, W], by position or else by depth."""
    if position.shape[0] > 0:
        for axis in range(3):
            line = points[axis]
            for j in range(line.size):
                line[j] = np.float64(position[i, j, axis])
    else:
        line = points[3]
        for j in range(line.size):
            line[j] = 1.0 / np.float64(depth[i, j])


@device_function
def _project_row(points: F64, camera: F64, columns: F64, row: float, out: F32) -> None:
    """Write the screen motion [2, W] of the points [4, W] of a row."""
    a, b, c, d, x = points[0], points[1], points[2], points[3], columns
    right, down = out[0], out[1]
    ax, bx, cx, dx = camera[0, 0], camera[0, 1], camera[0, 2], camera[0, 3]
    ay, by, cy, dy = camera[1, 0], camera[1, 1], camera[1, 2], camera[1, 3]
    az, bz, cz, dz = camera[2, 0], camera[2, 1], camera[2, 2], camera[2, 3]
    for j in range(x.size):
        u = ax * a[j] + bx * b[j] + cx * c[j] + dx * d[j]
        v = ay * a[j] + by * b[j] + cy * c[j] + dy * d[j]
        w = az * a[j] + bz * b[j] + cz * c[j] + dz * d[j]
        p, q = np.float32(u / w - x[j]), np.float32(v / w - row)
        right[j] = p if w > 0 else np.float32(np.nan)
        down[j] = q if w > 0 else np.float32(np.nan)


@device_function
def _clean_row(
    vectors: F32, rigid: F32, depth: F32, moving: B8, tolerance: np.float32, out: F32
) -> None:
    """Clean the pixels of a row as if none were at an edge; `vectors` and `out` are [2 W]."""
    right, down = rigid[0], rigid[1]
    for j in range(depth.size):
        dx, dy = vectors[2 * j] - right[j], vectors[2 * j + 1] - down[j]
        static = (dx * dx + dy * dy <= tolerance * tolerance) & (not moving[j])
        static |= abs(depth[j]) == np.float32(np.inf)
        static &= abs(right[j]) < np.float32(np.inf)
        out[2 * j] = right[j] if static else vectors[2 * j]
        out[2 * j + 1] = down[j] if static else vectors[2 * j + 1]


@inline
def _nearest_unmixed(
    i: int, j: int, depth: F32, stencil: I32, edge: B8, vectors: F32
) -> tuple[int, int]:
    """Return the nearest pixel of the same surface that is not at its edge, (-1, -1) if none."""
    height, width = depth.shape
    for k in range(len(NEIGHBOUR_STEPS)):
        y, x = i + NEIGHBOUR_STEPS[k, 0], j + NEIGHBOUR_STEPS[k, 1]
        if y < 0 or x < 0 or y >= height or x >= width:
            continue
        if edge[y, x] or (stencil.shape[0] > 0 and stencil[y, x] != stencil[i, j]):
            continue
        own, farther = depth[i, j], max(depth[i, j], depth[y, x])
        is_near = abs(own - depth[y, x]) <= SAME_DEPTH * farther and farther < np.inf
        if (is_near or own == depth[y, x]) and math.isfinite(vectors[y, 2 * x]):
            return y, x
    return -1, -1


@device_function
def _clean_edges(
    i: int,
    vectors: F32,
    rigid: F32,
    surfaces: Surfaces,
    cameras: F64,
    tolerance: np.float32,
    out: F32,
) -> None:
    """Clean the pixels of a row that are at edges; `rigid` is their motion if they stand still."""
    # Out of the tuple once a row: at each pixel it took as long as all the rest.
    position, depth, stencil, edge = surfaces
    for j in range(depth.shape[1]):
        if not edge[i, j]:
            continue
        background = math.isinf(depth[i, j])
        static = math.isfinite(rigid[0, j])
        y, x = i, j
        if not (static and background):
            static &= not (background or (stencil.shape[0] > 0 and stencil[i, j] > 0))
            y, x = _nearest_unmixed(i, j, depth, stencil, edge, vectors)
            if y < 0:
                y, x = i, j
            elif static:
                at_infinity = cameras[FAR, :, :3]
                right, down = rigid_displacement(position, depth, cameras[NEAR], at_infinity, y, x)
                dx, dy = vectors[y, 2 * x] - right, vectors[y, 2 * x + 1] - down
                static = dx * dx + dy * dy <= tolerance * tolerance
        out[2 * j] = rigid[0, j] if static else vectors[y, 2 * x]
        out[2 * j + 1] = rigid[1, j] if static else vectors[y, 2 * x + 1]


@ParallelKernel
def clean_vectors(
    # vectors: [H, 2 W] each, x and y in px; NaN where unusable, [0, 0] without any
    vectors: tuple[F32, F32],
    # surfaces: positions [H, W, 3] or [0, 0, 3]; depth, stencil and edges as in `find_edges`
    surfaces: Surfaces,
    # cameras: [2, 2, 3, 4] by frame: for (X, Y, Z, 1) or (x, y, 1, 1/depth); for background (x, y,
    # 1), with a last column of 1
    cameras: F64,
    tolerance: np.float32,  # px by which vectors and the motion of static points may differ
    out: tuple[F32, F32],  # [H, 2 W] each, written; [0, 0] without vectors
    band: Band,
) -> None:
    """Give every pixel its own surface's motion, to the frames before and after.

    Static pixels and background move as the cameras say, bit for bit as in
    `point_motion.write_rigid_motion`.
    Inside a surface the rendered vector holds. At its edge the nearest unmixed pixel of the same
    surface decides whether it is static, or moves with that pixel's vector. A surface that is all
    edge counts as static unless an id says that it moves.
    """
    # Both frames at once, with the cameras' motion in rows that stay in the cache: whole frames of
    # it, written and read again, took 2.3 times as long.
    position, depth, stencil, _ = surfaces
    height, width = depth.shape
    points, sky = np.ones((4, width), np.float64), np.ones((4, width), np.float64)
    for j in range(width):  # np.arange takes 1.4 s to compile
        points[0, j] = sky[0, j] = np.float64(j)
    # Times the last column of its camera, 1, this leaves every number as it is, zeros' signs too.
    sky[3] = -0.0
    rigid, far = np.empty((2, width), np.float32), np.empty((2, width), np.float32)
    moving = np.zeros(width, np.bool_)
    for i in band_range(height, band):
        row, depths, background = np.float64(i), depth[i], False
        points[1], sky[1] = row, row
        _place_row(i, position, depth, points)
        if stencil.shape[0] > 0:
            ids = stencil[i]
            for j in range(width):
                moving[j] = ids[j] > 0
        for j in range(width):
            background |= abs(depths[j]) == np.float32(np.inf)
        for side in range(2):
            if vectors[side].shape[0] == 0:
                continue
            _project_row(points, cameras[side, NEAR], sky[0], row, rigid)
            if background:
                _project_row(sky, cameras[side, FAR], sky[0], row, far)
                for axis in range(2):
                    motion, away = rigid[axis], far[axis]
                    for j in range(width):
                        motion[j] = away[j] if abs(depths[j]) == np.float32(np.inf) else motion[j]
            _clean_row(vectors[side][i], rigid, depths, moving, tolerance, out[side][i])
            _clean_edges(i, vectors[side], rigid, surfaces, cameras[side], tolerance, out[side][i])
