"""Read the bytes of a model, with weights that it keeps in other files, and what it declares.

A model's metadata may state `exwarp.interface`, the version of the inputs that it was made for, and
`exwarp.stride`, the number that the height and width of its inputs must be multiples of.

Exporters keep the weights of larger networks in files beside the model: a tensor then names a file
and an offset. Such a name may be any path, and onnxruntime looks in the current folder for files of
a model that it is given as bytes. So only files in the model's own folder are opened, here.

The bytes of a model are Protocol Buffers, of which only the nesting is read::

    field    = tag value                 tag: number of the field << 3 | kind
    value    = varint | 8 bytes | length bytes | 4 bytes        by the kind, 0, 1, 2, 5
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import stat
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any, NamedTuple

from exwarp_cli.errors import DamagedFileError, InputError, LayoutError
from exwarp_cli.runtime.read_registry import report_reading

# Limit of a file in Protocol Buffers, and more than any other file that is read whole.
MAX_BYTES = 2**31 - 1

CHECKSUMS = "checksums.json"  # beside the shipped models: SHA-256 by file name

STRIDE_KEY, INTERFACE_KEY = "exwarp.stride", "exwarp.interface"

# Fields that may contain a tensor, by message.
NESTED_MESSAGES: Mapping[str, Mapping[int, str]] = {
    "ModelProto": {7: "GraphProto", 20: "TrainingInfoProto", 25: "FunctionProto"},
    "TrainingInfoProto": {1: "GraphProto", 2: "GraphProto"},
    "FunctionProto": {7: "NodeProto", 11: "AttributeProto"},
    "GraphProto": {1: "NodeProto", 5: "TensorProto", 15: "SparseTensorProto"},
    "NodeProto": {5: "AttributeProto"},
    "AttributeProto": {
        5: "TensorProto",
        6: "GraphProto",
        10: "TensorProto",
        11: "GraphProto",
        22: "SparseTensorProto",
        23: "SparseTensorProto",
    },
    "SparseTensorProto": {1: "TensorProto", 2: "TensorProto"},
}

# Fields of a tensor: its bytes, the entries that name a file with them, and where the bytes are.
RAW_DATA, EXTERNAL_DATA, DATA_LOCATION = 9, 13, 14
EXTERNAL = 1

MAX_DEPTH = 100  # depth of nested messages that a reader of Protocol Buffers follows

VARINT, EIGHT_BYTES, LENGTH_DELIMITED, FOUR_BYTES = 0, 1, 2, 5
_FIXED_SIZES = {EIGHT_BYTES: 8, FOUR_BYTES: 4}

Chunks = list[memoryview]


def read_file_bytes(path: Path) -> bytes:
    """Read a whole regular file; OSError for a pipe, a device, or more than 2 GiB."""
    # O_NONBLOCK: to open a pipe into which no process writes would never end.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    with open(path, "rb", opener=lambda name, _: os.open(name, flags)) as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "it is a pipe or a device", str(path))
        if status.st_size > MAX_BYTES:
            raise OSError(errno.EFBIG, "it has more than 2 GiB", str(path))
        return file.read(MAX_BYTES)


def shipped_folder() -> Path:
    """Return the folder of the models that come with ExWarp, in the package or in a clone."""
    package = Path(__file__).resolve().parents[1]
    installed = package / "_models"
    return installed if installed.is_dir() else package.parent / "models"


def read_model(path: Path | None, shipped: str, option: str) -> tuple[Path, bytes]:
    """Read a user's model, or the one named `shipped` that comes with ExWarp if `path` is None.

    Raises InputError if the file is missing or unreadable, or if the checksum of a shipped model
    is missing or differs; the message then names the option by which to use another model.
    """
    if path is not None:
        try:
            return path, read_file_bytes(path)
        except FileNotFoundError as error:
            raise InputError(f"there is no model {path}; check the path") from error
        except OSError as error:
            raise InputError(
                f"cannot read the model {path}: {error.strerror}; check the path and its rights"
            ) from error
    path = shipped_folder() / shipped
    try:
        data = path.read_bytes()
        expected = json.loads((path.parent / CHECKSUMS).read_bytes())[path.name]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"the model {path}, which comes with ExWarp, is missing or has no checksum beside it; "
            f"install ExWarp again, or name a model with {option}"
        ) from error
    if hashlib.sha256(data).hexdigest() != expected:
        raise DamagedFileError(
            f"the model {path} is not the one that came with ExWarp, its checksum differs; install "
            f"ExWarp again, or name this model with {option}"
        )
    return path, data


def shape_text(shape: Sequence[Any]) -> str:
    """Format a shape; free sizes are written by their name or as ``?``."""
    return f"[{', '.join('?' if size is None else str(size) for size in shape)}]"


def embed_weights(path: Path, data: bytes) -> tuple[bytes, tuple[Path, ...]]:
    """Return a model's bytes with the weights in them that it keeps in other files, and these.

    Raises DamagedFileError if the bytes are no Protocol Buffers or a file of weights is too short,
    LayoutError if it names files outside of its folder or is too large with them, InputError if a
    file cannot be read.
    """
    weights = _Weights(path, {})
    try:
        with report_reading(path, required=True):
            chunks = weights.embed_in(memoryview(data), "ModelProto", 0)
    except _MalformedError as error:
        raise DamagedFileError(
            f"{path} is no ONNX model, or a damaged one ({error}); check the path, or export it "
            "again"
        ) from error
    files = tuple(path.parent / location for location in weights.files)
    return data if chunks is None else b"".join(chunks), files


class _MalformedError(ValueError):
    """The bytes are no Protocol Buffers."""


@dataclass
class _Weights:
    """Copies external weights into one model."""

    path: Path
    files: dict[str, memoryview]  # those that were read, by location
    size: int = 0  # of all that was copied, bytes

    def embed_in(self, message: memoryview, name: str, depth: int) -> Chunks | None:
        """Return a message of the type `name` with its weights in it; None if nothing changes."""
        if name == "TensorProto":
            fields = list(_fields(message))
            # A varint of 64 bits is cut to the 32 bits of an enumeration.
            if not any(
                f.number == DATA_LOCATION and f.value & 0xFFFFFFFF == EXTERNAL for f in fields
            ):
                return None
            entries = {}
            for field in fields:
                if field.number == EXTERNAL_DATA and field.kind == LENGTH_DELIMITED:
                    texts = {f.number: bytes(f.content) for f in _fields(field.content)}
                    key, value = (texts.get(k, b"").decode("utf-8", "replace") for k in (1, 2))
                    entries[key] = value
            replaced = (RAW_DATA, EXTERNAL_DATA, DATA_LOCATION)
            kept = [field.raw for field in fields if field.number not in replaced]
            return kept + _length_delimited(RAW_DATA, [self._external_bytes(entries)])
        if depth > MAX_DEPTH:
            raise _MalformedError("it is nested too deeply")
        chunks: Chunks = []
        is_changed = False
        for field in _fields(message):
            delimited = field.kind == LENGTH_DELIMITED
            nested = NESTED_MESSAGES[name].get(field.number) if delimited else None
            new = None if nested is None else self.embed_in(field.content, nested, depth + 1)
            is_changed = is_changed or new is not None
            chunks += [field.raw] if new is None else _length_delimited(field.number, new)
        return chunks if is_changed else None

    def _external_bytes(self, entries: Mapping[str, str]) -> memoryview:
        location = entries.get("location", "")
        if location not in self.files:
            path = self.path.parent / location
            if not self._is_inside(location):
                raise LayoutError(
                    f"{self.path} keeps weights in {location[:200]!r}, and only files in the "
                    "folder of a model are read; put them there, or save the model with its "
                    "weights inside"
                )
            try:
                self.files[location] = memoryview(read_file_bytes(path))
            except OSError as error:
                raise InputError(
                    f"{self.path} keeps weights in {path}, which cannot be read: "
                    f"{error.strerror}; copy that file along, or save the model with its weights "
                    "inside"
                ) from error
        content = self.files[location]
        numbers: dict[str, int] = {}
        for key in ("offset", "length"):
            text = entries.get(key, "0")
            if not (text.isascii() and text.isdecimal() and len(text) < 20):
                raise DamagedFileError(
                    f"{self.path} keeps weights in another file at {key} {text[:40]!r}, which is "
                    "no number of bytes; export it again"
                )
            numbers[key] = int(text)
        begin = numbers["offset"]
        end = begin + numbers["length"] if "length" in entries else max(begin, len(content))
        if end > len(content):
            raise DamagedFileError(
                f"{self.path.parent / location}, where {self.path.name} keeps weights, has "
                f"{len(content)} bytes and should have {end}; copy or export both files again"
            )
        self.size += end - begin
        if self.size > MAX_BYTES:
            raise LayoutError(
                f"{self.path} has more than 2 GiB of weights, which ExWarp does not take; use a "
                "smaller network"
            )
        return content[begin:end]

    def _is_inside(self, location: str) -> bool:
        """Return True if a location leads to a file in the model's folder."""
        windows = PureWindowsPath(location)  # its rules for what leads out are stricter
        parts = {*PurePosixPath(location).parts, *windows.parts}
        leads_out = ".." in parts or windows.drive or windows.root
        if not location or leads_out or "\0" in location:
            return False
        # Model and weights may both be links into one folder, as download caches have them.
        folders = {self.path.parent.resolve(), self.path.resolve().parent}
        with suppress(OSError, RuntimeError):  # links that lead to each other
            path = (self.path.parent / location).resolve()
            return any(path.is_relative_to(folder) for folder in folders)
        return False


class _Field(NamedTuple):
    number: int
    kind: int
    value: int  # of a varint; 0 of the other kinds
    content: memoryview  # of a length-delimited field; empty of the other kinds
    raw: memoryview  # with the tag


def _fields(message: memoryview) -> Iterator[_Field]:
    position, size = 0, len(message)
    while position < size:
        begin = position
        tag, position = _varint(message, position)
        number, kind = tag >> 3, tag & 7
        value, content = 0, message[:0]
        if kind == VARINT:
            value, position = _varint(message, position)
        elif kind == LENGTH_DELIMITED:
            length, position = _varint(message, position)
            content = message[position : position + length]
            position += length
        elif kind in _FIXED_SIZES:
            position += _FIXED_SIZES[kind]
        else:
            raise _MalformedError(f"there is no kind {kind} of field")
        if position > size or number == 0 or tag >> 32:
            raise _MalformedError("a field has no end")
        yield _Field(number, kind, value, content, message[begin:position])


def _varint(message: memoryview, position: int) -> tuple[int, int]:
    """Read a number of 7 bits a byte, lowest first; return it and the position behind it."""
    value = shift = 0
    for byte in message[position : position + 10]:
        value |= (byte & 0x7F) << shift
        shift += 7
        if byte < 0x80:
            return value, position + shift // 7
    raise _MalformedError("a number has no end")


def _length_delimited(number: int, chunks: Chunks) -> Chunks:
    head = bytearray()
    for value in (number << 3 | LENGTH_DELIMITED, sum(map(len, chunks))):
        while value > 0x7F:
            head.append(value & 0x7F | 0x80)
            value >>= 7
        head.append(value)
    return [memoryview(bytes(head)), *chunks]
