"""Whether something moves between two frames, by what they show and not by their vectors.

It is asked of frames whose vectors are all 0. Light that flickers and shadows that wander change
colour although nothing moves, so a change of colour alone is no motion: geometry has to change, or
a shift has to explain a large part of the picture.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.synthesis.sampling import Sampled

CHANGED_SHARE, LEAST_CHANGED = 0.002, 4
"""Share of the pixels, and number, whose geometry must change; a rim of one pixel does not count,
as noise of rendering changes it from frame to frame."""

SAME_SHARE = 0.005
"""Share of the pixels up to which geometry may differ where nothing moves."""

FAR_SIDE = 0.01
"""Share of its depth by which a surface must come nearer or go away to count as another one."""

STEP, STEPS_SHARE = 0.05, 0.01
"""Relative steps of depth between neighbouring pixels, and the share of pixels that must have one,
to tell that a camera stands: depth of an even wall is the same wherever the camera looks."""

BLOCK, REACH = 16, 8
"""Cells of a block's side, and of the longest shift that is tried."""

WIDTHS = (512, 128)
"""Cells of a row at which shifts are tried, so that they reach to a sixteenth of the frame."""

TEXTURE = 0.01
"""Deviation of a block's texture, relative to its light, from which on its shift is measurable."""

FITS = 0.8
"""Correlation from which on a block is found again."""

TEXTURED_SHARE, MOVED_SHARE = 0.5, 0.3
"""Share of the blocks that must have texture, and of these, that must have moved: at least as many
as stood. In a rendered shot with much parallax 44 % and more are found again. Of one that stands,
none are, whether its light flickers, a shadow wanders or its noise changes. On a bare floor only
rims of shadows have texture."""

LEAST_LIGHT = 0.02
"""Added to light before its logarithm is taken, in which light and texture are a sum."""


def geometry_moves(before: Sampled, after: Sampled) -> bool | None:
    """Return whether geometry moves between two frames, by position or depth; None if it is open.

    Parameters
    ----------
    before, after
        Neighbouring frames of one size.
    """
    if before.position is not None and after.position is not None:
        change = np.linalg.norm(after.position - before.position, axis=-1)
        limit = np.maximum(*(_footprint(frame.position) for frame in (before, after)))
        return _verdict(change > limit, change > 0.25 * limit)
    first, second = before.depth, after.depth
    if first is None or second is None:
        return None
    with np.errstate(invalid="ignore"):
        change = np.abs(second - first)
        change[first == second] = 0  # background is infinite in both
        footprint = np.maximum(*(_footprint(depth[..., None]) for depth in (first, second)))
        limit = FAR_SIDE * np.minimum(first, second) + footprint
        found = _verdict(~(change <= limit), ~(change <= 0.1 * limit))
    return None if found is False and not _has_steps(first) else found


def colour_moves(before: Float32, after: Float32) -> bool:
    """Return True if shifts explain the change of colour in a large part of the picture.

    Parameters
    ----------
    before, after
        float32 [H, W, 3], as the eye sees them. Exposure does not matter, as blocks are compared by
        their correlation.
    """
    return any(
        _is_shifted(*(_texture(_reduced(frame, width)) for frame in (before, after)))
        for width in WIDTHS
    )


def _verdict(changed: Bool, differs: Bool) -> bool | None:
    """Return True for much change in one place, False for nearly none, None in between."""
    if np.count_nonzero(_eroded(changed)) > max(CHANGED_SHARE * changed.size, LEAST_CHANGED):
        return True
    return False if np.count_nonzero(differs) <= SAME_SHARE * differs.size else None


def _footprint(values: Float32 | None) -> Float32:
    """Return by how much values [H, W, C] change to the neighbouring pixels of one surface."""
    assert values is not None
    with np.errstate(invalid="ignore"):
        sides = [
            np.linalg.norm(np.diff(values, axis=axis, append=_edge(values, axis)), axis=-1)
            for axis in (0, 1)
        ]
    steps = [np.fmin(side, np.roll(side, 1, axis)) for axis, side in enumerate(sides)]
    found: Float32 = np.nan_to_num(np.fmax(*steps), nan=0.0, posinf=0.0)
    return found


def _edge(values: Float32, axis: int) -> Float32:
    """Return the last row or column again."""
    return values[-1:] if axis == 0 else values[:, -1:]


def _has_steps(depth: Float32) -> bool:
    """Return True if depth has edges, which a moving camera moves over the frame."""
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = depth[:, 1:] / depth[:, :-1]
        steps = ~(np.abs(np.log(ratio)) < STEP) & ~np.isnan(ratio)
    return bool(np.mean(steps) >= STEPS_SHARE)


def _eroded(changed: Bool) -> Bool:
    """Return pixels that changed with all eight around them."""
    out = changed.copy()
    for axis in (0, 1):
        grown = out.copy()
        for step in (-1, 1):
            grown &= np.roll(out, step, axis)
        out = grown
    out[[0, -1]] = out[:, [0, -1]] = False
    return out


def _reduced(colour: Float32, width: int) -> Float32:
    """Return the mean light of cells, about so many a row, float32 [h, w]."""
    light = colour.mean(axis=-1)
    size = max(1, -(-light.shape[1] // width))
    rows, columns = (length // size for length in light.shape)
    cells = light[: rows * size, : columns * size].reshape(rows, size, columns, size)
    return np.asarray(cells.mean(axis=(1, 3)), np.float32)


def _texture(light: Float32) -> Float32:
    """Return what is left of light [h, w] without what changes slowly, as a lamp makes it."""
    logarithm = np.log(np.maximum(light, 0) + np.float32(LEAST_LIGHT))
    side = BLOCK // 2 + 1
    padded = np.pad(logarithm, side // 2, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (side, side))
    found: Float32 = logarithm - windows.mean(axis=(-1, -2))
    return found


@dataclass(frozen=True)
class _Blocks:
    """Blocks of a picture: their values about the mean [N, B²], from which a shift is found."""

    values: Float32

    @classmethod
    def of(cls, light: Float32, side: int, rows: int, columns: int) -> _Blocks:
        cut = light[: rows * side, : columns * side].reshape(rows, side, columns, side)
        values = cut.swapaxes(1, 2).reshape(rows * columns, side * side)
        return cls(values - values.mean(axis=1, keepdims=True))

    def correlation(self, other: _Blocks) -> Float32:
        """Return how well blocks fit, [N]; 0 where one of them is even."""
        norms = np.sqrt((self.values**2).sum(axis=1) * (other.values**2).sum(axis=1))
        products: Float32 = (self.values * other.values).sum(axis=1)
        found: Float32 = np.divide(products, norms, out=np.zeros_like(norms), where=norms > 0)
        return found


def _is_shifted(before: Float32, after: Float32) -> bool:
    """Return True if shifts explain a large part of the blocks, and standing still does not."""
    side = BLOCK if min(before.shape) >= 4 * BLOCK else BLOCK // 2
    reach = min(REACH, side)
    inner = before[reach:-reach, reach:-reach]
    rows, columns = (length // side for length in inner.shape)
    if rows * columns == 0:
        return False
    here = _Blocks.of(inner, side, rows, columns)
    textured = here.values.std(axis=1) >= TEXTURE
    still, best = np.zeros(rows * columns), np.zeros(rows * columns)
    for dy, dx in itertools.product(range(-reach, reach + 1), repeat=2):
        shifted = after[reach + dy :, reach + dx :]
        found = here.correlation(_Blocks.of(shifted, side, rows, columns))
        if dy == dx == 0:
            still = found
        else:
            best = np.maximum(best, found)
    moved = textured & (still < FITS) & (best >= FITS) & (2 * (1 - best) < 1 - still)
    judged = np.count_nonzero(textured)
    if judged < TEXTURED_SHARE * len(textured):
        return False
    stood = np.count_nonzero(textured & (still >= FITS))
    return bool(np.count_nonzero(moved) >= max(MOVED_SHARE * judged, stood))
