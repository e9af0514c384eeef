"""Encoding scan-line EXR files: OpenEXR's header, and blocks that are compressed here.

OpenEXR writes the header of a file of one pixel; the windows and chunks of the real one are put
into it. So every attribute stands there as OpenEXR writes it, of any type. The blocks hold the same
bits as OpenEXR's, but ISA-L deflates them, not libdeflate at its level 4. Other compressions than
ZIP and ZIPS are OpenEXR's.

Time as a multiple of OpenEXR's, and size as a share of the pixels' bytes here and there, for a
frame of four half channels at 1920x1080; ours begins with floats, OpenEXR with halfs that are
rounded already (`tests.bench.bench_exr`):

====  =================  =================  =================
..    render             noise              flat
====  =================  =================  =================
ZIP   0.22  0.464 0.448  0.24  0.823 0.825  0.17  0.003 0.003
ZIPS  0.50  0.463 0.477  0.49  0.826 0.835  0.45  0.009 0.007
====  =================  =================  =================

Only float layers of flat shapes grow noticeably (depth: 0.231 instead of 0.183 of its size).
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import OpenEXR
from isal import isal_zlib

from exwarp_cli.domain.frame import Float32, Window
from exwarp_cli.io.exr.header import COMPRESSION_NAMES, attributes_in
from exwarp_cli.kernels.exr_filters import predict, round_to_half
from exwarp_cli.runtime.frame_pool import pool

U16 = npt.NDArray[np.uint16]
U32 = npt.NDArray[np.uint32]

# OpenEXR's constants, as headers have them, by name.
COMPRESSIONS: dict[str, Any] = {
    "none": OpenEXR.NO_COMPRESSION,
    **{name: getattr(OpenEXR, f"{name.upper()}_COMPRESSION") for name in COMPRESSION_NAMES[1:]},
}

# Scan lines of a block, by the compressions that are encoded here.
LINES: dict[Any, int] = {OpenEXR.ZIPS_COMPRESSION: 1, OpenEXR.ZIP_COMPRESSION: 16}

DTYPES = (np.dtype(np.float16), np.dtype(np.float32), np.dtype(np.uint32))

LEVEL = 1  # of ISA-L's DEFLATE: 2 makes no smaller files, 3 takes twice the time for 1 % less
FLUSHED_ALONE = 4  # bytes at the beginning of a stream; see `deflate_stream`

_MIN_OWN_CODE = 1024  # bytes of a kind that are worth a code of their own
_BAND_ROWS = 16  # are prepared at once, whole blocks of them: they stay in the processor's cache


@dataclass(frozen=True)
class OpenExrCompression:
    """A compression whose chunks OpenEXR makes: smaller, in several times the time."""

    compression: Any


@dataclass(frozen=True)
class PendingHalf:
    """A channel of halfs that is still one of floats."""

    values: Float32  # float32 [H, W], of any strides
    bounded: bool  # whether values beyond half's range become its largest; else infinity

    dtype = np.dtype(np.float16)

    @property
    def shape(self) -> tuple[int, ...]:
        """Height and width."""
        return self.values.shape

    def rounded(self) -> np.ndarray:
        """Return the halfs [H, W]."""
        out = pool.empty(self.shape, np.uint16)
        round_to_half(_float_bits(self.values), self.bounded, out)
        return out.view(np.float16)


# A channel [H, W] to be written, of halfs, floats or integers.
OutputChannel: TypeAlias = np.ndarray | PendingHalf

Header: TypeAlias = Mapping[str, Any]
OutputPart: TypeAlias = tuple[Header, Mapping[str, OutputChannel]]
Buffer: TypeAlias = bytes | bytearray | memoryview


def scanline_attributes(data: Window, display: Window) -> dict[str, Any]:
    """Return the attributes of a scan-line part with these windows."""

    def box(window: Window) -> tuple[np.ndarray, np.ndarray]:
        x0, y0, x1, y1 = window.corners
        return np.array([x0, y0], np.int32), np.array([x1, y1], np.int32)

    return {"type": OpenEXR.scanlineimage, "dataWindow": box(data), "displayWindow": box(display)}


def encode(parts: Sequence[OutputPart]) -> list[Buffer]:
    """Encode a file in memory, of header and channels [H, W] of each part.

    A header's compression may be an `OpenExrCompression`. Returns the file in pieces; the first
    holds the headers, and can be changed. Raises RuntimeError, ValueError or TypeError when OpenEXR
    refuses it.
    """
    if not all(is_encoded_here(header, planes) for header, planes in parts):
        return [encode_by_openexr(parts)]
    is_multipart = len(parts) > 1
    bodies = [
        _encode_blocks(header, planes, struct.pack("<i", number) if is_multipart else b"")
        for number, (header, planes) in enumerate(parts)
    ]
    head = _encode_headers(parts, [len(blocks) for blocks in bodies])
    blocks = [block for body in bodies for block in body]
    starts = accumulate(map(len, blocks[:-1]), initial=len(head) + 8 * len(blocks))
    head += struct.pack(f"<{len(blocks)}Q", *starts)
    return [head, *blocks]


def is_encoded_here(header: Header, planes: Mapping[str, OutputChannel]) -> bool:
    """Return whether the blocks of a part are made here; else OpenEXR makes the file."""
    if header.get("compression") not in LINES or header.get("type") != OpenEXR.scanlineimage:
        return False
    if "lineOrder" in header or not {"dataWindow", "displayWindow"} <= header.keys():
        return False
    shapes = {channel.shape for channel in planes.values()}
    if len(shapes) != 1 or any(channel.dtype not in DTYPES for channel in planes.values()):
        return False
    (shape,) = shapes
    return len(shape) == 2 and 0 not in shape


def encode_by_openexr(parts: Sequence[OutputPart]) -> memoryview:
    """Encode a file of any kind; raises as `encode`."""
    complete = []
    for header, planes in parts:
        compression = header.get("compression")
        if isinstance(compression, OpenExrCompression):
            header = {**header, "compression": compression.compression}
        arrays = {n: p.rounded() if isinstance(p, PendingHalf) else p for n, p in planes.items()}
        complete.append((dict(header), arrays))
    if len(complete) == 1:
        file = OpenEXR.File(*complete[0], num_threads=0)
    else:
        named = [OpenEXR.Part(*part, part[0].get("name", "")) for part in complete]
        file = OpenEXR.File(named, num_threads=0)
    buffer = io.BytesIO()
    file.write(buffer)
    return buffer.getbuffer()


def _encode_headers(parts: Sequence[OutputPart], counts: Sequence[int]) -> bytearray:
    """Return everything before the chunk offset tables, of which each part has so many entries."""
    # OpenEXR encodes a file of one pixel, and the window and number of chunks are put into it.
    one_pixel_parts = []
    for header, planes in parts:
        corner = np.asarray(header["dataWindow"][0], np.int32)
        pixels = {name: np.zeros((1, 1), plane.dtype) for name, plane in planes.items()}
        one_pixel_parts.append(({**header, "dataWindow": (corner, corner.copy())}, pixels))
    data = encode_by_openexr(one_pixel_parts)
    out, attributes = bytearray(data), list(attributes_in(data))
    for attribute in attributes:
        if attribute.name == b"dataWindow":
            window = np.asarray(parts[attribute.part][0]["dataWindow"], "<i4")
            out[attribute.begin : attribute.end] = window.tobytes()
        elif attribute.name == b"chunkCount":
            out[attribute.begin : attribute.end] = struct.pack("<i", counts[attribute.part])
    return out[: attributes[-1].end + min(len(parts), 2)]


def _encode_blocks(
    header: Header, planes: Mapping[str, OutputChannel], part_number: bytes
) -> list[Buffer]:
    """Encode a part's blocks from the top, each of which begins with the part's number."""
    # Halfs stay floats until their rows are due. So a frame is rounded, filtered and compressed
    # band by band, while it is in the processor's cache: half the time that passes over whole
    # frames take, and 50 MB less memory at 1920x1080.
    channels = [planes[name] for name in sorted(planes, key=str.encode)]
    height, width = channels[0].shape
    line_size = width * sum(channel.dtype.itemsize for channel in channels)
    block_size = LINES[header["compression"]] * line_size
    halfs = np.empty((min(_BAND_ROWS, height), width), np.uint16)
    lines = np.empty((len(halfs), line_size // 2), np.uint16)
    filtered = np.empty(lines.nbytes, np.uint8)
    top = int(header["dataWindow"][0][1])
    blocks: list[Buffer] = []
    for y in range(0, height, _BAND_ROWS):
        band = lines[: height - y]
        _fill_lines(channels, y, halfs, band)
        predict(band.reshape(-1), block_size // 2, filtered)
        for start in range(0, band.nbytes, block_size):
            data = filtered.data[start : min(start + block_size, band.nbytes)]
            half = len(data) // 2
            # Even and odd bytes with a code each: 6 % smaller, at no cost.
            deflated = deflate_stream(
                *((data[:half], data[half:]) if half >= _MIN_OWN_CODE else (data,))
            )
            size, row = sum(map(len, deflated)), start // line_size
            if size >= len(data):  # readers take a block of that size for the pixels themselves
                size = len(data)
                deflated = [band[row : row + size // line_size].tobytes()]
            leader = struct.pack("<ii", top + y + row, size)
            blocks.append(b"".join([part_number, leader, *deflated]))
    return blocks


def _fill_lines(channels: Iterable[OutputChannel], top: int, halfs: U16, lines: U16) -> None:
    """Write rows from `top` on as a file has them uncompressed: in each, channel after channel.

    `lines` are pairs of bytes [rows, N], `halfs` is scratch memory [rows or more, W].
    """
    column, rows = 0, slice(top, top + len(lines))
    for channel in channels:
        if isinstance(channel, PendingHalf):
            pairs = halfs[: len(lines)]
            round_to_half(_float_bits(channel.values[rows]), channel.bounded, pairs)
        else:
            pairs = np.ascontiguousarray(channel[rows]).view(np.uint16)
        lines[:, column : column + pairs.shape[1]] = pairs
        column += pairs.shape[1]


def deflate_stream(*pieces: memoryview) -> list[bytes]:
    """Compress bytes that are not empty, each piece with a code of its own, to one zlib stream."""
    # Where ISA-L (2.32) begins with more than 16 bytes, it hashes the address of its own state in
    # place of the third position's bytes: one stream in thousands differs from that of the same
    # bytes in another thread or process. Another routine takes care of 4 to 16 bytes, and what
    # follows begins with a history; 3 or fewer leave none. So the first 4 bytes are flushed alone.
    stream = isal_zlib.compressobj(LEVEL)
    out = [stream.compress(pieces[0][:FLUSHED_ALONE])]
    for piece in (pieces[0][FLUSHED_ALONE:], *pieces[1:]):
        out += [stream.flush(isal_zlib.Z_SYNC_FLUSH), stream.compress(piece)]
    return [*out, stream.flush()]


def _float_bits(values: Float32) -> U32:
    return np.ascontiguousarray(values).view(np.uint32)
