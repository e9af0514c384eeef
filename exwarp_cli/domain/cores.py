"""How many cores a command uses, and who of its threads may work on them.

Reading ahead, making frames and writing behind have threads of their own, as many as it takes to
keep all cores busy. Where a command is given fewer than there are, nothing else would hold these
threads back: with one core, three worked at a time. So each takes a core for what it computes, and
gives it back while it waits for others or for a disk.

A kernel's threads count as the one that started them, and so do OpenImageIO's. Another process,
such as ffmpeg, works beside: the thread that feeds it keeps the core until it has taken a frame.

Whatever the number, threads that make a frame each keep a core busy, and what is read and staged
beside them is shared out among the cores that are left.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from threading import Condition, get_ident, local


class Cores:
    """Cores that are handed out, so many at a time.

    Parameters
    ----------
    count
        How many; None where the machine's own number is bound enough.
    """

    def __init__(self, count: int | None) -> None:
        self.count, self._free = count, count or 0
        self._changed = Condition()
        self._own = local()

    @contextmanager
    def taken(self, many: int = 1) -> Iterator[None]:
        """Have this thread own cores in the block, or as many as there are; waits for them.

        A thread that has some already keeps to these.
        """
        if self.count is None or self._owned:
            yield
            return
        self._take(min(many, self.count))
        try:
            yield
        finally:
            self._give()

    @contextmanager
    def given_back(self) -> Iterator[None]:
        """Have others work with this thread's cores, if it owns any, while it waits in the block.

        The thread must hold no lock that these may want: they could wait for each other.
        """
        many = self._owned
        if not many:
            yield
            return
        self._give()
        try:
            yield
        finally:
            self._take(many)

    @property
    def _owned(self) -> int:
        """How many this thread owns."""
        return int(getattr(self._own, "many", 0))

    def _take(self, many: int) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self._free >= many)
            self._own.many = many
            self._free -= many

    def _give(self) -> None:
        with self._changed:
            self._free += self._owned
            self._changed.notify_all()
            self._own.many = 0


_count: int | None = None
_cores = Cores(None)
_making: set[int] = set()
"""Threads that make a frame each; adding and removing one needs no lock."""


def share(count: int | None, usable: int) -> None:
    """Say how many cores this process uses from now on.

    Parameters
    ----------
    count
        As the user asked; None for all.
    usable
        How many there are for it.
    """
    global _count, _cores
    _count = count or usable
    bound = _count if _count < usable else None
    if bound != _cores.count:  # or else what is taken holds
        _cores = Cores(bound)


def count() -> int:
    """Return how many cores this process uses, and so how many threads a library may have."""
    return _count or os.cpu_count() or 1


def left() -> int:
    """Return how many cores no thread keeps busy that makes a frame, at least 1.

    For what goes on beside them. On two cores with two such threads, reading and features on two
    threads more took 3 % more processor time: each time that another thread gets a core, it fills
    the cache anew.
    """
    return max(1, count() - len(_making))


@contextmanager
def making() -> Iterator[None]:
    """Return a block in which this thread makes a frame, and keeps a core busy."""
    _making.add(get_ident())
    try:
        yield
    finally:
        _making.discard(get_ident())


def working(many: int = 1) -> AbstractContextManager[None]:
    """Return a block in which this thread works: it waits for cores first."""
    return _cores.taken(many)


def waiting() -> AbstractContextManager[None]:
    """Return a block in which this thread waits, and others may have its cores."""
    return _cores.given_back()
