"""The cores that this process uses, and which of its threads may work on them.

Threads that read ahead, render frames and write behind are as many as keep all cores busy. Where a
command may use fewer cores than there are, each thread takes a core for what it computes, and
releases it while it waits for other threads or for a disk. With one core, three threads worked at a
time without that.

A kernel's threads count as the one that started them, and so do OpenImageIO's. ffmpeg is another
process: the thread that feeds it keeps its core until ffmpeg has taken a frame.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from threading import Condition, local


class Cores:
    """A number of cores, None for no limit, which threads hold while they work."""

    def __init__(self, count: int | None) -> None:
        self.count, self._free = count, count or 0
        self._changed = Condition()
        self._thread = local()

    @contextmanager
    def hold(self, count: int = 1) -> Iterator[None]:
        """Wait for so many cores, or all there are, and hold them in the block.

        A thread that holds some already keeps to these.
        """
        if self.count is None or self._held:
            yield
            return
        self._keep(min(count, self.count))
        try:
            yield
        finally:
            self._keep(0)

    @contextmanager
    def release(self) -> Iterator[None]:
        """Let other threads work on this thread's cores, if it holds any, within the block.

        The thread must hold no lock that these may want: they could wait for each other.
        """
        count = self._held
        if not count:
            yield
            return
        self._keep(0)
        try:
            yield
        finally:
            self._keep(count)

    @property
    def _held(self) -> int:
        return int(getattr(self._thread, "held", 0))

    def _keep(self, count: int) -> None:
        """Wait for so many cores and hold them, or give all back for 0."""
        with self._changed:
            self._changed.wait_for(lambda: self._free >= count)
            self._free += self._held - count
            self._thread.held = count
            if not count:
                self._changed.notify_all()


_count: int | None = None
_cores = Cores(None)


def set_count(count: int | None, usable: int) -> None:
    """Set how many cores this process uses: `count`, or all `usable` ones for None."""
    global _count, _cores
    _count = count or usable
    limit = _count if _count < usable else None
    if limit != _cores.count:  # else what threads hold stays valid
        _cores = Cores(limit)


def count() -> int:
    """Return how many cores this process uses, and so how many threads a library may have."""
    return _count or os.cpu_count() or 1


def hold_cores(count: int = 1) -> AbstractContextManager[None]:
    """Return a block in which this thread works; it waits for cores first."""
    return _cores.hold(count)


def release_cores() -> AbstractContextManager[None]:
    """Return a block in which this thread waits, and other threads may have its cores."""
    return _cores.release()
