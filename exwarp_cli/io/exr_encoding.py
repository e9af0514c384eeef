"""Encoding scan-line EXR files: OpenEXR's header, and chunks that are compressed here.

OpenEXR writes the header of a file of one pixel; the windows and chunks of the real one are put
into it. So every attribute stands there as OpenEXR writes it, of any type. The chunks hold the same
bits as OpenEXR's, but ISA-L deflates them, not libdeflate at its level 4.

Time as a multiple of OpenEXR's, and size as a share of the pixels' bytes here and there, for a
frame of four half channels at 1920x1080; ours begins with floats, OpenEXR with halfs that are
rounded already (`tests.bench.bench_exr`):

=====  =================  =================  =================
..     render             noise              flat
=====  =================  =================  =================
ZIP    0.22  0.464 0.448  0.24  0.823 0.825  0.17  0.003 0.003
ZIPS   0.50  0.463 0.477  0.49  0.826 0.835  0.45  0.009 0.007
PXR24  0.26  0.493 0.480  0.31  0.906 0.918  0.22  0.004 0.003
=====  =================  =================  =================

Only float layers of flat shapes grow noticeably (depth: 0.231 instead of 0.183 of its size).
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import numpy as np
import OpenEXR
from isal import isal_zlib

from exwarp_cli.io.channel_rows import Channel, ChannelRows, Unrounded
from exwarp_cli.io.header_text import Attribute, attributes_in
from exwarp_cli.kernels.exr_lines import floats24, halfs24, halves, uints24

Header = Mapping[str, Any]
Planes = Mapping[str, Channel]
Part = tuple[Header, Planes]
Buffer = bytes | bytearray | memoryview

LINES: dict[Any, int] = {
    OpenEXR.NO_COMPRESSION: 1,
    OpenEXR.ZIPS_COMPRESSION: 1,
    OpenEXR.ZIP_COMPRESSION: 16,
    OpenEXR.PXR24_COMPRESSION: 16,
}
"""Scan lines in a chunk, by the compressions that are made here."""

TYPES = (np.dtype(np.float16), np.dtype(np.float32), np.dtype(np.uint32))

LEVEL = 1
"""Of ISA-L's DEFLATE: 2 makes no smaller files, 3 takes twice the time for 1 % less."""

_LEAST = 4096
"""Bytes of a chunk's floats under which OpenEXR decides whether PXR24 pays: it drops their last
bits, but not in chunks that would not become smaller, and there compressors differ. A larger chunk
always becomes smaller, as a quarter of its floats' bytes goes."""

_ALONE = 4
"""Bytes at the beginning of a stream that are flushed alone; see `_deflated`."""

_OWN_CODE = 1024
"""Least bytes of a kind that are worth a code of their own."""

_ROWS = 16
"""Lines that are prepared at once, whole chunks of them: they stay in the processor's cache."""


@dataclass(frozen=True)
class Smaller:
    """A compression whose chunks OpenEXR makes: smaller, in several times the time."""

    compression: Any


def encoded(parts: Sequence[Part]) -> list[Buffer]:
    """Encode a file in memory.

    One thread does it: frames are written side by side, which shares the cores better.

    Parameters
    ----------
    parts
        Header and channels [H, W] of each. The compression may be a `Smaller` one.

    Returns
    -------
    list of bytes-like
        What the file has one after the other. The first holds the headers, and can be changed.

    Raises
    ------
    RuntimeError, ValueError, TypeError
        When OpenEXR refuses it.
    """
    if not all(is_encoded_here(header, planes) for header, planes in parts):
        return [encoded_by_openexr(parts)]
    several = len(parts) > 1
    bodies = [
        _body(header, planes, struct.pack("<i", number) if several else b"")
        for number, (header, planes) in enumerate(parts)
    ]
    head = _head(parts, [len(sizes) for sizes, _ in bodies])
    sizes = [size for of_part, _ in bodies for size in of_part]
    starts = accumulate(sizes[:-1], initial=len(head) + 8 * len(sizes))
    head += struct.pack(f"<{len(sizes)}Q", *starts)
    return [head, *(piece for _, pieces in bodies for piece in pieces)]


def is_encoded_here(header: Header, planes: Planes) -> bool:
    """Whether a part is one whose chunks are made here; else OpenEXR makes the file."""
    compression, channels = header.get("compression"), list(planes.values())
    if compression not in LINES or header.get("type") != OpenEXR.scanlineimage:
        return False
    if "lineOrder" in header or not {"dataWindow", "displayWindow"} <= header.keys():
        return False
    shapes = {channel.shape for channel in channels}
    if len(shapes) != 1 or any(channel.dtype not in TYPES for channel in channels):
        return False
    (shape,) = shapes
    if len(shape) != 2 or 0 in shape:
        return False
    floats = sum(channel.dtype == np.float32 for channel in channels)
    if compression != OpenEXR.PXR24_COMPRESSION or not floats:
        return True
    height, width = shape
    lines = (height - 1) % LINES[compression] + 1
    return bool(4 * floats * width * lines >= _LEAST)


def encoded_by_openexr(parts: Sequence[Part]) -> memoryview:
    """Encode a file of any kind; raises as `encoded`."""
    made = [(_with_constant(header), _whole(planes)) for header, planes in parts]
    if len(made) == 1:
        file = OpenEXR.File(*made[0], num_threads=0)
    else:
        named = [OpenEXR.Part(*each, each[0].get("name", "")) for each in made]
        file = OpenEXR.File(named, num_threads=0)
    buffer = io.BytesIO()
    file.write(buffer)
    return buffer.getbuffer()


def _whole(planes: Planes) -> dict[str, np.ndarray]:
    return {n: p.rounded() if isinstance(p, Unrounded) else p for n, p in planes.items()}


def _with_constant(header: Header) -> dict[str, Any]:
    compression = header.get("compression")
    if isinstance(compression, Smaller):
        return {**header, "compression": compression.compression}
    return dict(header)


def _head(parts: Sequence[Part], counts: Sequence[int]) -> bytearray:
    """Return everything before the tables of chunks, of which each part has so many."""
    plain = encoded_by_openexr([_one_pixel(header, planes) for header, planes in parts])
    out, found = bytearray(plain), list(attributes_in(plain))
    for one in found:
        _put_back(out, one, parts[one.part][0], counts[one.part])
    return out[: found[-1].end + min(len(parts), 2)]


def _one_pixel(header: Header, planes: Planes) -> Part:
    first = np.asarray(header["dataWindow"][0], np.int32)
    pixels = {name: np.zeros((1, 1), plane.dtype) for name, plane in planes.items()}
    return {**header, "dataWindow": (first, first.copy())}, pixels


def _put_back(out: bytearray, one: Attribute, header: Header, chunks: int) -> None:
    if one.name == b"dataWindow":
        out[one.begin : one.end] = np.asarray(header["dataWindow"], "<i4").tobytes()
    elif one.name == b"chunkCount":
        out[one.begin : one.end] = struct.pack("<i", chunks)


Body = tuple[list[int], list[Buffer]]
"""Bytes of each of a part's chunks, from the top, with its head; and what they are made of."""


def _body(header: Header, planes: Planes, of_part: bytes) -> Body:
    """Make a part's chunks, whose heads begin with some bytes."""
    compression, top = header["compression"], int(header["dataWindow"][0][1])
    step = LINES[compression]
    channels = [planes[name] for name in sorted(planes, key=str.encode)]
    rows = ChannelRows(channels, _ROWS)
    if compression == OpenEXR.NO_COMPRESSION:
        return _stored(rows, top, of_part)
    sizes: list[int] = []
    pieces: list[Buffer] = []
    made = _pxr24(rows, channels) if compression == OpenEXR.PXR24_COMPRESSION else _zip(rows, step)
    for y, data in zip(range(0, rows.height, step), made, strict=True):
        size, plain = sum(map(len, data)), rows.line_size * min(step, rows.height - y)
        # What is as large as its pixels is taken for the pixels themselves.
        if size >= plain:
            size, data = plain, [_plain(rows, y, step)]
        pieces.append(b"".join([of_part, struct.pack("<ii", top + y, size), *data]))
        sizes.append(len(pieces[-1]))
    return sizes, pieces


def _stored(rows: ChannelRows, top: int, of_part: bytes) -> Body:
    """Put scan lines into chunks as they are, a line in each."""
    head = len(of_part) + 8
    out = np.empty((rows.height, head + rows.line_size), np.uint8)
    heads = b"".join(
        of_part + struct.pack("<ii", y, rows.line_size) for y in range(top, top + rows.height)
    )
    out[:, :head] = np.frombuffer(heads, np.uint8).reshape(rows.height, head)
    for y in range(0, rows.height, _ROWS):
        rows.put(y, out.view(np.uint16)[y : y + _ROWS, head // 2 :])
    return [out.shape[1]] * rows.height, [out.data.cast("B")]


def _plain(rows: ChannelRows, y: int, step: int) -> bytes:
    """Return the bytes of a chunk's lines as they are."""
    out = np.empty((min(step, rows.height - y), rows.line_size // 2), np.uint16)
    rows.put(y, out)
    return out.tobytes()


def _zip(rows: ChannelRows, step: int) -> Iterator[list[bytes]]:
    """Yield chunks of so many lines, compressed."""
    plain = np.empty((min(_ROWS, rows.height), rows.line_size // 2), np.uint16)
    filtered = np.empty(plain.nbytes, np.uint8)
    chunk = step * rows.line_size
    for y in range(0, rows.height, _ROWS):
        band = plain[: rows.height - y]
        rows.put(y, band)
        halves(band.reshape(-1), chunk // 2, filtered)
        for start in range(0, band.nbytes, chunk):
            yield _deflated_halves(filtered.data[start : min(start + chunk, band.nbytes)])


def _pxr24(rows: ChannelRows, channels: Sequence[Channel]) -> Iterator[list[bytes]]:
    """Yield chunks of channels, compressed.

    A code for each plane of a line would save 4 %, at three times the time.
    """
    sizes = [3 if channel.dtype == np.float32 else channel.dtype.itemsize for channel in channels]
    planes = np.empty((min(_ROWS, rows.height), rows.width * sum(sizes)), np.uint8)
    for y in range(0, rows.height, _ROWS):
        chunk, at = planes[: rows.height - y], 0
        for channel, size in zip(rows.rows(y, len(chunk)), sizes, strict=True):
            _RISES[size](channel.view(np.uint16 if size == 2 else np.uint32), at, chunk)
            at += size * rows.width
        yield _deflated(chunk.data.cast("B"))


_RISES = {2: halfs24, 3: floats24, 4: uints24}
"""Kernels of PXR24, by the bytes that they write of a pixel."""


def _deflated_halves(data: memoryview) -> list[bytes]:
    """Compress bytes of two kinds, each half with a code of its own: 6 % smaller, at no cost."""
    half = len(data) // 2
    return _deflated(data[:half], data[half:]) if half >= _OWN_CODE else _deflated(data)


def _deflated(*pieces: memoryview) -> list[bytes]:
    """Compress bytes that are not empty, each piece with a code of its own.

    The very first bytes are flushed alone. Where ISA-L (2.32) begins with more than 16 bytes, it
    hashes the address of its own state in place of the third position's bytes, and one stream in
    thousands differs from that of the same bytes in another thread or process. Of 4 to 16 bytes
    another routine takes care, and what follows begins with a history; 3 or fewer leave none.
    """
    stream = isal_zlib.compressobj(LEVEL)
    made = [stream.compress(pieces[0][:_ALONE])]
    for piece in (pieces[0][_ALONE:], *pieces[1:]):
        made += [stream.flush(isal_zlib.Z_SYNC_FLUSH), stream.compress(piece)]
    return [*made, stream.flush()]
