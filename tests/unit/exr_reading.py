"""Reading EXR files in both ways, for tests: here, and by OpenImageIO alone."""

from __future__ import annotations

import io
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from exwarp_cli.errors import InputError
from exwarp_cli.io.exr import reader
from exwarp_cli.io.exr.header import Channel, RawHeader
from exwarp_cli.io.exr.reader import ExrFile
from exwarp_cli.io.exr.scanlines import parse_layouts

Read = dict[tuple[int, str], np.ndarray]


class LeftToOpenImageIOError(Exception):
    """Raised where OpenImageIO would open a file."""


def every(file: ExrFile) -> list[Channel]:
    return [channel for part in file.parts for channel in part.channels]


def named(found: dict[Channel, np.ndarray]) -> Read:
    return {(c.part, c.raw_name): array for c, array in found.items()}


@contextmanager
def without_openimageio():
    with patch.object(reader, "open_image", side_effect=LeftToOpenImageIOError):
        yield


def here(path: Path, choose: Callable[[ExrFile], list[list[Channel]]] | None = None) -> Read:
    """Read without OpenImageIO's help."""
    with without_openimageio(), ExrFile(path) as file:
        return named(file.read(*(choose(file) if choose else [every(file)])))


def agree(path: Path, choose: Callable[[ExrFile], list[list[Channel]]] | None = None) -> Read:
    """See that a file is decoded here, with OpenImageIO's parts and bits."""
    ours = here(path, choose)
    with ExrFile(path) as file, ExrFile(path, by_openimageio=True) as other:
        assert file.parts == other.parts
        theirs = named(other.read(every(other)))
    assert ours
    for name, array in ours.items():
        assert array.dtype == theirs[name].dtype and array.shape == theirs[name].shape
        assert array.tobytes() == theirs[name].tobytes(), name
    return ours


def left(path: Path) -> bool:
    """Whether OpenImageIO opens a file that is read whole."""
    try:
        here(path)
    except LeftToOpenImageIOError:
        return True
    return False


def parts_of(data: bytes) -> list[Any]:
    file = io.BytesIO(data)
    return parse_layouts(RawHeader.read(file, len(data)), file, len(data))


def outcome(read: Callable[[], Read]) -> dict[tuple[int, str], bytes] | tuple[type, str]:
    try:
        return {name: array.tobytes() for name, array in read().items()}
    except InputError as error:
        return type(error), str(error)


def as_always(path: Path) -> Read:
    with ExrFile(path) as file:
        return named(file.read(every(file)))


def one_part_at_a_time(path: Path) -> Read:
    """What OpenImageIO reads, part by part as `ExrFile.read` does."""
    with ExrFile(path, by_openimageio=True) as file:
        return named(file.read(every(file)))
