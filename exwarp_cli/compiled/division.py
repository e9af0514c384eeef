"""Quotients and rests of whole numbers, rounded down, in few instructions and without branches.

Numba asks whether the divisor is zero, whether the quotient has a place in its bits, and whether it
has to be rounded, and goes another way each time.
"""

# mypy: disable-error-code="no-untyped-call"

from __future__ import annotations

import functools
import operator
from typing import Any

from numba.core import types
from numba.cpython import numbers
from numba.extending import lower_builtin

from exwarp_cli.compiled.folding import known

# As numba has no types of its own.
_numbers: Any = numbers
_quotient: Any = _numbers.int_floordiv_impl
_rest: Any = _numbers.int_rem_impl


def shorten() -> None:
    """Have them written so from now on."""
    lower: Any = lower_builtin
    kinds = types.Integer, types.Integer
    for function in (operator.floordiv, operator.ifloordiv):
        lower(function, *kinds)(functools.partial(_divide, 0, _quotient))
    for function in (operator.mod, operator.imod):
        lower(function, *kinds)(functools.partial(_divide, 1, _rest))


def _divide(
    which: int, usual: Any, context: Any, builder: Any, signature: Any, arguments: Any
) -> Any:
    """Return the quotient (0) or the rest (1) as numpy has it: nothing where there is none."""
    kind: Any = signature.return_type
    by_zero_fails = context.error_model.raise_on_fp_zero_division
    if by_zero_fails or kind not in types.signed_domain:
        return usual(context, builder, signature, arguments)
    number, by = (
        context.cast(builder, value, given, kind)
        for value, given in zip(arguments, signature.args, strict=True)
    )
    divisor = known(by)
    if divisor is None or divisor <= 0:
        return _by_any(builder, kind, number, by)[which]
    if divisor & (divisor - 1) == 0:
        if which:
            return builder.and_(number, by.type(divisor - 1))
        return builder.ashr(number, by.type(divisor.bit_length() - 1))
    return _rounded(builder, number, by)[which]


def _by_any(builder: Any, kind: Any, number: Any, by: Any) -> tuple[Any, Any]:
    """Divide by what may be zero, or make more of the least number than has a place."""
    nothing, one = by.type(0), by.type(1)
    least = builder.icmp_signed("==", number, by.type(kind.minval))
    too_much = builder.and_(least, builder.icmp_signed("==", by, by.type(-1)))
    in_vain = builder.or_(builder.icmp_signed("==", by, nothing), too_much)
    found = _rounded(builder, number, builder.select(in_vain, one, by))
    quotient, rest = (builder.select(in_vain, nothing, value) for value in found)
    return quotient, rest


def _rounded(builder: Any, number: Any, by: Any) -> tuple[Any, Any]:
    """Return quotient and rest, rounded down: the rest has the sign of the divisor."""
    nothing = by.type(0)
    quotient, rest = builder.sdiv(number, by), builder.srem(number, by)
    other_sign = builder.icmp_signed("<", builder.xor(rest, by), nothing)
    apart = builder.and_(builder.icmp_signed("!=", rest, nothing), other_sign)
    less = builder.sub(quotient, builder.zext(apart, by.type))
    return less, builder.add(rest, builder.select(apart, by, nothing))
