"""Headers of OpenEXR files: attributes as bytes, as text, and as OpenEXR's values.

OpenEXR's bindings only take headers whose text is all UTF-8, in and out. Other text goes through
them as a stand-in of the same length, and its bytes are put back: in Python as lone surrogates, in
a file as they were.
"""

from __future__ import annotations

import io
import re
import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, BinaryIO

import OpenEXR

MAGIC = b"\x76\x2f\x31\x01"
PNG = b"\x89PNG\r\n\x1a\n"

TILED, LONG_NAMES, DEEP, MULTIPART = 0x0200, 0x0400, 0x0800, 0x1000
"""Bits of the version: tiles in a single part, long names, deep parts, several headers."""

BODY = 8
"""Where the first header begins: after the magic number and the version."""

FIRST, LAST = 1 << 16, 1 << 26
"""Bytes that are read for headers at first and at last. Cryptomatte's manifests take megabytes."""

COMPRESSION_NAMES = ("none", "rle", "zips", "zip", "piz", "pxr24", "b44", "b44a", "dwaa", "dwab")
"""Names of compressions by their number in a header."""

_SIGNATURES = (
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
SIGNATURE_BYTES = max(len(signature) for signature, _ in _SIGNATURES)

_LONE_SURROGATE = re.compile("[\udc80-\udcff]")
_STAND_IN = "\x01"
_TEXTS = frozenset([b"string", b"stringvector"])


def kind_of(data: bytes) -> str:
    """Return what format a file has by its first bytes, in a few words.

    Checked before decoding, because OpenImageIO prints warnings for foreign data.
    """
    if not data:
        return "nothing"
    return next((kind for magic, kind in _SIGNATURES if data.startswith(magic)), "something else")


@dataclass(frozen=True)
class Attribute:
    """One attribute of a header, as it stands in a file.

    Attributes
    ----------
    part
        Index of the header.
    name, kind
        Its name and type.
    at, begin, end
        Where the name begins, and where the value begins and ends.
    """

    part: int
    name: bytes
    kind: bytes
    at: int
    begin: int
    end: int


def attributes_in(data: bytes | memoryview) -> Iterator[Attribute]:
    """Yield the attributes of every header.

    Parameters
    ----------
    data
        A file, or as much of it as holds all headers.

    Raises
    ------
    ValueError
        When it is no OpenEXR file, or a header has no end.
    """
    data = bytes(data)
    if data[:4] != MAGIC or len(data) < BODY:
        raise ValueError("no OpenEXR file")
    several = bool(int.from_bytes(data[4:BODY], "little") & MULTIPART)
    at, part = BODY, 0
    while True:
        if data[at : at + 1] == b"\0":
            at, part = at + 1, part + 1
            if not several or data[at : at + 1] == b"\0":
                return
        kind_at = data.index(b"\0", at) + 1
        size_at = data.index(b"\0", kind_at) + 1
        begin = size_at + 4
        (size,) = struct.unpack("<I", data[size_at:begin].ljust(4, b"\0"))
        if begin + size > len(data):
            raise ValueError("the header has no end")
        name, kind = data[at : kind_at - 1], data[kind_at : size_at - 1]
        yield Attribute(part, name, kind, at, begin, begin + size)
        at = begin + size


@dataclass(frozen=True)
class RawHeader:
    """The headers of a file, one for each part.

    Attributes
    ----------
    data
        The file's bytes up to the chunk offset tables.
    attributes
        Of all parts, in the order of the file; at least one.
    """

    data: bytes
    attributes: tuple[Attribute, ...]

    @classmethod
    def read(cls, file: BinaryIO, size: int) -> RawHeader:
        """Read the headers of a file of `size` bytes, whatever the file's position.

        Raises
        ------
        ValueError
            When it is no OpenEXR file, or a header has no end.
        OSError
            When the system does not let the file through.
        """
        length = FIRST
        while True:
            file.seek(0)
            data = _read_fully(file, min(length, size))
            try:
                attributes = tuple(attributes_in(data))
                break
            except ValueError:
                if length >= min(size, LAST):
                    raise
                length *= 8
        if not attributes:
            raise ValueError("a header is empty")
        several = bool(int.from_bytes(data[4:BODY], "little") & MULTIPART)
        return cls(data[: attributes[-1].end + 1 + several], attributes)

    @property
    def flags(self) -> int:
        """Bits of the version field, with the version's number in the lowest byte."""
        return int.from_bytes(self.data[4:BODY], "little")

    @property
    def is_multipart(self) -> bool:
        """Whether there may be several headers."""
        return bool(self.flags & MULTIPART)

    @property
    def part_count(self) -> int:
        """How many parts there are."""
        return self.attributes[-1].part + 1

    def value(self, attribute: Attribute) -> bytes:
        """Return the bytes of an attribute's value."""
        return self.data[attribute.begin : attribute.end]

    def by_part(self) -> list[dict[bytes, tuple[bytes, bytes]]]:
        """Return type and value of each part's attributes by name.

        Raises
        ------
        ValueError
            When a part has two attributes of a name.
        """
        headers: list[dict[bytes, tuple[bytes, bytes]]] = [{} for _ in range(self.part_count)]
        for attribute in self.attributes:
            if attribute.name in headers[attribute.part]:
                raise ValueError("an attribute is there twice")
            headers[attribute.part][attribute.name] = attribute.kind, self.value(attribute)
        return headers

    @cached_property
    def texts(self) -> tuple[dict[str, str], ...]:
        """The attributes of each part that are text, and the compression's name.

        Text that is no UTF-8 keeps its bytes as lone surrogates.
        """
        headers: tuple[dict[str, str], ...] = tuple({} for _ in range(self.part_count))
        for attribute in self.attributes:
            text, value = headers[attribute.part], self.value(attribute)
            if attribute.kind == b"string" and (value := value.partition(b"\0")[0]):
                text[decode(attribute.name)] = decode(value)
            elif attribute.kind == b"compression" and value and value[0] < len(COMPRESSION_NAMES):
                text[decode(attribute.name)] = COMPRESSION_NAMES[value[0]]
        return headers

    @cached_property
    def typed(self) -> tuple[dict[str, Any], ...]:
        """The attributes of each part as OpenEXR's bindings have them.

        Text that is no UTF-8 keeps its bytes as lone surrogates. Attributes with such names, and
        lists of such texts, are left out.

        Raises
        ------
        RuntimeError, ValueError, ArithmeticError
            When OpenEXR refuses the header.
        """
        try:
            return _typed(self.data)
        except UnicodeDecodeError:
            data, replaced = in_utf8(self.data)
        headers = _typed(data)
        for (part, name), text in replaced.items():
            if text is not None:
                headers[part][name] = text
            else:
                headers[part].pop(name, None)
        return headers


def _read_fully(file: BinaryIO, size: int) -> bytes:
    """Read so many bytes from an unbuffered file, fewer only where it ends."""
    pieces = []
    while size > 0 and (piece := file.read(size)):
        pieces.append(piece)
        size -= len(piece)
    return b"".join(pieces)


def _typed(data: bytes) -> tuple[dict[str, Any], ...]:
    opaque = OpenEXR.OpaqueAttribute  # which OpenEXR cannot write back
    # From memory, so that the file is not opened once more.
    with OpenEXR.File(io.BytesIO(data), header_only=True) as file:
        return tuple(
            {name: value for name, value in part.header.items() if not isinstance(value, opaque)}
            for part in file.parts
        )


def in_utf8(data: bytes) -> tuple[bytes, dict[tuple[int, str], str | None]]:
    """Return a file whose headers are all UTF-8, and what that left out.

    Parameters
    ----------
    data
        The file, or all of its headers.

    Returns
    -------
    tuple
        The same, of the same length; and by part and name, as they are called in there, the
        attributes that differ: their text with lone surrogates, None where text cannot hold them.

    Raises
    ------
    ValueError
        As :func:`attributes_in`.
    """
    out = bytearray(data)
    changed: dict[tuple[int, str], str | None] = {}
    for attribute in attributes_in(data):
        name, value = decode(attribute.name), decode(data[attribute.begin : attribute.end])
        lossy = attribute.kind in _TEXTS and replace_non_utf8(value) != value
        if lossy:
            out[attribute.begin : attribute.end] = replace_non_utf8(value).encode()
        if replace_non_utf8(name) != name:
            end = attribute.at + len(attribute.name)
            out[attribute.at : end] = replace_non_utf8(name).encode()
            changed[attribute.part, replace_non_utf8(name)] = None
        elif lossy:
            changed[attribute.part, name] = value if attribute.kind == b"string" else None
    return bytes(out), changed


def replace_non_utf8(text: str) -> str:
    """Return text that can be written as UTF-8: of the same length there, and mostly the same."""
    return _LONE_SURROGATE.sub(_STAND_IN, text)


def restore_non_utf8(
    data: bytes | memoryview, headers: Iterable[Mapping[str, object]]
) -> bytes | memoryview:
    """Put back the text that a file was written without.

    Parameters
    ----------
    data
        The file, written with text of :func:`replace_non_utf8`.
    headers
        Of each part, with text that may hold lone surrogates.
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
        if raw is not None and len(raw) == attribute.end - attribute.begin:
            out[attribute.begin : attribute.end] = raw
    return bytes(out)


def channels_in(value: bytes) -> Iterator[tuple[bytes, int, tuple[int, int]]]:
    """Yield name, pixel type, and steps across and down of each channel of a list.

    Raises
    ------
    ValueError
        When the list is cut off, or bytes follow it.
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
