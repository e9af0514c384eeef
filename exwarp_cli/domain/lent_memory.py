"""Memory for frames' arrays, which later frames get again when nobody holds them any more.

A frame of 1920x1080 with its geometry takes 100 MB. Fresh from the system, every page of it is
cleared and mapped at its first touch, a fifth of the time of reading it. The allocator's own heap
keeps such arrays too, but in pieces: of 590 MB that were in use it held 750.

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
from math import prod

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

_returned: deque[tuple[int, npt.NDArray[np.uint8]]] = deque()
"""What nobody holds any more, and since when. Its methods need no lock, which finalizers must not
wait for."""

_PRIVATE = {"flags": mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS} if hasattr(mmap, "MAP_PRIVATE") else {}
"""Not shared with other processes, as Windows' never is: shared pages are small ones."""

_age = 0
"""How often `let_go` was called."""


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
    memory = _taken(size)
    if memory is None:
        _make_room(size)
        memory = _fresh(size, filed=_lies_in_file(shape))
    loan = _Loan(memory, shape, kind)
    weakref.finalize(loan, _take_back, memory).atexit = False
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


def _fresh(size: int, filed: bool) -> npt.NDArray[np.uint8]:
    """Take memory from the system; from a file's only where it can be, and there is room.

    It goes back to the system as a whole, and not into the allocator's heap.
    """
    if filed and hasattr(mmap, "MADV_DONTNEED") and hasattr(os, "posix_fallocate"):
        with suppress(OSError), tempfile.TemporaryFile(prefix="exwarp-") as file:
            os.posix_fallocate(file.fileno(), 0, size)  # a full disk is met here, and not later
            room = mmap.mmap(file.fileno(), size)
            with _adding:
                _rooms.add(room)
            return np.frombuffer(room, np.uint8)
    try:
        pages = mmap.mmap(-1, size, **_PRIVATE)
    except OSError as error:
        raise MemoryError(f"{size} bytes") from error
    if hasattr(mmap, "MADV_HUGEPAGE"):
        with suppress(OSError):  # the system has none
            pages.madvise(mmap.MADV_HUGEPAGE)
    return np.frombuffer(pages, np.uint8)


def _make_room(size: int) -> None:
    """Give as much back to the system as will be taken from it, of what waited longest."""
    freed = 0
    while freed < size:
        try:
            _, memory = _returned.popleft()
        except IndexError:
            return
        freed += memory.size


def _take_back(memory: npt.NDArray[np.uint8]) -> None:
    _returned.append((_age, memory))


def let_go() -> None:
    """Give back to the system what came back before the last call of this, and nobody wanted since.

    Called once for every interval, it keeps what the next one wants.
    """
    global _age
    _age += 1
    for _ in range(len(_returned)):
        with suppress(IndexError):  # another thread took it
            since, memory = _returned.popleft()
            if since >= _age - 1:
                _returned.append((since, memory))


def forget() -> None:
    """Give back to the system whatever came back: what follows is of other sizes."""
    _returned.clear()


def _taken(size: int) -> npt.NDArray[np.uint8] | None:
    """Take memory of just this size, if any came back."""
    for _ in range(len(_returned)):
        try:
            since, memory = _returned.popleft()
        except IndexError:  # another thread took it
            return None
        if memory.size == size:
            return memory
        _returned.append((since, memory))
    return None
