"""Naive twins of what looks back from a slot and spreads it to planes: plain loops."""

from __future__ import annotations

import math

import numpy as np

Frame = tuple[np.ndarray, np.ndarray]
Part = np.ndarray | None


def end(field: np.ndarray, i: int, j: int) -> tuple[int, int] | None:
    """Return row and column of the pixel that a field leads to; None beyond the frame."""
    height, width = field.shape[:2]
    x, y = j + float(field[i, j, 0]), i + float(field[i, j, 1])
    if not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):
        return None
    return min(math.floor(y + 0.5), height - 1), min(math.floor(x + 0.5), width - 1)


def ends(field: np.ndarray) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Return the pixels that lead into the frame, and where to."""
    found = [(place, end(field, *place)) for place in np.ndindex(field.shape[:2])]
    return [(place, there) for place, there in found if there is not None]


def relative(depth: float, median: float, unknown: float) -> float:
    """Return d / (d + median); 1 for the background."""
    if math.isnan(depth):
        return unknown
    return 1.0 if math.isinf(depth) else 1 - median / (max(depth, 0.0) + median)


def held(value: float, unknown: float) -> float:
    """Return a value within 0 to 1."""
    return unknown if math.isnan(value) else min(max(value, 0.0), 1.0)


def spread(
    frames: tuple[Frame, Frame, Frame],
    filled: np.ndarray,
    parts: tuple[Part, Part, Part, Part],
    median: float,
    rows: slice,
    columns: slice,
    defaults: tuple[float, float, float],
) -> np.ndarray:
    """Return the planes float64 [25, h, w]."""
    height, width = filled.shape[:2]
    depth, normal, roughness, metallic = parts
    out = np.zeros((25, rows.stop - rows.start, columns.stop - columns.start))
    for y, x in np.ndindex(out.shape[1:]):
        at = min(max(rows.start + y, 0), height - 1), min(max(columns.start + x, 0), width - 1)
        last, seen = frames[0][0][at][:3], float(frames[0][1][at])
        direction = np.zeros(3) if normal is None else normal[at].astype(np.float64)
        direction = np.where(np.isfinite(direction), np.clip(direction, -1, 1), 0)
        surface = [
            defaults[0] if depth is None else relative(float(depth[at]), median, defaults[0]),
            defaults[1] if roughness is None else held(float(roughness[at]), defaults[1]),
            defaults[2] if metallic is None else held(float(metallic[at]), defaults[2]),
        ]
        history = [n for pixels, shown in frames for n in (*pixels[at][:3], float(shown[at]))]
        out[:, y, x] = [*(last * seen), *filled[at][:3], seen, *direction, *surface, *history]
    return out
