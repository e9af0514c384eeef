"""The slots of an interval made at once, each by a share of the threads."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Generic, TypeVar

from exwarp_cli.domain.cores import making, waiting, working
from exwarp_cli.kernels import _row_bands
from exwarp_cli.pipeline.schedule import awaited

S = TypeVar("S", bound=Hashable)
T = TypeVar("T")


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
        """Whether there are threads for it."""
        return self._workers > 1

    def begin(self, make: Callable[[S], T], slots: Iterable[S]) -> Begun[S, T]:
        """Begin to make slots, in their order, as many at once as there are threads for."""
        if self._pool is None:
            start = partial(
                _row_bands.set_threads, self._share
            )  # holds for the thread that calls it
            self._pool = ThreadPoolExecutor(self._workers, "exwarp-slot", start)
        pool, share = self._pool, self._share
        return Begun({slot: pool.submit(_made, make, slot, share) for slot in slots})


def _made(make: Callable[[S], T], slot: S, share: int) -> T:
    """Make a slot, on cores that are not left for others meanwhile."""
    with working(share), making():
        return make(slot)


class Begun(Generic[S, T]):
    """Slots under way, or waiting for a thread."""

    def __init__(self, under_way: dict[S, Future[T]]) -> None:
        self._under_way = under_way

    def take(self, slot: S) -> T:
        """Wait for a slot, which is handed out once; raises what making it raised."""
        return awaited(self._under_way.pop(slot))
