"""Naive twin of the bounds that a slot's colour is held within: plain loops."""

from __future__ import annotations

import math

import numpy as np


def bounds(
    pixels: np.ndarray, field: np.ndarray, wanted: np.ndarray, clear: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Return least and greatest of the 5x5 pixels around each end of a field, NaN where none count.

    Parameters as for the kernel; both results are float32 [h, w, C].
    """
    height, width, channels = pixels.shape
    least = np.full((*field.shape[:2], channels), np.nan, np.float32)
    greatest = least.copy()
    for i, j in zip(*np.nonzero(wanted), strict=True):
        x, y = np.float32(j) + field[i, j, 0], np.float32(i) + field[i, j, 1]
        if math.isnan(x) or math.isnan(y):
            continue
        column = math.floor(min(max(x, 0), width - 1) + np.float32(0.5))
        row = math.floor(min(max(y, 0), height - 1) + np.float32(0.5))
        part = pixels[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3]
        around = part.reshape(-1, channels)
        if clear:
            around = around[around[:, 3] == 0]
        for c in range(channels):
            values = around[:, c][np.isfinite(around[:, c])]
            if values.size:
                least[i, j, c], greatest[i, j, c] = values.min(), values.max()
    return least, greatest
