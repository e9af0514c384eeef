"""Naive twins of the passes of fitting a camera."""

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


def errors(image: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return distances in pixels; infinite behind the camera and where they are not finite."""
    with np.errstate(all="ignore"):
        away = np.linalg.norm(image[:, :2] / image[:, 2:] - pixels, axis=1)
    return np.where((image[:, 2] > 0) & np.isfinite(away), away, np.inf)


def weights(errors: np.ndarray, inliers: np.ndarray, depths: np.ndarray, unit: float) -> np.ndarray:
    """Return Geman and McClure's weights, over the depth; 0 for outliers."""
    doubt = 1 + (errors / unit) ** 2
    return np.where(inliers, 1 / (np.maximum(np.abs(depths), 1e-9) * doubt), 0)
