"""Encoding scan-line EXR files: OpenEXR's header, and chunks that are compressed here.

OpenEXR writes the header of a file of one pixel; the windows and chunks of the real one are put
into it. So every attribute stands there as OpenEXR writes it, of any type. The chunks hold the same
bits as OpenEXR's, but ISA-L deflates them, not libdeflate at its level 4.

Milliseconds of one core and size for a frame of four half channels, here and in OpenEXR, as
`tests.bench.bench_exr` has it:

=====  ============  ============  ============  ============  ============  ============
..     1080p render                1080p noise                 1080p, flat
-----  --------------------------  --------------------------  --------------------------
ZIP    32 ms 0.463   175 ms 0.446  45 ms 0.823   209 ms 0.825  9 ms 0.003    64 ms 0.003
ZIPS   62 ms 0.461   127 ms 0.475  78 ms 0.826   184 ms 0.835  15 ms 0.009   70 ms 0.007
PXR24  44 ms 0.491   143 ms 0.477  76 ms 0.906   262 ms 0.918  12 ms 0.004   39 ms 0.003
=====  ============  ============  ============  ============  ============  ============

Only float layers of flat shapes grow noticeably (depth: 0.231 instead of 0.183 of its size).
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import OpenEXR
from isal import isal_zlib

from exwarp_cli.io.header_text import Attribute, attributes_in
from exwarp_cli.kernels.exr_lines import floats24, halfs24, halves, uints24

Header = Mapping[str, Any]
Planes = Mapping[str, np.ndarray]
Part = tuple[Header, Planes]

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

_OWN_CODE = 1024
"""Least bytes of a kind that are worth a code of their own."""


@dataclass(frozen=True)
class Smaller:
    """A compression whose chunks OpenEXR makes: smaller, in several times the time."""

    compression: Any


def encoded(parts: Sequence[Part]) -> bytes | memoryview:
    """Encode a file in memory.

    One thread does it: frames are written side by side, which shares the cores better.

    Parameters
    ----------
    parts
        Header and channels [H, W] of each. The compression may be a `Smaller` one.

    Raises
    ------
    RuntimeError, ValueError, TypeError
        When OpenEXR refuses it.
    """
    if not all(is_encoded_here(header, planes) for header, planes in parts):
        return encoded_by_openexr(parts)
    chunks = [list(_chunks(header, planes)) for header, planes in parts]
    out = _head(parts, [len(each) for each in chunks])
    at = len(out) + 8 * sum(map(len, chunks))
    pieces: list[Any] = []
    starts: list[int] = []
    for number, each in enumerate(chunks):
        of_part = struct.pack("<i", number) if len(parts) > 1 else b""
        for line, data in each:
            starts.append(at)
            pieces += [of_part, struct.pack("<ii", line, len(data)), data]
            at += len(of_part) + 8 + len(data)
    return b"".join([out, struct.pack(f"<{len(starts)}Q", *starts), *pieces])


def is_encoded_here(header: Header, planes: Planes) -> bool:
    """Whether a part is one whose chunks are made here; else OpenEXR makes the file."""
    compression, arrays = header.get("compression"), list(planes.values())
    if compression not in LINES or header.get("type") != OpenEXR.scanlineimage:
        return False
    if "lineOrder" in header or not {"dataWindow", "displayWindow"} <= header.keys():
        return False
    shapes = {array.shape for array in arrays}
    if len(shapes) != 1 or any(a.dtype not in TYPES or a.ndim != 2 or not a.size for a in arrays):
        return False
    floats = sum(array.dtype == np.float32 for array in arrays)
    if compression != OpenEXR.PXR24_COMPRESSION or not floats:
        return True
    ((height, width),) = shapes
    lines = (height - 1) % LINES[compression] + 1
    return bool(4 * floats * width * lines >= _LEAST)


def encoded_by_openexr(parts: Sequence[Part]) -> memoryview:
    """Encode a file of any kind; raises as `encoded`."""
    made = [(_with_constant(header), dict(planes)) for header, planes in parts]
    if len(made) == 1:
        file = OpenEXR.File(*made[0], num_threads=0)
    else:
        named = [OpenEXR.Part(*each, each[0].get("name", "")) for each in made]
        file = OpenEXR.File(named, num_threads=0)
    buffer = io.BytesIO()
    file.write(buffer)
    return buffer.getbuffer()


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


def _chunks(header: Header, planes: Planes) -> Iterator[tuple[int, Any]]:
    """Yield a part's chunks from the top: the first line's number, and the bytes."""
    arrays = [np.ascontiguousarray(planes[name]) for name in sorted(planes, key=str.encode)]
    compression, top = header["compression"], int(header["dataWindow"][0][1])
    step = LINES[compression]
    if compression == OpenEXR.NO_COMPRESSION:
        yield from ((top + y, line.data) for y, line in enumerate(_lines(arrays)))
        return
    made = _pxr24(arrays) if compression == OpenEXR.PXR24_COMPRESSION else _zip(arrays, step)
    size = sum(array[:1].nbytes for array in arrays)
    for y, data in zip(range(0, len(arrays[0]), step), made, strict=True):
        rows = [array[y : y + step] for array in arrays]
        # What is as large as its pixels is taken for the pixels themselves.
        fits = len(data) < size * len(rows[0])
        yield top + y, data if fits else _lines(rows).data.cast("B")


def _lines(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Return the bytes of scan lines, uint8 [H, L]: in each, a channel after the other."""
    return np.concatenate([array.view(np.uint8) for array in arrays], axis=1)


def _zip(arrays: Sequence[np.ndarray], step: int) -> Iterator[bytes]:
    """Yield chunks of so many lines of channels [H, W], compressed."""
    lines = _lines(arrays)
    chunk = step * lines.shape[1]
    filtered = np.empty(lines.size, np.uint8)
    halves(lines.reshape(-1), chunk, filtered)
    data = filtered.data
    for start in range(0, lines.size, chunk):
        yield _deflated_halves(data[start : start + chunk])


def _pxr24(arrays: Sequence[np.ndarray]) -> Iterator[bytes]:
    """Yield chunks of channels [H, W], compressed.

    A code for each plane of a line would save 4 %, at three times the time.
    """
    height, width = arrays[0].shape
    sizes = [3 if array.dtype == np.float32 else array.dtype.itemsize for array in arrays]
    lines = np.empty((height, width * sum(sizes)), np.uint8)
    at = 0
    for array, size in zip(arrays, sizes, strict=True):
        bits = array.view(np.uint16 if size == 2 else np.uint32)
        _RISES[size](bits, lines[:, at : at + size * width])
        at += size * width
    step = LINES[OpenEXR.PXR24_COMPRESSION]
    for y in range(0, height, step):
        yield _deflated(lines[y : y + step].data.cast("B"))


_RISES = {2: halfs24, 3: floats24, 4: uints24}
"""Kernels of PXR24, by the bytes that they write of a pixel."""


def _deflated_halves(data: memoryview) -> bytes:
    """Compress bytes of two kinds, each half with a code of its own: 6 % smaller, at no cost."""
    half = len(data) // 2
    return _deflated(data[:half], data[half:]) if half >= _OWN_CODE else _deflated(data)


def _deflated(*pieces: memoryview) -> bytes:
    """Compress bytes that are not empty, each piece with a code of its own.

    The very first byte is flushed alone. Where ISA-L (2.32) begins with more than 16 bytes, it
    hashes the address of its own state in place of the third position's bytes, and one stream in
    thousands differs from that of the same bytes in another thread or process. Of one byte another
    routine takes care, and what follows begins with a history.
    """
    stream = isal_zlib.compressobj(LEVEL)
    made = [stream.compress(pieces[0][:1])]
    for piece in (pieces[0][1:], *pieces[1:]):
        made += [stream.flush(isal_zlib.Z_SYNC_FLUSH), stream.compress(piece)]
    return b"".join([*made, stream.flush()])
