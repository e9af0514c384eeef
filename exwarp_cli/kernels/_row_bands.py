"""Kernels shared out among threads: each thread runs the whole kernel, over some of its turns.

The threads are Python's, as kernels run without its lock. One build serves any number of threads,
and any kernels may run at once. numba's own parallel loops took two thirds more compilation time,
and its threads end the process when two kernels run at once without OpenMP or TBB.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from threading import local
from typing import Any

import numba

Share = tuple[int, int]

WHOLE: Share = (0, 1)
"""The number of a share of turns, and how many shares there are: here one of one."""

LEAST_SHARES = 8
"""Shares of a kernel that several threads run, if there are no more threads. Rows of sky take less
time than others, and a thread that wakes starts late: with a share for each, two cores took a tenth
more time for the inputs of a network."""

_own = local()


def turns(count: int, share: Share) -> range:
    """Return the turns of a share: neighbours, as many as others have, or one more.

    Parameters
    ----------
    count
        How many there are in all.
    share
        Its number, from 0 on, and how many shares there are.
    """
    number, shares = share
    return range(count * number // shares, count * (number + 1) // shares)


def rows_of(count: int, share: Share) -> slice:
    """Return the turns of a share as a slice, where numpy takes them at once; see `turns`."""
    some = turns(count, share)
    return slice(some.start, some.stop)


def run(kernel: Callable[..., None], arguments: Sequence[Any], threads: int) -> None:
    """Run a kernel in shares, which threads take as they come; the caller is one of them.

    Parameters
    ----------
    kernel
        Takes a share as its last argument.
    arguments
        All others.
    threads
        How many may work at once. One takes the whole kernel.

    Raises
    ------
    Exception
        What the kernel raises. No thread works on the arguments any more then.
    """
    if threads == 1:
        kernel(*arguments, WHOLE)
        return
    shares = max(threads, LEAST_SHARES)
    left = iter(range(shares))  # of which each thread that asks gets another number
    others: list[Future[None]] = []
    try:
        for _ in range(1, threads):
            others.append(_pool().submit(_take, kernel, arguments, left, shares))
        _take(kernel, arguments, left, shares)
    finally:
        _end([other for other in others if not other.cancel()])
    for other in others:
        if not other.cancelled():
            other.result()


def _take(
    kernel: Callable[..., None], arguments: Sequence[Any], left: Iterator[int], shares: int
) -> None:
    """Take shares while any are left; where one fails, no thread takes another."""
    try:
        for number in left:
            kernel(*arguments, (number, shares))
    finally:
        for _ in left:
            pass


def _end(begun: Sequence[Future[None]]) -> None:
    """Wait until nothing is under way, even if interrupted."""
    try:
        wait(begun)
    except BaseException:
        _end(begun)
        raise


def set_threads(count: int | Callable[[], int] | None) -> None:
    """Set how many threads run a kernel that this thread calls.

    Parameters
    ----------
    count
        A number; a function that returns it at each call; None for all threads.
    """
    _own.count = count


def threads() -> int:
    """Return how many threads run a kernel that this thread calls, 1 to the most that may."""
    most = int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
    count: int | Callable[[], int] | None = getattr(_own, "count", None)
    if callable(count):
        count = count()
    return most if count is None else max(1, min(count, most))


@functools.cache
def _pool() -> ThreadPoolExecutor:
    """Return the threads that help; they sleep while there is nothing to do."""
    return ThreadPoolExecutor(os.cpu_count(), "kernel")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # threads are not there in a child
