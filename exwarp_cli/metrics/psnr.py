"""Peak signal-to-noise ratio."""

from __future__ import annotations

import math

import numpy as np

from exwarp_cli.domain.frame import Float32
from exwarp_cli.metrics.display import PEAK, Measured

CAP_DB = 100.0
"""What equal images get in place of infinity, and the most that any pair gets."""


def measure(reference: Float32, test: Float32) -> Measured:
    """Compare two display-encoded images, float32 [H, W, 3], 0 to 255.

    The value is ``10 log10(255^2 / MSE)`` in decibels, with the mean squared error over the pixels
    in question and all three channels, at most `CAP_DB`.
    """
    error = np.zeros(reference.shape[:2])
    for c in range(3):
        difference = np.subtract(reference[..., c], test[..., c], dtype=np.float64)
        error += difference * difference
    return Measured(error / 3, finish=decibels)


def decibels(mean_squared_error: float) -> float:
    """Turn a mean squared error on the 255 scale into decibels, at most `CAP_DB`."""
    if mean_squared_error <= 0:
        return CAP_DB
    return min(CAP_DB, 10 * math.log10(PEAK**2 / mean_squared_error))
