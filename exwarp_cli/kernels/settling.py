"""Motion at silhouettes: renderers write a filtered mixture there, surfaces do not move so."""

from __future__ import annotations

import itertools
import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import inlined, parallel, part
from exwarp_cli.kernels._row_bands import Share, turns
from exwarp_cli.kernels.edges import ROWS_PER_BAND, SAME_DEPTH
from exwarp_cli.kernels.project import away_from, seen_from

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
I32 = npt.NDArray[np.int32]
B8 = npt.NDArray[np.bool_]
Surfaces = tuple[F32, F32, I32, B8]

SEARCH = 2
"""How far to look for an unmixed pixel of the same surface, pixels."""

AROUND = np.array(
    sorted(
        itertools.product(range(-SEARCH, SEARCH + 1), repeat=2),
        key=lambda step: step[0] ** 2 + step[1] ** 2,
    )
)
"""Steps (rows, columns) to the pixels so far around, the nearest first; equally near ones row by
row."""

NEAR, FAR = 0, 1
"""Which camera is for points, and which for the background."""


@part
def place_row(position: F32, depth: F32, points: F64) -> None:
    """Write the points of a row as columns of their four coordinates, float64 [4, W].

    `position` is [3 W], or empty: then the last coordinate alone is written, by the depth.
    """
    a, b, c, d = points[0], points[1], points[2], points[3]
    if position.size > 0:
        for j in range(depth.size):
            a[j] = np.float64(position[3 * j])
            b[j] = np.float64(position[3 * j + 1])
            c[j] = np.float64(position[3 * j + 2])
    else:
        for j in range(depth.size):
            d[j] = 1.0 / np.float64(depth[j])


@part
def project_row(points: F64, camera: F64, columns: F64, row: float, out: F32) -> None:
    """Write how far points [4, W] of a row's pixels are moved on the screen, float32 [2, W]."""
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


@part
def show_background(depth: F32, far: F32, rigid: F32) -> None:
    """Take the motion of a row's background from `far`, both [2, W]."""
    right, down, away_right, away_down = rigid[0], rigid[1], far[0], far[1]
    for j in range(depth.size):
        right[j] = away_right[j] if abs(depth[j]) == np.float32(np.inf) else right[j]
    for j in range(depth.size):
        down[j] = away_down[j] if abs(depth[j]) == np.float32(np.inf) else down[j]


@part
def shows_background(depth: F32) -> bool:
    """Whether a row shows any background."""
    found = False
    for j in range(depth.size):
        found |= abs(depth[j]) == np.float32(np.inf)
    return found


@part
def mark_moving(stencil: I32, moving: B8) -> None:
    """Mark the pixels of a row whose id says that they move."""
    for j in range(stencil.size):
        moving[j] = stencil[j] > 0


@part
def settle_row(
    vectors: F32, rigid: F32, depth: F32, moving: B8, tolerance: np.float32, out: F32
) -> None:
    """Settle the pixels of a row as if none were at an edge; `vectors` and `out` are [2 W]."""
    right, down = rigid[0], rigid[1]
    for j in range(depth.size):
        dx, dy = vectors[2 * j] - right[j], vectors[2 * j + 1] - down[j]
        static = (dx * dx + dy * dy <= tolerance * tolerance) & (not moving[j])
        static |= abs(depth[j]) == np.float32(np.inf)
        static &= abs(right[j]) < np.float32(np.inf)
        out[2 * j] = right[j] if static else vectors[2 * j]
        out[2 * j + 1] = down[j] if static else vectors[2 * j + 1]


@inlined
def rigid_at(
    i: int, j: int, position: F32, depth: F32, cameras: F64
) -> tuple[np.float32, np.float32]:
    """Return the same as :func:`project_row` of one pixel."""
    x, y = np.float64(j), np.float64(i)
    a, b, c, d, which = x, y, 1.0, -0.0, FAR
    if not math.isinf(depth[i, j]):
        which = NEAR
        d = 1.0 / np.float64(depth[i, j])
        if position.shape[0] > 0:
            a = np.float64(position[i, 3 * j])
            b = np.float64(position[i, 3 * j + 1])
            c = np.float64(position[i, 3 * j + 2])
            d = 1.0
    away_x, away_y = away_from(x, y, seen_from(cameras[which], (a, b, c, d)))
    return away_x, away_y


@inlined
def same_depth(one: np.float32, other: np.float32) -> bool:
    """Whether two depths may be those of one surface; background is one."""
    if math.isinf(one) or math.isinf(other):
        return math.isinf(one) == math.isinf(other)
    return bool(abs(one - other) <= SAME_DEPTH * max(one, other))


@inlined
def nearest_unmixed(
    i: int, j: int, depth: F32, stencil: I32, edge: B8, vectors: F32
) -> tuple[int, int]:
    """Return the nearest pixel of the same surface that is not at its edge, (-1, -1) if none."""
    height, width = depth.shape
    for k in range(len(AROUND)):
        y, x = i + AROUND[k, 0], j + AROUND[k, 1]
        if y < 0 or x < 0 or y >= height or x >= width:
            continue
        if edge[y, x] or (stencil.shape[0] > 0 and stencil[y, x] != stencil[i, j]):
            continue
        if same_depth(depth[i, j], depth[y, x]) and math.isfinite(vectors[y, 2 * x]):
            return y, x
    return -1, -1


@part
def settle_edges(
    i: int,
    vectors: F32,
    rigid: F32,
    surfaces: Surfaces,
    cameras: F64,
    tolerance: np.float32,
    out: F32,
) -> None:
    """Settle the pixels of a row that are at edges; `rigid` is their motion if they stand still."""
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
            y, x = nearest_unmixed(i, j, depth, stencil, edge, vectors)
            if y < 0:
                y, x = i, j
            elif static:
                right, down = rigid_at(y, x, position, depth, cameras)
                dx, dy = vectors[y, 2 * x] - right, vectors[y, 2 * x + 1] - down
                static = dx * dx + dy * dy <= tolerance * tolerance
        out[2 * j] = rigid[0, j] if static else vectors[y, 2 * x]
        out[2 * j + 1] = rigid[1, j] if static else vectors[y, 2 * x + 1]


@part
def settle_band(
    rows: tuple[int, int],
    vectors: tuple[F32, F32],
    surfaces: Surfaces,
    cameras: F64,
    tolerance: np.float32,
    out: tuple[F32, F32],
) -> None:
    """Settle the pixels in rows [rows[0], rows[1])."""
    position, depth, stencil, _ = surfaces
    width = depth.shape[1]
    points, beyond = np.ones((4, width), np.float64), np.ones((4, width), np.float64)
    for j in range(width):  # np.arange takes 1.4 s to compile
        points[0, j] = beyond[0, j] = np.float64(j)
    # Times the last column of its camera, 1, this leaves every number as it is, zeros' signs too.
    beyond[3] = -0.0
    rigid, far = np.empty((2, width), np.float32), np.empty((2, width), np.float32)
    moving, nothing = np.zeros(width, np.bool_), np.empty(0, np.float32)
    for i in range(rows[0], rows[1]):
        row = np.float64(i)
        points[1], beyond[1] = row, row
        place_row(position[i] if position.shape[0] > 0 else nothing, depth[i], points)
        if stencil.shape[0] > 0:
            mark_moving(stencil[i], moving)
        background = shows_background(depth[i])
        for way in range(2):
            if vectors[way].shape[0] == 0:
                continue
            project_row(points, cameras[way, NEAR], beyond[0], row, rigid)
            if background:
                project_row(beyond, cameras[way, FAR], beyond[0], row, far)
                show_background(depth[i], far, rigid)
            settle_row(vectors[way][i], rigid, depth[i], moving, tolerance, out[way][i])
            settle_edges(i, vectors[way], rigid, surfaces, cameras[way], tolerance, out[way][i])


@parallel
def settle(
    vectors: tuple[F32, F32],
    surfaces: Surfaces,
    cameras: F64,
    tolerance: np.float32,
    out: tuple[F32, F32],
    share: Share,
) -> None:
    """Give every pixel its own surface's motion, to the frames before and after.

    Parameters
    ----------
    vectors
        float32 [H, 2 W] each, pairs of x and y in pixels: as rendered, mixed at silhouettes; NaN
        where unusable. [0, 0] where there are none.
    surfaces
        Positions, depth, stencil and edges: float32 [H, 3 W] in the world, or [0, 0], then depth
        places the points; the others as :func:`exwarp_cli.kernels.edges.find_edges` has them.
    cameras
        float64 [2, 2, 3, 4], for each of both frames. The first takes points (X, Y, Z, 1) to it, or
        without positions (x, y, 1, 1/depth); the second, whose last column is 1, takes background
        at (x, y, 1). NaN where there is no camera.
    tolerance
        Pixels by which vectors and the motion of what stands still may differ for a pixel to count
        as static.
    out
        float32 [H, 2 W] each, written; [0, 0] where there are no vectors.

    Notes
    -----
    What stands still moves as the cameras have it, as in
    :func:`exwarp_cli.kernels.project.rigid`, bit for bit. Background follows them. Inside a
    surface the rendered vector holds; at its edge the nearest unmixed pixel of the same surface
    decides whether it is static (then the cameras' motion, which is exact at the pixel's centre) or
    moves (then that pixel's vector). Where a surface is all edge, thin structures, it counts as
    static unless an id says that it moves.

    Both ways at once, with the cameras' motion in rows that stay in the cache: with a frame of it
    for each way, written and read again, it took 2.3 times as long.
    """
    height, _ = surfaces[1].shape
    for band in turns((height + ROWS_PER_BAND - 1) // ROWS_PER_BAND, share):
        begin = band * ROWS_PER_BAND
        rows = begin, min(begin + ROWS_PER_BAND, height)
        settle_band(rows, vectors, surfaces, cameras, tolerance, out)
