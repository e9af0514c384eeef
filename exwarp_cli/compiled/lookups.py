"""What numba looks up again and again: how values are typed, kept and called.

It tries for each function whether it can be called like an object, finds by an exception that an
operator is no value, asks Python for the signature of all that writes code, and looks models up by
weak references.
"""

# mypy: disable-error-code="no-untyped-call"

from __future__ import annotations

import functools
from collections.abc import Callable
from types import BuiltinFunctionType, FunctionType
from typing import Any

from numba.core import base, types
from numba.core.lowering import Lower
from numba.core.registry import cpu_target
from numba.core.typing.context import BaseContext

from exwarp_cli.compiled.front_end import wrap

# As numba has no types of its own.
_Function: Any = types.functions.BaseFunction


def shorten() -> None:
    """Look up less from now on."""
    wrap(base, "_has_loc", _reading_names)
    wrap(BaseContext, "resolve_getattr", _calling_functions)
    wrap(BaseContext, "resolve_value_type", _knowing_functions)
    models: Any = cpu_target.target_context.data_model_manager
    models._cache = dict(models._cache)
    lower: Any = Lower
    lower._disable_sroa_like_opt = _computed_once(lower._disable_sroa_like_opt.fget)


def _reading_names(look: Callable[[Any], bool]) -> Callable[[Any], bool]:
    """Find whether a function takes a place in the source among the names of its arguments."""

    @functools.wraps(look)
    def reading(function: Any) -> bool:
        if type(function) is not FunctionType or hasattr(function, "__wrapped__"):
            return look(function)
        code = function.__code__
        return "loc" in code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]

    return reading


def _calling_functions(resolve: Callable[..., Any]) -> Callable[..., Any]:
    """Call functions as such, not as objects that may be called."""

    @functools.wraps(resolve)
    def resolving(self: Any, kind: Any, name: str) -> Any:
        if name == "__call__" and isinstance(kind, _Function):
            return None
        return resolve(self, kind, name)

    return resolving


def _knowing_functions(resolve: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """Look for functions among those that are known, before all that values may be."""

    @functools.wraps(resolve)
    def resolving(self: Any, value: Any) -> Any:
        if type(value) is BuiltinFunctionType or type(value) is FunctionType:
            found = self._lookup_global(value)
            if found is not None and not hasattr(value, "_numba_type_"):
                return found
        return resolve(self, value)

    return resolving


def _computed_once(compute: Callable[[Any], Any]) -> Any:
    """Return a property that is computed once for each object."""
    found: Any = functools.cached_property(compute)
    found.__set_name__(Lower, compute.__name__)
    return found
