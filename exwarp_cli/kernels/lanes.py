"""Four neighbouring floats at once.

The compiler's loops take several pixels at once, but never the channels of one: it unrolls such
short loops before it looks for vectors, and Numba leaves LLVM's search in straight code out.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import types
from numba.extending import intrinsic, overload

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
U64 = np.uint64
At = tuple[U64, U64, U64]

LANES = 4


def mix_four(pixels: F32, at: At, fx: np.float32, fy: np.float32, out: F32, place: U64) -> int:
    """Mix four times four neighbours bilinearly.

    Parameters
    ----------
    pixels
        float32 [N].
    at
        Where in `pixels` the four upper left values begin, and how far the others are right of them
        and below.
    fx, fy
        Weights of the right and the lower neighbours.
    out
        float32 [M], written from `place` on.

    Returns
    -------
    int
        A bit for each of the values, the first one's is 1: whether it is finite.
    """
    first, right, below = (int(k) for k in at)
    gx, gy = np.float32(1) - fx, np.float32(1) - fy
    corners = (pixels[k : k + LANES] for k in (first, first + right))
    upper = next(corners) * gx + next(corners) * fx
    corners = (pixels[k : k + LANES] for k in (first + below, first + below + right))
    lower = next(corners) * gx + next(corners) * fx
    value = upper * gy + lower * fy
    out[int(place) : int(place) + LANES] = value
    return sum(1 << k for k in range(LANES) if np.isfinite(value[k]))


def add_four(weight: np.float64, pixels: F32, at: U64, sums: F64, place: U64) -> None:
    """Add four weighted values, float32 [N] from `at` on, to sums, float64 [M] from `place` on."""
    seen = pixels[int(at) : int(at) + LANES].astype(np.float64)
    sums[int(place) : int(place) + LANES] += weight * seen


def _spread(builder: Any, value: Any) -> Any:
    """Return a vector of one value."""
    vector = ir.Constant(ir.VectorType(value.type, LANES), ir.Undefined)
    for lane in range(LANES):
        vector = builder.insert_element(vector, value, ir.Constant(ir.IntType(32), lane))
    return vector


def _four(context: Any, builder: Any, kind: Any, array: Any, index: Any) -> Any:
    """Return a pointer to four elements of an array of a Numba type."""
    data = context.make_array(kind)(context, builder, array).data
    element = builder.gep(data, [index])
    return builder.bitcast(element, ir.VectorType(element.type.pointee, LANES).as_pointer())


@intrinsic
def _mix_four(
    _: Any, pixels: Any, first: Any, right: Any, below: Any, fx: Any, fy: Any, out: Any, place: Any
) -> Any:
    """The same in LLVM's instructions for vectors."""
    vector = ir.VectorType(ir.FloatType(), LANES)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        kinds = signature.args

        def load(index: Any) -> Any:
            return builder.load(_four(context, builder, kinds[0], values[0], index), align=4)

        def mix(one: Any, other: Any, share: Any, rest: Any) -> Any:
            return builder.fadd(builder.fmul(one, rest), builder.fmul(other, share))

        first, right, below, fx, fy = values[1:6]
        place = values[7]
        one, zero = (ir.Constant(vector, [value] * LANES) for value in (1.0, 0.0))
        fx, fy = _spread(builder, fx), _spread(builder, fy)
        gx, gy = builder.fsub(one, fx), builder.fsub(one, fy)
        beneath = builder.add(first, below)
        upper = mix(load(first), load(builder.add(first, right)), fx, gx)
        lower = mix(load(beneath), load(builder.add(beneath, right)), fx, gx)
        value = mix(upper, lower, fy, gy)
        builder.store(value, _four(context, builder, kinds[6], values[6], place), align=4)
        check = builder.fmul(value, zero)  # NaN from infinity and NaN on
        finite = builder.bitcast(builder.fcmp_ordered("ord", check, check), ir.IntType(LANES))
        return builder.zext(finite, ir.IntType(64))

    return types.int64(pixels, first, right, below, fx, fy, out, place), generate


@overload(mix_four, strict=False)
def _compiled_mix_four(pixels: Any, at: Any, fx: Any, fy: Any, out: Any, place: Any) -> Any:
    def mix(pixels, at, fx, fy, out, place):  # type: ignore[no-untyped-def]
        return _mix_four(pixels, at[0], at[1], at[2], fx, fy, out, place)  # type: ignore[call-arg]

    return mix


@intrinsic
def _add_four(_: Any, weight: Any, pixels: Any, at: Any, sums: Any, place: Any) -> Any:
    """The same in LLVM's instructions for vectors."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        kinds = signature.args
        seen = builder.load(_four(context, builder, kinds[1], values[1], values[2]), align=4)
        seen = builder.fpext(seen, ir.VectorType(ir.DoubleType(), LANES))
        target = _four(context, builder, kinds[3], values[3], values[4])
        added = builder.fmul(_spread(builder, values[0]), seen)
        builder.store(builder.fadd(builder.load(target, align=8), added), target, align=8)
        return context.get_dummy_value()

    return types.void(weight, pixels, at, sums, place), generate


@overload(add_four, strict=False)
def _compiled_add_four(weight: Any, pixels: Any, at: Any, sums: Any, place: Any) -> Any:
    def add(weight, pixels, at, sums, place):  # type: ignore[no-untyped-def]
        _add_four(weight, pixels, at, sums, place)  # type: ignore[call-arg]

    return add
