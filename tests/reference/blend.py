"""Naive twin of blending two warped key frames."""

from __future__ import annotations

import math

import numpy as np

Seen = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Depth, hole and fringe of a side."""

Side = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Pixels, depth, hole and fringe of a side."""

Constants = tuple[int, float, float, float]
"""The power, the least ratio of depths, the weight of a fringe, the difference of one surface."""

Place = tuple[int, int]


def importance(side: Seen, p: Place, nearest: float, constants: Constants) -> float:
    """Weight of a side at a pixel: (nearest / depth) ** power, less for a fringe, 0 for a hole."""
    power, least_ratio, fringe_weight, _ = constants
    depth, hole, fringe = side
    if hole[p] or math.isnan(depth[p]):
        return 0.0
    ratio = 1.0 if depth[p] == nearest else max(nearest / float(depth[p]), least_ratio)
    return ratio**power * (fringe_weight if fringe[p] else 1.0)


def is_one_surface(first: float, second: float, constants: Constants) -> bool:
    """Whether depths differ by no more than a share of the nearer one; background is one."""
    if math.isinf(first) or math.isinf(second):
        return first == second
    return abs(first - second) <= constants[3] * min(first, second)  # False for NaN


def shared_edges(before: Seen, after: Seen, constants: Constants) -> np.ndarray:
    """Return bool [H, W]: the sides show two surfaces, and each has the other's within a pixel."""
    out = np.zeros(before[0].shape, bool)
    for y, x in np.ndindex(out.shape):
        depths = [
            math.nan if hole[y, x] else float(depth[y, x]) for depth, hole, _ in (before, after)
        ]
        if any(map(math.isnan, depths)) or is_one_surface(*depths, constants):
            continue
        around = np.s_[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
        out[y, x] = all(
            any(is_one_surface(float(d), wanted, constants) for d in depth[around][~hole[around]])
            for (depth, hole, _), wanted in zip((before, after), depths[::-1], strict=True)
        )
    return out


def weigh(
    before: Seen, after: Seen, time: float, constants: Constants
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the weight of the second side (float64, 0 in holes), depth and holes."""
    nearest = np.fmin(before[0], after[0])
    later, hole = np.zeros(nearest.shape), np.ones(nearest.shape, bool)
    shared = shared_edges(before, after, constants)
    for p in np.ndindex(nearest.shape):
        a = (1 - time) * importance(before, p, float(nearest[p]), constants)
        b = time * importance(after, p, float(nearest[p]), constants)
        if shared[p]:
            a, b = 1 - time, time
        if a + b > 0:
            hole[p], later[p] = False, b / (a + b)
    return later, nearest, hole


def mix(before: np.ndarray, after: np.ndarray, later: np.ndarray) -> np.ndarray:
    """Return the mean of two pictures, float64, by the weight of the second, [H, W]."""
    later = later.astype(np.float64)[..., None]
    return (1 - later) * before.astype(np.float64) + later * after.astype(np.float64)


def blend(
    before: Side, after: Side, time: float, constants: Constants
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return pixels (float64, NaN in holes), depth and holes; sides as the kernel takes them."""
    later, nearest, hole = weigh(before[1:], after[1:], time, constants)
    out = mix(before[0], after[0], later)
    out[hole] = np.nan
    return out, nearest, hole
