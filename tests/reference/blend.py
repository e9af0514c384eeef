"""Naive twin of blending two warped key frames."""

from __future__ import annotations

import math

import numpy as np

Side = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def importance(side: Side, p: tuple[int, int], nearest: float, constants: tuple) -> float:
    """Weight of a side at a pixel: (nearest / depth) ** power, less for a fringe, 0 for a hole."""
    power, least_ratio, fringe_weight = constants
    _, depth, hole, fringe = side
    if hole[p] or math.isnan(depth[p]):
        return 0.0
    ratio = 1.0 if depth[p] == nearest else max(nearest / float(depth[p]), least_ratio)
    return ratio**power * (fringe_weight if fringe[p] else 1.0)


def blend(
    before: Side, after: Side, time: float, constants: tuple[int, float, float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return pixels (float64, NaN in holes), depth and holes; sides as the kernel takes them.

    `constants` are the power, the least ratio of depths and the weight of a fringe.
    """
    out = np.full(before[0].shape, np.nan)
    nearest = np.fmin(before[1], after[1])
    hole = np.ones(nearest.shape, bool)
    for p in np.ndindex(nearest.shape):
        a = (1 - time) * importance(before, p, float(nearest[p]), constants)
        b = time * importance(after, p, float(nearest[p]), constants)
        if a + b > 0:
            hole[p] = False
            out[p] = (a * before[0][p].astype(np.float64) + b * after[0][p]) / (a + b)
    return out, nearest, hole
