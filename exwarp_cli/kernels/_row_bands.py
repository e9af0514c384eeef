"""Row bands: each thread runs a kernel over some of its iterations, mostly rows.

The threads are Python's, as kernels run without its lock. One build serves any number of threads,
and any kernels may run at once. numba's own parallel loops took two thirds more compilation time,
and its threads end the process when two kernels run at once without OpenMP or TBB.
"""

from __future__ import annotations

import functools
import itertools
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from threading import local
from typing import Any

import numba
import numpy as np

Band = tuple[int, int]  # number of the band, and how many bands there are

ALL: Band = (0, 1)

# Bands of a kernel on several threads, at least. Rows of sky take less time than others, and a
# thread that wakes starts late: with one band a thread, two cores took a tenth more time for the
# inputs of a network.
MIN_BANDS = 8

# Values of arrays that one thread works on: waking another one takes as long.
SMALL = 2**15

_own = local()


def band_range(count: int, band: Band) -> range:
    """Return a band's part of `count` iterations: consecutive, sizes differ by at most one."""
    number, bands = band
    return range(count * number // bands, count * (number + 1) // bands)


def run_bands(kernel: Callable[..., None], arguments: Sequence[Any], threads: int) -> None:
    """Run a kernel, which takes a band as its last argument, on several threads.

    The caller is one of them. With one thread, or for small arrays, the kernel runs once, over
    everything. An exception of the kernel is raised when no thread works on the arguments any more.
    """
    groups = (value if isinstance(value, tuple) else (value,) for value in arguments)
    sizes = [each.size for each in itertools.chain(*groups) if isinstance(each, np.ndarray)]
    if threads == 1 or max(sizes, default=SMALL) < SMALL:
        kernel(*arguments, ALL)
        return
    bands = max(threads, MIN_BANDS)
    remaining = iter(range(bands))  # shared: each thread that asks gets another number
    helpers: list[Future[None]] = []
    try:
        for _ in range(1, threads):
            helpers.append(_pool().submit(_run_remaining, kernel, arguments, remaining, bands))
        _run_remaining(kernel, arguments, remaining, bands)
    finally:
        _wait_for([helper for helper in helpers if not helper.cancel()])
    for helper in helpers:
        if not helper.cancelled():
            helper.result()


def _run_remaining(
    kernel: Callable[..., None], arguments: Sequence[Any], remaining: Iterator[int], bands: int
) -> None:
    try:
        for number in remaining:
            kernel(*arguments, (number, bands))
    finally:
        for _ in remaining:  # after a failure no thread starts another band
            pass


def _wait_for(started: Sequence[Future[None]]) -> None:
    try:
        wait(started)
    except BaseException:  # not even an interrupt leaves threads at work
        _wait_for(started)
        raise


def set_threads(count: int | None) -> None:
    """Set how many threads run the kernels that this thread calls; None for all threads."""
    _own.count = count


def threads() -> int:
    """Return how many threads run the kernels that this thread calls."""
    most = int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
    count: int | None = getattr(_own, "count", None)
    return most if count is None else max(1, min(count, most))


@functools.cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(os.cpu_count(), "kernel")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # a child has no threads
