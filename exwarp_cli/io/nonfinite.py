"""Pixels that a renderer left NaN or infinite, counted as frames are read."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from exwarp_cli.domain.frame import Bool, are_finite, broken_pixels
from exwarp_cli.io.channels import Role


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
    return None if are_finite(values) else broken_pixels(values)
