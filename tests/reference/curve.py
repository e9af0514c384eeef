"""Naive twin of the curve that interpolation networks see colour through, value by value."""

from __future__ import annotations

import math


def shown(linear: float, peak: float, encoding: str) -> float:
    """Encode one scene-linear value; `peak` is the brightest of the two frames, at least 1."""
    sign, size = math.copysign(1, linear), abs(linear)
    white = max(0.75, 1 / (1 + 1.055 / 2.4 * math.log(peak)))
    if size > 1:
        return sign * (white + (1 - white) * math.log(size) / math.log(peak))
    if encoding == "linear":
        plain = size
    elif encoding == "log":
        plain = math.log(1 + size) / math.log(2)
    else:
        plain = 12.92 * size if size <= 0.0031308 else 1.055 * size ** (1 / 2.4) - 0.055
    return sign * white * plain
