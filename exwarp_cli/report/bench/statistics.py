"""How two series of numbers go together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt

LEAST = 3
"""Points from which on a correlation says anything."""


def pearson(x: Sequence[float], y: Sequence[float]) -> float | None:
    """Return the linear correlation, -1 to 1; None for fewer points or a constant series."""
    a, b = np.asarray(x, np.float64), np.asarray(y, np.float64)
    if len(a) < LEAST or np.ptp(a) == 0 or np.ptp(b) == 0:
        return None
    a, b = a - a.mean(), b - b.mean()
    return float((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum()))


def spearman(x: Sequence[float], y: Sequence[float]) -> float | None:
    """Return the correlation of ranks, -1 to 1; equal values share their mean rank."""
    return pearson(_ranks(x).tolist(), _ranks(y).tolist())


def share(marks: Iterable[bool]) -> float | None:
    """Return how many of the marks are set, 0 to 1; None without any."""
    listed = list(marks)
    return sum(listed) / len(listed) if listed else None


def _ranks(values: Sequence[float]) -> npt.NDArray[np.float64]:
    _, inverse, counts = np.unique(np.asarray(values), return_inverse=True, return_counts=True)
    last = np.cumsum(counts)
    return np.asarray((last - (counts - 1) / 2)[inverse])
