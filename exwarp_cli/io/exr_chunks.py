"""Where the scan lines of an EXR file lie, by its own headers and tables of chunks.

Only what is plain and certain is told; of everything else OpenImageIO decides what it is.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Window
from exwarp_cli.io.header_text import BODY, MULTIPART, attributes_in

U8 = npt.NDArray[np.uint8]
I64 = npt.NDArray[np.int64]
Read = Callable[[int, int], U8]
"""Gives the bytes of a file from one place on, so many; fewer where it ends."""

Header = Mapping[bytes, tuple[bytes, bytes]]
"""Type and value of each attribute."""

NONE, RLE, ZIPS, ZIP, PXR24 = 0, 1, 2, 3, 5
LINES = {NONE: 1, RLE: 1, ZIPS: 1, ZIP: 16, PXR24: 16}
"""Scan lines in a chunk, by the number of each compression that is undone here."""

UINT, HALF, FLOAT = 0, 1, 2
BYTES = {UINT: 4, HALF: 2, FLOAT: 4}

MOST = 1032
"""Bytes that DEFLATE makes of one, at most: so a small file claims no memory for a large image."""

LARGEST = 2**31 - 1
"""Bytes of a chunk's pixels, at most, as in OpenEXR."""

LONG_NAMES, DEEP = 0x0400, 0x0800
"""Bits of the version that say nothing against a part; the latter where others may be deep."""

FIRST, LAST = 1 << 16, 1 << 26
"""Bytes among which headers are sought first and last; Cryptomatte's manifests take megabytes."""


REQUIRED = {
    b"compression": (b"compression", 1),
    b"dataWindow": (b"box2i", 16),
    b"displayWindow": (b"box2i", 16),
    b"lineOrder": (b"lineOrder", 1),
    b"pixelAspectRatio": (b"float", 4),
    b"screenWindowCenter": (b"v2f", 8),
    b"screenWindowWidth": (b"float", 4),
}
"""Type and bytes of what every header has beside channels. Without one of them OpenEXR reads no
pixels, or none of their compression."""


@dataclass(frozen=True)
class Stored:
    """How a part of flat scan lines is stored.

    Attributes
    ----------
    number
        What its chunks name it by; None in files of one part, whose chunks name none.
    compression
        A key of `LINES`.
    window
        The data window.
    channels
        Name and type of each, in the order in which they follow each other in a line.
    starts, ends
        int64 [N] of each chunk, from the top: where it begins, and where something else does.
    """

    number: int | None
    compression: int
    window: Window
    channels: Sequence[tuple[bytes, int]]
    starts: I64
    ends: I64

    @property
    def lines(self) -> int:
        """Lines of a chunk; the last one may have fewer."""
        return LINES[self.compression]

    @property
    def sizes(self) -> tuple[int, ...]:
        """Bytes of a pixel of each channel."""
        return tuple(BYTES[kind] for _, kind in self.channels)


def stored_parts(read: Read, size: int) -> list[Stored | None]:
    """Return how the parts of a file of so many bytes are stored: None for one that is not plain.

    Raises
    ------
    ValueError
        When its headers or tables of chunks are broken.
    """
    headers, several, at = _headers(read, size)
    plain = [_plain(header, size, several) for header in headers]
    counts = [_count(header) for header in headers] if several else [_chunks(plain[0])]
    begin = at + 8 * sum(counts)
    if begin > size:
        raise ValueError("the tables of chunks are cut off")
    table = read(at, begin - at).view("<u8")
    if len(table) != sum(counts):
        raise ValueError("the tables of chunks are cut off")
    stops = np.append(np.sort(np.minimum(table, np.uint64(size))), np.uint64(size))
    ends = stops[np.searchsorted(stops, table, "right").clip(max=len(table))]
    found: list[Stored | None] = []
    for number, (one, last) in enumerate(zip(plain, accumulate(counts), strict=True)):
        here = slice(last - counts[number], last)
        known = one is not None and _chunks(one) == counts[number]
        if not known or not ((begin <= table[here]) & (table[here] < size)).all():
            found.append(None)
            continue
        assert one is not None
        place = (table[here].astype(np.int64), ends[here].astype(np.int64))
        found.append(Stored(number if several else None, *one, *place))
    return found


def _headers(read: Read, size: int) -> tuple[list[Header], bool, int]:
    """Return every header, whether there may be several, and where the tables of chunks begin."""
    length = FIRST
    while True:
        data = read(0, min(length, size)).tobytes()
        try:
            attributes = list(attributes_in(data))
            break
        except ValueError:
            if length >= min(size, LAST):
                raise
            length *= 8
    version = int.from_bytes(data[4:BODY], "little")
    several = bool(version & MULTIPART)
    if version & ~(MULTIPART | LONG_NAMES | (DEEP if several else 0)) != 2 or not attributes:
        raise ValueError("no plain file")
    headers: list[dict[bytes, tuple[bytes, bytes]]] = [{} for _ in range(attributes[-1].part + 1)]
    for one in attributes:
        if one.name in headers[one.part]:
            raise ValueError("an attribute is there twice")
        headers[one.part][one.name] = one.kind, data[one.begin : one.end]
    return [*headers], several, attributes[-1].end + 1 + several


_Plain = tuple[int, Window, tuple[tuple[bytes, int], ...]]
"""Compression, data window and channels."""


def _plain(header: Header, size: int, several: bool) -> _Plain | None:
    """Return what a part holds, if it is flat and of scan lines that are decoded here."""
    kind = header.get(b"type")
    flat = kind == (b"string", b"scanlineimage") or (kind is None and not several)
    values = {name: header.get(name, (b"", b"")) for name in REQUIRED}
    whole = {name: (of, len(value)) for name, (of, value) in values.items()} == REQUIRED
    channels = _channels(header)
    if not flat or not whole or b"tiles" in header or channels is None:
        return None
    number, order = values[b"compression"][1][0], values[b"lineOrder"][1][0]
    left, top, right, bottom = struct.unpack("<4i", values[b"dataWindow"][1])
    if number not in LINES or order > 1 or left > right or top > bottom:
        return None
    window = Window(left, top, right - left + 1, bottom - top + 1)
    line = window.width * sum(BYTES[of] for _, of in channels)
    if line * LINES[number] > LARGEST or line * window.height > MOST * size:
        return None
    return number, window, channels


def _channels(header: Header) -> tuple[tuple[bytes, int], ...] | None:
    """Return name and type of each channel; None where one is subsampled, or they lie unsorted."""
    kind, value = header.get(b"channels", (b"", b""))
    found: list[tuple[bytes, int]] = []
    at = 0
    while kind == b"chlist" and value[at : at + 1] not in (b"", b"\0"):
        end = value.find(b"\0", at)
        if end < 0 or end + 17 > len(value):
            return None
        of, horizontal, vertical = struct.unpack_from("<i4x2i", value, end + 1)
        if of not in BYTES or (horizontal, vertical) != (1, 1):
            return None
        found.append((value[at:end], of))
        at = end + 17
    names = [name for name, _ in found]
    whole = value[at:] == b"\0" and names == sorted(set(names))
    return tuple(found) if whole and found else None


def _count(header: Header) -> int:
    """Return how many chunks a header tells of."""
    kind, value = header.get(b"chunkCount", (b"", b""))
    if kind != b"int" or len(value) != 4:
        raise ValueError("no chunkCount")
    count: int = struct.unpack("<i", value)[0]
    if count < 0:
        raise ValueError("chunkCount is below 0")
    return count


def _chunks(plain: _Plain | None) -> int:
    """Return how many chunks a part's lines make; 0 for one that is not plain."""
    return 0 if plain is None else -(-plain[1].height // LINES[plain[0]])
