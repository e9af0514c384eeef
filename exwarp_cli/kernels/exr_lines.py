"""Scan lines as OpenEXR's compressions want them: bytes sorted so that they deflate well.

Both are filters that lose nothing but PXR24's last 8 bits of floats; see OpenEXR's ImfZip.cpp and
ImfPxr24Compressor.cpp, which read what is made here. One thread makes a frame: frames are written
side by side.

Every loop writes one array, and rows are taken from contiguous ones: then the compiler makes them
loops over vectors, which take a tenth of the time. Where they begin at 1 and look back, that stands
on the compiler's seeing through `i - 1`; of slices it has nothing to see through.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import inlined, part, serial

U8 = npt.NDArray[np.uint8]
U16 = npt.NDArray[np.uint16]
U32 = npt.NDArray[np.uint32]


@part
def byte_rises(now: U16, before: U16, shift: np.uint16, out: U8) -> None:
    """Write the rises of one byte of pairs [N], which is lowest once they are shifted, plus 128."""
    for i in range(out.size):
        rise = np.uint16(np.uint16(now[i] >> shift) - np.uint16(before[i] >> shift))
        out[i] = np.uint8(rise + np.uint16(128))


@serial
def halves(lines: U16, chunk: int, out: U8) -> None:
    """Sort each chunk's even bytes before its odd ones, and take each byte's rise over the last.

    Parameters
    ----------
    lines
        Scan lines as pairs of bytes [N].
    chunk
        Pairs of a chunk; the last one may have fewer.
    out
        Bytes [2 N], written; rises are stored plus 128, a chunk's first byte as it is.
    """
    for start in range(0, lines.size, chunk):
        here = lines[start : start + chunk]
        last = here.size - 1
        low = out[2 * start : 2 * start + here.size]
        high = out[2 * start + here.size : 2 * start + 2 * here.size]
        low[0] = np.uint8(here[0])
        high[0] = np.uint8((here[0] >> 8) - here[last] + 128)
        byte_rises(here[1:], here[:last], np.uint16(0), low[1:])
        byte_rises(here[1:], here[:last], np.uint16(8), high[1:])


@inlined
def float24(bits: np.uint32) -> np.uint32:
    """Return a float's bits rounded to 24, as PXR24 does it; NaN and infinity stay what they are.

    Values that would round to infinity are cut instead.
    """
    size = np.uint32(bits & np.uint32(0x7FFFFFFF))
    cut = np.uint32(size >> np.uint32(8))
    up = np.uint32(np.uint32(size + (bits & np.uint32(0x80))) >> np.uint32(8))
    out = up if up < np.uint32(0x7F8000) else cut
    lost = size > np.uint32(0x7F800000) and cut == np.uint32(0x7F8000)
    sign = np.uint32(bits >> np.uint32(8)) & np.uint32(0x800000)
    return np.uint32(sign | out | np.uint32(lost))


@inlined
def put_rises(row: U32, size: int, out: U8) -> None:
    """Write a row's rises [W] as planes of bytes [size W], the highest of so many first."""
    width = row.size
    for k in range(size):
        plane, shift = out[k * width : (k + 1) * width], np.uint32(8 * (size - 1 - k))
        plane[0] = np.uint8(row[0] >> shift)
        for x in range(1, width):
            plane[x] = np.uint8(np.uint32(row[x] - row[x - 1]) >> shift)


@serial
def halfs24(plane: U16, at: int, out: U8) -> None:
    """Write the rises of half floats [H, W] along each row as two planes of bytes.

    They are the 2 W bytes from `at` on in each row of `out`.
    """
    height, width = plane.shape
    for y in range(height):
        row, high = plane[y], out[y, at : at + width]
        low = out[y, at + width : at + 2 * width]
        high[0], low[0] = np.uint8(row[0] >> 8), np.uint8(row[0])
        for x in range(1, width):
            high[x] = np.uint8(np.uint16(row[x] - row[x - 1]) >> 8)
        for x in range(1, width):
            low[x] = np.uint8(row[x] - row[x - 1])


@serial
def floats24(plane: U32, at: int, out: U8) -> None:
    """Write the rises of 24-bit floats, given as bits [H, W], as three planes; see `halfs24`."""
    height, width = plane.shape
    cut = np.empty(width, np.uint32)
    for y in range(height):
        row = plane[y]
        for x in range(width):
            cut[x] = float24(row[x])
        put_rises(cut, 3, out[y, at : at + 3 * width])


@serial
def uints24(plane: U32, at: int, out: U8) -> None:
    """Write the rises of whole numbers [H, W] as four planes of bytes; see `halfs24`."""
    height, width = plane.shape
    for y in range(height):
        put_rises(plane[y], 4, out[y, at : at + 4 * width])
