"""Naive twins of the sampling kernels: plain loops, straight from the definitions."""

from __future__ import annotations

import math

import numpy as np


def corners(x: float, y: float, shape: tuple[int, ...]) -> list[tuple[float, int, int]]:
    """Bilinear weights and pixels (row, column) around a point, clamped to the image."""
    left, top = math.floor(x), math.floor(y)
    fx, fy = x - left, y - top
    found = []
    for dy, wy in ((0, 1 - fy), (1, fy)):
        for dx, wx in ((0, 1 - fx), (1, fx)):
            row = min(max(top + dy, 0), shape[0] - 1)
            column = min(max(left + dx, 0), shape[1] - 1)
            found.append((wy * wx, row, column))
    return found


def lies_inside(x: float, y: float, shape: tuple[int, ...]) -> bool:
    """Whether a point lies in the pixel areas of an image; False for NaN."""
    return -0.5 <= x <= shape[1] - 0.5 and -0.5 <= y <= shape[0] - 0.5


def gather_bilinear(image: np.ndarray, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the sampled image, float64, and the hole mask."""
    height, width = field.shape[:2]
    out = np.zeros((height, width, image.shape[2]))
    hole = np.ones((height, width), bool)
    for i in range(height):
        for j in range(width):
            x, y = float(np.float32(j) + field[i, j, 0]), float(np.float32(i) + field[i, j, 1])
            if not (abs(x) < 1e7 and abs(y) < 1e7):
                continue
            value = sum(
                weight * image[row, column].astype(np.float64)
                for weight, row, column in corners(x, y, image.shape)
                if weight > 0
            )
            if np.isfinite(value).all():
                out[i, j] = value
                hole[i, j] = not lies_inside(x, y, image.shape)
    return out, hole
