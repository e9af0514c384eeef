"""Kernels shared out among threads: each runs the whole kernel, and takes some of its turns.

The threads are Python's, as kernels run without its lock. A build for one thread serves any number
of them, and any kernels may run at once. Numba's own loops for threads are compiled twice, between
six passes and two wrappers, which took two thirds more time; and its threads, where neither OpenMP
nor TBB is there, end the process when two kernels run at once.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any

from exwarp_cli.compiled.builds import part

Share = tuple[int, int]

WHOLE: Share = (0, 1)
"""Which share of its turns a thread takes, and of how many: here all of them."""


@part
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


def run(kernel: Callable[..., None], arguments: Sequence[Any], shares: int) -> None:
    """Run a kernel in shares, a thread each; the caller takes those that nobody else comes to.

    Parameters
    ----------
    kernel
        Takes a share as its last argument.
    arguments
        All others.
    shares
        How many there are.

    Raises
    ------
    Exception
        What the kernel raises. No thread works on the arguments any more then.
    """
    if shares == 1:
        kernel(*arguments, WHOLE)
        return
    others: list[Future[None]] = []
    try:
        for number in range(1, shares):
            others.append(_pool().submit(kernel, *arguments, (number, shares)))
        kernel(*arguments, (0, shares))
        for number, other in enumerate(others, 1):
            if other.cancel():
                kernel(*arguments, (number, shares))
    finally:
        _end([other for other in others if not other.cancel()])
    for other in others:
        if not other.cancelled():
            other.result()


def _end(begun: Sequence[Future[None]]) -> None:
    """Wait until nothing is under way, whoever interrupts."""
    try:
        wait(begun)
    except BaseException:
        _end(begun)
        raise


@functools.cache
def _pool() -> ThreadPoolExecutor:
    """Return the threads that help; they sleep while there is nothing to do."""
    return ThreadPoolExecutor(os.cpu_count(), "kernel")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # threads are not there in a child
