"""Naive twins of the hole kernels: tests and filling as the docstrings tell them."""

from __future__ import annotations

import math

import numpy as np

Pair = tuple[np.ndarray, np.ndarray]


def footprint(position: np.ndarray, i: int, j: int) -> float:
    """Sum over both axes of the smaller distance to a neighbour's position."""
    height, width, _ = position.shape
    total = 0.0
    for neighbours in (((i - 1, j), (i + 1, j)), ((i, j - 1), (i, j + 1))):
        distances = [
            float(np.linalg.norm(position[y, x] - position[i, j]))
            for y, x in neighbours
            if 0 <= y < height and 0 <= x < width
        ]
        total += min(distances, default=0.0)
    return total


def mark(
    field: np.ndarray,
    depths: Pair,
    stencils: Pair | None,
    positions: Pair | None,
    normals: Pair | None,
    constants: tuple[float, float, float],
    steps: tuple[float, float, float] = (0, 0, 0),
) -> np.ndarray:
    """Return the hole mask; None is unknown.

    `constants` are the footprints that positions may lie apart, the relative tolerance of depth and
    the least cosine between normals; `steps` those to which depth, its inverse and positions, as a
    share of each, were rounded.
    """
    footprints, depth_tolerance, min_cosine = constants
    height, width = depths[0].shape
    hole = np.ones((height, width), bool)
    for i in range(height):
        for j in range(width):
            x, y = float(np.float32(j) + field[i, j, 0]), float(np.float32(i) + field[i, j, 1])
            if not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):
                continue
            here = (i, j)
            there = (min(math.floor(y + 0.5), height - 1), min(math.floor(x + 0.5), width - 1))
            a, b = float(depths[0][here]), float(depths[1][there])
            if math.isinf(a) or math.isinf(b):
                hole[here] = math.isinf(a) != math.isinf(b)
                continue
            ids = (0, 0) if stencils is None else (stencils[0][here], stencils[1][there])
            dynamic = ids[0] > 0
            other = min(ids) >= 0 and ids[0] != ids[1]
            if dynamic and normals is not None:
                now, then = (normals[0][here], normals[1][there])
                lengths = float(np.linalg.norm(now) * np.linalg.norm(then))
                other |= float(now @ then) < min_cosine * lengths
            if not dynamic and positions is not None:
                apart = float(np.linalg.norm(positions[0][here] - positions[1][there]))
                rounding = steps[2] * float(np.abs(positions[0][here]).sum())
                other |= apart > footprints * footprint(positions[0], i, j) + rounding
            if not dynamic and positions is None:
                rounding = 1.1 * (steps[0] + steps[1] * a * b)
                other |= abs(a - b) > max(depth_tolerance * max(a, b), rounding)
            hole[here] = other
    return hole
