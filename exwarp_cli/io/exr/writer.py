"""Writing scan-line EXR files: what generated frames take over from key frames, and encoding.

A template lists the parts, channels, types and header attributes of a key frame's file. The header
may also contain how long the frame took to render: `render_seconds`.

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
import math
import re
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import OpenEXR
from isal import isal_zlib

from exwarp_cli.domain.frame import Float32, Window, nonfinite_pixels
from exwarp_cli.errors import LayoutError
from exwarp_cli.io.channels import ChannelRef
from exwarp_cli.io.display_colour import HALF_MAX
from exwarp_cli.io.exr.header import COMPRESSION_NAMES, Part, attributes_in
from exwarp_cli.io.exr.reader import HeaderCache, damaged_error
from exwarp_cli.io.layers import Layer, LayerKind
from exwarp_cli.io.views import list_views, view_channels
from exwarp_cli.kernels.exr_filters import predict, round_to_half
from exwarp_cli.runtime.frame_pool import pool

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

PREFIX = "exwarp:"  # of ExWarp's own attributes, which describe one generated frame

# Structure, which the writer sets itself; and what belongs to the source frame's own pixels.
_NOT_CARRIED = frozenset(
    [
        *("channels", "chunkCount", "dataWindow", "displayWindow", "lineOrder", "tiles", "type"),
        *("version", "compression", "view", "multiView", "maxSamplesPerPixel", "dataHash"),
        *("preview", "idManifest", "timeCode", "keyCode", "framesPerSecond"),
    ]
)

PIXEL_TYPES = {"half": np.float16, "float": np.float32, "uint": np.uint32}

# A channel of one view: the view's name, "" where there are none, and the channel in it.
PlaneKey = tuple[str, ChannelRef]

# Attributes with the render time: Blender's, V-Ray's, and those of Cycles' render layers.
BLENDER, VRAY = "RenderTime", "vrayInfo/rendertime"
_CYCLES_LAYER = re.compile(r"cycles\..*\.render_time", re.DOTALL)
_CLOCK = re.compile(r"(?:(?:(\d+):)?(\d+):)?(\d+(?:\.\d+)?)")
_UNITS = re.compile(r"(?:(\d+)h)?\s*(?:(\d+)m)?\s*(\d+(?:\.\d+)?)s")


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
        bits = np.ascontiguousarray(self.values).view(np.uint32)
        round_to_half(bits, self.bounded, out)
        return out.view(np.float16)


# A channel [H, W] to be written, of halfs, floats or integers.
OutputChannel: TypeAlias = np.ndarray | PendingHalf

Header: TypeAlias = Mapping[str, Any]
OutputPart: TypeAlias = tuple[Header, Mapping[str, OutputChannel]]
Buffer: TypeAlias = bytes | bytearray | memoryview


@dataclass(frozen=True)
class Plane:
    """One channel of a frame: values [H, W] of any type, and their window."""

    values: np.ndarray
    window: Window


@dataclass(frozen=True)
class ViewLayers:
    """The layers of one view of a shot that are written."""

    view: str  # its name; "" where there are none
    within: str  # which view of the files it is, as in :func:`exwarp_cli.io.views.view_channels`
    colour: tuple[ChannelRef, ...]  # R, G, B and, if there, A of the beauty
    layers: tuple[Layer, ...] = ()  # further layers; the beauty may be among them


@dataclass(frozen=True)
class PlaneTemplate:
    """One channel to write."""

    key: PlaneKey  # which one it is
    name: str  # as it stands in the file
    dtype: np.dtype[Any]  # pixel type: half, float or uint32
    # Whether values beyond the type's range become its largest; a depth may be infinite
    bounded: bool

    def channel(self, values: np.ndarray) -> OutputChannel:
        """Return values [H, W] in the channel's type; floats for halfs are rounded later.

        Bounded floats get the largest floats in place of infinity, and 0 for NaN.
        """
        if self.dtype == np.float32 and values.dtype == np.float32 and self.bounded:
            values = np.ascontiguousarray(values)
            return np.nan_to_num(values) if nonfinite_pixels(values[..., None]).any() else values
        if self.dtype != np.float16 or values.dtype == np.float16:
            return np.ascontiguousarray(values, dtype=self.dtype)
        if values.dtype == np.float32:
            return PendingHalf(values, self.bounded)
        if self.bounded:
            values = np.clip(values, -HALF_MAX, HALF_MAX)
        with np.errstate(over="ignore"):
            return np.ascontiguousarray(values, dtype=np.float16)


@dataclass(frozen=True)
class PartTemplate:
    """One part to write."""

    header: Mapping[str, Any]  # attributes to carry, with the part's compression
    planes: tuple[PlaneTemplate, ...]  # its channels
    window: Window  # the data window of the source's part


@dataclass(frozen=True)
class Template:
    """What a generated frame takes over from its key frame's file."""

    parts: tuple[PartTemplate, ...]  # in the order of the file, those of which something is written
    colour: tuple[PlaneTemplate, ...]  # the beauty of the leading view: R, G, B and, if there, A
    # Seconds that the key frame took to render, and the attribute with them; None if unknown
    render: tuple[float, str] | None = None


def read_template(
    path: Path, wanted: tuple[ViewLayers, ...], headers: HeaderCache | None = None
) -> Template:
    """Read what a generated frame takes over from the file of its key frame.

    Raises DamagedFileError when the header cannot be read, or a colour channel is missing. Raises
    LayoutError when a layer is missing.

    Parameters
    ----------
    path
        The key frame's file.
    wanted
        What is written of each view, the leading one first. A channel that several of them have
        in common is the first one's.
    headers
        Where the file's header may be kept; None to open the file.
    """
    header = (headers or HeaderCache()).read(path)
    parts, attributes = header.parts, header.attributes
    placed: dict[int, dict[int, PlaneTemplate]] = {}
    for layers in wanted:
        channels = view_channels(parts, layers.within)
        bounded = dict.fromkeys(layers.colour, True)
        for layer in layers.layers:
            for ref in layer.refs:
                bounded.setdefault(ref, layer.kind is not LayerKind.DEPTH)
        for ref, is_bounded in bounded.items():
            channel = channels.get(ref.name)
            if channel is None and ref in layers.colour:
                raise damaged_error(path, "its colour channels are gone")
            if channel is None:
                raise LayoutError(
                    f"{path} has no channel {ref.name!r}, which the sequence's first frame has; "
                    "render all frames with the same passes, or leave that layer out of --layers"
                )
            dtype = np.dtype(PIXEL_TYPES.get(channel.pixel_type, np.float32))
            plane = PlaneTemplate((layers.view, ref), channel.raw_name, dtype, is_bounded)
            placed.setdefault(channel.part, {}).setdefault(channel.index, plane)
    written_views = [layers.within for layers in wanted]
    part_templates = tuple(
        PartTemplate(
            _carried_header(attributes[index], parts, index, written_views),
            tuple(plane for _, plane in sorted(planes.items())),
            parts[index].data_window,
        )
        for index, planes in sorted(placed.items())
    )
    by_key = {plane.key: plane for part in part_templates for plane in part.planes}
    colour = tuple(by_key[wanted[0].view, ref] for ref in wanted[0].colour)
    return Template(part_templates, colour, render_seconds(attributes))


def _carried_header(
    header: Mapping[str, Any], parts: tuple[Part, ...], index: int, written_views: Iterable[str]
) -> dict[str, Any]:
    """Return the attributes that go over; of the views of one part those that are written."""
    carried = {
        name: value
        for name, value in header.items()
        if name not in _NOT_CARRIED and not name.startswith(PREFIX) and (name != "name" or value)
    }
    carried["compression"] = header["compression"]
    part = parts[index]
    if part.view:
        carried["view"] = part.view
        return carried
    # Views side by side in one part, the hero first.
    views = part.views or (list_views(parts) if len(parts) == 1 else ())
    written = {view or (views[0] if views else "") for view in written_views}
    if kept_views := [view for view in views if view in written]:
        carried["multiView"] = kept_views
    return carried


def render_seconds(headers: Iterable[Mapping[str, Any]]) -> tuple[float, str] | None:
    """Return how many seconds a frame took to render, and the attribute that contains it.

    None where no attribute contains it, or none is above 0. The headers are those of every part of
    the frame's file. Parts repeat the attributes of the whole frame, so the first one counts.
    """
    listed = list(headers)
    for name in (BLENDER, VRAY):
        for header in listed:
            seconds = parse_duration(header.get(name))
            if seconds:
                return seconds, name
    layers: dict[str, float] = {}
    for header in listed:
        for name, value in header.items():
            if _CYCLES_LAYER.fullmatch(name) and (seconds := parse_duration(value)):
                layers.setdefault(name, seconds)
    return (sum(layers.values()), "cycles.*.render_time") if layers else None


def parse_duration(value: object) -> float | None:
    """Read ``01:02:03.45``, ``02:03.45``, ``0h 28m 39.3s`` or a number of seconds; else None."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value) if math.isfinite(value) and value >= 0 else None
    if not isinstance(value, str):
        return None
    text = value.strip()
    match = _CLOCK.fullmatch(text) or _UNITS.fullmatch(text)
    if match is None:
        return None
    hours, minutes, seconds = match.groups()
    return 3600.0 * int(hours or 0) + 60.0 * int(minutes or 0) + float(seconds)


def scanline_attributes(data: Window, display: Window) -> dict[str, Any]:
    """Return the attributes of a scan-line part with these windows."""
    boxes = np.array([data.corners, display.corners], np.int32).reshape(2, 2, 2)
    return {
        "type": OpenEXR.scanlineimage,
        "dataWindow": tuple(boxes[0]),
        "displayWindow": tuple(boxes[1]),
    }


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
    # OpenEXR encodes a file of one pixel, and the window and number of chunks are put into it.
    one_pixel_parts = []
    for header, planes in parts:
        corner = np.asarray(header["dataWindow"][0], np.int32)
        pixels = {name: np.zeros((1, 1), plane.dtype) for name, plane in planes.items()}
        one_pixel_parts.append(({**header, "dataWindow": (corner, corner.copy())}, pixels))
    data = encode_by_openexr(one_pixel_parts)
    head, attributes = bytearray(data), list(attributes_in(data))
    for attribute in attributes:
        if attribute.name == b"dataWindow":
            window = np.asarray(parts[attribute.part][0]["dataWindow"], "<i4")
            head[attribute.begin : attribute.end] = window.tobytes()
        elif attribute.name == b"chunkCount":
            head[attribute.begin : attribute.end] = struct.pack("<i", len(bodies[attribute.part]))
    del head[attributes[-1].end + min(len(parts), 2) :]
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
        # In each row channel after channel, as a file has them uncompressed.
        column, rows = 0, slice(y, y + len(band))
        for channel in channels:
            if isinstance(channel, PendingHalf):
                pairs = halfs[: len(band)]
                bits = np.ascontiguousarray(channel.values[rows]).view(np.uint32)
                round_to_half(bits, channel.bounded, pairs)
            else:
                pairs = np.ascontiguousarray(channel[rows]).view(np.uint16)
            band[:, column : column + pairs.shape[1]] = pairs
            column += pairs.shape[1]
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
