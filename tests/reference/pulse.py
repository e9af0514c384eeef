"""Naive twin of pulse: plain loops, straight from the definition."""

from __future__ import annotations

import math

import numpy as np

from tests.reference.quality import srgb_255


def luma(pixel: np.ndarray) -> float:
    """Rec. 709 luma of one scene-linear pixel as displayed, 0 to 255."""
    red, green, blue = (srgb_255(float(value)) for value in pixel[:3])
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def mean_gradient(pixels: np.ndarray) -> float:
    """Mean |difference| of neighbours in rows plus that of neighbours in columns."""
    rows = [[luma(pixel) for pixel in row] for row in pixels]
    across, down = [], []
    for i, row in enumerate(rows):
        for j, here in enumerate(row):
            if j + 1 < len(row):
                across.append(abs(row[j + 1] - here))
            if i + 1 < len(rows):
                down.append(abs(rows[i + 1][j] - here))
    return sum(math.fsum(values) / len(values) for values in (across, down) if values)


def pulse(test: np.ndarray, reference: np.ndarray) -> float:
    """Per cent by which the mean gradient of a frame is above that of another."""
    return 100 * (mean_gradient(test) / mean_gradient(reference) - 1)
