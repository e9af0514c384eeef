"""How much is tried: a spread of the cases by default, every combination with EXWARP_TESTS=full."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Sequence
from typing import TypeVar

T = TypeVar("T")

FULL = os.environ.get("EXWARP_TESTS") == "full"
"""Whether everything is tried, as `make test-full` does."""


def combinations(*axes: Sequence[object]) -> list[tuple[object, ...]]:
    """Return all combinations if `FULL`, else so few that each value of each axis is in one."""
    if FULL:
        return list(itertools.product(*axes))
    count = max(len(axis) for axis in axes)
    return [tuple(axis[i % len(axis)] for axis in axes) for i in range(count)]


def spread(cases: Iterable[T], count: int) -> list[T]:
    """Return all cases if `FULL`, else `count` of them, evenly spread, first and last included."""
    found = list(cases)
    if FULL or count >= len(found):
        return found
    return [found[round(i * (len(found) - 1) / max(1, count - 1))] for i in range(count)]
