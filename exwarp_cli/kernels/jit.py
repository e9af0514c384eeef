"""How kernels are compiled: one text, a serial and a parallel build, both cached.

`fastmath` stays off: NaN marks pixels without a value, and results must not depend on the build.
`nogil` lets files be read and written meanwhile. Signatures stay lazy, as an eagerly typed parallel
kernel costs 0.35 s at import.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba

Kernel = Callable[..., Any]


def parallel(text: Kernel) -> Kernel:
    """Compile for all threads; loops over `numba.prange` are shared out."""
    compiled: Kernel = numba.njit(text, parallel=True, cache=True, nogil=True, error_model="numpy")
    return compiled


def serial(text: Kernel) -> Kernel:
    """Compile for one thread."""
    compiled: Kernel = numba.njit(text, cache=True, nogil=True, error_model="numpy")
    return compiled
