"""Explaining a pair of frames by shifting the whole frame: where there are no motion vectors."""

from __future__ import annotations

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.synthesis.agreement import CONTRAST, LEAST_BLOCKS, correlations

SHIFTS = 4
"""Displacements of the whole frame that are tried where there are no vectors, besides none."""


def gain_of_shifts(before: Float32, after: Float32) -> float | None:
    """Return by how much shifts of the whole frame explain a pair better than others do.

    Of each block counts the best of the few shifts that phase correlation finds (Kuglin and Hines
    1975), less what the best of as many far shifts comes to.
    """
    width = before.shape[1]
    found = _best_of([(0, 0), *_likely_shifts(before, after)], before, after)
    far = ((17, 10), (-17, 13), (12, -12), (-10, -18), (20, 3))
    others = [
        _best_of([(sign * x * width // 100, y * width // 100) for x, y in far], before, after)
        for sign in (1, -1)
    ]
    if found is None or None in others:
        return None
    return found - float(np.mean([o for o in others if o is not None]))


def _best_of(shifts: list[tuple[int, int]], before: Float32, after: Float32) -> float | None:
    """Return the mean over blocks of the best correlation that one of the shifts gives."""
    found = [correlations(before[..., None], *_shifted(after, x, y), CONTRAST) for x, y in shifts]
    told = np.isfinite(found).any(axis=0)
    if np.count_nonzero(told) < LEAST_BLOCKS:
        return None
    return float(np.nanmax(np.stack(found)[:, told], axis=0).mean())


def _shifted(image: Float32, x: int, y: int) -> tuple[Float32, Bool]:
    """Return what lies x cells right and y cells below, [h, w, 1], and where that is inside."""
    height, width = image.shape
    columns, rows = np.arange(width) + x, np.arange(height) + y
    inside = ((rows >= 0) & (rows < height))[:, None] & (columns >= 0) & (columns < width)
    moved = np.roll(image, (-y, -x), axis=(0, 1))
    return moved[..., None], inside


def _likely_shifts(before: Float32, after: Float32) -> list[tuple[int, int]]:
    """Return the highest peaks of phase correlation, as (x, y) in cells, + right and down."""
    height, width = before.shape
    window = np.outer(np.hanning(height), np.hanning(width))
    a, b = (np.fft.rfft2((light - light.mean()) * window) for light in (before, after))
    cross = a.conj() * b
    cross /= np.abs(cross) + 1e-9 * np.abs(cross).max() + 1e-30
    rate = np.fft.fftfreq(height)[:, None] ** 2 + np.fft.rfftfreq(width) ** 2
    # Frequencies above a sixth of a cell's hold more noise than motion.
    peaks = np.fft.irfft2(cross * np.exp(-rate / (2 * 0.15**2)), (height, width))
    out = []
    for _ in range(SHIFTS):
        y, x = divmod(int(np.argmax(peaks)), width)
        around = np.ix_(np.arange(y - 2, y + 3) % height, np.arange(x - 2, x + 3) % width)
        peaks[around] = -np.inf
        out.append((x - width if x > width // 2 else x, y - height if y > height // 2 else y))
    return out
