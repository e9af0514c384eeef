"""Tiles of a frame: their predicted error (risk), and their makers and paths."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.decision import EXTRAPOLATE, LOOKAHEAD, PATHS, SOFTSPLAT, WARP
from exwarp_cli.domain.frame import Bool

TILE_ROWS = 8  # tiles from a frame's top to its bottom

# Why a tile is expected to be wrong: light differs on surfaces that both key frames show; at most
# one key frame shows the surface; surfaces move apart, so that outlines are uncertain.
REASONS = ("light", "holes", "motion")

CODE_STEPS = 16  # steps of a tile's error to its doubling: it is kept to 4 %


@dataclass(frozen=True)
class Risk:
    """The predicted error of one frame, and of its tiles."""

    error: float  # predicted RMS error of the frame, display levels of 0 to 255
    columns: int  # tiles of the display window; see `tile_edges`
    rows: int
    codes: tuple[int, ...]  # of the tiles' predicted RMS errors, row by row; see `encode_level`
    reasons: tuple[int, ...]  # of the tiles: indices into REASONS

    @property
    def levels(self) -> tuple[float, ...]:
        """Predicted RMS error of each tile, display levels of 0 to 255."""
        return tuple(float(2 ** (code / CODE_STEPS) - 1) for code in self.codes)

    @property
    def text(self) -> str:
        """Return the tiles on one line: ``14x8:l1fh40…``, a reason's first letter and a code."""
        tiles = (f"{REASONS[w][0]}{c:02x}" for w, c in zip(self.reasons, self.codes, strict=True))
        return f"{self.columns}x{self.rows}:{''.join(tiles)}"

    @classmethod
    def parsed(cls, error: float, text: str) -> Risk:
        """Read `text` again; ValueError if it is no such text."""
        size, _, tiles = text.partition(":")
        columns, rows = map(int, size.split("x"))
        codes = re.findall(r"([a-z])([0-9a-f]{2})", tiles)
        letters = [reason[0] for reason in REASONS]
        if len(codes) != columns * rows or 3 * len(codes) != len(tiles):
            raise ValueError(f"{text!r} has other tiles than it says")
        reasons = tuple(letters.index(letter) for letter, _ in codes)
        return cls(float(error), columns, rows, tuple(int(c, 16) for _, c in codes), reasons)


def encode_level(level: float) -> int:
    """Return a tile's error, 0 to 255, as an integer number of steps, 0 to 128.

    `Risk.levels` inverts it, except for rounding.
    """
    return round(CODE_STEPS * math.log2(1 + min(max(level, 0.0), 255.0)))


def count_columns(width: int, height: int) -> int:
    """Return the number of columns of nearly square tiles."""
    return max(1, round(TILE_ROWS * width / height))


def tile_edges(size: int, parts: int) -> Sequence[int]:
    """Return where tiles begin along a side, and where the last one ends, in pixels."""
    return [i * size // parts for i in range(parts + 1)]


# Maker of a tile beside W and E: W of the slot before, which shows E there (path S4).
REWARP = "rewarp"

# Letters of the makers in headers and tables.
MAKER_LETTERS = {WARP: "w", EXTRAPOLATE: "e", REWARP: "r", SOFTSPLAT: "s", LOOKAHEAD: "l"}

# Paths of tiles, and the letters of their makers in slots 1 to 3. d1 warps, as a repeated frame
# gains nothing.
TILE_PATHS = {"S3": "wee", "S4": "wer", "S5": "wwe", "S6": "www"}

TILE_STATE = "tiles/1"  # version of the inputs of a tile policy; ``state`` in its metadata

# The policy's inputs for a tile, in place of the paper's six features of a frame. holes, outlines:
# shares of pixels that the key frame does not show, and that show a ghost outline. Var_x, Var_y:
# variances of its motion's components, squared pixels a key interval. light, motion: mean squared
# difference, in squared display levels, by which the key frame before predicts this one, away from
# edges of moving surfaces and beside them.
TILE_FEATURES = ("holes", "outlines", "Var_x", "Var_y", "light", "motion")

# The same between two key frames, and the version of these inputs. Of both key frames, moved to the
# slot: unseen, share of pixels that neither shows; light and motion, mean squared difference in
# squared display levels, away from edges of moving surfaces and beside them. key_light, key_motion:
# the same of one key frame moved to the other. apart: light + motion + half of the last two, in
# proportion to the mean of all tiles.
LOOK_AHEAD_FEATURES = ("unseen", "light", "motion", "key_light", "key_motion", "apart")
LOOK_AHEAD_STATE = "look-ahead tiles/1"


@dataclass(frozen=True)
class TileMakers:
    """The maker of each tile of one frame."""

    columns: int  # tiles of the display window; see `tile_edges`
    rows: int
    letters: str  # of the tiles, row by row: out of MAKER_LETTERS

    @classmethod
    def chosen(cls, marks: Bool) -> TileMakers:
        """Return tiles between key frames: bool [rows, columns], True where a network weighs."""
        letters = (MAKER_LETTERS[LOOKAHEAD if mark else SOFTSPLAT] for mark in marks.flat)
        return cls(marks.shape[1], marks.shape[0], "".join(letters))

    @property
    def text(self) -> str:
        """Return the tiles on one line: ``14x8:wwe…``."""
        return f"{self.columns}x{self.rows}:{self.letters}"

    @classmethod
    def parsed(cls, text: str) -> TileMakers:
        """Read `text` again; raises ValueError when it is no such text."""
        found = re.fullmatch(r"([1-9][0-9]*)x([1-9][0-9]*):([werls]+)", text)
        if found is None or int(found[1]) * int(found[2]) != len(found[3]):
            raise ValueError(f"{text!r} says nothing of tiles")
        return cls(int(found[1]), int(found[2]), found[3])

    def made_by(self, maker: str) -> Bool:
        """Return the tiles of a maker, bool [rows, columns]."""
        letters = np.array(list(self.letters)).reshape(self.rows, self.columns)
        return np.asarray(letters == MAKER_LETTERS[maker])

    def share(self, maker: str) -> float:
        """Return the share of a maker's tiles, 0 to 1."""
        return self.letters.count(MAKER_LETTERS[maker]) / len(self.letters)


@dataclass(frozen=True)
class TilePlan:
    """The path of each tile through a key interval."""

    columns: int  # as in `TileMakers`
    rows: int
    paths: tuple[str, ...]  # out of TILE_PATHS, row by row

    @classmethod
    def fixed(cls, columns: int, rows: int, path: str) -> TilePlan:
        """Return the plan that takes one path in every tile."""
        return cls(columns, rows, (path,) * (columns * rows))

    @property
    def extrapolates(self) -> bool:
        """Whether the network makes any part of any frame."""
        return any(PATHS[name].extrapolates for name in self.paths)

    def makers(self, slot: int) -> TileMakers:
        """Return the makers of the tiles of a slot, 1 to 3."""
        letters = (TILE_PATHS[name][slot - 1] for name in self.paths)
        return TileMakers(self.columns, self.rows, "".join(letters))
