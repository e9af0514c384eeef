"""Whether pictures stand still or move, by what they show and not by their vectors.

Holds are key frames that show the same picture as the one before. A shot on twos shows each picture
twice; held poses, freeze frames and files that were copied over missing ones look the same. Between
two such key frames the picture stands, whatever the vectors say: a copied file holds those of the
motion that led to it.

Of frames whose vectors are all 0, motion is searched in what they show. Light that flickers and
shadows that wander change colour although nothing moves, so a change of colour alone is no motion:
geometry has to change, or a shift has to explain a large part of the picture.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from exwarp_cli.domain.colour import SRGB
from exwarp_cli.domain.frame import Bool, Float32, Image, KeyFrame
from exwarp_cli.synthesis.calibration_samples import FrameSamples
from exwarp_cli.synthesis.motion_fields import splat_motion

# One step of a half float, relative to a value, by which two writers of one picture may differ; and
# the smallest half float, below which no file distinguishes values.
ROUNDING, MIN_VALUE = 2.0**-10, 2.0**-24

# Greatest local difference, in codes of 255, up to which two frames of a lossy video are the same
# picture: the mean over 3x3 pixels, so that no small object escapes. What a codec changes of a
# repeated picture and what a slow mover changes look alike: repeats that x264 wrote with crf 18
# differ by 3 codes, with crf 23 by 2 to 6, with crf 30 by 4 to 19, and a disc with a contrast of 60
# codes that moves by 0.1 pixels by 3 to 7. So the limit is below both, where neither is visible.
NOISE = 2.0

# The same soon after a picture that differs clearly and by so many times as much, on average: then
# it is no slow mover, which changes the picture as much every time.
NOISE_AFTER_MOTION, CALMER = 16.0, 10.0

# Pairs of frames before, of which one has to hold such motion: enough for shots on threes.
RECENT_PAIRS = 2

# Every so many rows are compared first: most pairs differ there, which costs next to nothing. The
# rest is compared in bands of rows, so that temporaries stay small.
EXAMINED, BAND = 16, 64

# Pixels: vectors of a renderer, and estimated ones, up to this length stand still; from MOVING on
# they move.
STANDING, ESTIMATED_STANDING, MOVING = 0.05, 0.25, 1.0

# Percent of estimated vectors that are left out, as some always go astray.
OUTLIERS = 0.5

# Share of the pixels, and number, whose geometry must change; a rim of one pixel does not count, as
# noise of rendering changes it from frame to frame.
CHANGED_SHARE, MIN_CHANGED = 0.002, 4

# Share of the pixels up to which geometry may differ where nothing moves.
SAME_SHARE = 0.005

# Share of its depth by which a surface must come nearer or go away to count as another one.
OTHER_SURFACE = 0.01

# Relative steps of depth between neighbouring pixels, and the share of pixels that must have one,
# to show that a camera stands: depth of an even wall is the same wherever the camera looks.
STEP, STEPS_SHARE = 0.05, 0.01

# Cells of a block's side, and of the longest shift that is tried.
BLOCK, REACH = 16, 8

# Cells of a row at which shifts are tried, so that they reach to a sixteenth of the frame.
WIDTHS = (512, 128)

# Deviation of a block's texture, relative to its light, from which on its shift is measurable, and
# correlation from which on a block is found again.
TEXTURE, FITS = 0.01, 0.8

# Share of the blocks that must have texture, and of these, that must have moved: at least as many
# as stood. In a rendered shot with much parallax 44 % and more are found again. Of one that stands,
# none are, whether its light flickers, a shadow wanders or its noise changes. On a bare floor only
# rims of shadows have texture.
TEXTURED_SHARE, MOVED_SHARE = 0.5, 0.3

# Added to light before its logarithm is taken, in which light and texture are a sum.
MIN_LIGHT = 0.02


def is_same_picture(before: Image, after: Image) -> bool:
    """Return True if two key frames show the same picture, but for the rounding of values.

    Each pixel must be the same: a small object that moves over a still background is no hold, nor
    is a still scene whose noise differs. NaN and infinities are equal to themselves.
    """
    first, second = before.pixels, after.pixels
    if before.data_window != after.data_window or first.shape != second.shape:
        return False
    if not _is_equal(first[::EXAMINED], second[::EXAMINED]):
        return False
    bands = (slice(y, y + BAND) for y in range(0, len(first), BAND))
    return all(_is_equal(first[band], second[band]) for band in bands)


def _is_equal(first: Float32, second: Float32) -> bool:
    """Return True if values are the same up to the rounding of a half float."""
    if np.array_equal(first, second):
        return True
    with np.errstate(invalid="ignore", over="ignore"):
        limit = ROUNDING * np.maximum(np.abs(first), np.abs(second)) + MIN_VALUE
        equal = np.isfinite(limit) & (np.abs(first - second) <= limit)
    equal |= (first == second) | (np.isnan(first) & np.isnan(second))
    return bool(equal.all())


@dataclass(frozen=True)
class PictureChange:
    """How much two frames of a video differ, in codes of 255 as a display shows them."""

    mean: float  # over the examined rows
    local: float  # the greatest mean over 3x3 pixels; infinite where the examined rows suffice

    def is_calm_after(self, earlier: PictureChange) -> bool:
        """Return True if a codec explains the change, as the earlier one was motion."""
        moved = math.isinf(earlier.local) and earlier.mean >= CALMER * self.mean
        return moved and self.local <= NOISE_AFTER_MOTION


def change_between(before: Image, after: Image) -> PictureChange:
    """Compare two neighbouring frames of a lossy video, whose codec changes what it repeats."""
    first, second = before.pixels, after.pixels
    if before.data_window != after.data_window or first.shape != second.shape:
        return PictureChange(math.inf, math.inf)
    examined = _code_differences(first[::EXAMINED], second[::EXAMINED])
    mean = float(examined.mean())
    # A row alone has a third of the 3x3 pixels around it.
    if _greatest_local_mean(examined, rows=1) > 3 * NOISE_AFTER_MOTION:
        return PictureChange(mean, math.inf)
    bands = [slice(max(0, y - 2), y + BAND) for y in range(0, len(first), BAND)]
    local = max(_greatest_local_mean(_code_differences(first[b], second[b])) for b in bands)
    return PictureChange(mean, local)


def _code_differences(first: Float32, second: Float32) -> Float32:
    """Return the greatest difference of a channel, in codes, float32 [H, W]."""
    codes = [SRGB.to_code(np.nan_to_num(pixels).clip(0, 1)) for pixels in (first, second)]
    differences: Float32 = 255 * np.abs(codes[0] - codes[1]).max(axis=-1)
    return differences


def _greatest_local_mean(differences: Float32, rows: int = 3) -> float:
    """Return the greatest mean over 3 columns and so many rows, or over fewer at small frames."""
    sums = differences
    for axis, size in ((0, min(rows, differences.shape[0])), (1, min(3, differences.shape[1]))):
        ends = differences.shape[axis] - size + 1
        sums = sum(np.take(sums, range(i, i + ends), axis) for i in range(size)) / size
    return float(sums.max())


def adapt_motion_to_holds(
    # With settled motion; `following` is None for causal methods.
    key: KeyFrame,
    following: KeyFrame | None,
    after_hold: bool = False,  # true if `key` shows the same picture as the key frame before it
) -> tuple[KeyFrame, KeyFrame | None]:
    """Return the key frames of an interval with those vectors alone that hold across it.

    Motion that starts or ends abruptly is no parabola. So where the picture stands on one side of a
    key frame and moves on the other, its vectors across the interval may count alone:

    - it stands in the interval and moved before, or moves on after it: those across count alone;
    - it stands before the interval and after it, as on twos: the motion is a straight line;
    - vectors lead one way alone, and those of one key frame are 0 because of the hold beyond it:
      those of the other key frame lead it, reversed.

    The same where nothing stands.
    """
    first = key.gbuffer
    second = None if following is None else following.gbuffer
    if first is None:
        return key, following
    if following is None or second is None:
        straight = after_hold and _has_hold(first.to_previous, first.to_next)
    else:
        straight = _has_hold(first.to_previous, first.to_next) and _has_hold(
            second.to_next, second.to_previous
        )
        forward_alone = first.to_previous is None and second.to_previous is None
        if straight or _has_hold(second.to_previous, second.to_next):
            following = replace(following, gbuffer=second.without("to_next", "bend"))
        elif forward_alone and _has_hold(second.to_next, first.to_next):
            assert first.to_next is not None
            motion = np.nan_to_num(splat_motion(first, first.to_next).field, nan=0.0)
            second = replace(second, to_next=None, to_previous=motion, bend=None)
            following = replace(following, gbuffer=second)
    if straight or _has_hold(first.to_next, first.to_previous):
        return replace(key, gbuffer=first.without("to_previous", "bend")), following
    if second is None or first.to_next is not None or second.to_next is not None:
        return key, following
    if _has_hold(first.to_previous, second.to_previous):
        assert second.to_previous is not None
        # What the other key frame does not show stands, as the own vectors say.
        motion = np.nan_to_num(splat_motion(second, second.to_previous).field, nan=0.0)
        key = replace(key, gbuffer=replace(first, to_previous=None, to_next=motion, bend=None))
    return key, following


def is_still_one_way(to_previous: Float32, to_next: Float32) -> bool:
    """Return True if estimated vectors stand still to one neighbour and move to the other."""
    lengths = [
        float(np.percentile(np.abs(vectors), 100 - OUTLIERS)) for vectors in (to_previous, to_next)
    ]
    return min(lengths) <= ESTIMATED_STANDING and max(lengths) >= MOVING


def _has_hold(standing: Float32 | None, moving: Float32 | None) -> bool:
    """Return True if vectors one way are 0 throughout, and those the other way are not."""
    if standing is None or moving is None:
        return False
    # The examined rows nearly always suffice.
    stands = _longest(standing[::EXAMINED]) <= STANDING and _longest(standing) <= STANDING
    return stands and _longest(moving) >= MOVING


def _longest(vectors: Float32) -> float:
    """Return the greatest component of vectors, in pixels; 0 where none is finite."""
    return float(np.max(np.abs(vectors), where=np.isfinite(vectors), initial=0.0))


def has_geometry_moved(before: FrameSamples, after: FrameSamples) -> bool | None:
    """Return whether geometry moves between neighbouring frames of one size; None if it is open."""
    if before.position is not None and after.position is not None:
        change = np.linalg.norm(after.position - before.position, axis=-1)
        limit = np.maximum(_footprint(before.position), _footprint(after.position))
        return _verdict(change > limit, change > 0.25 * limit)
    first, second = before.depth, after.depth
    if first is None or second is None:
        return None
    with np.errstate(invalid="ignore"):
        change = np.abs(second - first)
        change[first == second] = 0  # background is infinite in both
        footprint = np.maximum(*(_footprint(depth[..., None]) for depth in (first, second)))
        limit = OTHER_SURFACE * np.minimum(first, second) + footprint
        moved = _verdict(~(change <= limit), ~(change <= 0.1 * limit))
    if moved is not False:
        return moved
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = first[:, 1:] / first[:, :-1]
        steps = ~(np.abs(np.log(ratio)) < STEP) & ~np.isnan(ratio)
    return False if np.mean(steps) >= STEPS_SHARE else None


def _verdict(changed: Bool, differs: Bool) -> bool | None:
    """Return True for much change in one place, False for nearly none, None in between."""
    eroded = changed.copy()  # to pixels that changed with all eight around them
    for axis in (0, 1):
        eroded = eroded & np.roll(eroded, -1, axis) & np.roll(eroded, 1, axis)
    eroded[[0, -1]] = eroded[:, [0, -1]] = False
    if np.count_nonzero(eroded) > max(CHANGED_SHARE * changed.size, MIN_CHANGED):
        return True
    return False if np.count_nonzero(differs) <= SAME_SHARE * differs.size else None


def _footprint(values: Float32) -> Float32:
    """Return how much values [H, W, C] change to the neighbouring pixels of one surface."""
    with np.errstate(invalid="ignore"):
        down = np.linalg.norm(np.diff(values, axis=0, append=values[-1:]), axis=-1)
        across = np.linalg.norm(np.diff(values, axis=1, append=values[:, -1:]), axis=-1)
    steps = [np.fmin(side, np.roll(side, 1, axis)) for axis, side in enumerate((down, across))]
    footprint: Float32 = np.nan_to_num(np.fmax(*steps), nan=0.0, posinf=0.0)
    return footprint


def _texture(colour: Float32, width: int) -> Float32:
    """Return the light of cells, about `width` a row, without slow changes, as a lamp makes them.

    float32 [h, w], logarithmic.
    """
    light = colour.mean(axis=-1)
    size = max(1, -(-light.shape[1] // width))
    rows, columns = (length // size for length in light.shape)
    cells = light[: rows * size, : columns * size].reshape(rows, size, columns, size)
    light = np.asarray(cells.mean(axis=(1, 3)), np.float32)
    logarithm = np.log(np.maximum(light, 0) + np.float32(MIN_LIGHT))
    side = BLOCK // 2 + 1
    padded = np.pad(logarithm, side // 2, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (side, side))
    texture: Float32 = logarithm - windows.mean(axis=(-1, -2))
    return texture


def has_colour_moved(
    # float32 [H, W, 3], as the eye sees them. Exposure does not matter, as blocks are compared by
    # their correlation.
    before: Float32,
    after: Float32,
) -> bool:
    """Return True if shifts explain a large part of the picture, and standing still does not."""
    for width in WIDTHS:
        first, second = _texture(before, width), _texture(after, width)
        side = BLOCK if min(first.shape) >= 4 * BLOCK else BLOCK // 2
        reach = min(REACH, side)
        rows, columns = ((length - 2 * reach) // side for length in first.shape)
        if rows <= 0 or columns <= 0:
            continue
        fixed = _blocks(first[reach:, reach:][: rows * side, : columns * side], side)
        textured = fixed.std(axis=1) >= TEXTURE
        still, best = np.zeros(rows * columns), np.zeros(rows * columns)
        for dy, dx in itertools.product(range(-reach, reach + 1), repeat=2):
            inside = second[reach + dy :, reach + dx :][: rows * side, : columns * side]
            shifted = _blocks(inside, side)
            norms = np.sqrt((fixed**2).sum(axis=1) * (shifted**2).sum(axis=1))
            products = (fixed * shifted).sum(axis=1)
            # 0 where one of them is even.
            fits = np.divide(products, norms, out=np.zeros_like(norms), where=norms > 0)
            if dy == dx == 0:
                still = fits
            else:
                best = np.maximum(best, fits)
        moved = textured & (still < FITS) & (best >= FITS) & (2 * (1 - best) < 1 - still)
        judged = np.count_nonzero(textured)
        stood = np.count_nonzero(textured & (still >= FITS))
        enough = judged >= TEXTURED_SHARE * len(textured)
        if enough and np.count_nonzero(moved) >= max(MOVED_SHARE * judged, stood):
            return True
    return False


def _blocks(light: Float32, side: int) -> Float32:
    """Return blocks of a picture about their mean, [N, side²]."""
    rows, columns = light.shape[0] // side, light.shape[1] // side
    values = light.reshape(rows, side, columns, side).swapaxes(1, 2).reshape(rows * columns, -1)
    centred: Float32 = values - values.mean(axis=1, keepdims=True)
    return centred
