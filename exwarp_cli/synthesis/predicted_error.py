"""How wrong a new frame is expected to be, by what is measured while it is made.

Without ground truth three things count: how much the two key frames disagree where both were moved
to the slot, how much of a tile no key frame shows, and how well key frames predict each other. The
predicted mean squared error of a tile is a weighted sum of such terms. The weights were found by
``python -m tests.bench.risk`` on the judged scenes; examples/scenes/BENCH.md says how well they
predict.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, KeyFrame
from exwarp_cli.domain.tiles import LOOK_AHEAD_FEATURES, Risk, encode_level
from exwarp_cli.synthesis.camera import F64
from exwarp_cli.synthesis.mosaic import Tiles
from exwarp_cli.synthesis.warp import Warped, linear_to_srgb

# Pixels by which motion fields differ from sample to sample where surfaces move apart.
APART = np.float32(1.5)

PEAK = np.float32(255)

# Squared display levels: where key frames are less apart in the mean, little is to be gained.
NEGLIGIBLE = 8.0

# What the predicted mean squared error of a tile is a sum of, each in squared display levels.
#
# detail: squared differences of neighbouring pixels, which sampling softens. light, motion: squared
# difference of the two sides, moved along the residual flow as far as the frame is, where both show
# the surface: away from edges of moving surfaces, and beside them. unseen: share of pixels that no
# key frame shows, times the variance of the tile. key_light, key_motion: as light and motion, of
# one key frame moved to the other and compared there.
#
# The share that one key frame alone shows, the share beside edges of moving surfaces and a constant
# gained nothing (0.003 of rank correlation at most).
TERMS = ("detail", "light", "motion", "unseen", "key_light", "key_motion")

# Which of the terms depend on the slot's time.
TIMED = np.array([False, True, True, False, True, True])

# Terms of each of `domain.risk.REASONS`.
TERMS_OF_REASONS = ((1, 4), (3,), (2, 5))


@dataclass(frozen=True)
class Formula:
    """Weights of `TERMS`, 0 or more.

    If `two_sided`, the frame is made of both key frames, and timed terms are largest halfway; else
    they grow with the time since the key frame.
    """

    weights: tuple[float, ...]
    two_sided: bool


# Of frames made of the key frames on both sides, of those made of what came before, and of those
# after the first key frame of a shot, which no earlier one predicts.
MIXED = Formula((0.0051, 0.319, 0.4673, 0.7008, 0.0159, 0.016), two_sided=True)
WARPED = Formula((0.009, 0.0, 0.0, 0.1645, 0.5798, 0.4311), two_sided=False)
FIRST_WARPED = Formula((0.0255, 0.0, 0.0, 0.8394, 0.0, 0.0), two_sided=False)


@dataclass(frozen=True)
class KeyResidual:
    """Mean squared difference of one key frame, moved to another, from that, in each tile.

    float64 [rows, columns], squared display levels.
    """

    light: F64  # away from edges of moving surfaces
    motion: F64  # beside them


def key_residual(
    tiles: Tiles,
    # Key frames on one window.
    frame: KeyFrame,
    other: KeyFrame,
    motion: Float32,  # [H, W, 2], pixels: from `frame` to `other`; NaN where unknown
) -> KeyResidual:
    """Compare a key frame with another one, moved to it by plain bilinear sampling."""
    # Of the other frame, display levels at the ends of motion are sampled, of the samples alone.
    pixels, vectors = other.image.pixels, tiles.sample(motion)
    height, width = pixels.shape[:2]
    x, y = (np.arange(0, size, tiles.stride).astype(np.float32) for size in (width, height))
    right, down = x + vectors[..., 0], y[:, None] + vectors[..., 1]
    with np.errstate(invalid="ignore"):
        inside: Bool = (right >= 0) & (down >= 0) & (right <= width - 1) & (down <= height - 1)
    right, down = (np.where(inside, place, np.float32(0)) for place in (right, down))
    left, top = right.astype(np.int32), down.astype(np.int32)
    across, along = (right - left)[..., None], (down - top)[..., None]
    columns, rows = (left, np.minimum(left + 1, width - 1)), (top, np.minimum(top + 1, height - 1))
    upper, lower = (
        [_levels(pixels[row, column], linear=True) for column in columns] for row in rows
    )
    above = upper[0] + across * (upper[1] - upper[0])
    below = lower[0] + across * (lower[1] - lower[0])
    moved = above + along * (below - above)
    apart = _mean_square(_levels(tiles.sample(frame.image.pixels), linear=True) - moved)
    apart[~inside] = 0
    at_edges = beside_edges(vectors)
    light, moving = tiles.means([np.where(at_edges, 0, apart), np.where(at_edges, apart, 0)])
    return KeyResidual(light, moving)


@dataclass(frozen=True)
class TileEvidence:
    """What is measured of each tile of a frame while it is made; means, float64 [rows, columns]."""

    light: F64  # squared difference of the two sides; 0 where there is one side alone
    motion: F64
    unseen: F64  # share of pixels that none of the frame's key frames shows


def evidence_of_sides(
    tiles: Tiles,
    # Both key frames moved to the slot, and moved along the residual flow as well.
    plain: tuple[Warped, Warped],
    shifted: tuple[Warped, Warped],
    weight: Float32,  # [H, W]: how far the frame follows that flow
    # [H, W, 2]: a motion field of the slot, in which edges of moving surfaces show.
    field: Float32,
    linear: bool,  # whether colour is scene-linear, and not as shown
) -> TileEvidence:
    """Compare the two sides of a slot."""
    sides = [_levels(tiles.sample(side.pixels), linear) for side in (*plain, *shifted)]
    apart = sides[0] - sides[1]
    apart += tiles.sample(weight)[..., None] * (sides[2] - sides[3] - apart)
    before, after = (tiles.sample(side.hole) for side in plain)
    squares = _mean_square(apart)
    squares[before | after] = 0
    at_edges = beside_edges(tiles.sample(field))
    maps = np.where(at_edges, 0, squares), np.where(at_edges, squares, 0), before & after
    return TileEvidence(*tiles.means(maps))


def look_ahead_features(evidence: TileEvidence, residual: KeyResidual) -> F64:
    """Return what a policy of tiles sees between two key frames: `LOOK_AHEAD_FEATURES`.

    float64 [rows, columns, 6].
    """
    squares = evidence.light + evidence.motion + (residual.light + residual.motion) / 2
    apart = squares / (squares.mean() + NEGLIGIBLE)
    sides = evidence.light, evidence.motion
    parts = evidence.unseen, *sides, residual.light, residual.motion, apart
    assert len(parts) == len(LOOK_AHEAD_FEATURES)
    return np.stack(parts, axis=-1)


def beside_edges(field: Float32) -> Bool:
    """Return which samples of a motion field [h, w, 2] are beside surfaces that move apart."""
    out: Bool = np.isnan(field[..., 0])
    with np.errstate(invalid="ignore"):
        down, across = (np.abs(np.diff(field, axis=axis)).max(axis=-1) > APART for axis in (0, 1))
    out[1:] |= down
    out[:-1] |= down
    out[:, 1:] |= across
    out[:, :-1] |= across
    return out


def terms_of(
    tiles: Tiles,
    evidence: TileEvidence,
    residual: KeyResidual,  # of the frame's key frames
    pixels: Float32,  # [H, W, 3 or more]: the new frame, scene-linear
) -> F64:
    """Return the terms of a frame's tiles, float64 [len(TERMS), rows, columns]."""
    stride = tiles.stride
    samples = _levels(tiles.sample(pixels), linear=True)
    steps = np.zeros(samples.shape[:2], np.float32)
    for neighbours in (pixels[::stride, 1::stride], pixels[1::stride, ::stride]):
        rows, columns = neighbours.shape[:2]
        step = _levels(neighbours, linear=True) - samples[:rows, :columns]
        steps[:rows, :columns] += _mean_square(step)
    grey = samples.mean(axis=-1)
    detail, mean, mean_of_squares = tiles.means([steps, grey, grey * grey])
    unseen = evidence.unseen * np.maximum(mean_of_squares - mean * mean, 0)
    sides = evidence.light, evidence.motion
    return np.stack([detail, *sides, unseen, residual.light, residual.motion])


def weigh_terms(terms: F64, formula: Formula, time: float) -> F64:
    """Return weighted terms, whose sum is the predicted mean squared error of each tile.

    `terms` are those of `terms_of`; `time` is the slot's in the key interval, 0 < time < 1.
    """
    share = np.sqrt(4 * time * (1 - time)) if formula.two_sided else time
    weights = np.array(formula.weights) * np.where(TIMED, share, 1.0)
    return np.asarray(weights[:, None, None] * terms)


def predict_risk(terms: F64, formula: Formula, time: float) -> Risk:
    """Return how wrong a frame is expected to be; parameters as of `weigh_terms`."""
    weighted = weigh_terms(terms, formula, time)
    squares = weighted.sum(axis=0)
    reasons = np.argmax([weighted[list(own)].sum(axis=0) for own in TERMS_OF_REASONS], axis=0)
    error = min(float(np.sqrt(squares.mean())), float(PEAK))
    rows, columns = squares.shape
    return Risk(
        float(np.float32(error)),  # as the header of the frame stores it
        columns,
        rows,
        tuple(encode_level(float(level)) for level in np.sqrt(squares).flat),
        tuple(map(int, reasons.flat)),
    )


def _levels(colour: Float32, linear: bool) -> Float32:
    """Return colour [h, w, 3 or more] in display levels, 0 to 255; NaN counts as black."""
    colour = np.ascontiguousarray(colour[..., :3])
    shown = linear_to_srgb(colour) if linear else colour
    out: Float32 = np.nan_to_num(np.clip(shown, 0, 1), nan=0.0) * PEAK
    return out


def _mean_square(apart: Float32) -> Float32:
    squares = apart * apart
    mean: Float32 = (squares[..., 0] + squares[..., 1] + squares[..., 2]) / np.float32(3)
    return mean
