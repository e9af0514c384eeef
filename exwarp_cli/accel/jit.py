"""How the accelerator's kernels are compiled: lazily, cached, for one thread.

The kernels' own wrapper is not used, as the two packages stand side by side. `fastmath` has no
meaning for integers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba

Kernel = Callable[..., Any]


def compiled(text: Kernel) -> Kernel:
    """Compile on the first call; keep the result on disk where a folder for it can be written."""
    try:
        kernel: Kernel = numba.njit(text, cache=True, nogil=True)
    except RuntimeError:
        kernel = numba.njit(text, cache=False, nogil=True)
    return kernel


def inlined(text: Kernel) -> Kernel:
    """Compile for use inside another kernel's loops."""
    kernel: Kernel = numba.njit(text, nogil=True, forceinline=True)
    return kernel
