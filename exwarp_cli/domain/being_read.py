"""Which files libraries are reading now, told to whoever watches this process from outside.

A decoder may crash on a damaged file, or never come back; then this process cannot say any more
which file it was. Where it wants to go on without that file, another process takes its place.
"""

from __future__ import annotations

import mmap
import os
import struct
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from itertools import count
from pathlib import Path

from exwarp_cli.errors import DamagedFileError

PLACES = 64
"""Files that can be told of at a time; those beyond are read without."""

ROOM = 4096
"""Bytes of a place: a path is at most as long on the systems that matter."""

_HEAD = struct.Struct("<QI")
"""Number of the reading, 0 in an empty place, and the length of the path after it."""


class Board:
    """Memory that this process and the one that watches it share.

    Made before the process is parted in two; the one that reads files calls `hang_up`.

    Attributes
    ----------
    refused
        Files that are not read any more, with what is said of them.
    singly
        Whether files are read one after the other, so that it is known which one is bad.
    """

    def __init__(self) -> None:
        self._memory = mmap.mmap(-1, PLACES * ROOM + 1)  # the last byte: whether it goes on
        self._free = deque(range(PLACES))
        self._numbers = count(1)
        self._one = threading.RLock()
        self.refused: dict[Path, str] = {}
        self.singly = False

    @property
    def goes_on(self) -> bool:
        """Whether the process that reads wants to go on without files that are bad."""
        return self._memory[-1] == 1

    @goes_on.setter
    def goes_on(self, wanted: bool) -> None:
        self._memory[-1] = int(wanted)

    @property
    def is_used(self) -> bool:
        """Whether a process before this one failed at a file."""
        return self.singly or bool(self.refused)

    def clear(self) -> None:
        """Forget what was being read; who read it is gone."""
        self._memory[: PLACES * ROOM] = bytes(PLACES * ROOM)

    @contextmanager
    def read(self, path: Path) -> Iterator[None]:
        """Tell of a file while the block reads it, as `note` does.

        Raises
        ------
        DamagedFileError
            When it is not read any more.
        """
        if path in self.refused:
            raise DamagedFileError(self.refused[path])
        with self._one if self.singly else nullcontext(), self.note(path):
            yield

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


def go_on_without() -> None:
    """Have another process take this one's place where a library fails at a file."""
    if _board is not None:
        _board.goes_on = True


def begun_again() -> bool:
    """Whether this process took the place of one that failed at a file."""
    return _board is not None and _board.is_used


@contextmanager
def being_read(path: Path) -> Iterator[None]:
    """Tell of a file while a library that may fail on it reads it in the block.

    Raises
    ------
    DamagedFileError
        When a library failed at it before.
    """
    with nullcontext() if _board is None else _board.read(path):
        yield
