"""Naive twin of projecting static points into another camera's frame."""

from __future__ import annotations

import math

import numpy as np


def rigid(
    position: np.ndarray | None, depth: np.ndarray, camera: np.ndarray, at_infinity: np.ndarray
) -> np.ndarray:
    """Return displacements, float64 [H, W, 2]; without positions depth places the points."""
    out = np.full((*depth.shape, 2), np.nan)
    for i, j in np.ndindex(depth.shape):
        if math.isinf(depth[i, j]):
            image = at_infinity @ [j, i, 1.0]
        elif position is None:
            image = camera @ [j, i, 1.0, 1.0 / float(depth[i, j])]
        else:
            image = camera @ [*position[i, j].astype(np.float64), 1.0]
        if image[2] > 0:
            out[i, j] = image[:2] / image[2] - (j, i)
    return out
