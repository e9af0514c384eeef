"""Risk: how wrong a new frame is, as predicted without ground truth."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

ROWS = 8
"""Tiles from a frame's top to its bottom."""

REASONS = ("light", "holes", "motion")
"""Why a tile is expected to be wrong: light differs on surfaces that both key frames show; no key
frame, or only one, shows the surface; surfaces move apart there, so that outlines are uncertain."""

STEPS = 16
"""Steps of a tile's error to its doubling: it is kept to 4 %."""

_TILE = re.compile(r"([a-z])([0-9a-f]{2})")


@dataclass(frozen=True)
class Risk:
    """The predicted error of one frame, and of its tiles.

    Attributes
    ----------
    error
        Predicted RMS error of the frame, display levels of 0 to 255.
    columns, rows
        How many tiles the display window is divided into; see `edges`.
    codes
        Of each tile, row by row: its predicted RMS error, as `code_of` keeps it.
    reasons
        Of each tile: an index into `REASONS`.
    """

    error: float
    columns: int
    rows: int
    codes: tuple[int, ...]
    reasons: tuple[int, ...]

    @property
    def levels(self) -> tuple[float, ...]:
        """Predicted RMS error of each tile, display levels of 0 to 255."""
        return tuple(level_of(code) for code in self.codes)

    @property
    def text(self) -> str:
        """Return the tiles on one line: ``14x8:l1fh40…``, a reason's first letter and a code."""
        tiles = (f"{REASONS[w][0]}{c:02x}" for w, c in zip(self.reasons, self.codes, strict=True))
        return f"{self.columns}x{self.rows}:{''.join(tiles)}"

    @classmethod
    def parsed(cls, error: float, text: str) -> Risk:
        """Read `text` again.

        Raises
        ------
        ValueError
            When it is no such text.
        """
        size, _, tiles = text.partition(":")
        columns, rows = map(int, size.split("x"))
        found = _TILE.findall(tiles)
        letters = [reason[0] for reason in REASONS]
        if len(found) != columns * rows or 3 * len(found) != len(tiles):
            raise ValueError(f"{text!r} has other tiles than it says")
        reasons = tuple(letters.index(letter) for letter, _ in found)
        return cls(float(error), columns, rows, tuple(int(c, 16) for _, c in found), reasons)


def code_of(level: float) -> int:
    """Return a tile's error, 0 to 255, as a whole number of steps, 0 to 128."""
    return round(STEPS * math.log2(1 + min(max(level, 0.0), 255.0)))


def level_of(code: int) -> float:
    """Invert `code_of`, but for what it rounds."""
    return float(2 ** (code / STEPS) - 1)


def columns_of(width: int, height: int) -> int:
    """Return how many columns of nearly square tiles a frame has."""
    return max(1, round(ROWS * width / height))


def edges(size: int, parts: int) -> Sequence[int]:
    """Return where tiles begin along a side of so many pixels, and where the last one ends."""
    return [i * size // parts for i in range(parts + 1)]
