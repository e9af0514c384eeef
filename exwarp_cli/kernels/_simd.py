"""An intrinsic that mixes four pixels by vector instructions; `mix_four` is its plain text.

The compiler's loops take several pixels at once, but never the channels of one: it unrolls such
short loops before it looks for vectors, and numba leaves LLVM's search in straight code out.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import types
from numba.extending import intrinsic, overload

F32 = npt.NDArray[np.float32]
I32 = npt.NDArray[np.int32]

INDEX = ir.IntType(32)

LANES = 4
"""Values of a pixel, and pixels, that are taken at once."""


def mix_four(
    pixels: F32, steps: tuple[int, int], places: I32, weights: F32, first: int, out: F32
) -> int:
    """Mix four pixels bilinearly, each from four neighbours of three or four values.

    Parameters
    ----------
    pixels
        float32 [N].
    steps
        How far a neighbour is from that left of it, which is how many values a pixel has, and from
        that above it.
    places
        int32 [w], where in `pixels` the upper left neighbours begin. LANES values are read there
        and from the other neighbours on.
    weights
        float32 [2 w], of the right and of the lower neighbours by turns. What has weight 0 is left
        out, even if it is not finite.
    first
        The first of the four among the `w`.
    out
        float32 [M], all pixels, of which four are written, and one value after them where they have
        three.

    Returns
    -------
    int
        LANES bits for each of the four, the first one's lowest: what is written for it and is not
        finite. The last of three values' is that of another pixel.
    """
    right, below = steps
    strange = 0
    for j in range(first, first + LANES):
        fx, fy = weights[2 * j], weights[2 * j + 1]
        rows = []
        for at in (places[j], places[j] + (0 if fy == 0 else below)):
            other = at + (0 if fx == 0 else right)
            left = pixels[at : at + LANES] * (np.float32(1) - fx)
            rows.append(left + pixels[other : other + LANES] * fx)
        value = rows[0] * (np.float32(1) - fy) + rows[1] * fy
        out[right * j : right * j + LANES] = value
        for k in range(LANES):
            strange |= int(not np.isfinite(value[k])) << (LANES * (j - first) + k)
    return strange


def data_of(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    """Return a pointer to the values of an array of a Numba type."""
    return context.make_array(kind)(context, builder, array).data


def _from(builder: Any, data: Any, index: Any, count: int = LANES) -> Any:
    """Return a pointer to a vector of so many values from an index on."""
    vector = ir.VectorType(data.type.pointee, count)
    return builder.bitcast(builder.gep(data, [index]), vector.as_pointer())


def _chosen(builder: Any, one: Any, other: Any, lanes: Iterable[int]) -> Any:
    """Return a vector of lanes of two others of one length, counted through both."""
    which = list(lanes)
    return builder.shuffle_vector(one, other, ir.Constant(ir.VectorType(INDEX, len(which)), which))


def _spread(builder: Any, vector: Any, lanes: Iterable[int]) -> Any:
    """Return a vector of some lanes of another, each LANES times."""
    return _chosen(builder, vector, vector, [lane for lane in lanes for _ in range(LANES)])


def _joined(builder: Any, vectors: Sequence[Any]) -> Any:
    """Return a vector of all lanes of others; how many those are is a power of two."""
    while len(vectors) > 1:
        lanes = range(2 * vectors[0].type.count)
        pairs = zip(vectors[::2], vectors[1::2], strict=True)
        vectors = [_chosen(builder, one, other, lanes) for one, other in pairs]
    return vectors[0]


def _mix(builder: Any, one: Any, other: Any, share: Any) -> Any:
    """Mix two vectors by the share of the other, which is left out where it has none."""
    whole, none = (ir.Constant(share.type, [value] * share.type.count) for value in (1.0, 0.0))
    other = builder.select(builder.fcmp_ordered("==", share, none), one, other)
    rest = builder.fsub(whole, share)
    return builder.fadd(builder.fmul(one, rest), builder.fmul(other, share))


@intrinsic
def _mix_four(
    _: Any, pixels: Any, right: Any, below: Any, places: Any, weights: Any, first: Any, out: Any
) -> Any:
    """The same in LLVM's instructions for vectors."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        start, places, weights, out = (
            data_of(context, builder, signature.args[k], values[k]) for k in (0, 3, 4, 6)
        )
        right, below, first = values[1], values[2], values[5]
        numbers = [builder.add(first, ir.Constant(first.type, k)) for k in range(LANES)]
        at = [builder.load(builder.gep(places, [number])) for number in numbers]
        at = [builder.sext(place, first.type) for place in at]
        shares = _from(builder, weights, builder.add(first, first), 2 * LANES)
        shares = builder.load(shares, align=4)
        fx, fy = (_spread(builder, shares, range(k, 2 * LANES, 2)) for k in (0, 1))

        def seen(begin: Any) -> Any:
            fours = [builder.load(_from(builder, begin, place), align=4) for place in at]
            return _joined(builder, fours)

        upper, lower = (
            _mix(builder, seen(begin), seen(builder.gep(begin, [right])), fx)
            for begin in (start, builder.gep(start, [below]))
        )
        value = _mix(builder, upper, lower, fy)
        for k, number in enumerate(numbers):
            four = _chosen(builder, value, value, range(LANES * k, LANES * (k + 1)))
            builder.store(four, _from(builder, out, builder.mul(number, right)), align=4)
        check = builder.fmul(value, ir.Constant(value.type, [0.0] * value.type.count))
        strange = builder.fcmp_unordered("uno", check, check)  # NaN from infinity and NaN on
        strange = builder.bitcast(strange, ir.IntType(value.type.count))
        return builder.zext(strange, ir.IntType(64))

    return types.int64(pixels, right, below, places, weights, first, out), generate


@overload(mix_four, strict=False)
def _compiled_mix_four(
    pixels: Any, steps: Any, places: Any, weights: Any, first: Any, out: Any
) -> Any:
    def mix(pixels, steps, places, weights, first, out):  # type: ignore[no-untyped-def]
        right, below = steps
        return _mix_four(pixels, right, below, places, weights, first, out)  # type: ignore[call-arg]

    return mix
