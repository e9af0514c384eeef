"""How kernels are compiled: one text, a serial and a parallel build, both cached.

`fastmath` stays off: NaN marks pixels without a value, and results must not depend on the build.
`nogil` lets files be read and written meanwhile. Signatures stay lazy, as an eagerly typed parallel
kernel costs 0.35 s at import.
"""

from __future__ import annotations

import os
import types
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numba
from numba.core import dispatcher
from numba.extending import register_jitable

Kernel = Callable[..., Any]

KNOWN_INSIDE = ("0.68",)
"""Versions of numba whose insides are known. What saves time by them, half of that of compilation
and 0.3 s of a start, is left out with others, whose own cache keeps the kernels then."""

WAITING = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT")
"""Variables by which OpenMP is told how its threads wait for work."""


def _compile(text: Kernel, **options: bool) -> Kernel:
    """Compile lazily, and keep the result on disk where that is possible."""
    assert isinstance(text, types.FunctionType)
    common: dict[str, Any] = {"nogil": True, "error_model": "numpy", **options}
    compiled: Any = numba.njit(text, **common)
    if isinstance(compiled, dispatcher.Dispatcher):  # and not the text: NUMBA_DISABLE_JIT
        _keep(compiled, text, common)
    kernel: Kernel = compiled
    return kernel


def knows_inside() -> bool:
    """Whether numba is one of those whose insides are known."""
    return numba.__version__.rpartition(".")[0] in KNOWN_INSIDE


def _keep(compiled: Any, text: types.FunctionType, options: dict[str, Any]) -> None:
    """Have a kernel's builds kept on disk."""
    if knows_inside():
        from exwarp_cli.kernels.cache import KernelCache

        compiled._cache = KernelCache(text, options)
        return
    with suppress(RuntimeError):  # no folder can be written: compiled for every run
        compiled.enable_caching()


def parallel(text: Kernel) -> Kernel:
    """Compile for all threads; loops over `numba.prange` are shared out."""
    return _compile(text, parallel=True)


def serial(text: Kernel) -> Kernel:
    """Compile for one thread, from a twin that has a name of its own."""
    assert isinstance(text, types.FunctionType)
    name = f"{text.__name__}_serial"
    twin = types.FunctionType(
        text.__code__, text.__globals__, name, text.__defaults__, text.__closure__
    )
    twin.__doc__, twin.__module__ = text.__doc__, text.__module__
    twin.__qualname__ = f"{text.__qualname__}_serial"
    return _compile(twin)


def part(text: Kernel) -> Kernel:
    """Have a function compiled with the kernels that call it; Python calls it as it stands.

    As kernels of their own, which Python can call and the cache keeps, all parts took half the time
    of compilation once more.
    """
    return _part(text)


def inlined(text: Kernel) -> Kernel:
    """Have a part compiled into every place where a kernel calls it.

    Without force such functions stay calls: a gather took 3.2 times cv2.remap instead of 1.7.
    """
    return _part(text, forceinline=True)


def _part(text: Kernel, **options: bool) -> Kernel:
    common = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True, **options}
    known: Kernel = register_jitable(**common)(text)
    return known


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


if knows_inside():
    from exwarp_cli.kernels import machine_code, warm_cache

    machine_code.defer()
    warm_cache.load_lightly()
