"""How wrong a new frame is expected to be, by what is seen while it is made.

Without ground truth three things tell: how much the two key frames disagree where both were moved
to the slot, how much of a tile no key frame shows, and how well key frames predict each other. The
predicted mean squared error of a tile is a weighted sum of such terms. The weights were found by
``python -m tests.bench.risk`` on the judged scenes; examples/scenes/BENCH.md says how
well they predict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Bool, Float32, KeyFrame, Window
from exwarp_cli.domain.tiles import TILE_ROWS, Risk, count_columns, encode_level, tile_edges
from exwarp_cli.synthesis.warp import Warped, as_shown

F64 = npt.NDArray[np.float64]

SAMPLED_ROWS = 160
"""A frame is looked at in about so many of its rows at most, and in as many of its columns to their
length: every second row and column at 427x240, every seventh at 1920x1080."""

APART = np.float32(1.5)
"""Pixels by which motion fields differ from sample to sample where surfaces move apart."""

PEAK = np.float32(255)

TERMS = ("detail", "light", "motion", "unseen", "key_light", "key_motion")
"""What the predicted mean squared error of a tile is a sum of, each in squared display levels.

detail: squared differences of neighbouring pixels, which sampling softens. light, motion: squared
difference of the two sides, moved along the residual flow as far as the frame is, where both show
the surface: away from edges of moving surfaces, and beside them. unseen: share of pixels that no
key frame shows, times the variance of the tile. key_light, key_motion: as light and motion, of one
key frame moved to the other and compared there.

The share that one key frame alone shows, the share beside edges of moving surfaces and a constant
gained nothing (0.003 of rank correlation at most).
"""

TIMED = np.array([False, True, True, False, True, True])
"""Which of the terms count by the slot's time."""

OF_REASONS = ((1, 4), (3,), (2, 5))
"""Terms of each of `domain.risk.REASONS`."""


@dataclass(frozen=True)
class Formula:
    """Weights of `TERMS`.

    Attributes
    ----------
    weights
        0 or more.
    two_sided
        Whether the frame is made of both key frames, so that timed terms are largest halfway; else
        they grow with the time since the key frame.
    """

    weights: tuple[float, ...]
    two_sided: bool


MIXED = Formula((0.0051, 0.319, 0.4673, 0.7008, 0.0159, 0.016), two_sided=True)
"""Of frames made of the key frames on both sides."""

WARPED = Formula((0.009, 0.0, 0.0, 0.1645, 0.5798, 0.4311), two_sided=False)
"""Of frames made of what came before."""

FIRST_WARPED = Formula((0.0255, 0.0, 0.0, 0.8394, 0.0, 0.0), two_sided=False)
"""Of those after the first key frame of a shot, which no earlier one predicts."""


@dataclass(frozen=True)
class Tiles:
    """The tiles of a frame, and the pixels that are looked at in them.

    Attributes
    ----------
    canvas
        Window of the arrays that are looked at.
    display
        Window that the tiles divide.
    """

    canvas: Window
    display: Window

    @property
    def stride(self) -> int:
        """Every so many-th row and column is looked at."""
        return max(1, -(-min(self.canvas.shape) // SAMPLED_ROWS))

    @property
    def columns(self) -> int:
        """How many columns of tiles there are; rows are `ROWS`."""
        return count_columns(self.display.width, self.display.height)

    def sample(self, values: np.ndarray) -> np.ndarray:
        """Return the pixels that are looked at, of an array [H, W, ...] on the canvas."""
        return values[:: self.stride, :: self.stride]

    def means(self, maps: Sequence[np.ndarray]) -> F64:
        """Return the means of samples [h, w] over each tile, [N, rows, columns]; 0 outside."""
        height, width = maps[0].shape
        offset = self.display.y - self.canvas.y, self.display.x - self.canvas.x
        down = self._spans(offset[0], self.display.height, TILE_ROWS, height)
        across = self._spans(offset[1], self.display.width, self.columns, width)
        counts = np.outer([b - a for a, b in down], [b - a for a, b in across])
        # Plain sums, in an order that no number of threads changes.
        strips = [[values[a:b].sum(axis=0, dtype=np.float64) for a, b in down] for values in maps]
        sums = np.stack([np.array(strips)[..., a:b].sum(axis=-1) for a, b in across], axis=-1)
        return np.asarray(sums / np.maximum(counts, 1))

    def _spans(self, offset: int, size: int, parts: int, samples: int) -> list[tuple[int, int]]:
        """Return the samples of each row or column of tiles, from and to."""
        places = [-(-(offset + edge) // self.stride) for edge in tile_edges(size, parts)]
        return list(pairwise(min(max(place, 0), samples) for place in places))


@dataclass(frozen=True)
class KeyResidual:
    """How far one key frame, moved to another, is from what that shows.

    Attributes
    ----------
    light, motion
        float64 [rows, columns]: mean squared difference, squared display levels, beside no edge of
        moving surfaces, and beside one.
    """

    light: F64
    motion: F64


def key_residual(tiles: Tiles, frame: KeyFrame, other: KeyFrame, motion: Float32) -> KeyResidual:
    """Compare a key frame with another one, moved to it by plain bilinear sampling.

    Parameters
    ----------
    tiles
        Of both frames.
    frame, other
        Key frames on one window.
    motion
        float32 [H, W, 2], pixels: from `frame` to `other`; NaN where unknown.
    """
    there, known = _bilinear(other.image.pixels, tiles, motion)
    apart = _square(_levels(tiles.sample(frame.image.pixels), linear=True) - there)
    apart[~known] = 0
    beside = beside_edges(tiles.sample(motion))
    light, moving = tiles.means([np.where(beside, 0, apart), np.where(beside, apart, 0)])
    return KeyResidual(light, moving)


def _bilinear(pixels: Float32, tiles: Tiles, motion: Float32) -> tuple[Float32, Bool]:
    """Return display levels at the ends of motion, of the samples alone, and which are inside."""
    height, width = pixels.shape[:2]
    x, y = (np.arange(0, size, tiles.stride).astype(np.float32) for size in (width, height))
    vectors = tiles.sample(motion)
    right, down = x + vectors[..., 0], y[:, None] + vectors[..., 1]
    with np.errstate(invalid="ignore"):
        known: Bool = (right >= 0) & (down >= 0) & (right <= width - 1) & (down <= height - 1)
    right, down = (np.where(known, place, np.float32(0)) for place in (right, down))
    left, top = right.astype(np.int32), down.astype(np.int32)
    across, along = (right - left)[..., None], (down - top)[..., None]
    columns, rows = (left, np.minimum(left + 1, width - 1)), (top, np.minimum(top + 1, height - 1))
    upper, lower = (
        [_levels(pixels[row, column], linear=True) for column in columns] for row in rows
    )
    above = upper[0] + across * (upper[1] - upper[0])
    below = lower[0] + across * (lower[1] - lower[0])
    return above + along * (below - above), known


@dataclass(frozen=True)
class Evidence:
    """What was seen of each tile of a frame while it was made; means, float64 [rows, columns].

    Attributes
    ----------
    light, motion
        Squared difference of the two sides; 0 where there is one side alone.
    unseen
        Share of pixels that none of the key frames shows which the frame is made of.
    """

    light: F64
    motion: F64
    unseen: F64


def evidence_of_sides(
    tiles: Tiles,
    plain: tuple[Warped, Warped],
    shifted: tuple[Warped, Warped],
    weight: Float32,
    field: Float32,
    linear: bool,
) -> Evidence:
    """Look at the two sides of a slot.

    Parameters
    ----------
    tiles
        Of the slot.
    plain, shifted
        Both key frames moved to the slot, and moved along the residual flow as well.
    weight
        float32 [H, W]: how far the frame follows that flow.
    field
        float32 [H, W, 2]: a motion field of the slot, which tells edges of moving surfaces.
    linear
        Whether colour is scene-linear, and not as shown.
    """
    sides = [_levels(tiles.sample(side.pixels), linear) for side in (*plain, *shifted)]
    apart = sides[0] - sides[1]
    apart += tiles.sample(weight)[..., None] * (sides[2] - sides[3] - apart)
    before, after = (tiles.sample(side.hole) for side in plain)
    squares = _square(apart)
    squares[before | after] = 0
    beside = beside_edges(tiles.sample(field))
    parted = np.where(beside, 0, squares), np.where(beside, squares, 0)
    return Evidence(*tiles.means([*parted, before & after]))


def evidence_of_warp(tiles: Tiles, hole: Bool) -> Evidence:
    """Look at a slot that is moved from one key frame, with these holes, bool [H, W]."""
    (unseen,) = tiles.means([tiles.sample(hole)])
    none = np.zeros_like(unseen)
    return Evidence(none, none, unseen)


def beside_edges(field: Float32) -> Bool:
    """Return which samples of a motion field [h, w, 2] are beside surfaces that move apart."""
    out: Bool = np.isnan(field[..., 0])
    for axis in (0, 1):
        with np.errstate(invalid="ignore"):
            jump = np.abs(np.diff(field, axis=axis)).max(axis=-1) > APART
        for near in (slice(1, None), slice(None, -1)):
            out[(near, slice(None)) if axis == 0 else (slice(None), near)] |= jump
    return out


def terms_of(
    tiles: Tiles, evidence: Evidence, residual: KeyResidual | None, pixels: Float32
) -> F64:
    """Return the terms of a frame's tiles, float64 [len(TERMS), rows, columns].

    Parameters
    ----------
    tiles, evidence
        Of the frame.
    residual
        Of its key frames; None where there is none, which counts as 0.
    pixels
        float32 [H, W, 3 or more]: the new frame, scene-linear.
    """
    detail, variance = _texture(tiles, pixels)
    none = np.zeros_like(detail)
    of_keys = (none, none) if residual is None else (residual.light, residual.motion)
    seen = evidence.light, evidence.motion, evidence.unseen * variance
    return np.stack([detail, *seen, *of_keys])


def mean_square(terms: F64, formula: Formula, time: float) -> F64:
    """Return the predicted mean squared error of tiles, by their terms, float64 [rows, columns].

    Parameters
    ----------
    terms
        From `terms_of`.
    formula
        Of the kind of frame.
    time
        Of the slot in the key interval, 0 < time < 1.
    """
    summed: F64 = _weighted(terms, formula, time).sum(axis=0)
    return summed


def _weighted(terms: F64, formula: Formula, time: float) -> F64:
    share = np.sqrt(4 * time * (1 - time)) if formula.two_sided else time
    weights = np.array(formula.weights) * np.where(TIMED, share, 1.0)
    return np.asarray(weights[:, None, None] * terms)


def predict_risk(terms: F64, formula: Formula, time: float) -> Risk:
    """Return how wrong a frame is expected to be; parameters as of `mean_square`."""
    parts = _weighted(terms, formula, time)
    squares = parts.sum(axis=0)
    reasons = np.argmax([parts[list(own)].sum(axis=0) for own in OF_REASONS], axis=0)
    error = min(float(np.sqrt(squares.mean())), float(PEAK))
    rows, columns = squares.shape
    return Risk(
        float(np.float32(error)),  # as the header of the frame keeps it
        columns,
        rows,
        tuple(encode_level(float(level)) for level in np.sqrt(squares).flat),
        tuple(map(int, reasons.flat)),
    )


def _texture(tiles: Tiles, pixels: Float32) -> tuple[F64, F64]:
    """Return squared differences of neighbouring pixels, and the variance of grey, of each tile."""
    stride = tiles.stride
    here = _levels(pixels[::stride, ::stride], linear=True)
    detail = np.zeros(here.shape[:2], np.float32)
    for beside in (pixels[::stride, 1::stride], pixels[1::stride, ::stride]):
        rows, columns = beside.shape[:2]
        step = _levels(beside, linear=True) - here[:rows, :columns]
        detail[:rows, :columns] += _square(step)
    grey = here.mean(axis=-1)
    squares, mean, mean_of_squares = tiles.means([detail, grey, grey * grey])
    return squares, np.maximum(mean_of_squares - mean * mean, 0)


def _levels(colour: Float32, linear: bool) -> Float32:
    """Return colour [h, w, 3 or more] in display levels, 0 to 255; NaN counts as black."""
    colour = np.ascontiguousarray(colour[..., :3])
    shown = as_shown(colour) if linear else colour
    out: Float32 = np.nan_to_num(np.clip(shown, 0, 1), nan=0.0) * PEAK
    return out


def _square(apart: Float32) -> Float32:
    """Return the mean square over the channels of [h, w, 3]."""
    squares = apart * apart
    mean: Float32 = (squares[..., 0] + squares[..., 1] + squares[..., 2]) / np.float32(3)
    return mean
