"""Instructions on numbers that are known already, left out.

Numba multiplies by a step of one, adds to an offset of zero, and asks whether one is negative; LLVM
was handed these, and found out.
"""

# mypy: disable-error-code="no-untyped-call"

from __future__ import annotations

import functools
import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]

from exwarp_cli.compiled.front_end import wrap

COMPARISONS: dict[str, Callable[[int, int], bool]] = {
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


def shorten() -> None:
    """Leave them out from now on."""
    builder: Any = ir.IRBuilder
    wrap(builder, "add", functools.partial(_computing, operator.add, 0, True))
    wrap(builder, "sub", functools.partial(_computing, operator.sub, 0, False))
    wrap(builder, "mul", functools.partial(_computing, operator.mul, 1, True))
    wrap(builder, "icmp_signed", _comparing)
    wrap(builder, "select", _selecting)


def known(value: Any) -> int | None:
    """Return a whole number that a value always has, as signed; None where it is not known."""
    if type(value) is not ir.Constant or type(value.type) is not ir.IntType:
        return None
    number = value.constant
    if number is None:
        return 0
    return _signed(int(number), value.type.width) if isinstance(number, int) else None


def _signed(number: int, width: int) -> int:
    """Return what is left of a number in so many bits, of which the first is its sign."""
    half = 1 << (width - 1)
    return (number + half) % (2 * half) - half if width > 1 else number % 2


def _computing(
    compute: Callable[[int, int], int], nothing: int, either: bool, write: Callable[..., Any]
) -> Callable[..., Any]:
    """Compute at once what is known, and leave out what changes nothing.

    Parameters
    ----------
    compute
        What is computed of two numbers.
    nothing
        The second number that leaves the first as it is.
    either
        Whether the first does so as well.
    write
        Writes the instruction.
    """

    @functools.wraps(write)
    def computing(self: Any, left: Any, right: Any, *more: Any, **named: Any) -> Any:
        if left.type == right.type:
            first, second = known(left), known(right)
            if second == nothing:
                return left
            if either and first == nothing:
                return right
            if first is not None and second is not None:
                return ir.Constant(left.type, _signed(compute(first, second), left.type.width))
        return write(self, left, right, *more, **named)

    return computing


def _comparing(write: Callable[..., Any]) -> Callable[..., Any]:
    """Compare at once what is known."""

    @functools.wraps(write)
    def comparing(self: Any, how: str, left: Any, right: Any, *more: Any, **named: Any) -> Any:
        first, second = known(left), known(right)
        if first is None or second is None or left.type != right.type:
            return write(self, how, left, right, *more, **named)
        return ir.Constant(ir.IntType(1), int(COMPARISONS[how](first, second)))

    return comparing


def _selecting(write: Callable[..., Any]) -> Callable[..., Any]:
    """Choose at once where it is known."""

    @functools.wraps(write)
    def selecting(self: Any, which: Any, first: Any, other: Any, *more: Any, **named: Any) -> Any:
        chosen = known(which)
        if chosen is None or first.type != other.type:
            return write(self, which, first, other, *more, **named)
        return first if chosen else other

    return selecting
