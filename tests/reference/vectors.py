"""Vectors out of raw channels, one pixel after the other."""

from __future__ import annotations

import numpy as np


def scale_vectors(
    raw: np.ndarray, channels: tuple[int, int], scales: tuple[float, float]
) -> np.ndarray:
    """Return float32 [N, 2]: two channels of [N, C] times their scales; NaN where one is none."""
    out = np.full((len(raw), 2), np.nan, np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        for n, values in enumerate(raw.astype(np.float32)):
            x, y = (
                np.float32(values[c]) * np.float32(s) for c, s in zip(channels, scales, strict=True)
            )
            if np.isfinite(x + y):
                out[n] = x, y
    return out
