"""Naive twin of the sharp sampling kernels: plain loops, straight from the definitions."""

from __future__ import annotations

import math

import numpy as np

from tests.reference import gather

RADIUS = 3


def lanczos(x: float) -> float:
    """Lanczos' kernel of three lobes."""
    if x == 0:
        return 1.0
    if abs(x) >= RADIUS:
        return 0.0
    angle = math.pi * x
    return RADIUS * math.sin(angle) * math.sin(angle / RADIUS) / angle**2


def weights(offset: float, phases: int) -> list[float]:
    """Return the weights of the six pixels around a place, for the nearest of some phases."""
    offset = round(offset * phases) / phases
    found = [lanczos(offset - tap) for tap in range(1 - RADIUS, RADIUS + 1)]
    return [weight / sum(found) for weight in found]


def taps(image: np.ndarray, x: float, y: float, phases: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the weighted sum, [C], and the 3x3 pixels about the nearest, [9, C]."""
    height, width = image.shape[:2]
    left, top = math.floor(x), math.floor(y)
    across, down = weights(x - left, phases), weights(y - top, phases)

    def pixel(row: int, column: int) -> np.ndarray:
        row, column = min(max(row, 0), height - 1), min(max(column, 0), width - 1)
        return image[row, column].astype(np.float64)

    total = sum(
        down[p] * across[q] * pixel(top + p - RADIUS + 1, left + q - RADIUS + 1)
        for p in range(2 * RADIUS)
        for q in range(2 * RADIUS)
    )
    row, column = math.floor(y + 0.5), math.floor(x + 0.5)
    around = [pixel(row + dy, column + dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
    return np.asarray(total), np.array(around)


def resample(
    image: np.ndarray, field: np.ndarray, phases: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the image held to the 3x3 pixels, the hole mask, and the limit of linear sampling.

    Of finite images.
    """
    out, hole = gather.gather_bilinear(image, field)
    limit = np.zeros(hole.shape)
    for i, j in np.argwhere(~hole):
        x, y = float(np.float32(j) + field[i, j, 0]), float(np.float32(i) + field[i, j, 1])
        total, around = taps(image, x, y, phases)
        held = np.clip(total, around.min(axis=0), around.max(axis=0))
        way = np.where(held != total, (held - out[i, j]) / (total - out[i, j] + 1e-300), 1)
        limit[i, j] = np.clip(way, 0, 1).min()
        out[i, j] = held
    return out, hole, limit
