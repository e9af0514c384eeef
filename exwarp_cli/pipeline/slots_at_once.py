"""The slots of an interval made at once, each by a share of the threads."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Generic, TypeVar

from exwarp_cli.domain.cores import waiting, working
from exwarp_cli.kernels import jit
from exwarp_cli.pipeline.schedule import awaited

T = TypeVar("T")

Timed = tuple[T, float]
"""What was made, and the milliseconds that it took."""


class SlotsAtOnce:
    """Makes several slots at once; a context manager.

    A kernel that all threads share waits at its end for the last of them, whose core may be reading
    or writing a file: of two cores, 1.6 were busy. Threads with a slot each wait for nobody.

    Parameters
    ----------
    threads
        How many there are in all.
    slots
        The most slots that an interval has.
    """

    def __init__(self, threads: int, slots: int) -> None:
        self._workers = max(1, min(threads, slots))
        self._share = max(1, threads // self._workers)
        self._pool: ThreadPoolExecutor | None = None

    def __enter__(self) -> SlotsAtOnce:
        return self

    def __exit__(self, *exc: object) -> None:
        if self._pool is not None:
            with waiting():
                self._pool.shutdown(wait=True, cancel_futures=True)

    @property
    def pays(self) -> bool:
        """Whether there are threads for it, and they may run kernels at once."""
        return self._workers > 1 and jit.may_run_at_once()

    def begin(self, make: Callable[[int], T], slots: Iterable[int]) -> Begun[T]:
        """Begin to make slots, given by index, as many at once as there are threads for."""
        if self._pool is None:
            start = partial(jit.set_threads, self._share)  # holds for the thread that calls it
            self._pool = ThreadPoolExecutor(self._workers, "exwarp-slot", start)
        pool = self._pool

        def work(slot: int) -> Timed[T]:
            with working(self._share):
                return timed(make, slot)

        return Begun(lambda slot: pool.submit(work, slot), slots, self._workers)


class Begun(Generic[T]):
    """Slots under way.

    Parameters
    ----------
    submit
        Has a slot made.
    slots
        Their indices, in the order in which they are taken.
    most
        How many may be under way, or made and not taken: frames are large.
    """

    def __init__(
        self, submit: Callable[[int], Future[Timed[T]]], slots: Iterable[int], most: int
    ) -> None:
        self._submit = submit
        self._later = deque(slots)
        self._under_way: dict[int, Future[Timed[T]]] = {}
        for _ in range(min(most, len(self._later))):
            self._next()

    def __contains__(self, slot: int) -> bool:
        return slot in self._under_way

    def take(self, slot: int) -> Timed[T]:
        """Wait for a slot that is under way; raises what making it raised."""
        made = awaited(self._under_way.pop(slot))
        if self._later:
            self._next()
        return made

    def _next(self) -> None:
        slot = self._later.popleft()
        self._under_way[slot] = self._submit(slot)


def timed(make: Callable[[int], T], slot: int) -> Timed[T]:
    """Make a slot, and time it."""
    begin = time.perf_counter()
    made = make(slot)
    return made, 1e3 * (time.perf_counter() - begin)
