"""Naive twin of the kernel that follows points: plain loops, straight from the definition."""

from __future__ import annotations

import math

import numpy as np

LEAST, SHARE = 0.25, 0.1
"""Pixels, and share of the expected vector, by which a vector may differ from it."""

LEAST_TRUST = 0.25
CLOSE, TOLERANCE = 0.02, 0.1
"""Relative differences of depth up to which a sample surely, and possibly, shows the surface."""

Pair = tuple[np.ndarray, np.ndarray]
OTHER, DOUBTFUL, SAME = range(3)


def follow(
    step: np.ndarray,
    expected: np.ndarray,
    moved: np.ndarray,
    stencils: Pair | None = None,
    depths: Pair | None = None,
    rounded: tuple[float, float] = (0, 0),
) -> np.ndarray:
    """Return how far points have come, float64 [H, W, 2]."""
    height, width = moved.shape[:2]
    out = np.full(moved.shape, np.nan)
    for i in range(height):
        for j in range(width):
            x, y = float(np.float32(j) + moved[i, j, 0]), float(np.float32(i) + moved[i, j, 1])
            if math.isnan(x + y):
                continue
            hope = expected[i, j].astype(np.float64)
            weights, values, trusts, missing = [], [], [], 1.0
            left, top = math.floor(x), math.floor(y)
            for q in (top, top + 1):
                for p in (left, left + 1):
                    if not (0 <= p < width and 0 <= q < height):
                        continue
                    vector = step[q, p].astype(np.float64)
                    like = likeness((q, p), (i, j), stencils, depths, rounded)
                    trusted = trust(vector, hope, like)
                    if trusted > 0:
                        share = (1 - abs(x - p)) * (1 - abs(y - q))
                        weights.append(trusted * share)
                        values.append(vector)
                        trusts.append(trusted)
                        missing -= share
            if len(values) < 4 and not np.isnan(hope).any():
                weights.append(max(missing, 0) * (max(trusts) if sum(weights) > 0 else 1))
                values.append(hope)
            if sum(weights) > 0:
                out[i, j] = moved[i, j] + np.average(values, axis=0, weights=weights)
    return out


def likeness(
    there: tuple[int, int],
    here: tuple[int, int],
    stencils: Pair | None,
    depths: Pair | None,
    rounded: tuple[float, float],
) -> int:
    """Return whether a pixel shows a point's surface."""
    if stencils is not None and stencils[0][there] != stencils[1][here]:
        return OTHER
    if depths is None:
        return SAME
    a, b = float(depths[0][there]), float(depths[1][here])
    if math.isinf(a) or math.isinf(b):
        return SAME if a == b else OTHER
    rounding = 1.1 * (rounded[0] + rounded[1] * a * b)
    if abs(a - b) <= max(CLOSE * max(a, b), rounding):
        return SAME
    moves = stencils is not None and stencils[1][here] > 0
    return DOUBTFUL if moves or abs(a - b) <= max(TOLERANCE * max(a, b), rounding) else OTHER


def trust(vector: np.ndarray, hope: np.ndarray, like: int) -> float:
    """Return how much a sample counts beside what is expected."""
    if like == OTHER or np.isnan(vector).any():
        return 0.0
    if np.isnan(hope).any():
        return 1.0
    scale = max(LEAST, SHARE * float(np.hypot(*hope)))
    found = 1 / (1 + (np.hypot(*(vector - hope)) / scale) ** 2) ** 2
    return 0.0 if like == DOUBTFUL and found < LEAST_TRUST else float(found)
