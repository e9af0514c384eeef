"""Whether a depth channel grows away from the camera, by vectors alone.

Where two surfaces of a frame land on one pixel of its neighbour, the one that is seen there is the
nearer one; which of them it is, its own depth value tells, whatever its direction. How fast points
move as the camera does tells more: it is linear in the inverse of the distance (Hartley and
Zisserman, Multiple View Geometry, 2nd edition, section 13.3).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Float32
from exwarp_cli.synthesis.camera import pixels_at, sample
from exwarp_cli.synthesis.resection import fit

F64 = npt.NDArray[np.float64]

APART = 0.1
"""Share of all depth values that lies between two surfaces that count as apart."""

ALIKE, UNLIKE = 0.25, 0.5
"""Shares of the gap between two surfaces: a third value is that of one below the first from it, and
if it is beyond the second from the other."""

RANKED = 20000
"""Depth values that others are ranked among."""

LOOKED = 400_000
"""Pixels that are looked at, in whole rows; in all of 1920x1080 it took a second."""

BAND = 64
"""Rows that are splatted at a time, which bounds memory."""

FINER = 1.35
"""Ratio of neighbouring ends of the finer search."""

TELLS, CLEAR = 0.7, 0.01
"""Share of the worst error, and pixels below it, under which the best one tells the kind."""

ENDS = (0.0, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Where the camera may be beyond the largest value, in ranges of the values."""


@dataclass(frozen=True)
class OrderVotes:
    """Pixels where one surface covers another.

    Attributes
    ----------
    near_small, near_large
        How many of them show the surface of the smaller value, and of the larger one.
    """

    near_small: int = 0
    near_large: int = 0

    def __add__(self, other: OrderVotes) -> OrderVotes:
        """Join the votes of two pairs of frames."""
        small, large = self.near_small + other.near_small, self.near_large + other.near_large
        return OrderVotes(small, large)

    @property
    def count(self) -> int:
        """How many there are."""
        return self.near_small + self.near_large

    @property
    def small_share(self) -> float:
        """Share of those for small values nearby; a half without any."""
        return self.near_small / self.count if self.count else 0.5


def occlusion_votes(here: Float32, there: Float32, motion: Float32) -> OrderVotes:
    """Count which of two surfaces covers the other in a neighbouring frame.

    Parameters
    ----------
    here, there
        float32 [H, W]: depth values of both frames; not finite on background.
    motion
        float32 [H, W, 2], pixels: displacement from `here` to `there`; NaN where unknown.
    """
    known = np.concatenate([each[np.isfinite(each)] for each in (here, there)])
    if not known.size:
        return OrderVotes()
    # Ranks, as values of any kind are spread in their own way.
    table = np.sort(known[:: max(1, known.size // RANKED)])
    height, width = here.shape
    low = np.full(height * width, np.inf, np.float32)
    high = np.full(height * width, -np.inf, np.float32)
    every = max(1, height * width // LOOKED)
    for top in range(0, height, BAND):
        _land(here[top : top + BAND], motion[top : top + BAND], (top, every), (table, low, high))
    with np.errstate(invalid="ignore"):
        counts = np.isfinite(there.reshape(-1)) & (high - low > APART)
    seen, low, high = _ranks(there.reshape(-1)[counts], table), low[counts], high[counts]
    gap, from_low, from_high = high - low, np.abs(seen - low), np.abs(seen - high)
    small = (from_low < ALIKE * gap) & (from_high > UNLIKE * gap)
    large = (from_high < ALIKE * gap) & (from_low > UNLIKE * gap)
    return OrderVotes(int(small.sum()), int(large.sum()))


def _land(
    depth: Float32, motion: Float32, rows: tuple[int, int], target: tuple[Float32, ...]
) -> None:
    """Write the least and greatest rank that lands on each pixel of some rows, from a band.

    `rows` are the first of the band, and of how many one is written.
    """
    (top, every), (table, low, high) = rows, target
    width = depth.shape[1]
    with np.errstate(invalid="ignore"):
        landing = np.rint(motion[..., 1] + np.arange(top, top + len(depth))[:, None])
        used = np.isfinite(depth) & (landing % every == 0)
    y, x = np.nonzero(used)
    column, row = np.rint(x + motion[y, x, 0]), landing[y, x]
    # Comparisons leave out what is NaN, too.
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < low.size // width)
    place = (row[inside] * width + column[inside]).astype(np.intp)
    rank = _ranks(depth[y, x][inside], table)
    np.minimum.at(low, place, rank)
    np.maximum.at(high, place, rank)


def _ranks(values: Float32, table: Float32) -> Float32:
    """Return the share of the sorted table below each value; half of its equals count as below."""
    first, last = (np.searchsorted(table, values, side) for side in ("left", "right"))
    return ((first + last) / (2 * len(table))).astype(np.float32)


def camera_end(values: Float32, motion: Float32) -> float | None:
    """Find which value the camera is at, of values that grow towards it.

    Parameters
    ----------
    values
        float32 [H, W]; not finite on background.
    motion
        float32 [H, W, 2], pixels: displacement to a neighbouring frame.

    Returns
    -------
    float or None
        The value at the camera; infinity where values are the inverse of the distance. None where
        no camera explains the motion by either, or all do alike: it turns, or stands.
    """
    index = sample(values)
    if not index.size:
        return None
    d = values.reshape(-1)[index].astype(np.float64)
    pixels = pixels_at(index, values.shape[1])
    target = pixels + motion.reshape(-1, 2)[index]
    span, most = float(np.ptp(d)) or 1.0, float(d.max())

    def misses(shares: Iterable[float]) -> dict[float, float]:
        # At the largest value itself the inverse is not finite.
        ends = [most + max(share, 1e-4) * span for share in shares]
        return {end: _miss(1 / (end - d), pixels, target) for end in ends}

    errors = misses(ENDS)
    best = min(errors, key=lambda end: errors[end])
    share = (best - most) / span
    errors |= misses(share * FINER**step for step in (-3, -2, -1, 1, 2, 3))
    errors[np.inf] = _miss(d, pixels, target)
    best, worst = (choose(errors, key=lambda end: errors[end]) for choose in (min, max))
    tells = errors[best] < min(TELLS * errors[worst], errors[worst] - CLEAR)
    return best if tells else None


def _miss(nearness: F64, pixels: F64, target: F64) -> float:
    """Return by how many pixels a camera misses points of these inverse distances, in the median.

    Points that move by themselves are few, and do not change it much. Infinite without a camera.
    """
    points = np.column_stack([pixels, np.ones(len(pixels)), nearness])
    camera = fit(points, target, movers=True)
    if camera is None:
        return np.inf
    error = np.linalg.norm(camera.project(points) - target, axis=1)
    return float(np.median(np.where(np.isfinite(error), error, np.inf)))
