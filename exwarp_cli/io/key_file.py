"""A key frame's file as a run writes it: its bytes, but for the frame rate in its header.

Only the header is rewritten. Chunks are copied as they are, so that no pixel is decoded and encoded
again. OpenImageIO's `copy_image` was tried instead: it encodes B44 and DWA again, changes the type
and adds a date.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import BinaryIO

from exwarp_cli.domain.frame_rates import parsed_rate
from exwarp_cli.errors import InputError
from exwarp_cli.io import checksum
from exwarp_cli.io.atomic import atomic_copy, atomic_path
from exwarp_cli.io.exr import damaged
from exwarp_cli.io.exr_chunks import FIRST, LAST
from exwarp_cli.io.header_text import BODY, MULTIPART, Attribute, attributes_in
from exwarp_cli.io.output import CHECKSUM, is_intact, seal
from exwarp_cli.io.reading_retry import with_retries
from exwarp_cli.io.sequence import EXR

RATE = b"framesPerSecond"
PIECE = 1 << 23
"""Bytes that are copied at a time."""

_FORMATS = {b"int": "<i", b"float": "<f", b"double": "<d"}
"""Of the numbers that a rate may be, beside rationals and text."""

_ENTRY = 8
"""Bytes of a place in a table of chunks."""


@dataclass(frozen=True)
class KeyFile:
    """What is written for a key frame: a head of its own, then the source from a place on.

    Attributes
    ----------
    source
        The key frame's file.
    head
        Bytes that come first; empty where the file is copied as it is.
    rest
        Where the bytes of the source begin that follow.
    """

    source: Path
    head: bytes = b""
    rest: int = 0

    def pieces(self) -> Iterator[bytes]:
        """Yield the file piece by piece.

        Raises
        ------
        InputError
            When there is no such source.
        UnreadableError
            When the system does not let the source through.
        """
        yield self.head
        at = self.rest
        while piece := self._piece(at):
            at += len(piece)
            yield piece

    def _piece(self, at: int) -> bytes:
        """Read a piece of the source; the file is opened anew, as a stale handle stays stale."""

        def read() -> bytes:
            with self.source.open("rb") as file:
                file.seek(at)
                return file.read(PIECE)

        try:
            return with_retries(self.source, read)
        except OSError as error:
            raise _missing(self.source, error) from error

    def write(self, target: Path) -> None:
        """Write the file, whole or not at all.

        Raises
        ------
        InputError
            When there is no such source.
        UnreadableError
            When the system does not let the source through.
        OutputError
            When the target cannot be written.
        """
        if not self.head:
            atomic_copy(self.source, target)
            return
        with atomic_path(target) as temporary, temporary.open("wb") as file:
            file.writelines(self.pieces())

    def is_at(self, target: Path) -> bool:
        """Return whether a file holds the same bytes; raises OSError where it cannot be read."""
        size = len(self.head) + self.source.stat().st_size - self.rest
        if target.stat().st_size != size:
            return False
        with target.open("rb") as file:
            return all(file.read(len(piece)) == piece for piece in self.pieces())

    def begins_with(self, data: bytes) -> bool:
        """Return whether some bytes are the beginning of the file."""
        at = 0
        for piece in self.pieces():
            if at >= len(data):
                break
            if not piece.startswith(data[at : at + len(piece)]):
                return False
            at += len(piece)
        return at >= len(data)

    def digest(self) -> str:
        """Return the checksum of the file, hexadecimal; see `exwarp_cli.io.checksum`."""
        return checksum.digits_of(self.pieces())


def written_forms(source: Path, target: Path) -> tuple[KeyFile, ...]:
    """Return what a run may have written for a key frame at a file's place: as it is, or rated.

    Parameters
    ----------
    source
        The key frame's file.
    target
        A file that may be its copy. Its header tells the frame rate of the run that wrote it.
    """
    plain = KeyFile(source)
    try:
        with target.open("rb") as file:
            data, attributes = _header(file, target.stat().st_size)
        own = next(one for one in attributes if one.name == RATE)
        rate = _rate_of(own.kind, data[own.begin : own.end])
        return plain, key_file(source, rate)
    except (OSError, ValueError, struct.error, StopIteration, InputError):
        return (plain,)  # the target or the source is no sound EXR, or the target has no rate


def key_file(source: Path, rate: Fraction | None) -> KeyFile:
    """Return what is written for a key frame whose header is to have a frame rate.

    Parameters
    ----------
    source
        The key frame's file. One that is no EXR is copied as it is.
    rate
        Frames per second; None to copy the file as it is.

    Raises
    ------
    InputError
        When there is no such file.
    UnreadableError
        When the system does not let it through.
    DamagedFileError
        When its header or its table of chunks is broken.
    """
    if rate is None or source.suffix.lower() not in EXR:
        return KeyFile(source)
    try:
        return with_retries(source, partial(_rewritten, source, rate))
    except OSError as error:
        raise _missing(source, error) from error


def _rewritten(source: Path, rate: Fraction) -> KeyFile:
    try:
        with source.open("rb") as file:
            head, rest = _with_rate(file, source.stat().st_size, rate)
            if CHECKSUM.encode() in head:
                head = _sealed(file, head, rest)
    except (ValueError, struct.error) as error:
        raise damaged(source, str(error)) from error
    return KeyFile(source, head, rest)


def _with_rate(file: BinaryIO, size: int, rate: Fraction) -> tuple[bytes, int]:
    """Return the header and table of chunks with a rate, and where the source goes on."""
    data, attributes = _header(file, size)
    several = bool(int.from_bytes(data[4:BODY], "little") & MULTIPART)
    end = attributes[-1].end + 1 + several
    changes = _changes(attributes, data, rate)
    if not changes:
        return b"", 0
    head, at = b"", 0
    for begin, stop, text in changes:
        head, at = head + data[at:begin] + text, stop
    head += data[at:end]
    if len(head) == end:
        return head, end
    table = _table(file, size, end, _chunk_count(attributes, data) if several else None)
    moved = [place + len(head) - end if place else 0 for place in table]
    return head + struct.pack(f"<{len(moved)}Q", *moved), end + _ENTRY * len(table)


def _header(file: BinaryIO, size: int) -> tuple[bytes, list[Attribute]]:
    """Read the beginning of a file, as much of it as holds all headers."""
    length = FIRST
    while True:
        file.seek(0)
        data = file.read(min(length, size))
        try:
            return data, list(attributes_in(data))
        except ValueError:
            if length >= min(size, LAST):
                raise
            length *= 8


def _changes(
    attributes: Sequence[Attribute], data: bytes, rate: Fraction
) -> list[tuple[int, int, bytes]]:
    """Return what bytes of the headers are replaced: from, to, and by what."""
    text = RATE + b"\0rational\0" + struct.pack("<Iii", 8, rate.numerator, rate.denominator)
    found = []
    for part in range(attributes[-1].part + 1):
        mine = [one for one in attributes if one.part == part]
        own = next((one for one in mine if one.name == RATE), None)
        if own is None:
            found.append((mine[-1].end, mine[-1].end, text))
        elif _rate_of(own.kind, data[own.begin : own.end]) != rate:
            found.append((own.at, own.end, text))
    return found


def _rate_of(kind: bytes, value: bytes) -> Fraction | None:
    """Return the rate that an attribute's bytes stand for, None for none."""
    if kind == b"rational" and len(value) == 8:
        numerator, denominator = struct.unpack("<iI", value)
        return parsed_rate(Fraction(numerator, denominator)) if denominator else None
    if kind in _FORMATS and len(value) == struct.calcsize(_FORMATS[kind]):
        return parsed_rate(struct.unpack(_FORMATS[kind], value)[0])
    return parsed_rate(value.decode("utf-8", "replace")) if kind == b"string" else None


def _chunk_count(attributes: Sequence[Attribute], data: bytes) -> int:
    """Return how many chunks all parts have together."""
    counts = [one for one in attributes if one.name == b"chunkCount"]
    if len(counts) != attributes[-1].part + 1:
        raise ValueError("a part has no chunkCount")
    return sum(struct.unpack("<I", data[one.begin : one.end])[0] for one in counts)


def _table(file: BinaryIO, size: int, begin: int, count: int | None) -> list[int]:
    """Read the places of all chunks; without a count the table ends where the first one lies."""
    found: list[int] = []
    first = size
    file.seek(begin)
    while len(found) < count if count is not None else begin + _ENTRY * len(found) < first:
        (place,) = struct.unpack("<Q", file.read(_ENTRY))
        if place and not begin + _ENTRY * len(found) < place < size:
            raise ValueError("the table of chunks is broken")
        first = min(first, place or size)
        found.append(place)
    if first < begin + _ENTRY * len(found) or first == size:
        raise ValueError("the table of chunks is broken")
    return found


def _sealed(file: BinaryIO, head: bytes, rest: int) -> bytes:
    """Renew the checksum in the head of a key frame that ExWarp made, and that is undamaged."""
    file.seek(0)
    data = file.read()
    if not is_intact(data):
        return head
    begin = head.index(CHECKSUM.encode() + b"\0string\0") + len(CHECKSUM) + 12
    blank = head[:begin] + checksum.ZEROS.encode() + head[begin + checksum.DIGITS :]
    return bytes(seal(blank, data[rest:])[0])


def _missing(path: Path, error: OSError) -> InputError:
    return InputError(f"cannot read {path}: {error.strerror or error}; check the path")
