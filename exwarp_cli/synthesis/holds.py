"""Holds: key frames that show the same picture as the one before, and the motion around them.

A shot on twos shows each picture twice; held poses, freeze frames and files that were copied over
missing ones look the same. Between two such key frames the picture stands, whatever the vectors
say: a copied file holds those of the motion that led to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from exwarp_cli.domain.colour import SRGB
from exwarp_cli.domain.frame import Float32, GBuffer, Image, KeyFrame
from exwarp_cli.synthesis.geometry import moved_on

ROUNDING = 2.0**-10
"""One step of a half float, relative to a value: what two writers of one picture may differ by."""

LEAST_VALUE = 2.0**-24
"""The smallest half float: below it no file tells values apart."""

NOISE = 2.0
"""Greatest local difference, in codes of 255, up to which two frames of a lossy video are the same
picture: the mean over 3x3 pixels, so that no small object escapes. What a codec changes of a
repeated picture and what a slow mover changes look alike: repeats that x264 wrote with crf 18
differ by 3 codes, with crf 23 by 2 to 6, with crf 30 by 4 to 19, and a disc with a contrast of 60
codes that moves by 0.1 pixels by 3 to 7. So the limit is below both, where neither is seen."""

NOISE_AFTER_MOTION, CALMER = 16.0, 10.0
"""The same soon after a picture that differs clearly and by so many times as much, on average: then
it is no slow mover, which changes the picture as much every time."""

SOON = 2
"""Pairs of frames before, of which one has to hold such motion: enough for shots on threes."""

EXAMINED, BAND = 16, 64
"""Every so many rows are compared first: most pairs differ there, which costs next to nothing. The
rest is compared in bands of rows, so that temporaries stay small."""

STANDING, ESTIMATED_STANDING = 0.05, 0.25
"""Pixels: vectors of a renderer, and estimated ones, up to this length stand still."""

MOVING = 1.0
"""Pixels from which on vectors move, beside those that stand."""

OUTLIERS = 0.5
"""Percent of estimated vectors that are left out, as some always go astray."""


def is_same_picture(before: Image, after: Image) -> bool:
    """Return True if two key frames show the same picture, but for the rounding of values.

    Each pixel must be the same: a small object that moves over a still background is no hold, nor
    is a still scene whose noise differs. NaN and infinities are equal to themselves.
    """
    if not _is_comparable(before, after):
        return False
    first, second = before.pixels, after.pixels
    if not _is_equal(first[::EXAMINED], second[::EXAMINED]):
        return False
    bands = (slice(y, y + BAND) for y in range(0, len(first), BAND))
    return all(_is_equal(first[band], second[band]) for band in bands)


@dataclass(frozen=True)
class Change:
    """By how much two frames of a video differ, in codes of 255 as a display shows them.

    Attributes
    ----------
    mean
        Over some rows.
    local
        The greatest mean over 3x3 pixels; infinite where some rows tell that it is large.
    """

    mean: float
    local: float

    def is_noise(self) -> bool:
        """Return True if a codec explains the change, whatever was before."""
        return self.local <= NOISE

    def is_calm(self) -> bool:
        """Return True if a codec may explain the change, if there was motion before."""
        return self.local <= NOISE_AFTER_MOTION

    def is_calm_after(self, earlier: Change) -> bool:
        """Return True if a codec explains the change, as the earlier one was motion."""
        moved = math.isinf(earlier.local) and earlier.mean >= CALMER * self.mean
        return moved and self.is_calm()


def change_between(before: Image, after: Image) -> Change:
    """Compare two neighbouring frames of a lossy video, whose codec changes what it repeats."""
    if not _is_comparable(before, after):
        return Change(math.inf, math.inf)
    first, second = before.pixels, after.pixels
    some = _differences(first[::EXAMINED], second[::EXAMINED])
    mean = float(some.mean())
    # A row alone has a third of the 3x3 pixels around it.
    if _local(some, rows=1) > 3 * NOISE_AFTER_MOTION:
        return Change(mean, math.inf)
    bands = (slice(max(0, y - 2), y + BAND) for y in range(0, len(first), BAND))
    return Change(mean, max(_local(_differences(first[b], second[b])) for b in bands))


def _is_comparable(before: Image, after: Image) -> bool:
    return before.data_window == after.data_window and before.pixels.shape == after.pixels.shape


def _differences(first: Float32, second: Float32) -> Float32:
    """Return the greatest difference of a channel, in codes, float32 [H, W]."""
    codes = [SRGB.to_code(np.nan_to_num(pixels).clip(0, 1)) for pixels in (first, second)]
    found: Float32 = 255 * np.abs(codes[0] - codes[1]).max(axis=-1)
    return found


def _local(differences: Float32, rows: int = 3) -> float:
    """Return the greatest mean over 3 columns and so many rows, or over fewer at small frames."""
    sums = differences
    for axis, size in ((0, min(rows, differences.shape[0])), (1, min(3, differences.shape[1]))):
        ends = differences.shape[axis] - size + 1
        sums = sum(np.take(sums, range(i, i + ends), axis) for i in range(size)) / size
    return float(sums.max())


def _is_equal(first: Float32, second: Float32) -> bool:
    """Return True if values are the same up to the rounding of a half float."""
    if np.array_equal(first, second):
        return True
    with np.errstate(invalid="ignore", over="ignore"):
        limit = ROUNDING * np.maximum(np.abs(first), np.abs(second)) + LEAST_VALUE
        alike = np.isfinite(limit) & (np.abs(first - second) <= limit)
    alike |= (first == second) | (np.isnan(first) & np.isnan(second))
    return bool(alike.all())


def around_holds(
    key: KeyFrame, following: KeyFrame | None, after_hold: bool = False
) -> tuple[KeyFrame, KeyFrame | None]:
    """Return the key frames of an interval with the vectors that tell how it moves in between.

    Motion that starts or ends abruptly is no parabola. So where the picture stands on one side of a
    key frame and moves on the other, its vectors across the interval may count alone:

    - it stands in the interval and moved before, or moves on after it: those across count alone;
    - it stands before the interval and after it, as on twos: the motion is a straight line;
    - vectors lead one way alone, and those of one key frame are 0 because of the hold beyond it:
      those of the other key frame lead it, turned round.

    Parameters
    ----------
    key, following
        With settled motion; `following` is None for causal methods.
    after_hold
        True if `key` shows the same picture as the key frame before it.

    Returns
    -------
    tuple of KeyFrame
        The same where nothing stands.
    """
    here = key.gbuffer
    there = None if following is None else following.gbuffer
    if here is None:
        return key, following
    if following is None or there is None:
        straight = after_hold and _starts(here.to_previous, here.to_next)
    else:
        straight = _starts(here.to_previous, here.to_next) and _starts(
            there.to_next, there.to_previous
        )
        if straight or _starts(there.to_previous, there.to_next):
            following = replace(following, gbuffer=there.without("to_next", "bend"))
        elif _leads_alone(there.to_next, here.to_next, here, there, "to_previous"):
            following = replace(following, gbuffer=_turned_round(there, here, "to_next"))
    if straight or _starts(here.to_next, here.to_previous):
        key = replace(key, gbuffer=here.without("to_previous", "bend"))
    elif there is not None and _leads_alone(
        here.to_previous, there.to_previous, here, there, "to_next"
    ):
        key = replace(key, gbuffer=_turned_round(here, there, "to_previous"))
    return key, following


def stands_one_way(to_previous: Float32, to_next: Float32) -> bool:
    """Return True if estimated vectors stand still to one neighbour and move to the other."""
    lengths = [
        float(np.percentile(np.abs(vectors), 100 - OUTLIERS)) for vectors in (to_previous, to_next)
    ]
    return min(lengths) <= ESTIMATED_STANDING and max(lengths) >= MOVING


def _starts(standing: Float32 | None, moving: Float32 | None) -> bool:
    """Return True if vectors one way are 0 throughout, and those the other way are not."""
    if standing is None or moving is None:
        return False
    # Some rows first: nearly always they tell.
    stands = _length(standing[::EXAMINED]) <= STANDING and _length(standing) <= STANDING
    return stands and _length(moving) >= MOVING


def _length(vectors: Float32) -> float:
    """Return the greatest component of vectors, in pixels; 0 where none is finite."""
    return float(np.max(np.abs(vectors), where=np.isfinite(vectors), initial=0.0))


def _leads_alone(
    standing: Float32 | None, moving: Float32 | None, here: GBuffer, there: GBuffer, lacking: str
) -> bool:
    """Return True if one key frame's vectors are 0, the other's are not, and none lead back."""
    if getattr(here, lacking) is not None or getattr(there, lacking) is not None:
        return False
    return _starts(standing, moving)


def _turned_round(gbuffer: GBuffer, other: GBuffer, way: str) -> GBuffer:
    """Return a geometry with motion from the other key frame's vectors, which lead to it.

    `way` names these: "to_previous" for those of the next key frame, "to_next" for those of the key
    frame before. What they do not show stands, as its own vectors say.
    """
    found = np.nan_to_num(moved_on(other, getattr(other, way)).field, nan=0.0)
    if way == "to_previous":
        return replace(gbuffer, to_previous=None, to_next=found, bend=None)
    return replace(gbuffer, to_next=None, to_previous=found, bend=None)
