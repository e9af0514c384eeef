"""Reading ahead and writing behind, bounded, so that memory does not grow with the sequence."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from exwarp_cli.domain.cores import waiting, working
from exwarp_cli.errors import InputError
from exwarp_cli.io.threads import for_kernels

T = TypeVar("T")


def read_ahead(tasks: Iterable[Callable[[], T]], depth: int) -> Iterator[T]:
    """Run tasks on one thread, in order, at most `depth` ahead of the consumer.

    An error of a task is raised where its result is due.
    """
    ahead: deque[Future[T]] = deque()
    pool = ThreadPoolExecutor(1, "exwarp-read", for_kernels)
    try:
        for task in tasks:
            ahead.append(pool.submit(worked, task))
            if len(ahead) > depth:
                yield awaited(ahead.popleft())
        while ahead:
            yield awaited(ahead.popleft())
    finally:
        with waiting():
            pool.shutdown(wait=True, cancel_futures=True)


def awaited(future: Future[T]) -> T:
    """Return what another thread makes; it may work on this one's cores until it is there."""
    with waiting():
        return future.result()


def worked(task: Callable[[], T]) -> T:
    """Do a task on a core."""
    with working():
        return task()


class WriteBehind:
    """Runs writes on their own threads, at most `depth` behind; a context manager.

    The first error stops everything: it is raised by the next call of `submit`, or at the end.
    Where it is the input that cannot be used further on, what waits is still written.
    """

    def __init__(self, threads: int, depth: int) -> None:
        self._pool = ThreadPoolExecutor(threads, "exwarp-write", for_kernels)
        self._depth = depth
        self._waiting: deque[Future[None]] = deque()

    def __enter__(self) -> WriteBehind:
        return self

    def submit(self, write: Callable[[], None]) -> None:
        """Queue a write; blocks while `depth` writes are under way."""
        while len(self._waiting) >= self._depth:
            awaited(self._waiting.popleft())
        self._waiting.append(self._pool.submit(worked, write))

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        drops_waiting = kind is not None and not issubclass(kind, InputError)
        # What has begun is finished either way: a write is quick and leaves whole files.
        with waiting():
            self._pool.shutdown(wait=True, cancel_futures=drops_waiting)
        if kind is None:
            for future in self._waiting:
                future.result()
