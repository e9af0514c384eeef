"""A rendered frame's file as a run writes it: its bytes, but for some attributes in its header.

Only the header is rewritten. Chunks are copied as they are, so that no pixel is decoded and encoded
again. OpenImageIO's `copy_image` was tried instead: it encodes B44 and DWA again, changes the type
and adds a date.
"""

from __future__ import annotations

import hashlib
import os
import struct
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import BinaryIO

from exwarp_cli.domain.timeline import parse_rate
from exwarp_cli.errors import DamagedFileError, InputError
from exwarp_cli.io.exr.header import MULTIPART, Attribute, RawHeader
from exwarp_cli.io.exr.reader import HeaderCache, damaged_error, parse_header
from exwarp_cli.io.exr.writer import PREFIX
from exwarp_cli.io.files import (
    CHECKSUM_ZEROS,
    atomic_path,
    compute_checksum,
    new_checksum,
    with_retries,
)
from exwarp_cli.io.generated_frames import CHECKSUM, is_intact, seal
from exwarp_cli.io.sequences import EXR

RATE = b"framesPerSecond"

COPY_BYTES = 1 << 23  # that are copied at a time

# Formats of numbers that a rate may be, beside rationals and text.
_NUMBER_FORMATS = {b"int": "<i", b"float": "<f", b"double": "<d"}

# Bytes of an entry of a chunk offset table.
_OFFSET_SIZE = 8

# A replacement in the bytes of the headers: begin, end, new bytes.
Change = tuple[int, int, bytes]


@dataclass(frozen=True)
class KeyFile:
    """What is written for a key frame: a new head, then the source's bytes from `rest` on.

    An empty head and rest 0 copy the file as it is. `opened` is the source, open and unbuffered.
    """

    source: Path
    head: bytes = b""
    rest: int = 0
    opened: BinaryIO | None = field(default=None, compare=False, repr=False)

    def pieces(self) -> Iterator[bytes]:
        """Yield the file's bytes piece by piece.

        Raises InputError if there is no such source, UnreadableError if the system refuses it.
        """
        yield self.head
        file, position = self.opened, self.rest
        with ExitStack() as stack:

            def read_piece() -> bytes:
                nonlocal file
                if file is None:
                    file = stack.enter_context(self.source.open("rb", buffering=0))
                try:
                    file.seek(position)
                    return file.read(COPY_BYTES)
                except OSError:
                    file = None  # a stale handle stays stale
                    raise

            while True:
                with _report_unsound(self.source):
                    piece = with_retries(self.source, read_piece)
                if not piece:
                    return
                position += len(piece)
                yield piece

    def write(self, target: Path) -> None:
        """Write the file atomically; errors are those of `pieces`, and OutputError."""
        with atomic_path(target) as temporary, temporary.open("wb") as file:
            file.writelines(self.pieces())

    def is_at(self, target: Path) -> bool:
        """Return True if a file holds the same bytes; False if it is absent or cannot be read."""
        try:
            size = len(self.head) + self.source.stat().st_size - self.rest
            if target.stat().st_size != size:
                return False
            with target.open("rb") as file:
                return all(file.read(len(piece)) == piece for piece in self.pieces())
        except OSError:
            return False

    def begins_with(self, data: bytes) -> bool:
        """Return True if these bytes are the beginning of the file; reads no more than it needs."""
        rest = data
        for piece in self.pieces():
            if not piece.startswith(rest[: len(piece)]):
                return False
            rest = rest[len(piece) :]
            if not rest:
                return True
        return False


def possible_key_files(source: Path, target: Path) -> tuple[KeyFile, ...]:
    """Return what a run may have written to `target` for a key frame: as it is, or with a rate.

    The header of the target tells the frame rate of the run that wrote it.
    """
    plain = KeyFile(source)
    try:
        with target.open("rb", buffering=0) as file:
            header = RawHeader.read(file, target.stat().st_size)
        own = next(attribute for attribute in header.attributes if attribute.name == RATE)
        return plain, plan_key_file(source, _parse_rate(own))
    except (OSError, ValueError, struct.error, StopIteration, InputError):
        return (plain,)  # the target or the source is no sound EXR, or the target has no rate


def plan_key_file(source: Path, rate: Fraction | None) -> KeyFile:
    """Return what is written for a key frame; as `open_key_file`, but the source is closed."""
    with open_key_file(source, rate) as key:
        return replace(key, opened=None)


@contextmanager
def open_key_file(source: Path, rate: Fraction | None) -> Iterator[KeyFile]:
    """Open a key frame whose header is to have a frame rate, to write it or to read it once more.

    `rate` is in frames per second; if None, or if the source is no EXR, it is copied as it is.

    Raises InputError if there is no such file, UnreadableError if the system refuses it,
    DamagedFileError if its header or its chunk offset table is broken.
    """
    if rate is None or source.suffix.lower() not in EXR:
        yield KeyFile(source)
        return
    with ExitStack() as stack:

        def read() -> KeyFile:
            file = stack.enter_context(source.open("rb", buffering=0))
            return KeyFile(source, *_with_rate(file, rate), file)

        with _report_unsound(source):
            key = with_retries(source, read)
        yield key


def plan_marked_file(
    source: Path, rate: Fraction | None, marks: Mapping[str, str | int]
) -> KeyFile:
    """Return what is written for a rendered EXR file that gets attributes of ExWarp's own.

    Attributes that ExWarp may have written into its headers before are left out. `rate` None keeps
    the file's own rate. `marks` are attributes of the first part, by name without prefix; a
    checksum of the file joins them. Errors are those of `open_key_file`.
    """
    values = {f"{PREFIX}{name}": value for name, value in marks.items()}
    values[CHECKSUM] = CHECKSUM_ZEROS
    new = b""
    for name, value in values.items():
        if isinstance(value, int):
            kind, data = b"int", struct.pack("<i", value)
        else:
            kind, data = b"string", value.encode("utf-8", "surrogateescape")
        new += name.encode() + b"\0" + kind + b"\0" + struct.pack("<I", len(data)) + data

    def read() -> KeyFile:
        with source.open("rb", buffering=0) as file:
            header = RawHeader.read(file, os.fstat(file.fileno()).st_size)
            changes = [] if rate is None else _rate_changes(header, rate)
            own = (a for a in header.attributes if a.name.startswith(PREFIX.encode()))
            changes += [(attribute.at, attribute.end, b"") for attribute in own]
            end = next(a.end for a in reversed(header.attributes) if a.part == 0)
            head, rest = _changed_head(file, header, [*changes, (end, end, new)])
            file.seek(rest)
            return KeyFile(source, bytes(seal(head, file.read())[0]), rest)

    with _report_unsound(source):
        return with_retries(source, read)


@contextmanager
def _report_unsound(source: Path) -> Iterator[None]:
    """Translate what goes wrong while a key frame's file is read."""
    try:
        yield
    except OSError as error:
        raise InputError(
            f"cannot read {source}: {error.strerror or error}; check the path and its rights"
        ) from error
    except (ValueError, struct.error) as error:
        raise damaged_error(source, str(error)) from error


def file_digest(path: Path) -> str:
    """Digest a file's bytes; hexadecimal and errors as in `digests`."""
    return digests(path)[0]


def digests(
    path: Path, rate: Fraction | None = None, headers: HeaderCache | None = None
) -> tuple[str, str | None]:
    """Digest a frame's file, and what is written for it as a key frame with this rate.

    Hexadecimal, as generated files' checksums are. The second is None if a broken header takes no
    rate. `headers` keeps the file's header, so that the file need not be opened again for it.

    Raises DamagedFileError if there is no such file, UnreadableError if the system refuses it.
    """

    def read() -> tuple[str, str | None]:
        with path.open("rb", buffering=0) as file:
            digest = hashlib.file_digest(file, new_checksum).hexdigest()
            is_exr = path.suffix.lower() in EXR
            if headers is not None and is_exr:
                headers.keep(path, parse_header(path, file))
            if rate is None or not is_exr:
                return digest, digest
            try:
                key = KeyFile(path, *_with_rate(file, rate), file)
            except (ValueError, struct.error):
                return digest, None
            return digest, compute_checksum(key.pieces()) if key.head else digest

    try:
        return with_retries(path, read)
    except OSError as error:
        raise DamagedFileError(
            f"cannot read {path}: {error.strerror}; render or copy it again"
        ) from error


def _with_rate(file: BinaryIO, rate: Fraction) -> tuple[bytes, int]:
    """Return the headers and chunk offset table with a rate, and where the source goes on."""
    header = RawHeader.read(file, os.fstat(file.fileno()).st_size)
    changes = _rate_changes(header, rate)
    if not changes:
        return b"", 0
    head, rest = _changed_head(file, header, changes)
    if CHECKSUM.encode() in head:
        file.seek(0)
        data = file.read()
        if is_intact(data):  # a frame that ExWarp made gets a new checksum
            return bytes(seal(head, data[rest:])[0]), rest
    return head, rest


def _changed_head(file: BinaryIO, header: RawHeader, changes: list[Change]) -> tuple[bytes, int]:
    """Return changed headers, with their chunk offset table, and where the source goes on."""
    data, end = header.data, len(header.data)
    head, position = b"", 0
    for begin, stop, new in sorted(changes):
        head, position = head + data[position:begin] + new, stop
    head += data[position:]
    if len(head) == end:
        return head, end
    count = None
    if header.flags & MULTIPART:
        counts = [a.value for a in header.attributes if a.name == b"chunkCount"]
        if len(counts) != header.part_count:
            raise ValueError("a part has no chunkCount")
        count = sum(struct.unpack("<I", value)[0] for value in counts)
    size = os.fstat(file.fileno()).st_size
    first, rest = size, end
    moved: list[int] = []
    file.seek(end)
    # Without a count the chunk offset table ends where the first chunk begins.
    while rest < first if count is None else len(moved) < count:
        (offset,) = struct.unpack("<Q", file.read(_OFFSET_SIZE))
        if offset and not rest < offset < size:
            raise ValueError("the table of chunks is broken")
        first = min(first, offset or size)
        moved.append(offset + len(head) - end if offset else 0)
        rest += _OFFSET_SIZE
    if first < rest or first == size:
        raise ValueError("the table of chunks is broken")
    return head + struct.pack(f"<{len(moved)}Q", *moved), rest


def _rate_changes(header: RawHeader, rate: Fraction) -> list[Change]:
    """Return the changes that give all parts a frame rate."""
    text = RATE + b"\0rational\0" + struct.pack("<Iii", 8, rate.numerator, rate.denominator)
    changes = []
    for part in range(header.part_count):
        attributes = [attribute for attribute in header.attributes if attribute.part == part]
        own = next((attribute for attribute in attributes if attribute.name == RATE), None)
        if own is None:
            changes.append((attributes[-1].end, attributes[-1].end, text))
        elif _parse_rate(own) != rate:
            changes.append((own.at, own.end, text))
    return changes


def _parse_rate(attribute: Attribute) -> Fraction | None:
    kind, value = attribute.kind, attribute.value
    if kind == b"rational" and len(value) == 8:
        numerator, denominator = struct.unpack("<iI", value)
        return parse_rate(Fraction(numerator, denominator)) if denominator else None
    if kind in _NUMBER_FORMATS and len(value) == struct.calcsize(_NUMBER_FORMATS[kind]):
        return parse_rate(struct.unpack(_NUMBER_FORMATS[kind], value)[0])
    return parse_rate(value.decode("utf-8", "replace")) if kind == b"string" else None
