"""Half floats, rounded as IEEE 754 and numpy do: to the nearest, and to even between two.

Most processors round so by themselves, 16 numbers at once. Kernels are compiled for one processor,
and numba's cache tells processors apart, so each build takes what its own one has.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core.registry import cpu_target
from numba.extending import intrinsic, overload

from exwarp_cli.kernels._compile import inlined, serial

U16 = npt.NDArray[np.uint16]
U32 = npt.NDArray[np.uint32]

_ARM = ("aarch64", "arm64")


@inlined
def _rounded(bits: np.uint32, kept: np.uint32, dropped: np.uint32) -> np.uint32:
    """Return bits without the lowest ones, rounded; `kept` is the lowest that is not dropped."""
    half = (np.uint32(1) << (dropped - np.uint32(1))) - np.uint32(1)
    return np.uint32(np.uint32(bits + half + (kept & np.uint32(1))) >> dropped)


@inlined
def by_hand(bits: np.uint32) -> np.uint16:
    """Do what `nearest` does, on any processor."""
    size = bits & np.uint32(0x7FFFFFFF)
    sign = (bits >> np.uint32(16)) & np.uint32(0x8000)
    if size >= np.uint32(0x47800000):
        half = np.uint32(0x7C00)
    elif size >= np.uint32(0x38800000):
        lowered = np.uint32(size - np.uint32(0x38000000))
        half = _rounded(lowered, lowered >> np.uint32(13), np.uint32(13))
    else:  # below 2 ** -14 steps stay 2 ** -24
        drop = min(np.uint32(126) - (size >> np.uint32(23)), np.uint32(30))
        digits = size & np.uint32(0x7FFFFF) | np.uint32(0x800000)
        half = _rounded(digits, digits >> drop, drop)
        half = half if size >= np.uint32(0x33000000) else np.uint32(0)
    return np.uint16(half | sign)


def nearest(bits: np.uint32) -> np.uint16:
    """Return the half that is nearest to a float, of which the bits are given; it is no NaN."""
    return np.uint16(by_hand(bits))


@inlined
def nan(bits: np.uint32) -> np.uint16:
    """Return the half that keeps what fits of a NaN; instructions would make it a quiet one."""
    kept = (bits >> np.uint32(13)) & np.uint32(0x3FF)
    sign = (bits >> np.uint32(16)) & np.uint32(0x8000)
    return np.uint16(sign | np.uint32(0x7C00) | kept | np.uint32(kept == 0))


def rounds_itself(triple: str, features: str) -> bool:
    """Whether a processor, as LLVM calls it, has an instruction that rounds floats to halfs.

    Elsewhere LLVM calls a function for it, which numba has not.
    """
    return triple.startswith(_ARM) or "+f16c" in features.split(",")


@intrinsic
def _instruction(_context: Any, _bits: Any) -> Any:
    """Round by the processor's own instruction."""

    def generate(_target: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        single = builder.bitcast(arguments[0], ir.FloatType())
        return builder.bitcast(builder.fptrunc(single, ir.HalfType()), ir.IntType(16))

    return types.uint16(types.uint32), generate


@overload(nearest)
def _compiled(bits: Any) -> Any:
    """Return what `nearest` is compiled as; interpreted, it runs as it stands."""
    triple, _, features = cpu_target.target_context.codegen().magic_tuple()

    def instruction(bits: Any) -> Any:
        return _instruction(bits)  # type: ignore[call-arg]

    def text(bits: Any) -> Any:
        return by_hand(bits)

    return instruction if rounds_itself(triple, features) else text


@inlined
def round_row(row: U32, bounded: bool, out: U16) -> None:
    """Round floats [N], given as bits; see `to_halfs`."""
    most = np.uint32(0x477FE000) if bounded else np.uint32(0x7F800000)
    largest = np.uint32(0)
    for x in range(row.size):
        size = np.uint32(row[x] & np.uint32(0x7FFFFFFF))
        largest = max(largest, size)
        out[x] = nearest(np.uint32(min(size, most) | row[x] & np.uint32(0x80000000)))
    if largest > np.uint32(0x7F800000):
        for x in range(row.size):
            if row[x] & np.uint32(0x7FFFFFFF) > np.uint32(0x7F800000):
                out[x] = nan(row[x])


@serial
def to_halfs(pixels: U32, bounded: bool, out: U16) -> None:
    """Round single floats to half ones: in a tenth of the time that numpy takes.

    Rounding rows whole, and taking their channels apart after, takes half the time of rounding them
    one by one; and for the usual numbers of channels, a loop of their own a quarter of the time.

    Parameters
    ----------
    pixels
        Bits of floats [H, W C], contiguous.
    bounded
        Whether numbers beyond half's range, and infinity, become its largest; else infinity.
    out
        Bits of halfs [C, H, W], contiguous, written.
    """
    count, height, width = out.shape
    mixed = np.empty(count * width, np.uint16)
    for y in range(height):
        line = out[0, y] if count == 1 else mixed
        round_row(pixels[y], bounded, line)
        if count == 4:
            a, b, c, d = out[0, y], out[1, y], out[2, y], out[3, y]
            for x in range(width):
                a[x], b[x] = line[4 * x], line[4 * x + 1]
                c[x], d[x] = line[4 * x + 2], line[4 * x + 3]
        elif count == 3:
            a, b, c = out[0, y], out[1, y], out[2, y]
            for x in range(width):
                a[x], b[x], c[x] = line[3 * x], line[3 * x + 1], line[3 * x + 2]
        elif count > 1:
            for k in range(count):
                plane = out[k, y]
                for x in range(width):
                    plane[x] = line[count * x + k]
