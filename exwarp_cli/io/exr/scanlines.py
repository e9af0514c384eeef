"""Decoding of ZIP and ZIPS: where a file's chunks lie, and the pixels of their scan-line blocks.

Blocks of the wanted parts alone are read, inflated and put into place, on several threads. Whatever
is unusual or broken is left to OpenImageIO, which decides whether it can be read, and says why not.
Pixels are the same, bit for bit.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import accumulate
from threading import Lock
from typing import BinaryIO, TypeAlias

import deflate
import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Window
from exwarp_cli.io.exr import header
from exwarp_cli.runtime import cores
from exwarp_cli.runtime.frame_pool import pool

U8 = npt.NDArray[np.uint8]
I64 = npt.NDArray[np.int64]

ZIPS, ZIP = 2, 3
# Scan lines of a chunk by the number of its compression, as in `header.COMPRESSION_NAMES`.
LINES = (1, 1, 1, 16, 32, 16, 32, 32, 32, 256)

BYTES = {header.UINT: 4, header.HALF: 2, header.FLOAT: 4}

MAX_RATIO = 1032  # bytes that DEFLATE makes of one: a small file gets no memory for a large image
MAX_CHUNK = 2**31 - 1  # bytes of a chunk's pixels, as in OpenEXR
MAX_TILE = 1 << 16  # pixels across or down of a tile; OpenImageIO has a limit, too

RUN_BYTES = 1 << 21  # of pixels that a thread decodes at a time, or one block

# Bytes of any value that follow a block in memory. Near the end of its input libdeflate goes bit by
# bit and copies byte by byte. Of ids or a constant channel so few bytes are left of a block that
# this was all of it: it took six times as long.
INPUT_PADDING = 64

# Type and bytes of what every header has beside channels. Without one of them OpenEXR reads no
# pixels, or none of their compression.
REQUIRED = {
    b"compression": (b"compression", 1),
    b"dataWindow": (b"box2i", 16),
    b"displayWindow": (b"box2i", 16),
    b"lineOrder": (b"lineOrder", 1),
    b"pixelAspectRatio": (b"float", 4),
    b"screenWindowCenter": (b"v2f", 8),
    b"screenWindowWidth": (b"float", 4),
}

# Where the channels of a request go: int64 [K, 2] as kernels want it, bytes of each of the
# part's channels and its place in the array or -1; and that array, bits, uint32 [H, W, C]
_Destination: TypeAlias = tuple[I64, np.ndarray]

_NO_OFFSETS = np.empty(0, np.int64)


@dataclass(frozen=True)
class ChunkLayout:
    """How a part of flat pixels is stored, by its header and its chunk offset table."""

    # Part number in its chunks; None in files of one part, whose chunks have none
    number: int | None
    compression: int  # its number in the header
    window: Window  # the data window
    # Name and type of each, in the order in which they follow each other in a line
    channels: Sequence[tuple[bytes, int]]
    # Width and height of its tiles; None where its chunks are scan lines
    tile: tuple[int, int] | None
    # int64 [N] of each chunk in the table's order: its beginning, and that of what follows
    starts: I64
    ends: I64

    @property
    def is_decoded_here(self) -> bool:
        """Whether its chunks are scan-line blocks of ZIP or ZIPS."""
        return self.tile is None and self.compression in (ZIPS, ZIP)

    @property
    def count(self) -> int:
        """Number of chunks by the header."""
        width, height = self.tile or (self.window.width, self.lines)
        return -(-self.window.width // width) * -(-self.window.height // height)

    @property
    def lines(self) -> int:
        """Lines of a block; the last one may have fewer."""
        return LINES[self.compression]

    @property
    def sizes(self) -> tuple[int, ...]:
        """Bytes of a pixel of each channel."""
        return tuple(BYTES[kind] for _, kind in self.channels)


def parse_layouts(raw: header.RawHeader, file: BinaryIO, size: int) -> list[ChunkLayout | None]:
    """Return how the parts of an unbuffered file of `size` bytes are stored.

    None stands for a part of deep, subsampled or mipmapped pixels, and for one with anything that
    is unusual or broken.

    Raises ValueError when headers or chunk offset tables are broken.
    """
    is_multipart = bool(raw.flags & header.MULTIPART)
    further = header.DEEP if is_multipart else header.TILED
    if raw.flags & ~(header.MULTIPART | header.LONG_NAMES | further) != 2:
        raise ValueError("the version is unknown")
    values = raw.by_part()
    flat = [_parse_flat(part, size, raw.flags) for part in values]
    counts = [0 if flat[0] is None else flat[0].count]
    if is_multipart:
        fields = [part.get(b"chunkCount", (b"", b"")) for part in values]
        if any(kind != b"int" or len(value) != 4 for kind, value in fields):
            raise ValueError("a part has no chunkCount")
        counts = [int.from_bytes(value, "little", signed=True) for _, value in fields]
    begin = len(raw.data) + 8 * sum(counts)
    if min(counts) < 0 or begin > size:
        raise ValueError("the tables of chunks are cut off")
    file.seek(len(raw.data))
    table = np.frombuffer(file.read(8 * sum(counts)), "<u8")
    if len(table) != sum(counts):
        raise ValueError("the tables of chunks are cut off")
    stops = np.append(np.sort(np.minimum(table, np.uint64(size))), np.uint64(size))
    ends = stops[np.searchsorted(stops, table, "right").clip(max=len(table))].astype(np.int64)
    layouts: list[ChunkLayout | None] = []
    for number, (layout, last) in enumerate(zip(flat, accumulate(counts), strict=True)):
        own = slice(last - counts[number], last)
        is_valid = ((begin <= table[own]) & (table[own] < size)).all()
        if layout is not None and layout.count == counts[number] and is_valid:
            part, starts = number if is_multipart else None, table[own].astype(np.int64)
            layouts.append(replace(layout, number=part, starts=starts, ends=ends[own]))
        else:
            layouts.append(None)
    return layouts


def _parse_flat(values: header.Values, size: int, flags: int) -> ChunkLayout | None:
    """Read a part's header in a file of `size` bytes; None where it is not flat or not usual.

    The chunk offsets are left empty.
    """
    kind, tiles = values.get(b"type"), values.get(b"tiles")
    is_flat = kind == (b"string", b"tiledimage" if tiles else b"scanlineimage")
    if kind is None:
        is_flat = not flags & header.MULTIPART
    try:
        channels = tuple(header.channels_in(values.get(b"channels", (b"", b""))[1]))
    except ValueError:
        return None
    names = [name for name, _, _ in channels]
    are_usual = bool(names) and values[b"channels"][0] == b"chlist" and names == sorted(set(names))
    # Subsampled channels have other steps.
    are_usual &= all(kind in BYTES and steps == (1, 1) for _, kind, steps in channels)
    required = {name: values.get(name, (b"", b"")) for name in REQUIRED}
    has_required = {n: (k, len(v)) for n, (k, v) in required.items()} == REQUIRED
    if not is_flat or not are_usual or not has_required:
        return None
    compression, order = required[b"compression"][1][0], required[b"lineOrder"][1][0]
    window = header.window_of(values, b"dataWindow")
    display = header.window_of(values, b"displayWindow")
    if compression >= len(LINES) or order > 1 or min(window.shape + display.shape) < 1:
        return None
    line = window.width * sum(BYTES[kind] for _, kind, _ in channels)
    if line * LINES[compression] > MAX_CHUNK or line * window.height > MAX_RATIO * size:
        return None
    tile = None
    if tiles is not None:
        if tiles[0] != b"tiledesc" or len(tiles[1]) != 9 or tiles[1][8]:
            return None  # of several levels
        tile = struct.unpack("<2I", tiles[1][:8])
        if not 0 < min(tile) <= max(tile) <= MAX_TILE:
            return None
    if not flags & header.MULTIPART and bool(flags & header.TILED) != (tile is not None):
        return None
    stored = tuple((name, kind) for name, kind, _ in channels)
    return ChunkLayout(None, compression, window, stored, tile, _NO_OFFSETS, _NO_OFFSETS)


@dataclass(eq=False)
class FileBytes:
    """Reads pieces of an open, unbuffered file at any position, from any thread."""

    _file: BinaryIO
    _lock: Lock = field(default_factory=Lock)

    def read_padded(self, start: int, size: int) -> U8:
        """Read bytes, fewer where the file ends, and append `INPUT_PADDING` bytes of any value."""
        out = np.empty(size + INPUT_PADDING, np.uint8)
        filled = 0
        while filled < size:
            if hasattr(os, "preadv"):
                more = os.preadv(self._file.fileno(), [out[filled:size].data], start + filled)
            else:  # Windows
                with self._lock:
                    self._file.seek(start + filled)
                    piece = self._file.read(size - filled)
                out[filled : filled + len(piece)] = np.frombuffer(piece, np.uint8)
                more = len(piece)
            if not more:
                break
            filled += more
        return out[: filled + INPUT_PADDING]


def read_blocks(
    file: BinaryIO, requests: Sequence[tuple[ChunkLayout, Sequence[header.Channel]]]
) -> list[np.ndarray | None]:
    """Decode channels of parts of an unbuffered file whose layout `is_decoded_here`.

    A request lists channels of one part, all integers or none, that go into one array. Returns
    float32 or uint32 [H, W, C] for each; None where OpenImageIO is to decide.
    """
    arrays: list[np.ndarray | None] = []
    by_part: dict[int | None, tuple[ChunkLayout, list[_Destination]]] = {}
    for layout, channels in requests:
        out, kinds = None, dict(layout.channels)
        names = [channel.raw_name.encode("utf-8", "surrogateescape") for channel in channels]
        stored = [header.PIXEL_TYPES.get(kinds.get(n, -1)) for n in names]
        if stored == [c.pixel_type for c in channels]:
            with suppress(MemoryError):
                out = pool.empty((*layout.window.shape, len(names)), np.uint32)
                places = [names.index(n) if n in names else -1 for n, _ in layout.channels]
                columns = np.array([layout.sizes, places], np.int64).T.copy()
                members = by_part.setdefault(layout.number, (layout, []))[1]
                members.append((columns, out))
        arrays.append(out)
    runs: list[tuple[ChunkLayout, list[_Destination], I64]] = []  # each for one thread
    for layout, members in by_part.values():
        order = np.argsort(layout.starts, kind="stable")  # as they follow each other on disk
        step = max(1, RUN_BYTES // (layout.lines * layout.window.width * sum(layout.sizes)))
        for first in range(0, len(order), step):
            runs.append((layout, members, order[first : first + step]))
    file_bytes = FileBytes(file)
    broken: set[int | None] = set()  # numbers of the parts that could not be decoded

    def decode(run: tuple[ChunkLayout, list[_Destination], I64]) -> None:
        # A part that fails is left at once: each further read of a bad share may take a minute.
        with cores.hold_cores():
            if run[0].number not in broken and not _decode_blocks(file_bytes, *run):
                broken.add(run[0].number)

    threads = min(cores.count(), len(runs))
    if threads > 1:
        # No thread can be started when the interpreter ends, or the system has no more.
        with suppress(RuntimeError), ThreadPoolExecutor(threads, "exr") as executor:
            # A pool of its own: starting one takes a thousandth of a frame's time.
            results = executor.map(decode, runs)
            with cores.release_cores():
                list(results)
            runs = []
    for run in runs:
        decode(run)
    return [
        None
        if out is None or layout.number in broken
        else out.view(np.uint32 if channels[0].pixel_type == "uint" else np.float32)
        for (layout, channels), out in zip(requests, arrays, strict=True)
    ]


def _decode_blocks(
    file: FileBytes, layout: ChunkLayout, destinations: Sequence[_Destination], chunks: I64
) -> bool:
    """Decode blocks of a part; False when one of them is not what it should be."""
    from exwarp_cli.kernels import exr_filters  # numba: not for what reads no pixels

    # Before each block: the part's number, the first line, the bytes.
    leader = struct.Struct("<2i" if layout.number is None else "<3i")
    line_size = layout.window.width * sum(layout.sizes)
    try:
        starts = layout.starts[chunks]
        # In front of something else there may be a gap of any length.
        ends = np.minimum(layout.ends[chunks], starts + leader.size + layout.lines * line_size)
        breaks = np.flatnonzero(starts[1:] != ends[:-1]) + 1
        # Blocks that follow each other are read at once.
        for group in np.split(np.arange(len(starts)), breaks):
            begin = int(starts[group[0]])
            blocks = file.read_padded(begin, int(ends[group[-1]]) - begin)
            blocks.flags.writeable = False  # kernels are compiled for arrays of one kind
            for i in group:
                data = blocks[starts[i] - begin : ends[i] - begin + INPUT_PADDING]
                if len(data) < leader.size + INPUT_PADDING:
                    return False
                first = int(chunks[i]) * layout.lines
                rows = min(layout.lines, layout.window.height - first)
                *number, line, size = leader.unpack_from(data.data)
                full_size = rows * line_size
                packed = data[leader.size : leader.size + size + INPUT_PADDING]
                is_own = number in ([], [layout.number]) and line == layout.window.y + first
                is_complete = 0 < size <= full_size and len(packed) == size + INPUT_PADDING
                if not is_own or not is_complete:
                    return False
                if size == full_size:  # stored uncompressed, as it did not become smaller
                    kernel, pixels = exr_filters.read_lines, packed[:full_size]
                else:
                    # libdeflate takes 0.6 of ISA-L's time. It ignores what follows the checksum.
                    inflated = deflate.zlib_decompress(packed, full_size)
                    checksum = packed[-INPUT_PADDING - 4 : -INPUT_PADDING].tobytes()
                    is_sound = deflate.adler32(inflated) == int.from_bytes(checksum, "big")
                    if len(inflated) != full_size or not is_sound:
                        return False
                    kernel, pixels = exr_filters.read_predicted, np.frombuffer(inflated, np.uint8)
                    pixels.flags.writeable = False
                for columns, out in destinations:
                    kernel(pixels, columns, out[first : first + rows])
    except (OSError, MemoryError, deflate.DeflateError):
        return False
    return True
