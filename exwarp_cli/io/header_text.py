"""Text in OpenEXR headers that is no UTF-8: what artists named, as some programs write it.

OpenEXR's bindings only take headers whose text is all UTF-8, in and out. So whatever is not goes
through them as other text of the same length, and its bytes are put back: in Python as lone
surrogates, as :meth:`exwarp_cli.io.exr.ExrReader.headers` has them, in a file as they were.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

MAGIC = b"\x76\x2f\x31\x01"
MULTIPART = 0x1000
"""The bit of the version that tells of several headers."""

BODY = 8
"""Where the first header begins: after the magic number and the version."""

_LONE = re.compile("[\udc80-\udcff]")
_STAND_IN = "\x01"
_TEXTS = frozenset([b"string", b"stringvector"])


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


def in_utf8(data: bytes) -> tuple[bytes, dict[tuple[int, str], str | None]]:
    """Return a file whose headers are all UTF-8, and what that left out.

    Parameters
    ----------
    data
        The file.

    Returns
    -------
    tuple
        The file, of the same length; and by part and name, as they are called in there, the
        attributes that are otherwise: their text with lone surrogates, None where only bytes tell.

    Raises
    ------
    ValueError
        As :func:`attributes_in`.
    """
    out = bytearray(data)
    changed: dict[tuple[int, str], str | None] = {}
    for one in attributes_in(data):
        name, value = _read(one.name), _read(data[one.begin : one.end])
        lossy = one.kind in _TEXTS and plain(value) != value
        if lossy:
            out[one.begin : one.end] = plain(value).encode()
        if plain(name) != name:
            out[one.at : one.at + len(one.name)] = plain(name).encode()
            changed[one.part, plain(name)] = None
        elif lossy:
            changed[one.part, name] = value if one.kind == b"string" else None
    return bytes(out), changed


def plain(text: str) -> str:
    """Return text that can be written as UTF-8: of the same length there, and mostly the same."""
    return _LONE.sub(_STAND_IN, text)


def as_it_was(
    data: bytes | memoryview, headers: Iterable[Mapping[str, object]]
) -> bytes | memoryview:
    """Put back the text that a file was written without.

    Parameters
    ----------
    data
        The file, written with :func:`plain` text.
    headers
        Of each part, with text that may hold lone surrogates.
    """
    lost = {
        (part, name.encode()): value.encode("utf-8", "surrogateescape")
        for part, header in enumerate(headers)
        for name, value in header.items()
        if isinstance(value, str) and plain(value) != value
    }
    if not lost:
        return data
    out = bytearray(data)
    for one in attributes_in(data):
        raw = lost.get((one.part, one.name))
        if raw is not None and len(raw) == one.end - one.begin:
            out[one.begin : one.end] = raw
    return bytes(out)


def _read(raw: bytes) -> str:
    return raw.decode("utf-8", "surrogateescape")
