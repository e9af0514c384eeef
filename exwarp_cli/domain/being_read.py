"""Which files libraries are reading now, told to whoever watches this process from outside.

A decoder may crash on a damaged file, or never come back; then this process cannot say any more
which file it was.
"""

from __future__ import annotations

import mmap
import os
import struct
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path

PLACES = 64
"""Files that can be told of at a time; those beyond are read without."""

ROOM = 4096
"""Bytes of a place: a path is at most as long on the systems that matter."""

_HEAD = struct.Struct("<QI")
"""Number of the reading, 0 in an empty place, and the length of the path after it."""


class Board:
    """Memory that this process and the one that watches it share.

    Made before the process is parted in two; the one that reads files calls `hang_up`.
    """

    def __init__(self) -> None:
        self._memory = mmap.mmap(-1, PLACES * ROOM)
        self._free = deque(range(PLACES))
        self._numbers = count(1)

    @contextmanager
    def note(self, path: Path) -> Iterator[None]:
        """Tell of a file while the block reads it."""
        try:
            place = self._free.popleft()
        except IndexError:
            yield
            return
        try:
            name = os.fsencode(path)[: ROOM - _HEAD.size]
            begin = place * ROOM
            self._memory[begin + _HEAD.size : begin + _HEAD.size + len(name)] = name
            _HEAD.pack_into(self._memory, begin, next(self._numbers), len(name))
            try:
                yield
            finally:
                _HEAD.pack_into(self._memory, begin, 0, 0)
        finally:
            self._free.append(place)

    def notes(self) -> dict[int, Path]:
        """Return what is being read, by the number of the reading; no two have the same."""
        found = {}
        for place in range(PLACES):
            number, size = _HEAD.unpack_from(self._memory, place * ROOM)
            if number:
                begin = place * ROOM + _HEAD.size
                found[number] = Path(os.fsdecode(self._memory[begin : begin + size]))
        return found


_board: Board | None = None


def hang_up(board: Board) -> None:
    """Have this process tell on a board what it reads."""
    global _board
    _board = board


@contextmanager
def being_read(path: Path) -> Iterator[None]:
    """Tell of a file while a library that may fail on it reads it in the block."""
    if _board is None:
        yield
        return
    with _board.note(path):
        yield
