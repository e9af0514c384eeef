"""How kernels are compiled: one text, one build, cached, that one thread runs or several."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from threading import local

import numba

from exwarp_cli.compiled import builds, shares
from exwarp_cli.compiled.builds import Kernel
from exwarp_cli.compiled.shares import WHOLE

_own = local()


def parallel(text: Kernel) -> Kernel:
    """Compile for as many threads as :func:`threads` tells, which share the turns of its loop.

    Parameters
    ----------
    text
        Takes a share as its last argument, and runs through the
        :func:`~exwarp_cli.compiled.shares.turns` that it has.
    """
    kernel = build(text)

    @functools.wraps(text)
    def run(*arguments: object) -> None:
        shares.run(kernel, arguments, threads())

    return run


def serial(text: Kernel) -> Kernel:
    """Compile for one thread."""
    kernel = build(text)
    if "share" not in inspect.signature(text).parameters:
        return kernel

    @functools.wraps(text)
    def run(*arguments: object) -> None:
        kernel(*arguments, WHOLE)

    return run


@functools.cache
def build(text: Kernel) -> Kernel:
    """Return what Numba makes of a text, for any number of threads."""
    return builds.compiled(text)


def part(text: Kernel) -> Kernel:
    """Have a function compiled with the kernels that call it; Python calls it as it stands.

    As kernels of their own, which Python can call and the cache keeps, all parts took half the time
    of compilation once more.
    """
    return builds.part(text)


def inlined(text: Kernel) -> Kernel:
    """Have a part compiled into every place where a kernel calls it.

    Without force such functions stay calls: a gather took 3.2 times cv2.remap instead of 1.7.
    """
    return builds.part(text, forceinline=True)


def set_threads(count: int | Callable[[], int] | None) -> None:
    """Set how many threads run a kernel that this thread calls.

    Parameters
    ----------
    count
        How many; what tells it at each call, as it may change; None for all that there are.
    """
    _own.count = count


def threads() -> int:
    """Return how many threads run a kernel that this thread calls, 1 to all that there are."""
    count: int | Callable[[], int] | None = getattr(_own, "count", None)
    if callable(count):
        count = count()
    return _most() if count is None else max(1, min(count, _most()))


def _most() -> int:
    """Return how many there may be, as Numba tells it: by its variable, or as many as cores."""
    return int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
