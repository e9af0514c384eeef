"""Ids out of floats, one pixel after the other."""

from __future__ import annotations

import math

import numpy as np


def whole_ids(ids: np.ndarray) -> np.ndarray:
    """Return int32 [N]: the nearest whole number within int32, -1 for mixtures and NaN."""
    return np.array([_whole(float(value)) for value in ids], np.int32)


def _whole(value: float) -> int:
    if not math.isfinite(value):
        return -1
    whole = round(value)  # halves to even, as IEEE 754 has it
    bounded = min(max(whole, -1), 2**31 - 128)
    return bounded if abs(value - bounded) < float(np.float32(0.02)) else -1
