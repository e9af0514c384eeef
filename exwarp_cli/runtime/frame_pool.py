"""A free list of buffers for the arrays of frames, and scratch files for large ones.

Memory that is fresh from the system is cleared and mapped page by page at its first use. For
frames of 1920x1080 that was a quarter of the processor time. Later frames have arrays of the same
sizes, so a buffer that is free serves the next array of its size.
"""

from __future__ import annotations

import mmap
import os
import tempfile
import threading
import weakref
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field, fields, is_dataclass, replace
from math import inf, prod
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

MIN_BYTES = 1 << 20  # arrays below this size are left to numpy
MAX_FREE_BYTES = 256 << 20  # of free buffers in a pool: about those of a slot at 1920x1080

# Pixels of a frame above which its arrays lie in scratch files where a network extrapolates. Of
# 3840x2160, what a slot is made from takes 5 GB.
LARGE_PIXELS = 4 * 2**20

T = TypeVar("T")


@dataclass(eq=False)
class FramePool:
    """A free list of buffers. Every method may be called in any thread.

    Above `max_free` bytes of free buffers, those that are free for longest are dropped.
    """

    # To drop after each key interval what it did not use saves no memory: at 1920x1080 the peak was
    # 1311 MB with it and 1337 without with softsplat, 1526 and 1471 with s6.

    max_free: int = MAX_FREE_BYTES
    _free: list[mmap.mmap] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    # A finalizer may run while its thread has the lock, so it only appends; that needs none.
    _returned: deque[mmap.mmap] = field(default_factory=deque)

    def empty(self, shape: tuple[int, ...], dtype: npt.DTypeLike) -> np.ndarray:
        """Return a C-contiguous array of arbitrary values.

        Its buffer is free again when the array and all its views are gone.

        Raises MemoryError if the system has too little memory.
        """
        dtype = np.dtype(dtype)
        size = prod(shape) * dtype.itemsize
        if size < MIN_BYTES:
            return np.empty(shape, dtype)
        with self._lock:
            self._collect()
            # The one that was used last
            buffer = next((free for free in reversed(self._free) if len(free) == size), None)
            if buffer is not None:
                self._free.remove(buffer)
        if buffer is None:  # map memory, which returns to the system when the buffer is dropped
            # Pages that other processes do not share, as always on Windows: only these can be huge.
            is_unix = hasattr(mmap, "MAP_PRIVATE")
            private = {"flags": mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS} if is_unix else {}
            try:
                buffer = mmap.mmap(-1, size, **private)
            except OSError as error:
                raise MemoryError(f"{size} bytes") from error
            if hasattr(mmap, "MADV_HUGEPAGE"):
                with suppress(OSError):  # the system has none
                    buffer.madvise(mmap.MADV_HUGEPAGE)
        lease = np.frombuffer(buffer, dtype)  # the base of the array and of all its views
        weakref.finalize(lease, self._returned.append, buffer).atexit = False
        return lease.reshape(shape)

    def copy(self, array: np.ndarray) -> np.ndarray:
        """Return a C-contiguous copy of an array."""
        out = self.empty(array.shape, array.dtype)
        out[...] = array
        return out

    def clear(self) -> None:
        """Drop all free buffers; call before something else needs much memory."""
        with self._lock:
            self._collect()
            self._free.clear()

    def _collect(self) -> None:
        """Take over the returned buffers, and drop the oldest above the limit."""
        while self._returned:
            self._free.append(self._returned.popleft())
        excess = sum(map(len, self._free)) - self.max_free
        while excess > 0 and self._free:
            excess -= len(self._free.pop(0))


pool = FramePool()


@dataclass(eq=False)
class ScratchFrames:
    """Copies of large arrays in files without a name, which leave memory until they are used.

    The system removes a file when its last array is gone, or the process ends. The files lie in the
    system's folder for temporary files. Arrays [H, W, ...] with more than `min_pixels` are stored;
    the default stores none.
    """

    min_pixels: float = inf
    _mapped: weakref.WeakSet[mmap.mmap] = field(default_factory=weakref.WeakSet)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def store(self, value: T) -> T:
        """Return an array, or a tuple or dataclass of such, with every large array in a file.

        Arrays stay in memory where the disk has no room, or the system lacks a call.
        """
        before: Any = value
        after: Any = value
        if isinstance(before, np.ndarray):
            after = self._store_array(before)
        elif type(before) is tuple:
            items = tuple(map(self.store, before))
            if any(new is not old for new, old in zip(items, before, strict=True)):
                after = items
        elif is_dataclass(before) and not isinstance(before, type):
            parts = {f.name: self.store(getattr(before, f.name)) for f in fields(before) if f.init}
            if any(part is not getattr(before, name) for name, part in parts.items()):
                after = replace(before, **parts)
        stored: T = after
        return stored

    def page_out(self) -> None:
        """Remove all stored arrays from the process's memory; it reads again what it uses."""
        with self._lock:
            files = list(self._mapped)
        for file in files:
            file.madvise(mmap.MADV_DONTNEED)

    def _store_array(self, array: np.ndarray) -> np.ndarray:
        base: object = array
        while isinstance(base, np.ndarray):
            base = base.base
        with self._lock:
            is_stored = isinstance(base, mmap.mmap) and base in self._mapped
        can_store = hasattr(mmap, "MADV_DONTNEED") and hasattr(os, "posix_fallocate")
        if is_stored or not can_store or prod(array.shape[:2]) <= self.min_pixels:
            return array
        try:
            with tempfile.TemporaryFile(prefix="exwarp-") as unnamed:
                # Else a full disk would end the process.
                os.posix_fallocate(unnamed.fileno(), 0, array.nbytes)
                file = mmap.mmap(unnamed.fileno(), array.nbytes)
        except OSError:  # the disk has no room
            return array
        out = np.ndarray(array.shape, array.dtype, buffer=file)
        self.page_out()  # else rarely used arrays count at every peak
        out[...] = array
        file.madvise(mmap.MADV_DONTNEED)
        with self._lock:
            self._mapped.add(file)
        return out


IN_MEMORY = ScratchFrames()  # stores nothing
