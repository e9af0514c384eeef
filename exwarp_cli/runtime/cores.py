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
from contextlib import contextmanager
from threading import Condition, local

_count: int | None = None
_limit: int | None = None  # cores that threads hold while they work; None where all may work
_free = 0  # of these
_changed = Condition()


class _Thread(local):
    held = 0  # cores that a thread holds


_thread = _Thread()


def set_count(count: int | None, usable: int) -> None:
    """Set how many cores this process uses: `count`, or all `usable` ones for None."""
    global _count, _limit, _free, _thread
    _count = count or usable
    limit = _count if _count < usable else None
    if limit != _limit:  # else what threads hold stays valid
        with _changed:
            _limit, _free, _thread = limit, limit or 0, _Thread()
            _changed.notify_all()


def count() -> int:
    """Return how many cores this process uses, and so how many threads a library may have."""
    return _count or os.cpu_count() or 1


@contextmanager
def hold_cores(count: int = 1) -> Iterator[None]:
    """Wait for so many cores, or all there are, and let this thread work on them in the block.

    A thread that holds some already keeps to these.
    """
    if needs_cores := _limit is not None and not _thread.held:
        _keep(count)
    try:
        yield
    finally:
        if needs_cores:
            _keep(0)


@contextmanager
def release_cores() -> Iterator[None]:
    """Let other threads work on this thread's cores, if it holds any, while it waits in the block.

    The thread must hold no lock that these may want: they could wait for each other.
    """
    if count := _thread.held:
        _keep(0)
    try:
        yield
    finally:
        if count:
            _keep(count)


def _keep(count: int) -> None:
    """Wait for so many cores, or all there are, and hold them; give all back for 0."""
    global _free
    with _changed:
        _changed.wait_for(lambda: _free >= min(count, _limit or 0))
        kept = min(count, _limit or 0)  # after `set_count` there may be fewer
        _free += _thread.held - kept
        _thread.held = kept
        if not kept:
            _changed.notify_all()
