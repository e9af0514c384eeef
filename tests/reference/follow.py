"""Naive twin of the kernel that follows points: plain loops, straight from the definition."""

from __future__ import annotations

import math

import numpy as np


def follow(
    step: np.ndarray,
    expected: np.ndarray,
    moved: np.ndarray,
    stencils: tuple[np.ndarray, np.ndarray] | None = None,
    prior: float = 0.2,
    least: float = 0.25,
    share: float = 0.1,
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
            foreseen = not np.isnan(hope).any()
            weights, values = ([prior], [hope]) if foreseen else ([], [])
            left, top = math.floor(x), math.floor(y)
            for q in (top, top + 1):
                for p in (left, left + 1):
                    if not (0 <= p < width and 0 <= q < height):
                        continue
                    vector = step[q, p].astype(np.float64)
                    other = stencils is not None and stencils[0][q, p] != stencils[1][i, j]
                    if other or np.isnan(vector).any():
                        continue
                    weight = (1 - abs(x - p)) * (1 - abs(y - q))
                    if foreseen:
                        scale = max(least, share * float(np.hypot(*hope)))
                        weight /= (1 + (np.hypot(*(vector - hope)) / scale) ** 2) ** 2
                    weights.append(weight)
                    values.append(vector)
            if sum(weights) > 0:
                out[i, j] = moved[i, j] + np.average(values, axis=0, weights=weights)
    return out
