"""Memory for frames' arrays, which later frames get again when nobody holds them any more.

A frame of 1920x1080 with its geometry takes 100 MB. Fresh from the system, every page of it is
cleared and mapped at its first touch, a fifth of the time of reading it. The allocator's own heap
keeps such arrays too, but in pieces: of 590 MB that were in use it held 750. Here small arrays get
parts of what larger ones had, which are joined again when they come back; what nobody wants goes
back to the system page by page.

The memory of large frames may lie in files without a name, in the folder for temporary ones: then
it leaves the process where it is told to rest, and comes back page by page as it is used.
"""

from __future__ import annotations

import mmap
import os
import tempfile
import threading
import weakref
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from math import prod
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

LEAST = 1 << 20
"""Bytes from which memory is kept; below, the allocator keeps it itself."""

LARGE, HUGE = 2**20, 4 * 2**20
"""Pixels of a frame from which its memory should lie in files: where a network extrapolates, and
where one may have to. Of 3840x2160 a key frame with all that networks see takes 1 GB, and four of
them are at hand; of 1920x1080 that fits, but not beside what extrapolating takes, while a warp of
frames in files takes half as long again."""

_rooms: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()
_adding = threading.Lock()
_filed_from: int | None = None

_PRIVATE = {"flags": mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS} if hasattr(mmap, "MAP_PRIVATE") else {}
"""Not shared with other processes, as Windows' never is: shared pages are small ones."""


class _Loan:
    """What an array and all of its views keep alive; of a memoryview they would not."""

    def __init__(
        self, memory: npt.NDArray[np.uint8], shape: tuple[int, ...], kind: np.dtype
    ) -> None:
        interface = memory.__array_interface__
        self.__array_interface__ = {**interface, "shape": shape, "typestr": kind.str}
        del self.__array_interface__["descr"]


def lent(shape: tuple[int, ...], dtype: npt.DTypeLike) -> np.ndarray:
    """Return an array of any values, whose memory comes back with the last view of it.

    Raises
    ------
    MemoryError
        When there is not enough.
    """
    kind = np.dtype(dtype)
    size = prod(shape) * kind.itemsize
    if size < LEAST:
        return np.empty(shape, kind)
    piece = _store.take(size, filed=_lies_in_file(shape))
    loan = _Loan(piece.bytes, shape, kind)
    weakref.finalize(loan, _store.returned.append, piece).atexit = False
    return np.asarray(loan)


def file_from(pixels: int | None) -> None:
    """Have the memory of frames above so many pixels lie in files from now on; None for no more."""
    global _filed_from
    _filed_from = pixels


def filed(array: np.ndarray) -> np.ndarray:
    """Return a copy in such a file, where frames of that size lie there; else itself."""
    return copied(array) if _lies_in_file(array.shape) else array


def copied(array: np.ndarray) -> np.ndarray:
    """Return a copy in lent memory."""
    out = lent(array.shape, array.dtype)
    out[...] = array
    return out


def rest() -> None:
    """Have all that lies in files leave the process; it comes back where it is used."""
    with _adding:
        rooms = list(_rooms)
    for room in rooms:
        room.madvise(mmap.MADV_DONTNEED)


def _lies_in_file(shape: tuple[int, ...]) -> bool:
    return _filed_from is not None and prod(shape[:2]) > _filed_from


@dataclass(frozen=True)
class _Piece:
    """A part of a block that is lent: bytes from `begin` up to `end`."""

    block: _Block
    begin: int
    end: int
    bytes: npt.NDArray[np.uint8]


class _Block:
    """Memory that came from the system at once, and goes back as a whole.

    Attributes
    ----------
    memory
        All of it.
    filed
        Whether it lies in a file.
    idle
        Parts that nobody holds, by where they begin: their end, and the age of the store when they
        came back. No two of them touch.
    emptied
        Parts whose pages went back before, by where they begin: their end.
    """

    def __init__(self, size: int, filed: bool) -> None:
        room = _room(size) if filed else None
        self.filed = filed
        self.memory = _anonymous(size) if room is None else room
        self.idle: dict[int, tuple[int, int]] = {}
        self.emptied: dict[int, int] = {}

    def lend(self, begin: int, size: int) -> _Piece:
        """Lend the first bytes of an idle part, or of all."""
        end, since = self.idle.pop(begin, (0, 0))
        if end > begin + size:
            self.idle[begin + size] = end, since
        memory = np.frombuffer(self.memory, np.uint8)[begin : begin + size]
        return _Piece(self, begin, begin + size, memory)

    def take_back(self, begin: int, end: int, age: int) -> None:
        """Join a part that came back to those beside it."""
        for other, (stop, since) in list(self.idle.items()):
            if stop == begin or other == end:
                del self.idle[other]
                begin, end, age = min(begin, other), max(end, stop), max(age, since)
        self.idle[begin] = end, age

    def empty(self, begin: int) -> int:
        """Give the pages of an idle part back to the system; return its bytes."""
        end, _ = self.idle.pop(begin)
        self.emptied[begin] = end
        if hasattr(self.memory, "madvise"):
            self.memory.madvise(mmap.MADV_DONTNEED, begin, end - begin)
        return end - begin

    @property
    def is_gone(self) -> bool:
        """Whether all of it went back to the system."""
        return len(self.memory) == sum(end - begin for begin, end in self.emptied.items())


class _Idle(NamedTuple):
    """A part of a block that nobody holds: bytes from `begin` on, and the age when it came back."""

    block: _Block
    begin: int
    size: int
    since: int


class _Store:
    """All memory that came from the system, lent or idle.

    Attributes
    ----------
    returned
        What nobody holds any more. Its methods need no lock, which finalizers must not wait for.
    blocks
        All of it.
    waits
        Bytes that may wait for somebody while others are taken from the system.
    """

    def __init__(self) -> None:
        self.returned: deque[_Piece] = deque()
        self.blocks: list[_Block] = []
        self.waits = 0
        self._age = 0
        self._lock = threading.Lock()

    @property
    def idle(self) -> list[int]:
        """Bytes of each part that nobody holds."""
        with self._lock:
            self._drain()
            return [part.size for part in self._parts()]

    def take(self, size: int, filed: bool) -> _Piece:
        """Take the smallest idle part that has so many bytes, or memory from the system.

        As much is given back then as is taken, of what waited longest, down to what may wait.
        """
        size = -(-size // mmap.PAGESIZE) * mmap.PAGESIZE
        with self._lock:
            self._drain()
            best = self._fitting(size, filed)
            if best is not None:
                return best.block.lend(best.begin, size)
            self._make_room(min(size, sum(one.size for one in self._parts()) - self.waits))
            block = _Block(size, filed)
            self.blocks.append(block)
            return block.lend(0, size)

    def let_go(self) -> None:
        """Give back what came back before the last call of this, and nobody wanted since."""
        with self._lock:
            self._drain()
            self._age += 1
            for one in self._parts():
                if one.since < self._age - 1:
                    one.block.empty(one.begin)
            self._drop()

    def forget(self) -> None:
        """Give back whatever nobody holds."""
        with self._lock:
            self._drain()
            for one in self._parts():
                one.block.empty(one.begin)
            self._drop()

    def _drain(self) -> None:
        while self.returned:
            piece = self.returned.popleft()
            piece.block.take_back(piece.begin, piece.end, self._age)

    def _fitting(self, size: int, filed: bool) -> _Idle | None:
        """Return the smallest idle part that has so many bytes, of those the last that came back.

        By plain comparisons: tuples of all parts took twice as long, and frames take fifty arrays.
        """
        found, least, latest = None, 0, 0
        for block in self.blocks:
            if block.filed != filed or len(block.memory) < size:
                continue
            for begin, (end, since) in block.idle.items():
                spare = end - begin
                if spare < size or (found and (spare, -since) >= (least, -latest)):
                    continue
                found, least, latest = (block, begin), spare, since
        return None if found is None else _Idle(*found, least, latest)

    def _parts(self) -> list[_Idle]:
        """Return all that nobody holds."""
        return [
            _Idle(block, begin, end - begin, since)
            for block in self.blocks
            for begin, (end, since) in block.idle.items()
        ]

    def _make_room(self, size: int) -> None:
        """Give so many bytes back, of those parts first that waited longest."""
        for one in sorted(self._parts(), key=lambda one: one.since):
            if size <= 0:
                break
            size -= one.block.empty(one.begin)
        self._drop()

    def _drop(self) -> None:
        """Let blocks go that went back to the system."""
        self.blocks = [block for block in self.blocks if not block.is_gone]


def _room(size: int) -> mmap.mmap | None:
    """Map a new file, where there can be one and there is room for it."""
    if hasattr(mmap, "MADV_DONTNEED") and hasattr(os, "posix_fallocate"):
        with suppress(OSError), tempfile.TemporaryFile(prefix="exwarp-") as file:
            os.posix_fallocate(file.fileno(), 0, size)  # a full disk is met here, and not later
            room = mmap.mmap(file.fileno(), size)
            with _adding:
                _rooms.add(room)
            return room
    return None


def _anonymous(size: int) -> mmap.mmap:
    """Take memory from the system, which goes back as a whole, and not into the allocator's heap.

    Raises
    ------
    MemoryError
        When there is not enough.
    """
    try:
        pages = mmap.mmap(-1, size, **_PRIVATE)
    except OSError as error:
        raise MemoryError(f"{size} bytes") from error
    if hasattr(mmap, "MADV_HUGEPAGE"):
        with suppress(OSError):  # the system has none
            pages.madvise(mmap.MADV_HUGEPAGE)
    return pages


_store = _Store()


def let_wait(size: int) -> None:
    """Have so many bytes wait for whom they fit, where others take memory from the system.

    Without, a run takes no more than it has in use at its peak.
    """
    _store.waits = size


def let_go() -> None:
    """Give back to the system what came back before the last call of this, and nobody wanted since.

    Called once for every interval, it keeps what the next one wants.
    """
    _store.let_go()


def forget() -> None:
    """Give back to the system whatever came back: what follows is of other sizes."""
    _store.forget()
