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
from typing import BinaryIO, TypeVar

from exwarp_cli.domain.timeline import parse_rate
from exwarp_cli.errors import DamagedFileError, InputError
from exwarp_cli.io import files
from exwarp_cli.io.exr.header import MULTIPART, Attribute, RawHeader
from exwarp_cli.io.exr.reader import HeaderCache, damaged_error, parse_header
from exwarp_cli.io.exr.writer import PREFIX
from exwarp_cli.io.generated_frames import CHECKSUM, is_intact, seal
from exwarp_cli.io.sequences import EXR

T = TypeVar("T")

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

            while piece := _read_source(self.source, read_piece):
                position += len(piece)
                yield piece

    def write(self, target: Path) -> None:
        """Write the file atomically; errors are those of `pieces`, and OutputError."""
        with files.atomic_path(target) as temporary, temporary.open("wb") as file:
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


def plan_key_file(
    source: Path, rate: Fraction | None, marks: Mapping[str, str | int] | None = None
) -> KeyFile:
    """Return what is written for a key frame; as `open_key_file`, but the source is closed."""
    with open_key_file(source, rate, marks) as key:
        return replace(key, opened=None)


@contextmanager
def open_key_file(
    source: Path, rate: Fraction | None, marks: Mapping[str, str | int] | None = None
) -> Iterator[KeyFile]:
    """Open a key frame whose header is to change, to write it or to read it once more.

    `rate` is in frames per second; None keeps the file's own. `marks` are attributes of ExWarp's
    own for the first part of a rendered EXR file, by name without prefix; a checksum of the file
    joins them, and those that ExWarp may have written before are left out. Without both, or if the
    source is no EXR, it is copied as it is.

    Raises InputError if there is no such file, UnreadableError if the system refuses it,
    DamagedFileError if its header or its chunk offset table is broken.
    """
    if (rate is None and marks is None) or source.suffix.lower() not in EXR:
        yield KeyFile(source)
        return
    with ExitStack() as stack:

        def read() -> KeyFile:
            file = stack.enter_context(source.open("rb", buffering=0))
            return KeyFile(source, *_new_head(file, rate, marks), file)

        yield _read_source(source, read)


def _read_source(source: Path, read: Callable[[], T]) -> T:
    """Call a reader of a key frame's file as `with_retries` does, and translate its errors."""
    try:
        return files.with_retries(source, read)
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
            digest = hashlib.file_digest(file, files.new_checksum).hexdigest()
            is_exr = path.suffix.lower() in EXR
            if headers is not None and is_exr:
                headers.keep(path, parse_header(path, file))
            if rate is None or not is_exr:
                return digest, digest
            try:
                key = KeyFile(path, *_new_head(file, rate), file)
            except (ValueError, struct.error):
                return digest, None
            return digest, files.compute_checksum(key.pieces()) if key.head else digest

    try:
        return files.with_retries(path, read)
    except OSError as error:
        raise DamagedFileError(
            f"cannot read {path}: {error.strerror}; render or copy it again"
        ) from error


def _new_head(
    file: BinaryIO, rate: Fraction | None, marks: Mapping[str, str | int] | None = None
) -> tuple[bytes, int]:
    """Return the headers and chunk offset table as they are to be, and where the source goes on.

    Empty and 0 if nothing changes; `rate` and `marks` as in `open_key_file`.
    """
    header = RawHeader.read(file, os.fstat(file.fileno()).st_size)
    changes: list[Change] = []
    if rate is not None:
        value = struct.pack("<Iii", 8, rate.numerator, rate.denominator)
        text = RATE + b"\0rational\0" + value
        for part in range(header.part_count):
            attributes = [attribute for attribute in header.attributes if attribute.part == part]
            own = next((attribute for attribute in attributes if attribute.name == RATE), None)
            if own is None:
                changes.append((attributes[-1].end, attributes[-1].end, text))
            elif _parse_rate(own) != rate:
                changes.append((own.at, own.end, text))
    if marks is not None:
        earlier = (a for a in header.attributes if a.name.startswith(PREFIX.encode()))
        changes += [(attribute.at, attribute.end, b"") for attribute in earlier]
        new = b""
        for name, mark in {**marks, files.CHECKSUM_NAME: files.CHECKSUM_ZEROS}.items():
            if isinstance(mark, int):
                kind, data = b"int", struct.pack("<i", mark)
            else:
                kind, data = b"string", mark.encode("utf-8", "surrogateescape")
            new += f"{PREFIX}{name}".encode() + b"\0" + kind + b"\0"
            new += struct.pack("<I", len(data)) + data
        end = next(a.end for a in reversed(header.attributes) if a.part == 0)
        changes.append((end, end, new))
    if not changes:
        return b"", 0
    head, rest = _changed_head(file, header, changes)
    if marks is not None or CHECKSUM.encode() in head:
        file.seek(0)
        data = file.read()
        if marks is not None or is_intact(data):  # a frame that ExWarp made gets a new checksum
            return bytes(seal(head, memoryview(data)[rest:])[0]), rest
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


def _parse_rate(attribute: Attribute) -> Fraction | None:
    kind, value = attribute.kind, attribute.value
    if kind == b"rational" and len(value) == 8:
        numerator, denominator = struct.unpack("<iI", value)
        return parse_rate(Fraction(numerator, denominator)) if denominator else None
    if kind in _NUMBER_FORMATS and len(value) == struct.calcsize(_NUMBER_FORMATS[kind]):
        return parse_rate(struct.unpack(_NUMBER_FORMATS[kind], value)[0])
    return parse_rate(value.decode("utf-8", "replace")) if kind == b"string" else None
