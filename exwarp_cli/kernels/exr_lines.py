"""Scan lines as OpenEXR's compressions want them: bytes sorted so that they deflate well.

Both are filters that lose nothing but PXR24's last 8 bits of floats; see OpenEXR's ImfZip.cpp and
ImfPxr24Compressor.cpp, which read what is made here. One thread makes a frame: frames are written
side by side.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels.jit import inlined, serial

U8 = npt.NDArray[np.uint8]
U16 = npt.NDArray[np.uint16]
U32 = npt.NDArray[np.uint32]


@serial
def halves(lines: U8, chunk: int, out: U8) -> None:
    """Sort each chunk's even bytes before its odd ones, and take each byte's rise over the last.

    Parameters
    ----------
    lines
        Bytes [N] of all scan lines.
    chunk
        Bytes of a chunk, even; the last one may have fewer.
    out
        Bytes [N], written; rises are stored plus 128, a chunk's first byte as it is.
    """
    for start in range(0, lines.size, chunk):
        size = min(chunk, lines.size - start)
        half = size // 2
        here, low, high = lines[start : start + size], out[start:], out[start + half :]
        low[0] = here[0]
        high[0] = np.uint8(here[1] - here[size - 2] + 128)
        for i in range(1, half):
            low[i] = np.uint8(here[2 * i] - here[2 * i - 2] + 128)
        for i in range(1, half):
            high[i] = np.uint8(here[2 * i + 1] - here[2 * i - 1] + 128)


@inlined
def float24(bits: np.uint32) -> np.uint32:
    """Return a float's bits rounded to 24, as PXR24 does it; NaN and infinity stay what they are.

    Values that would round to infinity are cut instead.
    """
    sign, exponent = bits & np.uint32(0x80000000), bits & np.uint32(0x7F800000)
    fraction = bits & np.uint32(0x007FFFFF)
    cut = (exponent | fraction) >> np.uint32(8)
    if exponent == np.uint32(0x7F800000):
        lost = fraction != 0 and (fraction >> np.uint32(8)) == 0
        out = cut | np.uint32(1) if lost else cut
    else:
        out = ((exponent | fraction) + (fraction & np.uint32(0x80))) >> np.uint32(8)
        if out >= np.uint32(0x7F8000):
            out = cut
    return np.uint32(out | (sign >> np.uint32(8)))


@serial
def halfs24(plane: U16, out: U8) -> None:
    """Write the rises of half floats [H, W] along each row as two planes of bytes [H, 2 W]."""
    height, width = plane.shape
    for y in range(height):
        row, high, low = plane[y], out[y, :width], out[y, width:]
        high[0], low[0] = np.uint8(row[0] >> 8), np.uint8(row[0])
        for x in range(1, width):
            rise = np.uint16(row[x] - row[x - 1])
            high[x] = np.uint8(rise >> 8)
            low[x] = np.uint8(rise)


@serial
def floats24(plane: U32, out: U8) -> None:
    """Write the rises of 24-bit floats, given as bits [H, W], as three planes [H, 3 W]."""
    height, width = plane.shape
    for y in range(height):
        high, middle, low = out[y, :width], out[y, width : 2 * width], out[y, 2 * width :]
        for x in range(width):
            before = float24(plane[y, x - 1]) if x else np.uint32(0)
            rise = np.uint32(float24(plane[y, x]) - before)
            high[x] = np.uint8(rise >> np.uint32(16))
            middle[x] = np.uint8(rise >> np.uint32(8))
            low[x] = np.uint8(rise)


@serial
def uints24(plane: U32, out: U8) -> None:
    """Write the rises of whole numbers [H, W] as four planes of bytes [H, 4 W]."""
    height, width = plane.shape
    for y in range(height):
        for x in range(width):
            before = plane[y, x - 1] if x else np.uint32(0)
            rise = np.uint32(plane[y, x] - before)
            for k in range(4):
                out[y, k * width + x] = np.uint8(rise >> np.uint32(24 - 8 * k))
