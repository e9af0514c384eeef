"""How kernels are compiled: one text, a serial and a parallel build, both cached."""

from __future__ import annotations

import os
import types
from collections.abc import Iterator
from contextlib import contextmanager

import numba

from exwarp_cli.compiled import builds
from exwarp_cli.compiled.builds import Kernel

WAITING = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT")
"""Variables by which OpenMP is told how its threads wait for work."""


def parallel(text: Kernel) -> Kernel:
    """Compile for all threads; the turns of its loop are shared out.

    Parameters
    ----------
    text
        Takes a share as its last argument, all by default, and runs through the
        :func:`~exwarp_cli.compiled.shares.turns` that it has.
    """
    return builds.shared(text)


def serial(text: Kernel) -> Kernel:
    """Compile for one thread, from a twin that has a name of its own."""
    assert isinstance(text, types.FunctionType)
    name = f"{text.__name__}_serial"
    twin = types.FunctionType(
        text.__code__, text.__globals__, name, text.__defaults__, text.__closure__
    )
    twin.__doc__, twin.__module__ = text.__doc__, text.__module__
    twin.__qualname__ = f"{text.__qualname__}_serial"
    return builds.compiled(twin)


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


def set_threads(count: int | None) -> None:
    """Set how many threads the parallel builds use; None for all that there are."""
    most: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
    with _asleep_while_waiting():
        numba.set_num_threads(most if count is None else max(1, min(count, most)))


def threads() -> int:
    """Return how many threads the parallel builds use."""
    with _asleep_while_waiting():
        return int(numba.get_num_threads())


def may_run_at_once() -> bool:
    """Whether several threads may run parallel builds at the same time, once one has run.

    Numba's own pool of threads, which it takes where there is neither OpenMP nor TBB, ends the
    process then.
    """
    try:
        layer: str = numba.threading_layer()  # type: ignore[attr-defined]
    except ValueError:  # none has run
        return False
    return layer in ("omp", "tbb")


@contextmanager
def _asleep_while_waiting() -> Iterator[None]:
    """Have the threads that start in this block sleep when they wait for a kernel.

    OpenMP reads its environment as its library is loaded, which the first call that concerns
    threads does. By default its threads spin for a while after each kernel, on the cores that read
    and write files meanwhile: 3 of 21 CPU seconds of a run.
    """
    if any(name in os.environ for name in WAITING):
        yield
        return
    os.environ[WAITING[0]] = "PASSIVE"
    try:
        yield
    finally:
        del os.environ[WAITING[0]]
