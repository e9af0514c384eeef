"""What numba does before there is code for LLVM, without the work that is done again and again.

More than half of the time of compilation passes there, in Python.
"""

# mypy: disable-error-code="no-untyped-call"

from __future__ import annotations

import functools
import gc
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

from llvmlite import binding  # type: ignore[import-untyped]
from numba.core import types, utils
from numba.core.base import BaseContext
from numba.core.compiler import CompilerBase
from numba.core.ir import Expr, Inst, Loc, Var
from numba.core.registry import cpu_target
from numba.core.runtime.context import NRTContext
from numba.core.targetconfig import ConfigStack
from numba.core.typeinfer import ConstraintNetwork
from numba.core.types.functions import BaseFunction
from numba.core.typing.templates import _OverloadFunctionTemplate
from numba.np import linalg

from exwarp_cli.compiled.in_place import WRITTEN, signature_of

RARELY = 50_000
"""New objects after which Python looks for unreachable ones; at its 700 that is a tenth of all."""
NEVER = 1_000_000
"""Such searches after which it looks through what has been there for longer."""

PLAIN = frozenset({Loc, str, int, float, bool, type(None)})
"""Types of what stands in instructions and holds no variables."""


# As numba has no types of its own.
_Tuple: Any = types.BaseTuple


def wrap(owner: object, name: str, by: Callable[[Any], Any]) -> None:
    """Put something around a function of numba's from now on."""
    setattr(owner, name, by(getattr(owner, name)))


def shorten() -> None:
    """Spare numba what it repeats, from now on; what it makes stays the same."""
    wrap(CompilerBase, "_compile_core", _collecting_rarely)
    template: Any = _OverloadFunctionTemplate
    template._get_impl = _implementation
    for context in (cpu_target.target_context, cpu_target.typing_context):
        wrap(type(context), "load_additional_registries", _importing_once)
        wrap(type(context), "install_registry", _installing_once)
    wrap(Inst, "_rec_list_vars", _listing_plainly)
    wrap(utils, "order_by_target_specificity", _ordering_once)
    wrap(NRTContext, "_call_incref_decref", _counting_arrays)
    wrap(BaseFunction, "get_call_type", _typing_once)
    kinds: Any = type(types.Type)
    kinds.__instancecheck__ = type.__instancecheck__
    wrap(ConstraintNetwork, "propagate", _warning_once)
    wrap(BaseContext, "get_abi_sizeof", _measuring_once)
    # Numba tells who may listen of every call of LLVM, and nobody does.
    binding.ffi.lib._lock._cblist.clear()


def _collecting_rarely(compile_core: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Let Python look for unreachable objects rarely while something is compiled."""
    rarely = RARELY, NEVER, NEVER

    @functools.wraps(compile_core)
    def compiling(self: Any) -> Any:
        usual = gc.get_threshold()
        if usual[0] == 0 or usual[0] > RARELY or usual == rarely:
            return compile_core(self)  # switched off, or rarer, or inside another one
        gc.set_threshold(*rarely)
        try:
            return compile_core(self)
        finally:
            gc.set_threshold(*usual)

    return compiling


def _implementation(self: Any, args: Any, kws: Any) -> tuple[Any, Any]:
    """Return how a function is compiled for arguments, as numba does.

    Numba keeps one for all flags of the caller; it has these from the caller where it does not say
    them itself, and no others. So parts were compiled again for each kind of function around them.
    """
    stack: Any = ConfigStack
    flags = stack.top_or_none()
    own = self._jit_options
    inherited = flags and (
        own.get("_nrt", flags.nrt),
        str(own.get("fastmath", flags.fastmath)),
        own.get("error_model", flags.error_model),
        own.get("forceinline", flags.forceinline),
    )
    key = self.context, tuple(args), tuple(kws.items()), inherited
    found: tuple[Any, Any] | None = self._impl_cache.get(key)
    if found is None:
        # Nor does C call numba's own functions, which are compiled with an entry for it.
        self._jit_options = {**self._jit_options, "no_cfunc_wrapper": True}
        found = self._build_impl(key, args, kws)
    return found


def _importing_once(load: Callable[[Any], None]) -> Callable[[Any], None]:
    """Run a context's thirty imports once; look for new functions in its registries always."""
    loaded = set()

    @functools.wraps(load)
    def loading(self: Any) -> None:
        if self not in loaded:
            with _without_blas():
                load(self)
            loaded.add(self)
            return
        for registry in list(self._registries):
            self.install_registry(registry)

    return loading


@contextmanager
def _without_blas() -> Iterator[None]:
    """Let numba import its mathematics without scipy's, which it tries by importing it.

    Who multiplies matrices in a compiled function needs it, and is told then where there is none.
    """
    if "numba.np.arraymath" in sys.modules:
        yield
        return
    real, linalg.ensure_blas = linalg.ensure_blas, lambda: None
    try:
        yield
    finally:
        linalg.ensure_blas = real


def _installing_once(install: Callable[[Any, Any], None]) -> Callable[[Any, Any], None]:
    """Look through a registry only where it has grown."""
    sizes: dict[tuple[Any, Any], int] = {}

    @functools.wraps(install)
    def installing(self: Any, registry: Any) -> None:
        size = sum(len(items) for items in vars(registry).values() if type(items) is list)
        if sizes.get((self, registry)) != size:
            install(self, registry)
            sizes[self, registry] = size

    return installing


def _ordering_once(order: Callable[..., list[Any]]) -> Callable[..., list[Any]]:
    """Keep in which order what a function may be typed by is tried."""
    known: dict[tuple[Any, ...], list[Any]] = {}

    @functools.wraps(order)
    def ordering(target: Any, templates: list[Any], fnkey: Any = "") -> list[Any]:
        key = target, *templates
        if key not in known:
            known[key] = order(target, templates, fnkey)
        return known[key]

    return ordering


def _counting_arrays(count: Callable[..., None]) -> Callable[..., None]:
    """Count who has a value only where it holds memory: numba takes numbers and tuples apart."""

    @functools.wraps(count)
    def counting(self: Any, builder: Any, kind: Any, value: Any, name: str) -> None:
        if self._context.data_model_manager[kind].contains_nrt_meminfo():
            count(self, builder, kind, value, name)

    return counting


def _typing_once(find: Callable[..., Any]) -> Callable[..., Any]:
    """Keep how functions are typed that numba knows of itself, by numbers, arrays and tuples.

    It asks while types are inferred, again and again, and when code is made. Functions written in
    Python are asked for always: how they are compiled depends on who calls them.
    """
    known: dict[tuple[Any, ...], Any] = {}

    @functools.wraps(find)
    def finding(self: Any, context: Any, args: Any, kws: Any) -> Any:
        written = not kws and self.typing_key in WRITTEN
        if kws or not (written or all(_is_plain(kind) for kind in args)):
            return find(self, context, args, kws)
        key = context, self, tuple(args)
        found = known.get(key)
        if found is None and written:
            found = signature_of(context, self.typing_key, args)
            if found is not None:
                self._impl_keys[found.args] = self.typing_key
                known[key] = found
        if found is None:
            found = find(self, context, args, kws)
            if not written and self.get_impl_key(found) is self.typing_key:
                known[key] = found
        return found

    return finding


def _is_plain(kind: Any) -> bool:
    """Whether a type says all of a value, as those of numbers, arrays and tuples of them do."""
    if isinstance(kind, _Tuple):
        return all(_is_plain(one) for one in kind.types)
    return isinstance(kind, types.Number | types.Boolean | types.Array | types.SliceType)


def _measuring_once(measure: Callable[[Any, Any], int]) -> Callable[[Any, Any], int]:
    """Keep how large values are: LLVM tells for a text that has one of them."""
    known: dict[tuple[type, str], int] = {}

    @functools.wraps(measure)
    def measuring(self: Any, kind: Any) -> int:
        told = str(kind)
        if "%" in told:  # a name, which may stand for something else
            return measure(self, kind)
        key = type(self), told
        if key not in known:
            known[key] = measure(self, kind)
        return known[key]

    return measuring


def _listing_plainly(
    listing: Callable[[Any, Any], list[Var]],
) -> Callable[[Any, Any], list[Var]]:
    """List the variables of an instruction with fewer calls: numba makes two for each word."""

    @functools.wraps(listing)
    def variables(self: Any, value: Any) -> list[Var]:
        kind = type(value)
        if kind is Var:
            return [value]
        if kind is Expr:
            value = value._kws.values()
        elif kind is dict:
            value = value.values()
        elif kind is not list and kind is not tuple:
            return listing(self, value)
        found: list[Var] = []
        for one in value:
            kind = type(one)
            if kind is Var:
                found.append(one)
            elif kind not in PLAIN:
                found += variables(self, one)
        return found

    return variables


class _Silent:
    """What catches no warnings, as somebody around it does."""

    def catch_warnings(self, **_: Any) -> nullcontext[None]:
        return nullcontext()


def _warning_once(propagate: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """Catch warnings while types are inferred, not anew for each of their thousands of steps."""

    @functools.wraps(propagate)
    def propagating(self: Any, inference: Any) -> Any:
        catcher = inference.warnings
        with catcher.catch_warnings():
            inference.warnings = _Silent()
            try:
                return propagate(self, inference)
            finally:
                inference.warnings = catcher

    return propagating
