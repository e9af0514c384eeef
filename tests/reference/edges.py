"""Naive twins of the silhouette kernels."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

Pixel = tuple[int, int]


def around(pixel: Pixel, shape: tuple[int, ...], reach: int) -> Iterator[Pixel]:
    """Pixels of the square around a pixel, row by row, itself included."""
    for y in range(pixel[0] - reach, pixel[0] + reach + 1):
        for x in range(pixel[1] - reach, pixel[1] + reach + 1):
            if 0 <= y < shape[0] and 0 <= x < shape[1]:
                yield y, x


def same_surface(
    depth: np.ndarray, stencil: np.ndarray | None, p: Pixel, q: Pixel, tolerance: float
) -> bool:
    """Whether two pixels lie on one surface, by id and relative difference of depth."""
    if stencil is not None and stencil[p] != stencil[q]:
        return False
    a, b = np.float32(depth[p]), np.float32(depth[q])
    if math.isinf(a) or math.isinf(b):
        return math.isinf(a) and math.isinf(b)
    return bool(abs(a - b) <= np.float32(tolerance) * max(a, b))


def find_edges(depth: np.ndarray, stencil: np.ndarray | None, tolerance: float) -> np.ndarray:
    """Return which pixels have another surface among their eight neighbours."""
    edge = np.zeros(depth.shape, bool)
    for p in np.ndindex(depth.shape):
        edge[p] = any(
            not same_surface(depth, stencil, p, q, tolerance) for q in around(p, depth.shape, 1)
        )
    return edge


def unmix(
    vectors: np.ndarray,
    rigid: np.ndarray,
    surfaces: tuple[np.ndarray, np.ndarray | None, np.ndarray],
    tolerance: float,
    constants: tuple[float, int],
) -> np.ndarray:
    """Return every pixel's own surface's motion.

    `surfaces` are depth, stencil (None unknown) and edge; `constants` the depth tolerance and how
    far to search.
    """
    depth, stencil, edge = surfaces
    same_depth, search = constants
    out = np.empty_like(vectors)
    for p in np.ndindex(depth.shape):
        known = bool(np.isfinite(rigid[p]).all())
        moving = stencil is not None and stencil[p] > 0
        source: Pixel | None = p
        if edge[p]:
            inside = [
                ((q[0] - p[0]) ** 2 + (q[1] - p[1]) ** 2, q)
                for q in around(p, depth.shape, search)
                if not edge[q]
                and np.isfinite(vectors[q]).all()
                and same_surface(depth, stencil, p, q, same_depth)
            ]
            source = min(inside)[1] if inside else None
        if math.isinf(depth[p]):
            static = known
        elif source is None:
            static = known and not moving
        else:
            gap = vectors[source] - rigid[source]
            static = known and not moving and float(gap @ gap) <= tolerance**2
        out[p] = rigid[p] if static else vectors[p if source is None else source]
    return out


def beside_nearer(depth: np.ndarray, p: Pixel, tolerance: float) -> bool:
    """Whether one of the four direct neighbours shows a clearly nearer surface."""
    limit = np.float32(depth[p]) * (np.float32(1) - np.float32(tolerance))
    neighbours = [q for q in around(p, depth.shape, 1) if abs(q[0] - p[0]) + abs(q[1] - p[1]) == 1]
    return any(depth[q] < limit for q in neighbours)


def find_fringe(
    field: np.ndarray, near: np.ndarray, depth: np.ndarray, tolerance: float
) -> np.ndarray:
    """Return which pixels show the rim of a nearer surface that is not beside them any more."""
    height, width = depth.shape
    out = np.zeros((height, width), bool)
    for i, j in np.ndindex(height, width):
        x, y = float(np.float32(j) + field[i, j, 0]), float(np.float32(i) + field[i, j, 1])
        if not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):
            continue
        source = (min(math.floor(y + 0.5), height - 1), min(math.floor(x + 0.5), width - 1))
        out[i, j] = beside_nearer(depth, source, tolerance) and not beside_nearer(
            near, (i, j), tolerance
        )
    return out


def find_moving_edges(
    depth: np.ndarray, field: np.ndarray, fringe: np.ndarray, jump: float, apart: float
) -> np.ndarray:
    """Return which pixels have another surface among their 3x3 that moves otherwise."""
    far = np.where(np.isnan(depth), np.inf, depth)
    out = np.zeros(depth.shape, bool)
    for p in np.ndindex(*depth.shape):
        square = list(around(p, depth.shape, 1))
        depths = [far[q] for q in square]
        ways = np.array([field[q] for q in square])
        jumps = max(depths) > np.float32(jump) * min(depths)
        spread = ways.max(axis=0) - ways.min(axis=0)  # NaN where some motion is
        out[p] = jumps and not fringe[p] and not (spread <= apart).all()
    return out
