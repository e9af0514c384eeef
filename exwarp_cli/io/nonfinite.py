"""Pixels that a renderer left NaN or infinite, counted as frames are read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping


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
