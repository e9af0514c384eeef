"""Which frame a sequence is recognised by where some of its frames may be missing or damaged."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TypeVar

from exwarp_cli.errors import InputError
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
    told: InputError | None = None
    for number in numbers:
        try:
            return made_of(number)
        except InputError as error:
            told = told or error
    assert told is not None
    raise told


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
