"""Reading ahead and writing behind, bounded, so that memory does not grow with the sequence."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from exwarp_cli.errors import InputError

T = TypeVar("T")


def read_ahead(tasks: Iterable[Callable[[], T]], depth: int) -> Iterator[T]:
    """Run tasks on one thread, in order, at most `depth` ahead of the consumer.

    An error of a task is raised where its result is due.
    """
    waiting: deque[Future[T]] = deque()
    with ThreadPoolExecutor(1, thread_name_prefix="exwarp-read") as pool:
        try:
            for task in tasks:
                waiting.append(pool.submit(task))
                if len(waiting) > depth:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


class WriteBehind:
    """Runs writes on their own threads, at most `depth` behind; a context manager.

    The first error stops everything: it is raised by the next call of `submit`, or at the end.
    Where it is the input that cannot be used further on, what waits is still written.
    """

    def __init__(self, threads: int, depth: int) -> None:
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="exwarp-write")
        self._depth = depth
        self._waiting: deque[Future[None]] = deque()

    def __enter__(self) -> WriteBehind:
        return self

    def submit(self, write: Callable[[], None]) -> None:
        """Queue a write; blocks while `depth` writes are under way."""
        while len(self._waiting) >= self._depth:
            self._waiting.popleft().result()
        self._waiting.append(self._pool.submit(write))

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        if kind is not None and not issubclass(kind, InputError):
            for future in self._waiting:
                future.cancel()
        # What has begun is finished either way: a write is quick and leaves whole files.
        self._pool.shutdown(wait=True)
        if kind is None:
            for future in self._waiting:
                future.result()
