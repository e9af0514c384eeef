"""Filters of OpenEXR's ZIP and ZIPS, both ways, and the conversion between half and float.

Before a scan-line block is deflated, its even bytes are put before its odd bytes (OpenEXR calls the
inverse *interleave*), and each byte is replaced by its difference to the byte before, plus 128 (the
*predictor*). See OpenEXR's ImfZip.cpp. One thread filters a frame: frames are read and written side
by side.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import compiled, inlined, part

U8 = npt.NDArray[np.uint8]
U16 = npt.NDArray[np.uint16]
U32 = npt.NDArray[np.uint32]
I64 = npt.NDArray[np.int64]


@part
def delta_encode(values: U16, previous: U16, shift: np.uint16, out: U8) -> None:
    """Write the differences of one byte of pairs [N], plus 128; `shift` selects the byte."""
    # One output array, and no look back into it: so the loop becomes vector instructions.
    for i in range(out.size):
        rise = np.uint16(np.uint16(values[i] >> shift) - np.uint16(previous[i] >> shift))
        out[i] = np.uint8(rise + np.uint16(128))


@compiled
def predict(lines: U16, block: int, out: U8) -> None:
    """Filter scan-line blocks before they are deflated.

    Parameters
    ----------
    lines
        Scan lines as pairs of bytes [N].
    block
        Pairs of a block; the last one may have fewer.
    out
        Bytes [2 N], written. The first byte of a block stands as it is.
    """
    for start in range(0, lines.size, block):
        pairs = lines[start : start + block]
        last = pairs.size - 1
        even = out[2 * start : 2 * start + pairs.size]
        odd = out[2 * start + pairs.size : 2 * start + 2 * pairs.size]
        even[0] = np.uint8(pairs[0])
        odd[0] = np.uint8((pairs[0] >> 8) - pairs[last] + 128)
        delta_encode(pairs[1:], pairs[:last], np.uint16(0), even[1:])
        delta_encode(pairs[1:], pairs[:last], np.uint16(8), odd[1:])


@inlined
def half_to_float(half: np.uint32) -> np.uint32:
    """Return the bits of a half's value as a float; a NaN keeps its bits. Without branches."""
    sign, size = (half & np.uint32(0x8000)) << np.uint32(16), half & np.uint32(0x7FFF)
    bits = np.uint32((size << np.uint32(13)) + np.uint32(0x38000000))
    full = np.uint32(bits | np.uint32(0x7F800000))  # infinity and NaN
    steps = np.float32(size).view(np.uint32)  # below 2 ** -14: so many times 2 ** -24
    small = np.uint32(steps - np.uint32(0x0C000000)) if size > 0 else np.uint32(0)
    normal = full if size >= np.uint32(0x7C00) else bits
    return np.uint32(sign | (small if size < np.uint32(0x0400) else normal))


@inlined
def scatter(line: U32, row: U32, place: int) -> None:
    """Write a channel's line [W] among those of the others, [W, C]."""
    # Values are computed in a line of their own before: in one loop they would be scattered by
    # vector instructions, which took five times as long.
    for x in range(line.size):
        row[x, place] = line[x]


@compiled
def read_lines(data: U8, columns: I64, out: U32) -> None:
    """Read a block that is stored uncompressed: in each line a channel after the other.

    Parameters
    ----------
    data
        Bytes, as many as the lines need; the caller has checked that.
    columns
        int64 [K, 2] by channel in the file's order: bytes of a pixel (2 or 4), and its place in
        `out`, -1 where it is not wanted.
    out
        Bits of floats or of integers [H, W, C], written. A half becomes the float of its value.
    """
    height, width, _ = out.shape
    line = np.empty(width, np.uint32)
    at = 0
    for y in range(height):
        for k in range(len(columns)):
            size, place = columns[k]
            pixels = data[at : at + size * width]
            at += size * width
            if place < 0:
                continue
            if size == 2:
                for x in range(width):
                    low, high = np.uint32(pixels[2 * x]), np.uint32(pixels[2 * x + 1])
                    line[x] = half_to_float(low | high << np.uint32(8))
            else:
                for x in range(width):
                    low = np.uint32(pixels[4 * x]) | np.uint32(pixels[4 * x + 1]) << np.uint32(8)
                    high = np.uint32(pixels[4 * x + 2])
                    high |= np.uint32(pixels[4 * x + 3]) << np.uint32(8)
                    line[x] = low | high << np.uint32(16)
            scatter(line, out[y], place)


@inlined
def prefix_sum(deltas: U8, before: np.uint8) -> np.uint8:
    """Return the last byte of a run of stored differences that follows `before`."""
    value = np.uint8(before + np.uint8(deltas.size << 7))
    for i in range(deltas.size):
        value = np.uint8(value + deltas[i])
    return value


@inlined
def decode_line(even: U8, odd: U8, start: np.uint64, line: U32) -> np.uint64:
    """Write the pixels [W] of a channel from the stored differences of its even and odd bytes.

    `start` holds the byte before in either half of the block, in its lower and upper 32 bits, where
    sums need no carry from one into the other. The bytes at the end are returned likewise. Only the
    prefix sum cannot be done on vectors.
    """
    width, flip = line.size, np.uint8(128)
    sums = np.empty(width, np.uint64)
    if even.size == width:
        for x in range(width):
            sums[x] = np.uint64(even[x] ^ flip) | np.uint64(odd[x] ^ flip) << np.uint64(32)
    else:
        for x in range(width):
            a = np.uint32(even[2 * x] ^ flip) + np.uint32(even[2 * x + 1] ^ flip)
            b = np.uint32(odd[2 * x] ^ flip) + np.uint32(odd[2 * x + 1] ^ flip)
            sums[x] = np.uint64(a) | np.uint64(b) << np.uint64(32)
    value = start
    for x in range(width):
        value = np.uint64(value + sums[x])
        sums[x] = value
    byte = np.uint32(255)
    if even.size == width:
        for x in range(width):
            a, b = np.uint32(sums[x]) & byte, np.uint32(sums[x] >> np.uint64(32)) & byte
            line[x] = half_to_float(a | b << np.uint32(8))
    else:
        for x in range(width):
            a, b = np.uint32(sums[x]), np.uint32(sums[x] >> np.uint64(32))
            first = np.uint32(a - np.uint32(even[2 * x + 1] ^ flip)) & byte
            second = np.uint32(b - np.uint32(odd[2 * x + 1] ^ flip)) & byte
            lower, upper = first | second << np.uint32(8), a & byte | (b & byte) << np.uint32(8)
            line[x] = lower | upper << np.uint32(16)
    return np.uint64(value & np.uint64(0x000000FF000000FF))


@compiled
def read_predicted(data: U8, columns: I64, out: U32) -> None:
    """Read an inflated block, which `predict` filtered; parameters as for `read_lines`.

    Of a channel that is not wanted only the differences are summed, a twentieth of the work.
    """
    height, width, _ = out.shape
    half = data.size // 2
    even, odd = data[:half], data[half:]
    a = np.uint8(128)  # the first byte stands as it is
    b = prefix_sum(even, a)
    line = np.empty(width, np.uint32)
    at = 0
    for y in range(height):
        for k in range(len(columns)):
            size, place = columns[k]
            step = size * width // 2
            low, high = even[at : at + step], odd[at : at + step]
            at += step
            if place < 0:
                a, b = prefix_sum(low, a), prefix_sum(high, b)
                continue
            ends = decode_line(low, high, np.uint64(a) | np.uint64(b) << np.uint64(32), line)
            a, b = np.uint8(ends), np.uint8(ends >> np.uint64(32))
            scatter(line, out[y], place)


@inlined
def float_to_half(bits: np.uint32) -> np.uint16:
    """Round a float's bits, no NaN, to the nearest half, and to even between two.

    As IEEE 754 and numpy do. Without branches: vector instructions take 1.6 ms for a frame of four
    channels at 1920x1080, the processor's own instruction 1.4 ms.
    """
    size = bits & np.uint32(0x7FFFFFFF)
    sign = np.uint32(bits >> np.uint32(16)) & np.uint32(0x8000)
    even = np.uint32(0xFFF) + (np.uint32(size >> np.uint32(13)) & np.uint32(1))
    normal = np.uint32(np.uint32(size - np.uint32(0x38000000) + even) >> np.uint32(13))
    # Below 2 ** -14 halfs are steps of 2 ** -24, which are the lowest bits of floats above 0.5.
    raised = np.float32(np.uint32(size).view(np.float32) + np.float32(0.5))
    small = np.uint32(raised.view(np.uint32) - np.uint32(0x3F000000))
    half = normal if size >= np.uint32(0x38800000) else small
    half = np.uint32(0x7C00) if size >= np.uint32(0x477FF000) else half
    return np.uint16(half | sign)


@inlined
def nan_to_half(bits: np.uint32) -> np.uint16:
    """Return the half that keeps what fits of a NaN's bits."""
    kept = (bits >> np.uint32(13)) & np.uint32(0x3FF)
    sign = (bits >> np.uint32(16)) & np.uint32(0x8000)
    return np.uint16(sign | np.uint32(0x7C00) | kept | np.uint32(kept == 0))


@compiled
def round_to_half(pixels: U32, bounded: bool, out: U16) -> None:
    """Round floats to halfs, in a tenth of the time that numpy takes.

    Parameters
    ----------
    pixels
        Bits of floats [H, W], contiguous.
    bounded
        Whether numbers beyond half's range, and infinity, become its largest; else infinity.
    out
        Bits of halfs [H, W], contiguous, written.
    """
    most = np.uint32(0x477FE000) if bounded else np.uint32(0x7F800000)
    for y in range(len(pixels)):
        row, halfs = pixels[y], out[y]
        largest = np.uint32(0)
        for x in range(row.size):
            size = np.uint32(row[x] & np.uint32(0x7FFFFFFF))
            largest = max(largest, size)
            halfs[x] = float_to_half(np.uint32(min(size, most) | row[x] & np.uint32(0x80000000)))
        if largest > np.uint32(0x7F800000):
            for x in range(row.size):
                if row[x] & np.uint32(0x7FFFFFFF) > np.uint32(0x7F800000):
                    halfs[x] = nan_to_half(row[x])
