"""Chunks of a sequence: which key frames each one does, and how they are written."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from exwarp_cli.domain.timeline import ranges

DEFAULT_SIZE = 10
"""Key frames of a chunk where nobody chooses: starting ExWarp takes about as long as one of 2K."""


def split(numbers: Sequence[int], size: int) -> tuple[tuple[int, ...], ...]:
    """Cut key frames into chunks.

    Parameters
    ----------
    numbers
        Key frames, ascending: their input numbers, or anything else that stands for them.
    size
        Key frames of a chunk, at least 1; the last may have fewer.
    """
    return tuple(tuple(numbers[i : i + size]) for i in range(0, len(numbers), size))


def frames_text(numbers: Sequence[int]) -> str:
    """Write key frames as ``--frames`` and Open Job Description take them.

    Both read ``1001-1010``, ``10-30:4``, ``-8-4:4``, ``1,2,9`` and ``7`` as the same numbers.
    """
    return ranges(list(numbers)).replace("x", ":")


def is_dense(numbers: Sequence[int]) -> bool:
    """Whether key frames are numbered in steps of one, gaps aside.

    Of others, such as 10, 14, 18, a range without a step holds a single one.
    """
    return len(numbers) < 2 or any(b - a == 1 for a, b in pairwise(numbers))
