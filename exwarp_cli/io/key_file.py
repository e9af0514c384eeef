"""A rendered frame's file as a run writes it: its bytes, but for some attributes in its header.

Only the header is rewritten. Chunks are copied as they are, so that no pixel is decoded and encoded
again. OpenImageIO's `copy_image` was tried instead: it encodes B44 and DWA again, changes the type
and adds a date.
"""

from __future__ import annotations

import hashlib
import os
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import BinaryIO

from exwarp_cli.domain.timeline import parse_rate
from exwarp_cli.errors import InputError
from exwarp_cli.io import checksum
from exwarp_cli.io.atomic import PIECE, atomic_copy, atomic_path
from exwarp_cli.io.exr.header import RawHeader
from exwarp_cli.io.exr.reader import HeaderCache, damaged, parse_header
from exwarp_cli.io.output import CHECKSUM, PREFIX, is_intact, seal
from exwarp_cli.io.reading_retry import with_retries
from exwarp_cli.io.sequence import EXR

RATE = b"framesPerSecond"

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
    opened
        The source, opened unbuffered; None to open it when it is read.
    """

    source: Path
    head: bytes = b""
    rest: int = 0
    opened: BinaryIO | None = field(default=None, compare=False, repr=False)

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
        file, at = self.opened, self.rest
        with ExitStack() as stack:

            def read() -> bytes:
                nonlocal file
                if file is None:
                    file = stack.enter_context(self.source.open("rb", buffering=0))
                try:
                    file.seek(at)
                    return file.read(PIECE)
                except OSError:
                    file = None  # a stale handle stays stale
                    raise

            while True:
                try:
                    piece = with_retries(self.source, read)
                except OSError as error:
                    raise _missing(self.source, error) from error
                if not piece:
                    return
                at += len(piece)
                yield piece

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
        if not self.head and self.opened is None:
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
        with target.open("rb", buffering=0) as file:
            header = RawHeader.read(file, target.stat().st_size)
        own = next(attribute for attribute in header.attributes if attribute.name == RATE)
        return plain, key_file(source, _rate_of(own.kind, header.value(own)))
    except (OSError, ValueError, struct.error, StopIteration, InputError):
        return (plain,)  # the target or the source is no sound EXR, or the target has no rate


def key_file(source: Path, rate: Fraction | None) -> KeyFile:
    """Return what is written for a key frame; as `opened_key`, but the source is closed."""
    with opened_key(source, rate) as key:
        return replace(key, opened=None)


@contextmanager
def opened_key(source: Path, rate: Fraction | None) -> Iterator[KeyFile]:
    """Open a key frame whose header is to have a frame rate, to write it or to read it once more.

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
        yield KeyFile(source)
        return
    with ExitStack() as stack:

        def opened() -> KeyFile:
            file = stack.enter_context(source.open("rb", buffering=0))
            return KeyFile(source, *_with_rate(file, rate), file)

        yield _sound(source, opened)


def marked_file(source: Path, rate: Fraction | None, marks: Mapping[str, str | int]) -> KeyFile:
    """Return what is written for a rendered EXR file that gets attributes of ExWarp's own.

    Parameters
    ----------
    source
        The file. What ExWarp may have written into its headers is left out.
    rate
        Frames per second; None to leave the file's own rate.
    marks
        Attributes of the first part, by name without prefix. A checksum of the file joins them.

    Raises
    ------
    InputError
        When there is no such file.
    UnreadableError
        When the system does not let it through.
    DamagedFileError
        When its header or its table of chunks is broken.
    """

    def read() -> KeyFile:
        with source.open("rb", buffering=0) as file:
            header = RawHeader.read(file, os.fstat(file.fileno()).st_size)
            changes = [] if rate is None else _rate_changes(header, rate)
            head, rest = _changed(file, header, [*changes, *_mark_changes(header, marks)])
            file.seek(rest)
            return KeyFile(source, bytes(seal(head, file.read())[0]), rest)

    return _sound(source, read)


def _sound(source: Path, read: Callable[[], KeyFile]) -> KeyFile:
    """Return what reading a file gives; errors are those of `opened_key`."""
    try:
        return with_retries(source, read)
    except OSError as error:
        raise _missing(source, error) from error
    except (ValueError, struct.error) as error:
        raise damaged(source, str(error)) from error


def digests(
    path: Path, rate: Fraction | None = None, headers: HeaderCache | None = None
) -> tuple[str, str | None]:
    """Digest a frame's file, and what is written for it as a key frame.

    Parameters
    ----------
    path
        The file.
    rate
        The frame rate that a written key frame gets; None where it is copied as it is.
    headers
        Keeps the file's header, so that the file need not be opened again for it.

    Returns
    -------
    str
        Of the file, hexadecimal, as generated files' checksums are.
    str or None
        Of what is written; None where a broken header takes no rate.

    Raises
    ------
    DamagedFileError
        When there is no such file.
    UnreadableError
        When the system does not let it through.
    """

    def read() -> tuple[str, str | None]:
        with path.open("rb", buffering=0) as file:
            digest = hashlib.file_digest(file, checksum.new).hexdigest()
            is_exr = path.suffix.lower() in EXR
            if headers is not None and is_exr:
                headers.keep(path, parse_header(path, file))
            if rate is None or not is_exr:
                return digest, digest
            try:
                key = KeyFile(path, *_with_rate(file, rate), file)
            except (ValueError, struct.error):
                return digest, None
            return digest, key.digest() if key.head else digest

    try:
        return with_retries(path, read)
    except OSError as error:
        raise damaged(path, str(error.strerror)) from error


def _with_rate(file: BinaryIO, rate: Fraction) -> tuple[bytes, int]:
    """Return the header and table of chunks with a rate, and where the source goes on."""
    header = RawHeader.read(file, os.fstat(file.fileno()).st_size)
    changes = _rate_changes(header, rate)
    if not changes:
        return b"", 0
    head, rest = _changed(file, header, changes)
    return (_sealed(file, head, rest) if CHECKSUM.encode() in head else head), rest


Change = tuple[int, int, bytes]
"""Bytes of the headers that are replaced: from, to, and by what."""


def _changed(file: BinaryIO, header: RawHeader, changes: list[Change]) -> tuple[bytes, int]:
    """Return changed headers with their table of chunks, and where the source goes on."""
    data, end = header.data, len(header.data)
    head, at, rest = b"", 0, end
    for begin, stop, text in sorted(changes):
        head, at = head + data[at:begin] + text, stop
    head += data[at:]
    if len(head) != end:
        size = os.fstat(file.fileno()).st_size
        table = _table(file, size, end, _chunk_count(header) if header.is_multipart else None)
        moved = [place + len(head) - end if place else 0 for place in table]
        head, rest = head + struct.pack(f"<{len(moved)}Q", *moved), end + _ENTRY * len(table)
    return head, rest


def _rate_changes(header: RawHeader, rate: Fraction) -> list[Change]:
    """Return what gives all parts a frame rate."""
    text = RATE + b"\0rational\0" + struct.pack("<Iii", 8, rate.numerator, rate.denominator)
    changes = []
    for part in range(header.part_count):
        attributes = [one for one in header.attributes if one.part == part]
        own = next((one for one in attributes if one.name == RATE), None)
        if own is None:
            changes.append((attributes[-1].end, attributes[-1].end, text))
        elif _rate_of(own.kind, header.value(own)) != rate:
            changes.append((own.at, own.end, text))
    return changes


def _mark_changes(header: RawHeader, marks: Mapping[str, str | int]) -> list[Change]:
    """Return what gives the first part attributes of ExWarp's own in place of any earlier ones."""
    named: dict[str, str | int] = {f"{PREFIX}{name}": value for name, value in marks.items()}
    named[CHECKSUM] = checksum.ZEROS
    text = b"".join(_attribute(name, value) for name, value in named.items())
    own = [one for one in header.attributes if one.name.startswith(PREFIX.encode())]
    end = next(one.end for one in reversed(header.attributes) if one.part == 0)
    return [*((one.at, one.end, b"") for one in own), (end, end, text)]


def _attribute(name: str, value: str | int) -> bytes:
    """Return an attribute as it stands in a header."""
    if isinstance(value, int):
        kind, data = b"int", struct.pack("<i", value)
    else:
        kind, data = b"string", value.encode("utf-8", "surrogateescape")
    return name.encode() + b"\0" + kind + b"\0" + struct.pack("<I", len(data)) + data


def _rate_of(kind: bytes, value: bytes) -> Fraction | None:
    """Return the rate that an attribute's bytes stand for, None for none."""
    if kind == b"rational" and len(value) == 8:
        numerator, denominator = struct.unpack("<iI", value)
        return parse_rate(Fraction(numerator, denominator)) if denominator else None
    if kind in _FORMATS and len(value) == struct.calcsize(_FORMATS[kind]):
        return parse_rate(struct.unpack(_FORMATS[kind], value)[0])
    return parse_rate(value.decode("utf-8", "replace")) if kind == b"string" else None


def _chunk_count(header: RawHeader) -> int:
    """Return how many chunks all parts have together."""
    counts = [one for one in header.attributes if one.name == b"chunkCount"]
    if len(counts) != header.part_count:
        raise ValueError("a part has no chunkCount")
    return sum(struct.unpack("<I", header.value(one))[0] for one in counts)


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
