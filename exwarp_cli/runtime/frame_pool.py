"""A free list of buffers for the arrays of frames.

Memory that is fresh from the system is cleared and mapped page by page at its first use. For
frames of 1920x1080 that was a quarter of the processor time. Later frames have arrays of the same
sizes, so a buffer that is free serves the next array of its size.
"""

from __future__ import annotations

import threading
import weakref
from collections import defaultdict, deque
from math import prod
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

MIN_BYTES = 1 << 20
"""Arrays below this size are left to numpy."""

Buffer = npt.NDArray[np.uint8]


class _Lease:
    """The base of an array and of all its views: the buffer is free when this is collected."""

    def __init__(self, buffer: Buffer, shape: tuple[int, ...], dtype: np.dtype) -> None:
        interface = buffer.__array_interface__
        self.__array_interface__ = {
            "version": interface["version"],
            "data": interface["data"],
            "shape": shape,
            "typestr": dtype.str,
        }


class _Free(NamedTuple):
    """A free buffer, and the count of `trim` calls when it became free."""

    buffer: Buffer
    since: int


class FramePool:
    """Buffers of frame arrays by their size in bytes. Every method may be called in any thread."""

    def __init__(self) -> None:
        self._free: defaultdict[int, list[_Free]] = defaultdict(list)
        self._trims = 0
        self._lock = threading.Lock()
        # A finalizer may run while its thread has the lock, so it only appends; that needs none.
        self._returned: deque[Buffer] = deque()

    @property
    def free_bytes(self) -> int:
        """Bytes that no array uses."""
        with self._lock:
            self._collect()
            return sum(size * len(free) for size, free in self._free.items())

    def empty(self, shape: tuple[int, ...], dtype: npt.DTypeLike) -> np.ndarray:
        """Return a C-contiguous array of arbitrary values.

        Its buffer is free again when the array and all its views are gone.

        Raises
        ------
        MemoryError
            If the system has too little memory.
        """
        dtype = np.dtype(dtype)
        size = prod(shape) * dtype.itemsize
        if size < MIN_BYTES:
            return np.empty(shape, dtype)
        with self._lock:
            self._collect()
            free = self._free[size]
            buffer = free.pop().buffer if free else np.empty(size, np.uint8)
        lease = _Lease(buffer, shape, dtype)
        weakref.finalize(lease, self._returned.append, buffer).atexit = False
        return np.asarray(lease)

    def copy(self, array: np.ndarray) -> np.ndarray:
        """Return a C-contiguous copy of an array."""
        out = self.empty(array.shape, array.dtype)
        out[...] = array
        return out

    def trim(self) -> None:
        """Drop the buffers that are free since before the last call; call once per key interval."""
        with self._lock:
            self._collect()
            kept = {
                size: [one for one in free if one.since == self._trims]
                for size, free in self._free.items()
            }
            self._free = defaultdict(list, {size: free for size, free in kept.items() if free})
            self._trims += 1

    def clear(self) -> None:
        """Drop all free buffers; call where arrays of other sizes follow."""
        with self._lock:
            self._collect()
            self._free.clear()

    def _collect(self) -> None:
        """Take over what finalizers returned."""
        while self._returned:
            buffer = self._returned.popleft()
            self._free[buffer.nbytes].append(_Free(buffer, self._trims))


pool = FramePool()
"""The pool of this process."""
