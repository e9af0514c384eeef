"""Reading EXR files in both ways, for tests: here, and by OpenImageIO alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from exwarp_cli.errors import InputError
from exwarp_cli.io.exr import Channel, ExrReader
from exwarp_cli.io.exr_chunks import stored_parts

Read = dict[tuple[int, str], np.ndarray]


def every(file: ExrReader) -> list[Channel]:
    return [channel for part in file.parts for channel in part.channels]


def named(found: dict[Channel, np.ndarray]) -> Read:
    return {(c.part, c.raw_name): array for c, array in found.items()}


def here(path: Path, choose: Callable[[ExrReader], list[list[Channel]]] | None = None) -> Read:
    """Read without OpenImageIO's help."""
    with ExrReader(path) as file:
        file._by_openimageio = lambda left: dict.fromkeys(left)  # type: ignore[method-assign]
        return named(file.read(*(choose(file) if choose else [every(file)])))


def by_openimageio(path: Path) -> Read:
    with ExrReader(path) as file:
        return named(file._by_openimageio(every(file)))


def agree(path: Path, choose: Callable[[ExrReader], list[list[Channel]]] | None = None) -> Read:
    """See that a file is decoded here, and is what OpenImageIO has in every bit."""
    ours, theirs = here(path, choose), by_openimageio(path)
    assert ours
    for name, array in ours.items():
        assert array is not None, f"{name} is left to OpenImageIO"
        assert array.dtype == theirs[name].dtype and array.shape == theirs[name].shape
        assert array.tobytes() == theirs[name].tobytes(), name
    return ours


def left(path: Path) -> bool:
    """Whether all of a file is left to OpenImageIO."""
    return all(array is None for array in here(path).values())


def parts_of(data: bytes) -> list[Any]:
    def read(start: int, size: int) -> np.ndarray:
        return np.frombuffer(data[start : start + size], np.uint8)

    return stored_parts(read, len(data))


def outcome(read: Callable[[], Read]) -> dict[tuple[int, str], bytes] | tuple[type, str]:
    try:
        return {name: array.tobytes() for name, array in read().items()}
    except InputError as error:
        return type(error), str(error)


def as_always(path: Path) -> Read:
    with ExrReader(path) as file:
        return named(file.read(every(file)))


def one_part_at_a_time(path: Path) -> Read:
    """What OpenImageIO reads, part by part as `ExrReader.read` does."""
    with ExrReader(path) as file:
        return named(file._by_openimageio(every(file)))
