"""Naive twin of the equations of a camera's fit."""

from __future__ import annotations

import numpy as np


def equations(
    points: np.ndarray, pixels: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the weighted points [M, 4], and their equations [2 M, 12]: those of x, those of y."""
    used = weights > 0
    scaled, (x, y) = points[used] * weights[used, None], pixels[used].T[..., None]
    zero = np.zeros_like(scaled)
    return scaled, np.block([[scaled, zero, -x * scaled], [zero, scaled, -y * scaled]])
