"""What numba compiles as functions of their own, written where it is called.

The larger and smaller of numbers, whole ones and new arrays are functions written in Python, each
compiled anew for the types that it is given: 37 of the 210 functions that all kernels consisted of.
"""

# mypy: disable-error-code="no-untyped-call"

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from numba.core import types
from numba.core.typing.templates import signature
from numba.cpython import builtins
from numba.extending import lower_builtin
from numba.np import arrayobj

# As numba has no types of its own.
_extreme: Any = builtins.do_minmax
_signature: Any = signature
_plain: Any = types.unliteral
_arguments: Any = arrayobj._parse_empty_args
_array: Any = arrayobj._empty_nd_impl

COMPARED = {max: operator.gt, min: operator.lt}
"""How the number that is left compares with those before."""

WRITTEN = (max, min, int, np.empty)
"""Functions that are written where they are called."""


def shorten() -> None:
    """Have them written so from now on."""
    lower: Any = lower_builtin
    for function, comparison in COMPARED.items():
        lower(function, types.VarArg(types.Any))(_choosing(comparison))
    lower(int, types.Any)(_whole)
    lower(np.empty, types.Any, types.Any)(_empty)


def signature_of(context: Any, function: Any, arguments: Any) -> Any:
    """Return how a function is typed that is written where it is called; None for others."""
    given = tuple(_plain(kind) for kind in arguments)
    if function in COMPARED:
        if len(given) < 2 or not all(
            isinstance(kind, types.Integer | types.Float) for kind in given
        ):
            return None
        result = context.unify_types(*given)
    elif function is int:
        if len(given) != 1 or not isinstance(given[0], types.Integer | types.Float):
            return None
        result = given[0] if isinstance(given[0], types.Integer) else types.intp
    else:
        result = _kind_of_array(*given) if len(given) == 2 else None
    return None if result is None else _signature(result, *given)


def _kind_of_array(shape: Any, number: Any) -> Any:
    """Return the type of a new array; None where its shape or numbers need a closer look."""
    sizes = shape.types if isinstance(shape, types.UniTuple) else (shape,)
    if not isinstance(number, types.NumberClass):
        return None
    if not all(isinstance(size, types.Integer) for size in sizes):
        return None
    return types.Array(number.instance_type, len(sizes), "C")


def _choosing(comparison: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    """Return what writes a choice among numbers."""

    def choosing(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _extreme(context, builder, signature.args, arguments, comparison)

    return choosing


def _whole(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Write a number without its fraction."""
    return context.cast(builder, arguments[0], signature.args[0], signature.return_type)


def _empty(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Write a new array."""
    return _array(context, builder, *_arguments(context, builder, signature, arguments))._getvalue()
