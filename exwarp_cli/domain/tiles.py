"""Choices tile by tile: what makes each part of a frame, and the paper's path of each tile."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.decision import EXTRAPOLATE, PATHS, WARP
from exwarp_cli.domain.frame import Bool

REWARP = "rewarp"
"""What makes a tile beside W and E: W of the slot before, which shows E there (path S4)."""

LETTERS = {WARP: "w", EXTRAPOLATE: "e", REWARP: "r"}
"""Of each maker, as headers and tables keep it."""

TILE_PATHS = tuple(name for name, path in PATHS.items() if path.made_by[0] == WARP)
"""Paths that a tile may take, S3 to S6: d1 warps, as nothing is gained by a repeated frame."""

TILE_STATE = "tiles/1"
"""Version of what a policy of tiles sees; its metadata have it as ``state``."""

TILE_FEATURES = ("holes", "outlines", "Var_x", "Var_y", "light", "motion")
"""What a policy sees of a tile, in place of the paper's six features of a frame.

holes, outlines: shares of its pixels that the key frame does not show, and that show the outline of
a surface which was there. Var_x, Var_y: variances of the components of its motion, squared pixels
a key interval. light, motion: mean squared difference, in squared display levels, by which the key
frame before predicts this one, beside no edge of moving surfaces and beside one.
"""

_TEXT = re.compile(r"([1-9][0-9]*)x([1-9][0-9]*):([wer]+)")


@dataclass(frozen=True)
class TileMakers:
    """What makes each tile of one frame.

    Attributes
    ----------
    columns, rows
        How many tiles the display window is divided into; see `exwarp_cli.domain.risk.edges`.
    letters
        Of each tile, row by row: out of `LETTERS`.
    """

    columns: int
    rows: int
    letters: str

    @property
    def text(self) -> str:
        """Return the tiles on one line: ``14x8:wwe…``."""
        return f"{self.columns}x{self.rows}:{self.letters}"

    @classmethod
    def parsed(cls, text: str) -> TileMakers:
        """Read `text` again; raises ValueError when it is no such text."""
        found = _TEXT.fullmatch(text)
        if found is None or int(found[1]) * int(found[2]) != len(found[3]):
            raise ValueError(f"{text!r} says nothing of tiles")
        return cls(int(found[1]), int(found[2]), found[3])

    def made_by(self, maker: str) -> Bool:
        """Return which tiles a maker makes, bool [rows, columns]."""
        letters = np.array(list(self.letters)).reshape(self.rows, self.columns)
        return np.asarray(letters == LETTERS[maker])

    def share(self, maker: str) -> float:
        """Return the share of the tiles that a maker makes, 0 to 1."""
        return self.letters.count(LETTERS[maker]) / len(self.letters)


@dataclass(frozen=True)
class TilePlan:
    """The path that each tile takes through a key interval.

    Attributes
    ----------
    columns, rows
        As `TileMakers` has them.
    paths
        Out of `TILE_PATHS`, row by row.
    """

    columns: int
    rows: int
    paths: tuple[str, ...]

    @classmethod
    def fixed(cls, columns: int, rows: int, path: str) -> TilePlan:
        """Return the plan that takes one path in every tile."""
        return cls(columns, rows, (path,) * (columns * rows))

    @property
    def extrapolates(self) -> bool:
        """Whether the network makes any part of any frame."""
        return any(PATHS[name].extrapolates for name in self.paths)

    def makers(self, slot: int) -> TileMakers:
        """Return what makes each tile of a slot, 1 to 3."""
        letters = {name: LETTERS[_maker(name, slot)] for name in TILE_PATHS}
        return TileMakers(self.columns, self.rows, "".join(letters[name] for name in self.paths))


def _maker(path: str, slot: int) -> str:
    """Return what makes a tile of a slot on a path."""
    makers = PATHS[path].made_by
    if slot == 3 and makers[1:] == (EXTRAPOLATE, WARP):
        return REWARP
    return makers[slot - 1]


def paths_of(second: TileMakers, third: TileMakers) -> tuple[str, ...]:
    """Return the path of each tile from what made slots 2 and 3; raises KeyError for no path."""
    pairs = {(LETTERS[_maker(p, 2)], LETTERS[_maker(p, 3)]): p for p in TILE_PATHS}
    return tuple(pairs[pair] for pair in zip(second.letters, third.letters, strict=True))
