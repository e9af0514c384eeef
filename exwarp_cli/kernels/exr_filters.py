"""Filters of OpenEXR's ZIP and ZIPS, both ways, and the conversion between half and float.

Before a scan-line block is deflated, its even bytes are put before its odd bytes (OpenEXR calls the
inverse *interleave*), and each byte is replaced by its difference to the byte before, plus 128 (the
*predictor*). See OpenEXR's ImfZip.cpp. One thread filters a frame: frames are read and written side
by side.
"""

from __future__ import annotations

import numpy as np

from exwarp_cli.kernels._compile import device_function, inline, kernel
from exwarp_cli.kernels.array_types import I64, U8, U16, U32


@device_function
def _delta_encode(values: U16, previous: U16, shift: np.uint16, out: U8) -> None:
    """Write the differences of one byte of pairs [N], plus 128; `shift` selects the byte."""
    # One output array, and no look back into it: so the loop becomes vector instructions.
    for i in range(out.size):
        rise = np.uint16(np.uint16(values[i] >> shift) - np.uint16(previous[i] >> shift))
        out[i] = np.uint8(rise + np.uint16(128))


@kernel
def predict(
    lines: U16,  # scan lines as pairs of bytes, [N]
    block: int,  # pairs of a block; the last one may have fewer
    out: U8,  # bytes [2 N], written; the first byte of a block stays as it is
) -> None:
    """Filter scan-line blocks before they are deflated."""
    for start in range(0, lines.size, block):
        pairs = lines[start : start + block]
        last = pairs.size - 1
        even = out[2 * start : 2 * start + pairs.size]
        odd = out[2 * start + pairs.size : 2 * start + 2 * pairs.size]
        even[0] = np.uint8(pairs[0])
        odd[0] = np.uint8((pairs[0] >> 8) - pairs[last] + 128)
        _delta_encode(pairs[1:], pairs[:last], np.uint16(0), even[1:])
        _delta_encode(pairs[1:], pairs[:last], np.uint16(8), odd[1:])


@inline
def _half_to_float(half: np.uint32) -> np.uint32:
    """Return the bits of a half's value as a float; a NaN keeps its bits. Without branches."""
    sign, size = (half & np.uint32(0x8000)) << np.uint32(16), half & np.uint32(0x7FFF)
    bits = np.uint32((size << np.uint32(13)) + np.uint32(0x38000000))
    special = np.uint32(bits | np.uint32(0x7F800000))  # infinity and NaN
    steps = np.float32(size).view(np.uint32)  # below 2 ** -14: so many times 2 ** -24
    small = np.uint32(steps - np.uint32(0x0C000000)) if size > 0 else np.uint32(0)
    normal = special if size >= np.uint32(0x7C00) else bits
    return np.uint32(sign | (small if size < np.uint32(0x0400) else normal))


@inline
def _scatter(line: U32, row: U32, place: int) -> None:
    # Values are computed in a line of their own before: in one loop they would be scattered by
    # vector instructions, which took five times as long.
    for x in range(line.size):
        row[x, place] = line[x]


@kernel
def read_lines(
    data: U8,  # bytes, as many as the lines need; the caller has checked that
    # columns: [K, 2] by channel in the file's order: bytes of a pixel (2 or 4); place in `out`, or
    # -1
    columns: I64,
    out: U32,  # bits of floats or integers [H, W, C], written; halves become floats
) -> None:
    """Read a block that is stored uncompressed: in each line one channel after the other."""
    height, width, _ = out.shape
    line = np.empty(width, np.uint32)
    offset = 0
    for y in range(height):
        for k in range(len(columns)):
            size, place = columns[k]
            pixels = data[offset : offset + size * width]
            offset += size * width
            if place < 0:
                continue
            if size == 2:
                for x in range(width):
                    low, high = np.uint32(pixels[2 * x]), np.uint32(pixels[2 * x + 1])
                    line[x] = _half_to_float(low | high << np.uint32(8))
            else:
                for x in range(width):
                    low = np.uint32(pixels[4 * x]) | np.uint32(pixels[4 * x + 1]) << np.uint32(8)
                    high = np.uint32(pixels[4 * x + 2])
                    high |= np.uint32(pixels[4 * x + 3]) << np.uint32(8)
                    line[x] = low | high << np.uint32(16)
            _scatter(line, out[y], place)


@inline
def _prefix_sum(deltas: U8, before: np.uint8) -> np.uint8:
    value = np.uint8(before + np.uint8(deltas.size << 7))
    for i in range(deltas.size):
        value = np.uint8(value + deltas[i])
    return value


@inline
def _decode_line(even: U8, odd: U8, start: np.uint64, line: U32) -> np.uint64:
    """Write the pixels [W] of a channel from the stored differences of its even and odd bytes.

    `start` holds the byte before in either half of the block, in its lower and upper 32 bits, where
    sums need no carry. The last bytes are returned in the same form.
    """
    # Only the prefix sum cannot be vectorised.
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
            line[x] = _half_to_float(a | b << np.uint32(8))
    else:
        for x in range(width):
            a, b = np.uint32(sums[x]), np.uint32(sums[x] >> np.uint64(32))
            first = np.uint32(a - np.uint32(even[2 * x + 1] ^ flip)) & byte
            second = np.uint32(b - np.uint32(odd[2 * x + 1] ^ flip)) & byte
            lower, upper = first | second << np.uint32(8), a & byte | (b & byte) << np.uint32(8)
            line[x] = lower | upper << np.uint32(16)
    return np.uint64(value & np.uint64(0x000000FF000000FF))


@kernel
def read_predicted(data: U8, columns: I64, out: U32) -> None:
    """Read an inflated block that `predict` filtered; parameters as for `read_lines`."""
    # Of a channel that is not wanted only the differences are summed: a twentieth of the work.
    height, width, _ = out.shape
    half = data.size // 2
    even, odd = data[:half], data[half:]
    a = np.uint8(128)  # the first byte stands as it is
    b = _prefix_sum(even, a)
    line = np.empty(width, np.uint32)
    offset = 0
    for y in range(height):
        for k in range(len(columns)):
            size, place = columns[k]
            step = size * width // 2
            low, high = even[offset : offset + step], odd[offset : offset + step]
            offset += step
            if place < 0:
                a, b = _prefix_sum(low, a), _prefix_sum(high, b)
                continue
            ends = _decode_line(low, high, np.uint64(a) | np.uint64(b) << np.uint64(32), line)
            a, b = np.uint8(ends), np.uint8(ends >> np.uint64(32))
            _scatter(line, out[y], place)


@kernel
def round_to_half(
    pixels: U32,  # bits of floats [H, W], contiguous
    bounded: bool,  # values beyond half's range, and infinity, become its largest; else infinity
    out: U16,  # bits of halves [H, W], contiguous, written
) -> None:
    """Round floats to the nearest halves, ties to even (IEEE 754); NaN keeps its upper bits."""
    most = np.uint32(0x477FE000) if bounded else np.uint32(0x7F800000)
    for y in range(len(pixels)):
        row, halfs = pixels[y], out[y]
        largest = np.uint32(0)
        for x in range(row.size):
            size = np.uint32(row[x] & np.uint32(0x7FFFFFFF))
            largest = max(largest, size)
            # Without branches: 1.6 ms for four channels at 1920x1080, a tenth of numpy's time; the
            # processor's own instruction 1.4 ms.
            size = np.uint32(min(size, most))
            even = np.uint32(0xFFF) + (np.uint32(size >> np.uint32(13)) & np.uint32(1))
            normal = np.uint32(np.uint32(size - np.uint32(0x38000000) + even) >> np.uint32(13))
            # Below 2 ** -14 halfs are steps of 2 ** -24: the lowest bits of floats above 0.5.
            raised = np.float32(size.view(np.float32) + np.float32(0.5))
            small = np.uint32(raised.view(np.uint32) - np.uint32(0x3F000000))
            half = normal if size >= np.uint32(0x38800000) else small
            half = np.uint32(0x7C00) if size >= np.uint32(0x477FF000) else half
            halfs[x] = np.uint16(half | (row[x] >> np.uint32(16)) & np.uint32(0x8000))
        if largest > np.uint32(0x7F800000):
            for x in range(row.size):
                if row[x] & np.uint32(0x7FFFFFFF) > np.uint32(0x7F800000):
                    payload = (row[x] >> np.uint32(13)) & np.uint32(0x3FF)
                    sign = (row[x] >> np.uint32(16)) & np.uint32(0x8000)
                    nan = sign | np.uint32(0x7C00) | payload | np.uint32(payload == 0)
                    halfs[x] = np.uint16(nan)
