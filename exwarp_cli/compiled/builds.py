"""How functions are compiled: lazily, and once for all runs and processes that share a folder.

Signatures stay lazy, as an eagerly typed parallel kernel costs 0.35 s at import.
"""

from __future__ import annotations

import types
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numba
from numba.core import dispatcher
from numba.extending import register_jitable

Kernel = Callable[..., Any]

KNOWN_INSIDE = ("0.68",)
"""Versions of numba whose insides are known. What saves time by them, more than half of that of
compilation and 0.3 s of a start, is left out with others, whose own cache keeps the kernels then.
"""

COMMON: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
"""How everything is compiled. `nogil` lets files be read and written meanwhile. `fastmath` stays
off: NaN marks pixels without a value, and results must not depend on the build. C does not call
kernels, so that they need no entry for it."""

MAKERS = frozenset({"empty", "zeros", "ones", "full", "ascontiguousarray", "copy", "astype"})
"""Names of functions that make arrays."""


def compiled(text: Kernel) -> Kernel:
    """Compile on the first call, and keep the result on disk where that is possible."""
    assert isinstance(text, types.FunctionType)
    options = {**COMMON, **(_counting(text) if _returns_nothing(text) else {})}
    built: Any = numba.njit(text, **options)
    if isinstance(built, dispatcher.Dispatcher):  # and not the text: NUMBA_DISABLE_JIT
        _keep(built, text, options)
    kernel: Kernel = built
    return kernel


def part(text: Kernel, **options: bool) -> Kernel:
    """Have a function compiled with the kernels that call it; Python calls it as it stands."""
    known: Kernel = register_jitable(**COMMON, **_counting(text), **options)(text)
    return known


def _counting(text: Kernel) -> dict[str, bool]:
    """Return the option by which arrays are counted, where some are made.

    Else they belong to the caller, and counting who has them was a quarter of all instructions.
    """
    return {"_nrt": not MAKERS.isdisjoint(text.__code__.co_names)}


def _returns_nothing(text: types.FunctionType) -> bool:
    """Whether a function only writes: what Python gets may be an array.

    As it is annotated; its instructions tell it too, in 15 ms for all kernels.
    """
    return text.__annotations__.get("return", "") in ("None", None)


def knows_inside() -> bool:
    """Whether numba is one of those whose insides are known."""
    return numba.__version__.rpartition(".")[0] in KNOWN_INSIDE


def _keep(built: Any, text: types.FunctionType, options: dict[str, Any]) -> None:
    """Have a function's builds kept on disk."""
    if knows_inside():
        from exwarp_cli.compiled.cache import KernelCache

        built._cache = KernelCache(text, options)
        return
    with suppress(RuntimeError):  # no folder can be written: compiled for every run
        built.enable_caching()


if knows_inside():
    from exwarp_cli.compiled import (
        bytecode,
        calls,
        division,
        folding,
        front_end,
        in_place,
        indexing,
        lookups,
        loops,
        machine_code,
        passes,
        structures,
        variables,
        writing,
    )

    front_end.shorten()
    lookups.shorten()
    bytecode.shorten()
    passes.shorten()
    structures.shorten()
    variables.shorten()
    calls.shorten()
    division.shorten()
    folding.shorten()
    indexing.shorten()
    loops.shorten()
    in_place.shorten()
    writing.shorten()
    machine_code.defer()
