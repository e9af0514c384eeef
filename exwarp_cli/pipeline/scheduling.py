"""Threads of a run: intervals read ahead, slots rendered in parallel, files written behind.

Everything is bounded, so that memory does not grow with the sequence.

`use_threads` passes the number of cores of this process on to the libraries that start threads.
onnxruntime's sessions, ffmpeg and this package's own thread pools take the number from
`runtime.cores` at each use. OpenCV always has one thread. numpy starts BLAS as it is imported, so
`exwarp_cli.cli` limits BLAS.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from typing import TYPE_CHECKING, TypeVar

import OpenImageIO as oiio

from exwarp_cli.errors import InputError
from exwarp_cli.kernels import _row_bands
from exwarp_cli.runtime import cores
from exwarp_cli.runtime.cores import hold_cores, release_cores
from exwarp_cli.runtime.machine import processors

if TYPE_CHECKING:
    from exwarp_cli.pipeline.interval_builder import PreparedInterval
    from exwarp_cli.synthesis.methods import Method

S = TypeVar("S")
T = TypeVar("T")

# Pixels of a frame up to which anything is done ahead: of 3840x2160 a key frame with its geometry
# takes 430 MB, and decoding keeps all cores busy by itself.
MAX_PIXELS_AHEAD = 4 * 2**20


def use_threads(count: int | None) -> None:
    """Set how many cores this process uses: at least 1, or None for all that it may use."""
    cores.set_count(count, processors().usable)
    oiio.attribute("threads", cores.count())
    oiio.attribute("exr_threads", cores.count())
    # Each thread has to call it: the kernels of a new thread use all cores.
    _row_bands.set_threads(cores.count())


def fits_pool(
    prepared: PreparedInterval, method: Method, pixels: int, has_layers: bool, workers: int
) -> bool:
    """Return True if the slots of an interval are rendered several at a time, in a pool.

    Each is rendered by a share of the threads then, which write the file as well. Otherwise all
    threads together render one after the other, and files are written behind.

    `pixels` is of a frame: in a pool several slots are in memory at a time. `has_layers` says
    whether more than the beauty is written: layers of a slot are made in order. `workers` are the
    threads of the pool.
    """
    # A kernel that all threads share waits for the last of them, whose core may be reading or
    # writing: of two cores, 1.6 were busy. Networks use all threads by themselves.
    interval = prepared.interval
    fits = workers > 1 and pixels <= MAX_PIXELS_AHEAD and not has_layers
    # Optical flow takes as much memory as all the rest of a slot.
    only_warps = not (prepared.extrapolates or method.interpolates or method.finds_flow)
    # Slots with G-buffers are led along those before.
    independent = interval is not None and not interval.slots
    return fits and only_warps and independent


def read_depth(pixels: int) -> int:
    """Return how many intervals are read ahead of the one that is rendered."""
    return 1 if pixels <= MAX_PIXELS_AHEAD else 0


@contextmanager
def record_time(timing_ms: dict[S, float], step: S, count: int = 1) -> Iterator[None]:
    """Add the milliseconds that the block takes to a step, as the share of each of `count`."""
    begin = time.perf_counter()
    yield
    elapsed = 1e3 * (time.perf_counter() - begin)
    timing_ms[step] = timing_ms.get(step, 0.0) + elapsed / max(count, 1)


def wait_result(future: Future[T]) -> T:
    """Return what another thread makes; it may work on this thread's cores until then."""
    with release_cores():
        return future.result()


def run_with_core(task: Callable[[], T], count: int = 1) -> T:
    """Run a task while it holds `count` cores."""
    with hold_cores(count):
        return task()


def prefetch(tasks: Iterable[Callable[[], T]], depth: int) -> Iterator[T]:
    """Run tasks on one thread, in order, at most `depth` ahead of the consumer.

    An error of a task is raised where its result is due.
    """
    ahead: deque[Future[T]] = deque()
    pool = ThreadPoolExecutor(1, "exwarp-read", _row_bands.set_threads, (cores.count(),))
    try:
        for task in tasks:
            ahead.append(pool.submit(run_with_core, task))
            if len(ahead) > depth:
                yield wait_result(ahead.popleft())
        while ahead:
            yield wait_result(ahead.popleft())
    finally:
        with release_cores():
            pool.shutdown(wait=True, cancel_futures=True)


class ParallelSlots(AbstractContextManager["ParallelSlots"]):
    """Renders the slots of intervals, in a pool or in line; a context manager.

    `threads` is how many there are in all, `slots` the most slots that an interval has.
    """

    def __init__(self, threads: int, slots: int) -> None:
        self.workers = max(1, min(threads, slots))
        self._share = max(1, threads // self.workers)
        set_share = _row_bands.set_threads, (self._share,)
        self._pool = ThreadPoolExecutor(self.workers, "exwarp-slot", *set_share)

    def __exit__(self, *exc: object) -> None:
        with release_cores():
            self._pool.shutdown(wait=True, cancel_futures=True)

    def render(self, render: Callable[[S], T], slots: Iterable[S], in_pool: bool) -> Iterator[T]:
        """Yield what `render` returns for each slot, in their order.

        An error of a slot is raised where its result is due.
        """
        if not in_pool:
            yield from map(render, slots)
            return
        tasks = (partial(render, slot) for slot in slots)
        pending = deque([self._pool.submit(run_with_core, task, self._share) for task in tasks])
        while pending:
            yield wait_result(pending.popleft())


class AsyncWriter(AbstractContextManager["AsyncWriter"]):
    """Runs writes on their own threads, at most `depth` behind; a context manager.

    The first error stops everything: it is raised by the next call of `submit`, or at the end.
    Where an input cannot be used further on, what waits is still written.
    """

    def __init__(self, threads: int, depth: int) -> None:
        limit = _row_bands.set_threads, (cores.count(),)
        self._pool = ThreadPoolExecutor(threads, "exwarp-write", *limit)
        self._depth = depth
        self._waiting: deque[Future[None]] = deque()

    def submit(self, write: Callable[[], None]) -> None:
        """Queue a write; blocks while `depth` writes are under way."""
        while len(self._waiting) >= self._depth:
            wait_result(self._waiting.popleft())
        self._waiting.append(self._pool.submit(run_with_core, write))

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        drops_waiting = kind is not None and not issubclass(kind, InputError)
        # What has begun is finished either way: a write is quick and leaves complete files.
        with release_cores():
            self._pool.shutdown(wait=True, cancel_futures=drops_waiting)
        if kind is None:
            for future in self._waiting:
                future.result()
