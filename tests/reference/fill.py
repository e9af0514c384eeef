"""Filling holes, pixel by pixel."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

WAYS = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if (dy, dx) != (0, 0)]


def look(hole: np.ndarray, reach: int) -> np.ndarray:
    """Return the steps to the first visible pixel in eight ways, int [8, H, W]."""
    height, width = hole.shape
    out = np.zeros((8, height, width), int)
    for i, j in zip(*np.nonzero(hole), strict=True):
        for way, step, _, _ in seen_from(i, j, hole, reach):
            out[way, i, j] = step
    return out


def seen_from(i: int, j: int, hole: np.ndarray, reach: int) -> Iterator[tuple[int, int, int, int]]:
    """The first visible pixel in each way that has one: the way, the steps, row and column."""
    for way, (dy, dx) in enumerate(WAYS):
        for step in range(1, reach + 1):
            y, x = i + dy * step, j + dx * step
            if not (0 <= y < hole.shape[0] and 0 <= x < hole.shape[1]):
                break
            if not hole[y, x]:
                yield way, step, y, x
                break


def fill(
    image: np.ndarray,
    depth: np.ndarray,
    hole: np.ndarray,
    limits: tuple[float, int],
    powers: tuple[int, int],
) -> np.ndarray:
    """Return the filled image, float64; `limits` are cap and reach."""
    cap, reach = limits
    out = image.astype(np.float64)
    for i, j in zip(*np.nonzero(hole), strict=True):
        seen = []
        for _, _, y, x in seen_from(i, j, hole, reach):
            seen.append((y, x, np.hypot(y - i, x - j), min(float(depth[y, x]), cap)))
        wanted = min(float(depth[i, j]), cap)
        power = powers[0]
        if np.isnan(depth[i, j]):
            power = powers[1]
            wanted = max((far for *_, far in seen), default=0.0)
        total, value = 0.0, np.zeros(image.shape[2])
        for y, x, distance, far in seen:
            largest = max(far, wanted)
            alike = min(far, wanted) / largest if largest > 0 else 1.0
            weight = (alike**power + 1e-6) / distance**2
            total += weight
            value += weight * image[y, x]
        out[i, j] = value / total if total > 0 else 0.0
    return out


def count_holes(hole: np.ndarray, depth: np.ndarray) -> tuple[list[int], list[float]]:
    """Return each row's number of holes, and the greatest finite depth outside them, or 0."""
    furthest = [
        max((float(z) for z, h in zip(*row, strict=True) if not h and np.isfinite(z)), default=0.0)
        for row in zip(depth, hole, strict=True)
    ]
    return [sum(map(bool, row)) for row in hole], furthest


def list_holes(hole: np.ndarray) -> list[int]:
    """Return the columns of all holes, row by row."""
    return [j for row in hole for j, is_hole in enumerate(row) if is_hole]
