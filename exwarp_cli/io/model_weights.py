"""Weights that an ONNX model keeps in files beside it, put into it.

Exporters keep the weights of larger networks apart: a tensor then names a file, and where in it
they begin. So a model may name any file at all, and onnxruntime looks in the current folder for
those of a model that it is given as bytes. What is opened is therefore decided here: files in the
model's own folder, and nothing else.

The bytes of the model are Protocol Buffers, of which only the nesting is read::

    field    = tag value                 tag: number of the field << 3 | kind
    value    = varint | 8 bytes | length bytes | 4 bytes        by the kind, 0, 1, 2, 5
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import NamedTuple

from exwarp_cli.errors import DamagedFileError, InputError, LayoutError
from exwarp_cli.io.model_files import MOST_BYTES, read_whole
from exwarp_cli.runtime.read_registry import report_reading

INSIDE: Mapping[str, Mapping[int, str]] = {
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
"""Fields by message, and what is in them, of those in which there may be a tensor."""

RAW, APART, WHERE = 9, 13, 14
"""Fields of a tensor: its bytes, what names the file with them, and whether that counts."""

DEEPEST = 100
"""Messages in each other that a reader of Protocol Buffers follows."""

VARINT, EIGHT, BYTES, FOUR = 0, 1, 2, 5
_FIXED = {EIGHT: 8, FOUR: 4}

Chunks = list[memoryview]


class Field(NamedTuple):
    """A field of a message, as it stands there; `whole` begins with its tag."""

    number: int
    kind: int
    value: int  # of a varint; 0 of all others
    content: memoryview  # of what has a length; nothing of all others
    whole: memoryview


def with_weights(path: Path, data: bytes) -> bytes:
    """Return a model that needs no other file.

    Parameters
    ----------
    path
        Of the model.
    data
        Its bytes.

    Raises
    ------
    DamagedFileError
        When the bytes are no Protocol Buffers, or a file is shorter than the model says.
    LayoutError
        When the model names files that are not in its folder, or is too large with them.
    InputError
        When a file cannot be read.
    """
    chunks = _Weights(path).of_model(data)
    return data if chunks is None else b"".join(chunks)


def files_of(path: Path) -> tuple[Path, ...]:
    """Return the files in which a model keeps weights; errors are those of `with_weights`."""
    weights = _Weights(path)
    weights.of_model(read_whole(path))
    return tuple(path.parent / location for location in weights.files)


class _MalformedError(ValueError):
    """Bytes that are no Protocol Buffers."""


class _Weights:
    """The weights of one model."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._size = 0
        self.files: dict[str, memoryview] = {}

    def of_model(self, data: bytes) -> Chunks | None:
        """Return a model with its weights; None where they are in it already."""
        try:
            with report_reading(self._path, required=True):
                return self.put_in(memoryview(data), "ModelProto", 0)
        except _MalformedError as error:
            raise DamagedFileError(
                f"{self._path} is no ONNX model, or a damaged one ({error}); check the path, or "
                "export it again"
            ) from error

    def put_in(self, message: memoryview, name: str, depth: int) -> Chunks | None:
        """Return a message with its weights; None where they are in it already."""
        if depth > DEEPEST:
            raise _MalformedError("it is nested too deeply")
        chunks: Chunks = []
        changed = False
        for field in _fields(message):
            inside = INSIDE[name].get(field.number) if field.kind == BYTES else None
            made = None
            if inside == "TensorProto":
                made = self._tensor(field.content)
            elif inside is not None:
                made = self.put_in(field.content, inside, depth + 1)
            changed = changed or made is not None
            chunks += [field.whole] if made is None else _joined(field.number, made)
        return chunks if changed else None

    def _tensor(self, message: memoryview) -> Chunks | None:
        """Return a tensor with its bytes; None where it has them already."""
        fields = list(_fields(message))
        # Numbers of 64 bits are cut to the 32 that such a value has.
        if not any(f.number == WHERE and f.value & 0xFFFFFFFF == 1 for f in fields):
            return None
        entries = dict(_entry(f.content) for f in fields if f.number == APART and f.kind == BYTES)
        kept = [field.whole for field in fields if field.number not in (RAW, APART, WHERE)]
        return kept + _joined(RAW, [self._bytes(entries)])

    def _bytes(self, entries: Mapping[str, str]) -> memoryview:
        """Return the part of a file that a tensor names."""
        location = entries.get("location", "")
        content = self._file(location)
        begin = self._number(entries, "offset", 0)
        end = begin + self._number(entries, "length", max(0, len(content) - begin))
        if end > len(content):
            raise DamagedFileError(
                f"{self._path.parent / location}, where {self._path.name} keeps weights, has "
                f"{len(content)} bytes and should have {end}; copy or export both files again"
            )
        self._size += end - begin
        if self._size > MOST_BYTES:
            raise LayoutError(
                f"{self._path} has more than 2 GiB of weights, which ExWarp does not take; use a "
                "smaller network"
            )
        return content[begin:end]

    def _number(self, entries: Mapping[str, str], key: str, default: int) -> int:
        text = entries.get(key, str(default))
        if not (text.isascii() and text.isdecimal() and len(text) < 20):
            raise DamagedFileError(
                f"{self._path} keeps weights in another file at {key} {text[:40]!r}, which is no "
                "number of bytes; export it again"
            )
        return int(text)

    def _file(self, location: str) -> memoryview:
        """Return a file's content, which is read once."""
        if location not in self.files:
            place = self._place(location)
            try:
                self.files[location] = memoryview(read_whole(place))
            except OSError as error:
                raise InputError(
                    f"{self._path} keeps weights in {place}, which cannot be read: "
                    f"{error.strerror}; copy that file along, or save the model with its weights "
                    "inside"
                ) from error
        return self.files[location]

    def _place(self, location: str) -> Path:
        """Return the path of a file in the model's folder; LayoutError for one elsewhere."""
        windows = PureWindowsPath(location)  # whose rules for what leads out are the stricter ones
        parts = {*PurePosixPath(location).parts, *windows.parts}
        leads_out = ".." in parts or windows.drive or windows.root
        if location and not leads_out and "\0" not in location:
            # Model and weights may both be links into one folder, as download caches have them.
            homes = {self._path.parent.resolve(), self._path.resolve().parent}
            place = self._path.parent / location
            with suppress(OSError, RuntimeError):  # links that lead to each other
                if any(place.resolve().is_relative_to(home) for home in homes):
                    return place
        raise LayoutError(
            f"{self._path} keeps weights in {location[:200]!r}, and only files in the folder of a "
            "model are read; put them there, or save the model with its weights inside"
        )


def _fields(message: memoryview) -> Iterator[Field]:
    """Yield the fields of a message."""
    at, size = 0, len(message)
    while at < size:
        begin = at
        tag, at = _varint(message, at)
        number, kind = tag >> 3, tag & 7
        value, content = 0, message[:0]
        if kind == VARINT:
            value, at = _varint(message, at)
        elif kind == BYTES:
            length, at = _varint(message, at)
            content = message[at : at + length]
            at += length
        elif kind in _FIXED:
            at += _FIXED[kind]
        else:
            raise _MalformedError(f"there is no kind {kind} of field")
        if at > size or number == 0 or tag >> 32:
            raise _MalformedError("a field has no end")
        yield Field(number, kind, value, content, message[begin:at])


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """Read a number of 7 bits a byte, lowest first; return it and where it ends."""
    value = shift = 0
    for byte in message[at : at + 10]:
        value |= (byte & 0x7F) << shift
        shift += 7
        if byte < 0x80:
            return value, at + shift // 7
    raise _MalformedError("a number has no end")


def _entry(message: memoryview) -> tuple[str, str]:
    """Read a key and its value."""
    texts = {field.number: bytes(field.content).decode("utf-8", "replace") for field in
             _fields(message)}  # fmt: skip
    return texts.get(1, ""), texts.get(2, "")


def _joined(number: int, chunks: Chunks) -> Chunks:
    """Write a field that has a length."""
    head = bytearray()
    for value in (number << 3 | BYTES, sum(map(len, chunks))):
        while value > 0x7F:
            head.append(value & 0x7F | 0x80)
            value >>= 7
        head.append(value)
    return [memoryview(bytes(head)), *chunks]
