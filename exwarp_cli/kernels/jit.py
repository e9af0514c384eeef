"""How kernels are compiled: one text, a serial and a parallel build, both cached.

`fastmath` stays off: NaN marks pixels without a value, and results must not depend on the build.
`nogil` lets files be read and written meanwhile. Signatures stay lazy, as an eagerly typed parallel
kernel costs 0.35 s at import.
"""

from __future__ import annotations

import os
import types
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numba

Kernel = Callable[..., Any]

WAITING = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT")
"""Variables by which OpenMP is told how its threads wait for work."""


def _compile(text: Kernel, **options: bool) -> Kernel:
    """Compile lazily, and keep the result on disk where that is possible.

    Numba looks for a folder beside the source, then in the user's cache. On a machine where neither
    can be written (a read-only container without a home) kernels are compiled for every run.
    """
    common: dict[str, Any] = {"nogil": True, "error_model": "numpy", **options}
    try:
        compiled: Kernel = numba.njit(text, cache=True, **common)
    except RuntimeError:
        compiled = numba.njit(text, cache=False, **common)
    return compiled


def parallel(text: Kernel) -> Kernel:
    """Compile for all threads; loops over `numba.prange` are shared out."""
    return _compile(text, parallel=True)


def serial(text: Kernel) -> Kernel:
    """Compile for one thread.

    Numba's cache goes by a function's name and not by `parallel`, so the serial build is made from
    a twin of another name; else one build would be loaded for both.
    """
    assert isinstance(text, types.FunctionType)
    name = f"{text.__name__}_serial"
    twin = types.FunctionType(
        text.__code__, text.__globals__, name, text.__defaults__, text.__closure__
    )
    twin.__doc__, twin.__module__ = text.__doc__, text.__module__
    twin.__qualname__ = f"{text.__qualname__}_serial"
    return _compile(twin)


def inlined(text: Kernel) -> Kernel:
    """Compile for use at every pixel of another kernel.

    Without force such functions stay calls: a gather took 3.2 times cv2.remap instead of 1.7.
    """
    return _compile(text, forceinline=True)


def set_threads(count: int | None) -> None:
    """Set how many threads the parallel builds use; None for all that there are."""
    most: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
    with _asleep_while_waiting():
        numba.set_num_threads(most if count is None else max(1, min(count, most)))


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
