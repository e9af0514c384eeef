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
from exwarp_cli.io import files
from exwarp_cli.io.exr.header import RawHeader
from exwarp_cli.io.exr.reader import HeaderCache, damaged_error, parse_header
from exwarp_cli.io.exr.template import PREFIX
from exwarp_cli.io.files import COPY_BYTES, atomic_copy, atomic_path, with_retries
from exwarp_cli.io.generated_frames import CHECKSUM, is_intact, seal
from exwarp_cli.io.sequences import EXR

RATE = b"framesPerSecond"

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
                try:
                    piece = with_retries(self.source, read_piece)
                except OSError as error:
                    raise _unreadable(self.source, error) from error
                if not piece:
                    return
                position += len(piece)
                yield piece

    def write(self, target: Path) -> None:
        """Write the file atomically; errors are those of `pieces`, and OutputError."""
        if not self.head and self.opened is None:
            atomic_copy(self.source, target)
            return
        with atomic_path(target) as temporary, temporary.open("wb") as file:
            file.writelines(self.pieces())

    def is_at(self, target: Path) -> bool:
        """Return True if a file holds the same bytes; raises OSError if it cannot be read."""
        size = len(self.head) + self.source.stat().st_size - self.rest
        if target.stat().st_size != size:
            return False
        with target.open("rb") as file:
            return all(file.read(len(piece)) == piece for piece in self.pieces())

    def begins_with(self, data: bytes) -> bool:
        """Return True if these bytes are the beginning of the file."""
        position = 0
        for piece in self.pieces():
            if position >= len(data):
                break
            if not piece.startswith(data[position : position + len(piece)]):
                return False
            position += len(piece)
        return position >= len(data)

    def digest(self) -> str:
        """Return the checksum of the file, hexadecimal; see `exwarp_cli.io.files`."""
        return files.compute_checksum(self.pieces())


def possible_key_files(source: Path, target: Path) -> tuple[KeyFile, ...]:
    """Return what a run may have written to `target` for a key frame: as it is, or with a rate.

    The header of the target tells the frame rate of the run that wrote it.
    """
    plain = KeyFile(source)
    try:
        with target.open("rb", buffering=0) as file:
            header = RawHeader.read(file, target.stat().st_size)
        own = next(attribute for attribute in header.attributes if attribute.name == RATE)
        return plain, plan_key_file(source, _parse_rate(own.kind, header.value(own)))
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

        yield _read_sound(source, read)


def plan_marked_file(
    source: Path, rate: Fraction | None, marks: Mapping[str, str | int]
) -> KeyFile:
    """Return what is written for a rendered EXR file that gets attributes of ExWarp's own.

    Attributes that ExWarp may have written into its headers before are left out. `rate` None keeps
    the file's own rate. `marks` are attributes of the first part, by name without prefix; a
    checksum of the file joins them. Errors are those of `open_key_file`.
    """

    def read() -> KeyFile:
        with source.open("rb", buffering=0) as file:
            header = RawHeader.read(file, os.fstat(file.fileno()).st_size)
            changes = [] if rate is None else _rate_changes(header, rate)
            head, rest = _changed_head(file, header, [*changes, *_mark_changes(header, marks)])
            file.seek(rest)
            return KeyFile(source, bytes(seal(head, file.read())[0]), rest)

    return _read_sound(source, read)


def _read_sound(source: Path, read: Callable[[], KeyFile]) -> KeyFile:
    try:
        return with_retries(source, read)
    except OSError as error:
        raise _unreadable(source, error) from error
    except (ValueError, struct.error) as error:
        raise damaged_error(source, str(error)) from error


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
            digest = hashlib.file_digest(file, files.new_checksum).hexdigest()
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
        raise damaged_error(path, str(error.strerror)) from error


def _with_rate(file: BinaryIO, rate: Fraction) -> tuple[bytes, int]:
    """Return the headers and chunk offset table with a rate, and where the source goes on."""
    header = RawHeader.read(file, os.fstat(file.fileno()).st_size)
    changes = _rate_changes(header, rate)
    if not changes:
        return b"", 0
    head, rest = _changed_head(file, header, changes)
    if CHECKSUM.encode() not in head:
        return head, rest
    # A frame that ExWarp made, and that is undamaged, gets a new checksum.
    file.seek(0)
    data = file.read()
    if not is_intact(data):
        return head, rest
    begin = head.index(CHECKSUM.encode() + b"\0string\0") + len(CHECKSUM) + 12
    blank = head[:begin] + files.CHECKSUM_ZEROS.encode() + head[begin + files.CHECKSUM_DIGITS :]
    return bytes(seal(blank, data[rest:])[0]), rest


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
    if header.is_multipart:
        counts = [attribute for attribute in header.attributes if attribute.name == b"chunkCount"]
        if len(counts) != header.part_count:
            raise ValueError("a part has no chunkCount")
        count = sum(struct.unpack("<I", header.value(attribute))[0] for attribute in counts)
    offsets = _read_offsets(file, os.fstat(file.fileno()).st_size, end, count)
    moved = [offset + len(head) - end if offset else 0 for offset in offsets]
    return head + struct.pack(f"<{len(moved)}Q", *moved), end + _OFFSET_SIZE * len(offsets)


def _rate_changes(header: RawHeader, rate: Fraction) -> list[Change]:
    """Return the changes that give all parts a frame rate."""
    text = RATE + b"\0rational\0" + struct.pack("<Iii", 8, rate.numerator, rate.denominator)
    changes = []
    for part in range(header.part_count):
        attributes = [attribute for attribute in header.attributes if attribute.part == part]
        own = next((attribute for attribute in attributes if attribute.name == RATE), None)
        if own is None:
            changes.append((attributes[-1].end, attributes[-1].end, text))
        elif _parse_rate(own.kind, header.value(own)) != rate:
            changes.append((own.at, own.end, text))
    return changes


def _mark_changes(header: RawHeader, marks: Mapping[str, str | int]) -> list[Change]:
    """Return the changes that replace ExWarp's own attributes by new ones of the first part."""
    values: dict[str, str | int] = {f"{PREFIX}{name}": value for name, value in marks.items()}
    values[CHECKSUM] = files.CHECKSUM_ZEROS
    text = b""
    for name, value in values.items():
        if isinstance(value, int):
            kind, data = b"int", struct.pack("<i", value)
        else:
            kind, data = b"string", value.encode("utf-8", "surrogateescape")
        text += name.encode() + b"\0" + kind + b"\0" + struct.pack("<I", len(data)) + data
    changes = [
        (attribute.at, attribute.end, b"")
        for attribute in header.attributes
        if attribute.name.startswith(PREFIX.encode())
    ]
    end = next(attribute.end for attribute in reversed(header.attributes) if attribute.part == 0)
    return [*changes, (end, end, text)]


def _parse_rate(kind: bytes, value: bytes) -> Fraction | None:
    """Return the rate in an attribute of this type, or None."""
    if kind == b"rational" and len(value) == 8:
        numerator, denominator = struct.unpack("<iI", value)
        return parse_rate(Fraction(numerator, denominator)) if denominator else None
    if kind in _NUMBER_FORMATS and len(value) == struct.calcsize(_NUMBER_FORMATS[kind]):
        return parse_rate(struct.unpack(_NUMBER_FORMATS[kind], value)[0])
    return parse_rate(value.decode("utf-8", "replace")) if kind == b"string" else None


def _read_offsets(file: BinaryIO, size: int, begin: int, count: int | None) -> list[int]:
    """Read the chunk offset table; without a count it ends where the first chunk begins."""
    offsets: list[int] = []
    first, position = size, begin
    file.seek(begin)
    while position < first if count is None else len(offsets) < count:
        (offset,) = struct.unpack("<Q", file.read(_OFFSET_SIZE))
        if offset and not position < offset < size:
            raise ValueError("the table of chunks is broken")
        first = min(first, offset or size)
        offsets.append(offset)
        position += _OFFSET_SIZE
    if first < position or first == size:
        raise ValueError("the table of chunks is broken")
    return offsets


def _unreadable(path: Path, error: OSError) -> InputError:
    return InputError(f"cannot read {path}: {error.strerror or error}; check the path")
