"""Headers of OpenEXR files: their attributes, parts and channels.

OpenEXR's bindings only take headers whose text is all UTF-8, in and out. Other text goes through
them as a stand-in of the same length, and its bytes are put back: in Python as lone surrogates, in
a file as they were.
"""

from __future__ import annotations

import io
import re
import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, BinaryIO

import OpenEXR

from exwarp_cli.domain.frame import Window

MAGIC = b"\x76\x2f\x31\x01"
PNG = b"\x89PNG\r\n\x1a\n"

# Bits of the version: tiles in a single part, long names, deep parts, several headers.
TILED, LONG_NAMES, DEEP, MULTIPART = 0x0200, 0x0400, 0x0800, 0x1000

BODY = 8  # where the first header begins: after the magic number and the version

# Bytes that are read for headers at first and at last. Cryptomatte's manifests take megabytes.
FIRST_READ, LAST_READ = 1 << 16, 1 << 26

# Compressions by their number in a header.
COMPRESSION_NAMES = ("none", "rle", "zips", "zip", "piz", "pxr24", "b44", "b44a", "dwaa", "dwab")

UINT, HALF, FLOAT = 0, 1, 2
PIXEL_TYPES = {UINT: "uint", HALF: "half", FLOAT: "float"}

# Type and value of each attribute of a header, by name.
Values = Mapping[bytes, tuple[bytes, bytes]]

# First bytes of files, and what is said of their format.
SIGNATURES = (
    (MAGIC, "openexr"),
    (PNG, "png"),
    (b"\xff\xd8\xff", "jpeg"),
    (b"II*\0", "tiff"),
    (b"MM\0*", "tiff"),
    (b"SDPX", "dpx"),
    (b"XPDS", "dpx"),
    (b"#?R", "hdr"),
    (b"BM", "bmp"),
    (b"GIF8", "gif"),
    (b"8BPS", "psd"),
    (b"RIFF", "riff"),
    (b"\xff\x0a", "jpeg xl"),
    (b"\0\0\0\x0cjP", "jpeg 2000"),
    (b"\0\0\0\x0cJXL", "jpeg xl"),
)
SIGNATURE_BYTES = max(len(signature) for signature, _ in SIGNATURES)

# Last elements of names that OpenImageIO sorts first: in a usual layer, and in one of a vector.
_CHANNEL_ORDER = (
    b"r red g green b blue y real imag a alpha ar ra ag ga ab ba z depth zback".split(),
    b"r red g green b blue x y z real imag a alpha ar ra ag ga ab ba depth zback".split(),
)

_LONE_SURROGATE = re.compile("[\udc80-\udcff]")
_STAND_IN = "\x01"


@dataclass(frozen=True)
class Attribute:
    """One attribute of a header, as it stands in a file."""

    part: int  # index of the header
    # Its name, type and value
    name: bytes
    kind: bytes
    value: bytes
    # Where the name begins, and where the value begins and ends
    at: int
    begin: int
    end: int


def attributes_in(data: bytes | memoryview) -> Iterator[Attribute]:
    """Yield the attributes of every header in a file, or in as much of it as holds all headers.

    Raises ValueError when it is no OpenEXR file, or a header has no end.
    """
    data = bytes(data)
    if data[:4] != MAGIC or len(data) < BODY:
        raise ValueError("no OpenEXR file")
    is_multipart = bool(int.from_bytes(data[4:BODY], "little") & MULTIPART)
    at, part = BODY, 0
    while True:
        if data[at : at + 1] == b"\0":
            at, part = at + 1, part + 1
            if not is_multipart or data[at : at + 1] == b"\0":
                return
        kind_at = data.index(b"\0", at) + 1
        size_at = data.index(b"\0", kind_at) + 1
        begin = size_at + 4
        end = begin + int.from_bytes(data[size_at:begin], "little")
        if end > len(data):
            raise ValueError("the header has no end")
        name, kind = data[at : kind_at - 1], data[kind_at : size_at - 1]
        yield Attribute(part, name, kind, data[begin:end], at, begin, end)
        at = end


@dataclass(frozen=True)
class RawHeader:
    """The headers of a file, one for each part."""

    data: bytes  # the file's bytes up to the chunk offset tables
    attributes: tuple[Attribute, ...]  # of all parts, in the order of the file; at least one
    flags: int  # bits of the version field, with the version's number in the lowest byte

    @classmethod
    def read(cls, file: BinaryIO, size: int) -> RawHeader:
        """Read the headers of an unbuffered file of `size` bytes, from its beginning.

        Raises ValueError when it is no OpenEXR file, or a header has no end. Raises OSError when
        the system does not let the file through.
        """
        length = FIRST_READ
        while True:
            file.seek(0)
            data = b""
            while len(data) < min(length, size) and (piece := file.read(min(length, size))):
                data += piece
            try:
                attributes = tuple(attributes_in(data))
                break
            except ValueError:
                if length >= min(size, LAST_READ):
                    raise
                length *= 8
        if not attributes:
            raise ValueError("a header is empty")
        flags = int.from_bytes(data[4:BODY], "little")
        end = attributes[-1].end + 1 + bool(flags & MULTIPART)
        return cls(data[:end], attributes, flags)

    @property
    def part_count(self) -> int:
        """Number of parts."""
        return self.attributes[-1].part + 1

    def by_part(self) -> list[dict[bytes, tuple[bytes, bytes]]]:
        """Return type and value of each part's attributes by name.

        Raises ValueError when a part has two attributes of a name.
        """
        headers: list[dict[bytes, tuple[bytes, bytes]]] = [{} for _ in range(self.part_count)]
        for attribute in self.attributes:
            if attribute.name in headers[attribute.part]:
                raise ValueError("an attribute is there twice")
            headers[attribute.part][attribute.name] = attribute.kind, attribute.value
        return headers

    @cached_property
    def typed(self) -> tuple[dict[str, Any], ...]:
        """The attributes of each part as OpenEXR's bindings have them.

        Text that is no UTF-8 keeps its bytes as lone surrogates. Attributes with such names, and
        lists of such texts, are left out.

        Raises RuntimeError, ValueError or ArithmeticError when OpenEXR refuses the header.
        """
        data, changed = in_utf8(self.data)
        opaque = OpenEXR.OpaqueAttribute  # which OpenEXR cannot write back
        # From memory, so that the file is not opened once more.
        with OpenEXR.File(io.BytesIO(data), header_only=True) as file:
            headers = tuple(
                {n: v for n, v in part.header.items() if not isinstance(v, opaque)}
                for part in file.parts
            )
        for (part, name), text in changed.items():
            if text is not None:
                headers[part][name] = text
            else:
                headers[part].pop(name, None)
        return headers


def in_utf8(data: bytes) -> tuple[bytes, dict[tuple[int, str], str | None]]:
    """Return a file whose headers are all UTF-8, and the attributes that this changed.

    `data` is the file, or all of its headers; the result has the same length. The changed
    attributes are listed by part and new name, with their text in lone surrogates, or None where
    text cannot hold them. Raises ValueError as `attributes_in` does.
    """
    out = bytearray(data)
    changed: dict[tuple[int, str], str | None] = {}
    for attribute in attributes_in(data):
        is_text = attribute.kind in (b"string", b"stringvector")
        name, value = decode(attribute.name), decode(attribute.value) if is_text else ""
        new_name, new_value = replace_non_utf8(name), replace_non_utf8(value)
        if new_value != value:
            out[attribute.begin : attribute.end] = new_value.encode()
        if new_name != name:
            out[attribute.at : attribute.at + len(attribute.name)] = new_name.encode()
            changed[attribute.part, new_name] = None
        elif new_value != value:
            changed[attribute.part, name] = value if attribute.kind == b"string" else None
    return bytes(out), changed


def replace_non_utf8(text: str) -> str:
    """Return text that can be written as UTF-8: of the same length there, and mostly the same."""
    try:
        text.encode()  # takes a tenth of a search; manifests have megabytes
    except UnicodeEncodeError:
        return _LONE_SURROGATE.sub(_STAND_IN, text)
    return text


def restore_non_utf8(
    data: bytes | memoryview, headers: Iterable[Mapping[str, object]]
) -> bytes | memoryview:
    """Put the bytes back that `replace_non_utf8` replaced in a file.

    `headers` are those of each part, with text that may hold lone surrogates.
    """
    lost = {
        (part, name.encode()): value.encode("utf-8", "surrogateescape")
        for part, header in enumerate(headers)
        for name, value in header.items()
        if isinstance(value, str) and replace_non_utf8(value) != value
    }
    if not lost:
        return data
    out = bytearray(data)
    for attribute in attributes_in(data):
        raw = lost.get((attribute.part, attribute.name))
        if raw is not None and len(raw) == len(attribute.value):
            out[attribute.begin : attribute.end] = raw
    return bytes(out)


def channels_in(value: bytes) -> Iterator[tuple[bytes, int, tuple[int, int]]]:
    """Yield name, pixel type, and steps across and down of each channel of a list.

    Raises ValueError when the list is cut off, or bytes follow it.
    """
    at = 0
    while value[at : at + 1] not in (b"", b"\0"):
        end = value.index(b"\0", at)
        if end + 17 > len(value):
            break
        kind, across, down = struct.unpack_from("<i4x2i", value, end + 1)
        yield value[at:end], kind, (across, down)
        at = end + 17
    if value[at:] != b"\0":
        raise ValueError("the list of channels has no end")


def decode(raw: bytes) -> str:
    """Return text, in which bytes that are no UTF-8 are lone surrogates."""
    return raw.decode("utf-8", "surrogateescape")


@dataclass(frozen=True)
class Channel:
    """One channel of one part."""

    part: int  # index of the part in the file
    index: int  # index of the channel in the part, in OpenImageIO's order
    name: str  # as `name_channels` sets it
    raw_name: str  # name as it stands in the file
    pixel_type: str  # "half", "float" or "uint"


@dataclass(frozen=True)
class Part:
    """One part of a file."""

    # Position in the file, and the part's name ("" in single-part files)
    index: int
    name: str
    # In OpenEXR's coordinates
    data_window: Window
    display_window: Window
    channels: tuple[Channel, ...]  # in OpenImageIO's order
    view: str  # name of the stereo view, "" where there is none
    deep: bool  # whether the part holds deep samples
    tiled: bool = False  # whether it is stored in tiles; of several levels the full one is read
    # Views whose channels lie in this one part, the hero first: the attribute ``multiView``
    views: tuple[str, ...] = ()


def describe_part(
    index: int,
    attributes: Mapping[str, Any],
    windows: tuple[Window, Window],
    channels: Iterable[tuple[str, str]],
    is_multipart: bool,
    deep: bool,
    tiled: bool,
) -> Part:
    """Describe a part by its attributes, its windows of data and display, and its channels.

    Of each channel, in OpenImageIO's order, the raw name and the pixel type are given.
    """
    name, view = (
        value.partition("\0")[0] if isinstance(value := attributes.get(key), str) else ""
        for key in ("name", "view")
    )
    views = attributes.get("multiView")
    if isinstance(views, str):  # a list of one string
        views = (views,) if views else ()
    return Part(
        index,
        name if is_multipart else "",
        *windows,
        tuple(Channel(index, i, name, name, kind) for i, (name, kind) in enumerate(channels)),
        view,
        deep,
        tiled,
        tuple(str(v) for v in views) if isinstance(views, (tuple, list)) else (),
    )


def window_of(values: Values, name: bytes) -> Window:
    """Return a window of a header."""
    left, top, right, bottom = struct.unpack("<4i", values[name][1])
    return Window(left, top, right - left + 1, bottom - top + 1)


def in_openimageio_order(channels: Iterable[tuple[bytes, int]]) -> list[tuple[str, str]]:
    """Sort names and pixel types of channels as OpenImageIO does: layer by layer, RGBA first.

    Raises ValueError when OpenImageIO takes them for luminance and chroma, and gives them other
    names.
    """
    layers: dict[bytes, dict[bytes, tuple[bytes, int]]] = {}
    for name, kind in channels:
        dot = name.rfind(b".") + 1
        layers.setdefault(name[:dot], {})[name[dot:]] = name, kind
    if {b"y", b"ry", b"by"} <= {last.lower() for layer in layers.values() for last in layer}:
        raise ValueError("luminance and chroma")
    ordered: list[tuple[bytes, int]] = []
    for _, layer in sorted(layers.items()):
        letters = {last.lower() for last in layer}
        is_vector = b"x" in letters and bool(letters & {b"y", b"z"})
        rank = {last: i for i, last in enumerate(_CHANNEL_ORDER[is_vector])}
        names = sorted(layer, key=lambda last: (rank.get(last.lower(), len(rank)), last))
        ordered += [layer[last] for last in names]
    return [(decode(name), PIXEL_TYPES[kind]) for name, kind in ordered]


def name_channels(parts: Iterable[Part]) -> tuple[Part, ...]:
    """Return parts whose channels have distinct names, among those of one view.

    A part's name stands in front where the channel does not carry its layer itself, or an earlier
    part has a channel of that name. The part's view is not repeated in it.
    """
    used: set[tuple[str, str]] = set()
    out = []
    for part in parts:
        layer = part.name
        if part.view:  # as an element of the name: "depth_left", "left.depth"
            element = re.compile(rf"(^|[._ -]){re.escape(part.view)}($|[._ -])")
            layer = element.sub(lambda m: m[1] if m[1] and m[2] else "", layer, count=1)
        channels = []
        for channel in part.channels:
            name = channel.raw_name
            if layer and "." not in name:
                name = f"{layer}.{name}"
            if (part.view, name) in used:
                name = f"{layer}.{name}"
            channels.append(replace(channel, name=name))
        out.append(replace(part, channels=tuple(channels)))
        if not part.deep:
            used |= {(part.view, channel.name) for channel in channels}
    return tuple(out)
