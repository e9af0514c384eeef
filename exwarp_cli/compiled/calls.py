"""Calls of one compiled function by another, without what nobody asks for.

Numba computes after each call whether it succeeded, returned nothing, stopped, or failed in one of
three ways, and looks whether the caller catches exceptions. Most functions here cannot fail.
"""

# mypy: disable-error-code="no-untyped-call"

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from llvmlite.ir.instructions import Ret  # type: ignore[import-untyped]
from numba.core import base, callconv, cgutils, types
from numba.core.imputils import fix_returning_optional, impl_ret_new_ref
from numba.core.lowering import Lower

from exwarp_cli.compiled.front_end import wrap
from exwarp_cli.compiled.structures import memory
from exwarp_cli.compiled.variables import tries

FINE = (callconv.RETCODE_OK.constant, callconv.RETCODE_NONE.constant)
"""What functions return that succeed."""

_unfailing: set[str] = set()
"""Names of compiled functions that always succeed."""

# As numba has no types of its own.
_Convention: Any = callconv.CPUCallConv
_cleared_space: Any = cgutils.alloca_once
_unlikely: Any = cgutils.if_unlikely
_optional: Any = fix_returning_optional
_owned: Any = impl_ret_new_ref


def shorten() -> None:
    """Have functions called so from now on."""
    _Convention.call_function = _call
    wrap(_Convention, "return_status_propagate", _failing)
    wrap(_Convention, "check_try_status", _looking)
    contexts: Any = base
    contexts.user_function = _function
    wrap(Lower, "setup_function", _beginning)
    wrap(Lower, "lower_normal_function", _noting)


class Outcome:
    """How a call went, computed where somebody asks.

    Parameters
    ----------
    builder
        What makes the caller's code.
    code
        What the function returned.
    place
        Where it left what is known of an exception.
    """

    def __init__(self, builder: Any, code: Any, place: Any) -> None:
        self._builder, self.code, self._place = builder, code, place

    @property
    def is_ok(self) -> Any:
        """Whether it succeeded."""
        return self._builder.or_(self._is(callconv.RETCODE_OK), self.is_none)

    @property
    def is_error(self) -> Any:
        """Whether it failed."""
        return self._builder.not_(self.is_ok)

    @property
    def is_none(self) -> Any:
        """Whether it returned nothing where it might return something."""
        return self._is(callconv.RETCODE_NONE)

    @property
    def is_python_exc(self) -> Any:
        """Whether it failed with an exception that Python knows of."""
        return self._is(callconv.RETCODE_EXC)

    @property
    def is_stop_iteration(self) -> Any:
        """Whether there is nothing more."""
        return self._is(callconv.RETCODE_STOPIT)

    @property
    def is_user_exc(self) -> Any:
        """Whether it failed with an exception of its own."""
        return self._builder.icmp_signed(">=", self.code, callconv.RETCODE_USEREXC)

    @property
    def excinfoptr(self) -> Any:
        """What is known of that."""
        return self._builder.load(self._place)

    def _is(self, code: Any) -> Any:
        return self._builder.icmp_signed("==", self.code, code)


def _call(
    self: Any, builder: Any, callee: Any, result: Any, kinds: Any, given: Any, attrs: Any = ()
) -> tuple[Any, Any]:
    """Call a function; return how that went, and what it returned."""
    returned = self.get_return_type(result)
    kind = returned.pointee
    assert kind == self._get_return_argument(callee.function_type).pointee
    nothing = isinstance(result, types.NoneType)
    place = _nowhere(builder, kind) if nothing else memory(builder, kind)
    if getattr(builder, "catches", True):
        about = _cleared_space(builder, ir.PointerType(callconv.excinfo_t))
    else:  # it is the caller's own failure as well
        about = self._get_excinfo_argument(builder.function)
    arguments = list(self._get_arg_packer(kinds).as_arguments(builder, given))
    words = attrs.split() if isinstance(attrs, str) else attrs or ()
    code = builder.call(callee, [place, about, *arguments], attrs=tuple(words))
    found = ir.Constant(kind, None) if nothing else builder.load(place)
    return Outcome(builder, code, about), self.context.get_returned_value(builder, result, found)


def _nowhere(builder: Any, kind: Any) -> Any:
    """Return memory for what functions write that return nothing, one place for all of them."""
    caller = builder.function
    if not hasattr(caller, "nowhere"):
        caller.nowhere = memory(builder, kind)
    return caller.nowhere


def _function(description: Any, libraries: Any) -> Callable[..., Any]:
    """Return what makes the code by which a compiled function is called."""

    def calling(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        called = context.declare_function(builder.module, description)
        outcome, value = context.call_conv.call_function(
            builder, called, description.restype, description.argtypes, arguments
        )
        if description.mangled_name not in _unfailing:
            with _unlikely(builder, outcome.is_error):
                context.call_conv.return_status_propagate(builder, outcome)
        assert signature.return_type == description.restype
        value = _optional(context, builder, signature, outcome, value)
        assert value.type == context.get_value_type(signature.return_type)
        return _owned(context, builder, description.restype, value)

    made: Any = calling
    made.signature, made.libs = description.argtypes, tuple(libraries)
    return calling


def _beginning(begin: Callable[[Any, Any], None]) -> Callable[[Any, Any], None]:
    """Note whether a function catches exceptions."""

    def beginning(self: Any, description: Any) -> None:
        begin(self, description)
        self.builder.catches = tries(self.func_ir)

    return beginning


def _noting(write: Callable[[Any, Any], None]) -> Callable[[Any, Any], None]:
    """Note whether a function always succeeds."""

    def noting(self: Any, description: Any) -> None:
        write(self, description)
        ends = [block.terminator for block in self.function.blocks]
        codes = [end.operands[0] for end in ends if type(end) is Ret]
        if all(isinstance(code, ir.Constant) and code.constant in FINE for code in codes):
            _unfailing.add(description.mangled_name)

    return noting


def _failing(fail: Callable[..., None]) -> Callable[..., None]:
    """Fail as what was called did, at once where no exception is caught: it was told by then."""

    def failing(self: Any, builder: Any, outcome: Any) -> None:
        if getattr(builder, "catches", True):
            fail(self, builder, outcome)
            return
        self._return_errcode_raw(builder, outcome.code)

    return failing


def _looking(look: Callable[..., Any]) -> Callable[..., Any]:
    """Look whether an exception is to be caught only where some may be."""

    def looking(self: Any, builder: Any) -> Any:
        if getattr(builder, "catches", True):
            return look(self, builder)
        return callconv.TryStatus(in_try=cgutils.false_bit, excinfo=None)

    return looking
