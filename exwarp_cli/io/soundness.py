"""What is wrong with frames: missing and damaged files, and pixels that are NaN or infinite."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TypeVar

import numpy as np

from exwarp_cli.domain.frame import Bool, is_surely_finite, nonfinite_pixels
from exwarp_cli.errors import InputError
from exwarp_cli.io.channels import Role
from exwarp_cli.io.exr.reader import ExrFile

T = TypeVar("T")

AT_A_TIME = 8
"""Channels that are decoded together: a part may have dozens, of 33 MB each at 3840x2160."""


def first_of(numbers: Iterable[int], made_of: Callable[[int], T]) -> T:
    """Return what the first frame gives that can be used.

    Parameters
    ----------
    numbers
        Of the frames, at least one.
    made_of
        Called with a number; raises InputError where nothing comes of that frame.

    Raises
    ------
    InputError
        That of the very first frame, where all are of no use.
    """
    first_error: InputError | None = None
    for number in numbers:
        try:
            return made_of(number)
        except InputError as error:
            first_error = first_error or error
    assert first_error is not None
    raise first_error


def require_sound(paths: Iterable[Path]) -> None:
    """Decode all that is flat in some EXR files, as damage shows in pixels alone.

    Raises
    ------
    InputError
        When one is missing or damaged.
    """
    for path in paths:
        with ExrFile(path) as file:
            for part in file.parts:
                for i in range(0, 0 if part.deep else len(part.channels), AT_A_TIME):
                    file.read(part.channels[i : i + AT_A_TIME])


class NonFinite:
    """What was found in a sequence's frames. Several threads may note what they read."""

    def __init__(self) -> None:
        self._found: dict[int, dict[str, int]] = {}

    def note(self, number: int, pixels: Mapping[str, int]) -> None:
        """Note how many pixels of a frame are not finite, by what was read.

        Parameters
        ----------
        number
            Of the frame, which may be read several times.
        pixels
            By the channels' role, or their layer.
        """
        for channels, count in pixels.items():
            if count:
                known = self._found.setdefault(number, {})
                known[channels] = max(count, known.get(channels, 0))

    def of(self, number: int) -> Iterator[tuple[str, int]]:
        """Yield what was found in a frame, sorted: channels, and how many pixels."""
        yield from sorted(self._found.get(number, {}).items())


def count_broken(planes: Iterable[np.ndarray], role: Role | None = None) -> int:
    """Count the pixels that are not finite in some of these channels.

    In a depth these are NaN alone: infinity is how renderers write the background.

    Parameters
    ----------
    planes
        [H, W] or [H, W, C] of any types; those of other windows than the first are left out.
    role
        What they are for, as far as that is known.
    """
    found: Bool | None = None
    shape: tuple[int, ...] | None = None
    for plane in planes:
        if plane.dtype.kind != "f":
            continue
        shape = shape or plane.shape[:2]
        broken = _broken(plane.reshape(*plane.shape[:2], -1), role)
        if broken is not None and broken.shape == shape:
            found = broken if found is None else found | broken
    return 0 if found is None else int(np.count_nonzero(found))


def _broken(values: np.ndarray, role: Role | None) -> Bool | None:
    """bool [H, W]: pixels of [H, W, C] as `count_broken` counts them; None where there are none."""
    if role is Role.DEPTH:
        unknown = np.isnan(values)
        return np.asarray(unknown.any(axis=-1)) if unknown.any() else None
    return None if is_surely_finite(values) else nonfinite_pixels(values)
