"""Kernels from the cache, without what compiling them would take.

Before it looks into a kernel's cache, numba makes ready to compile: it imports two hundred modules,
scipy.linalg among them, and registers every function that a kernel might call. That is 0.3 s of a
start in which nothing is compiled; machine code from the cache needs numba's memory functions only.
Whatever has to be compiled after all makes ready for itself.
"""

from __future__ import annotations

from typing import Any

from numba.core.caching import Cache
from numba.core.runtime.nrt import rtsys


def _load(cache: Any, signature: Any, target: Any) -> Any:
    """Load a kernel as `Cache.load_overload` does, without refreshing the target."""
    rtsys.initialize(target)
    with cache._guard_against_spurious_io_errors():
        return cache._load_overload(signature, target)


def load_lightly() -> None:
    """Have numba load kernels from their caches without making ready to compile, from now on."""
    if hasattr(Cache, "_load_overload") and hasattr(Cache, "_guard_against_spurious_io_errors"):
        Cache.load_overload = _load  # type: ignore[method-assign]
