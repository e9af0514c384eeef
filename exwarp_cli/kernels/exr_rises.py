"""Pixels out of scan lines as OpenEXR's compressions sort them: what `exr_lines` makes, undone.

Each kernel takes one chunk, inflated, and writes the channels that are wanted straight to where
they belong; the caller has checked that the chunk is as long as its lines need. `columns` is int64
[K, 2]: by channel, in the file's order, the bytes of a pixel and its place in `out`, -1 where it is
not wanted. `out` is [H, W, C] bits of floats or of whole numbers; a half becomes the float of its
value, a NaN with the same bits. See OpenEXR's ImfZip.cpp, ImfPxr24Compressor.cpp and ImfRle.cpp.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import inlined, part, serial

U8 = npt.NDArray[np.uint8]
U32 = npt.NDArray[np.uint32]
I64 = npt.NDArray[np.int64]


@inlined
def single(half: np.uint32) -> np.uint32:
    """Return the bits of a half's value as a float, without branches, so that loops are vectors."""
    sign, size = (half & np.uint32(0x8000)) << np.uint32(16), half & np.uint32(0x7FFF)
    bits = np.uint32((size << np.uint32(13)) + np.uint32(0x38000000))
    full = np.uint32(bits | np.uint32(0x7F800000))  # infinity and NaN
    whole = np.float32(size).view(np.uint32)  # below 2 ** -14: so many times 2 ** -24
    small = np.uint32(whole - np.uint32(0x0C000000)) if size > 0 else np.uint32(0)
    normal = full if size >= np.uint32(0x7C00) else bits
    return np.uint32(sign | (small if size < np.uint32(0x0400) else normal))


@inlined
def spread(line: U32, row: U32, place: int) -> None:
    """Write a channel's line [W] among those of the others, [W, C].

    Values are made in a line of their own before: in one loop they would be scattered by vector
    instructions, which took five times as long.
    """
    for x in range(line.size):
        row[x, place] = line[x]


@serial
def from_lines(data: U8, columns: I64, out: U32) -> None:
    """Read lines as they are in memory: in each line, a channel after the other."""
    height, width, _ = out.shape
    line = np.empty(width, np.uint32)
    at = 0
    for y in range(height):
        for k in range(len(columns)):
            size, place = columns[k]
            here = data[at : at + size * width]
            at += size * width
            if place < 0:
                continue
            if size == 2:
                for x in range(width):
                    low, high = np.uint32(here[2 * x]), np.uint32(here[2 * x + 1])
                    line[x] = single(low | high << np.uint32(8))
            else:
                for x in range(width):
                    low = np.uint32(here[4 * x]) | np.uint32(here[4 * x + 1]) << np.uint32(8)
                    high = np.uint32(here[4 * x + 2]) | np.uint32(here[4 * x + 3]) << np.uint32(8)
                    line[x] = low | high << np.uint32(16)
            spread(line, out[y], place)


@inlined
def total(rises: U8, before: np.uint8) -> np.uint8:
    """Return where stored rises lead from `before`, without the bytes between."""
    found = np.uint8(before + np.uint8(rises.size << 7))
    for i in range(rises.size):
        found = np.uint8(found + rises[i])
    return found


@inlined
def heights(low: U8, high: U8, start: np.uint64, line: U32) -> np.uint64:
    """Write the pixels [W] of a channel, given its even and odd bytes as stored rises.

    `start` holds the byte before in either half, in its lower and upper 32 bits, where rises add up
    without a carry from one into the other; so does what is returned, the bytes at the end. Only
    the adding up cannot be done on vectors.
    """
    width, flip = line.size, np.uint8(128)
    sums = np.empty(width, np.uint64)
    if low.size == width:
        for x in range(width):
            sums[x] = np.uint64(low[x] ^ flip) | np.uint64(high[x] ^ flip) << np.uint64(32)
    else:
        for x in range(width):
            a = np.uint32(low[2 * x] ^ flip) + np.uint32(low[2 * x + 1] ^ flip)
            b = np.uint32(high[2 * x] ^ flip) + np.uint32(high[2 * x + 1] ^ flip)
            sums[x] = np.uint64(a) | np.uint64(b) << np.uint64(32)
    value = start
    for x in range(width):
        value = np.uint64(value + sums[x])
        sums[x] = value
    byte = np.uint32(255)
    if low.size == width:
        for x in range(width):
            a, b = np.uint32(sums[x]) & byte, np.uint32(sums[x] >> np.uint64(32)) & byte
            line[x] = single(a | b << np.uint32(8))
    else:
        for x in range(width):
            a, b = np.uint32(sums[x]), np.uint32(sums[x] >> np.uint64(32))
            first = np.uint32(a - np.uint32(low[2 * x + 1] ^ flip)) & byte
            second = np.uint32(b - np.uint32(high[2 * x + 1] ^ flip)) & byte
            lower, upper = first | second << np.uint32(8), a & byte | (b & byte) << np.uint32(8)
            line[x] = lower | upper << np.uint32(16)
    return np.uint64(value & np.uint64(0x000000FF000000FF))


@serial
def from_halves(data: U8, columns: I64, out: U32) -> None:
    """Read a chunk of ZIP, ZIPS or RLE: all even bytes before all odd ones, as rises plus 128.

    Of a channel that is not wanted only the rises are added up, some twentieth of the work.
    """
    height, width, _ = out.shape
    half = data.size // 2
    even, odd = data[:half], data[half:]
    a = np.uint8(128)  # the first byte stands as it is
    b = total(even, a)
    line = np.empty(width, np.uint32)
    at = 0
    for y in range(height):
        for k in range(len(columns)):
            size, place = columns[k]
            step = size * width // 2
            low, high = even[at : at + step], odd[at : at + step]
            at += step
            if place < 0:
                a, b = total(low, a), total(high, b)
                continue
            ends = heights(low, high, np.uint64(a) | np.uint64(b) << np.uint64(32), line)
            a, b = np.uint8(ends), np.uint8(ends >> np.uint64(32))
            spread(line, out[y], place)


@part
def rises_of(planes: U8, size: int, line: U32) -> None:
    """Write the rises of a channel's line [W], given as planes of bytes [size W].

    Of halfs they are 16 bits.
    """
    width = line.size
    for x in range(width):
        line[x] = np.uint32(planes[x]) << np.uint32(8) | np.uint32(planes[width + x])
    if size > 2:
        third, fourth = planes[2 * width : 3 * width], planes[(size - 1) * width :]
        lowest = np.uint32(255) if size == 4 else np.uint32(0)
        for x in range(width):
            lower = np.uint32(third[x]) << np.uint32(8) | np.uint32(fourth[x]) & lowest
            line[x] = line[x] << np.uint32(16) | lower


@part
def add_up_four(lines: U32, row: U32) -> None:
    """Write where the rises of four channels [4, W] lead, pixel by pixel, [4 W].

    Together, as each sum waits for the one before it.
    """
    a, b, c, d = lines[0], lines[1], lines[2], lines[3]
    p, q, r, s = np.uint32(0), np.uint32(0), np.uint32(0), np.uint32(0)
    for x in range(a.size):
        p, q = np.uint32(p + a[x]), np.uint32(q + b[x])
        r, s = np.uint32(r + c[x]), np.uint32(s + d[x])
        row[4 * x], row[4 * x + 1], row[4 * x + 2], row[4 * x + 3] = p, q, r, s


@part
def add_up_three(lines: U32, row: U32) -> None:
    """Do as `add_up_four` with three channels."""
    a, b, c = lines[0], lines[1], lines[2]
    p, q, r = np.uint32(0), np.uint32(0), np.uint32(0)
    for x in range(a.size):
        p, q, r = np.uint32(p + a[x]), np.uint32(q + b[x]), np.uint32(r + c[x])
        row[3 * x], row[3 * x + 1], row[3 * x + 2] = p, q, r


@part
def add_up(line: U32, row: U32) -> None:
    """Do as `add_up_four` with one channel; both may be the same memory."""
    value = np.uint32(0)
    for x in range(row.size):
        value = np.uint32(value + line[x])
        row[x] = value


@part
def show_halfs(values: U32) -> None:
    """Make floats of halfs in the lower 16 bits, [N]."""
    for k in range(values.size):
        values[k] = single(values[k] & np.uint32(0xFFFF))


@part
def are_one_kind(columns: I64) -> bool:
    """Whether all channels that are wanted are halfs, or none is."""
    halfs, others = False, False
    for k in range(len(columns)):
        halfs |= columns[k, 1] >= 0 and columns[k, 0] == 2
        others |= columns[k, 1] >= 0 and columns[k, 0] > 2
    return not (halfs and others)


@part
def add_up_pixels(lines: U32, halfs: bool, row: U32) -> None:
    """Write where the rises of one, three or four channels [C, W] of a kind lead, [C W]."""
    if lines.shape[0] == 4:
        add_up_four(lines, row)
    elif lines.shape[0] == 3:
        add_up_three(lines, row)
    else:
        add_up(lines[0], row)
    if halfs:
        show_halfs(row)


@part
def add_up_each(lines: U32, columns: I64, row: U32) -> None:
    """Write where the rises of channels [C, W] lead, one after the other, [W, C]."""
    for k in range(len(columns)):
        size, place = columns[k]
        if place < 0:
            continue
        line = lines[place]
        add_up(line, line)
        if size == 2:
            show_halfs(line)
        spread(line, row, place)


@serial
def from_planes(data: U8, columns: I64, out: U32) -> None:
    """Read a chunk of PXR24: of each line and channel planes of bytes, the highest first, as rises.

    Of floats there are three bytes; the lowest is 0. Pixels of one, three or four channels of a
    kind, the usual ones, are written whole: two thirds of the time.
    """
    height, width, channels = out.shape
    whole = (channels == 1 or channels == 3 or channels == 4) and are_one_kind(columns)
    lines, halfs, at = np.empty((channels, width), np.uint32), False, 0
    for y in range(height):
        for k in range(len(columns)):
            size, place = columns[k]
            if place >= 0:
                rises_of(data[at : at + size * width], size, lines[place])
                halfs = size == 2
            at += size * width
        if whole:
            add_up_pixels(lines, halfs, out[y].reshape(-1))
        else:
            add_up_each(lines, columns, out[y])


@serial
def from_runs(data: U8, out: U8) -> bool:
    """Write out run lengths [N] as bytes [M]; False where they are not just so many."""
    at, i = 0, 0
    while i < data.size:
        count = int(data[i])
        i += 1
        if count >= 128:  # so many bytes, 256 - count, as they are
            count = 256 - count
            if i + count > data.size or at + count > out.size:
                return False
            for j in range(count):
                out[at + j] = data[i + j]
            i += count
        else:
            count += 1
            if i == data.size or at + count > out.size:
                return False
            for j in range(count):
                out[at + j] = data[i]
            i += 1
        at += count
    return at == out.size
