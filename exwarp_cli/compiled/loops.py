"""Loops over whole numbers, in few instructions where each is one more than that before.

Numba divides by the distance of the numbers to find out how many there are, and raises an error
where that is zero, and LLVM finds out that it is one.
"""

# mypy: disable-error-code="no-untyped-call"

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba.core.imputils import builtin_registry
from numba.cpython import rangeobj
from numba.extending import lower_builtin

from exwarp_cli.compiled.folding import known
from exwarp_cli.compiled.structures import Value, memory


def shorten() -> None:
    """Have loops written so from now on."""
    lower: Any = lower_builtin
    usual = {kinds: run for run, what, kinds in builtin_registry.functions if what == "getiter"}
    ranges: Any = rangeobj
    for number, (state, iterator) in ranges.range_impl_map.items():
        lower(range, number)(_range)
        lower(range, number, number)(_range)
        lower("getiter", state)(_beginning(usual[state,]))
        lower("iternext", iterator)(_next)


def _of(context: Any, builder: Any, kind: Any, value: Any = None) -> Any:
    """Return what takes a value of a type apart, or makes one."""
    made: Any = context.make_helper(builder, kind, value)
    assert isinstance(made, Value)
    return made


def _range(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Return a range in steps of one."""
    number = signature.args[0]
    made = _of(context, builder, signature.return_type)
    made.start = context.get_constant(number, 0) if len(arguments) == 1 else arguments[0]
    made.stop = arguments[-1]
    made.step = context.get_constant(number, 1)
    return made._getvalue()


def _beginning(usual: Callable[..., Any]) -> Callable[..., Any]:
    """Return where a loop over a range begins."""

    def beginning(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        through = _of(context, builder, signature.args[0], arguments[0])
        if known(through.step) != 1:
            return usual(context, builder, signature, arguments)
        place = memory(builder, through.start.type)
        builder.store(through.start, place)
        made = _of(context, builder, signature.return_type)
        made.iter = made.count = place  # how many are left is told by the end
        made.stop, made.step = through.stop, through.step
        return made._getvalue()

    return beginning


def _next(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Return the next number, and whether there is one."""
    kind = signature.args[0]
    at = _of(context, builder, kind, arguments[0])
    number, stop, step = builder.load(at.iter), at.stop, at.step
    compare = builder.icmp_signed if kind.yield_type.signed else builder.icmp_unsigned
    goes_on, following = compare("<", number, stop), builder.add(number, step)
    if known(step) != 1:  # as of a loop inside of another iterator, which keeps it in memory
        left = builder.load(at.count)
        one = builder.icmp_signed("==", step, step.type(1))
        goes_on = builder.select(one, goes_on, builder.icmp_signed(">", left, left.type(0)))
        fewer = builder.select(one, left, builder.sub(left, left.type(1)))
        builder.store(builder.select(goes_on, fewer, left), at.count)
        following = builder.select(goes_on, following, number)
    builder.store(following, at.iter)
    made = _of(context, builder, signature.return_type)
    made.first, made.second = number, goes_on
    return made._getvalue()
