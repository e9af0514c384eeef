"""Looking surface points up in a neighbouring frame: how well a displacement explains it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.domain.motion import AxisMap
from exwarp_cli.kernels import gather
from exwarp_cli.synthesis.sampling import (
    FEW_MOVE,
    GRID,
    LEAST,
    SAMPLES,
    Index,
    Interval,
    Sampled,
    is_moving,
)

F64 = npt.NDArray[np.float64]

DEPTH_TOLERANCE = 0.02
"""Relative error of depth that counts as a miss."""

COLOUR_TOLERANCE = 0.15
"""Distance of perceived colours that counts as a miss."""


RESTS = 0.3
"""Pixels without vectors rest if their error in place is below this share of the movers'."""

FAR = 40
"""Values tell points apart if they change over a distance of this share of the frame's width."""

LEVELS = 16
"""Fewer values of depth are surfaces that face the camera, and not steps of a coarse depth."""


@dataclass(frozen=True)
class Probe:
    """Sampled pixels of one frame, to be looked up in its neighbour.

    Values of one component are depth, others are fixed to the surface point.

    Attributes
    ----------
    xy, raw
        Pixels [N, 2], and the motion channels there [N, C].
    here, there, tolerance
        Of each observable: values [N, C], the neighbour's image, and the distance that is a miss.
    weights, floors
        Of each observable: by how much its values tell points apart, and its error by noise alone.
    resting
        True if the camera rests, so that depths need no correction for its movement.
    """

    xy: F64
    raw: Float32
    here: list[F64]
    there: list[Float32]
    tolerance: list[F64]
    weights: list[float]
    floors: list[float]
    resting: bool = False

    @property
    def weight(self) -> float:
        """By how much the probe tells points apart."""
        return sum(self.weights)

    @property
    def floor(self) -> float:
        """The mean error by noise alone."""
        return float(np.average(self.floors, weights=self.weights if self.weight > 0 else None))

    def part(self, count: int | None) -> slice:
        """Return which samples stand for all where only about so many are looked up."""
        return slice(None, None, 1 if count is None else max(1, len(self.xy) // count))

    def shifts(self, readings: Sequence[AxisMap], count: int | None = None) -> Float32:
        """Return the displacements of the samples by each reading, float32 [K, N, 2]."""
        raw = self.raw[self.part(count)]
        return np.stack([reading.apply(raw) for reading in readings])

    def errors(self, shifts: Float32, count: int | None = None) -> F64:
        """Return the mean errors of displacements, 0 (all samples find themselves) to 1.

        Parameters
        ----------
        shifts
            float32 [K, N, 2]: K displacements of every sample that counts.
        count
            About how many do; see `part`.

        Returns
        -------
        F64
            One a displacement, [K].
        """
        part = self.part(count)
        xy = np.ascontiguousarray(self.xy[part])
        losses = np.empty((len(shifts), len(self.here), len(xy)))
        for index, (here, there, whole) in enumerate(
            zip(self.here, self.there, self.tolerance, strict=True)
        ):
            wanted, tolerance = np.ascontiguousarray(here[part]), np.ascontiguousarray(whole[part])
            if wanted.shape[1] == 1:
                for loss, shift in zip(losses[:, index], shifts, strict=True):
                    _count_depths(xy, shift, there, wanted, tolerance, loss, self.resting)
            else:
                gather.write_shifted_losses(xy, shifts, there, wanted, tolerance, index, losses)
        weights = self.weights if self.weight > 0 else None
        return np.asarray(np.average(losses.mean(axis=2), axis=1, weights=weights))


@dataclass(frozen=True)
class Trail(Probe):
    """Sampled pixels of a key frame, to be followed frame by frame to the next key frame.

    Attributes
    ----------
    fields
        Motion channels of the frames on the way, the sampled one first, float32 [h, w, C].
    stride
        Distance of the pixels that these hold.
    """

    fields: tuple[Float32, ...] = ()
    stride: int = 1

    def shifts(self, readings: Sequence[AxisMap], count: int | None = None) -> Float32:
        """Return the displacements over all frames by each reading, float32 [K, N, 2]."""
        start = self.xy[self.part(count)].astype(np.float32)
        return np.stack([self._followed(reading, start) - start for reading in readings])

    def _followed(self, reading: AxisMap, start: Float32) -> Float32:
        """Return where points arrive; NaN for those that leave the frame on the way."""
        place = start
        height, width, _ = self.fields[0].shape
        for field in self.fields:
            known = np.isfinite(place[:, 0]) & np.isfinite(place[:, 1])
            cell = np.rint(np.where(known[:, None], place, 0) / self.stride)
            x = np.clip(cell[:, 0], 0, width - 1).astype(np.intp)
            y = np.clip(cell[:, 1], 0, height - 1).astype(np.intp)
            inside = known & (cell[:, 0] == x) & (cell[:, 1] == y)
            place = np.where(inside[:, None], place + reading.apply(field[y, x]), np.nan)
        return np.asarray(place, np.float32)


def trail(way: Interval, later: bool) -> Trail | None:
    """Sample pixels of a key frame, to follow them to the next one or the one before.

    Parameters
    ----------
    way
        The two key frames, and the vectors between.
    later
        True to start from the earlier key frame.

    Returns
    -------
    Trail or None
        None where there are too few pixels.
    """
    here, there = (way.before, way.after) if later else (way.after, way.before)
    fields = way.vectors[:-1] if later else way.vectors[:0:-1]
    first = fields[0].reshape(-1, fields[0].shape[-1])
    usable, moving = np.isfinite(first).all(axis=1), is_moving(first)
    rows, columns = np.divmod(np.arange(len(first)), fields[0].shape[1])
    y, x = rows * way.stride, columns * way.stride
    height, width, _ = here.shape
    usable &= (y > 0) & (y < height - 1) & (x > 0) & (x < width - 1)
    loss = np.linalg.norm(here[y, x] - there[y, x], axis=1) / COLOUR_TOLERANCE
    chosen, _ = _chosen(usable, moving, usable, np.minimum(loss, 1).astype(np.float64))
    if len(chosen) < LEAST:
        return None
    y, x = y[chosen], x[chosen]
    values = here[y, x].astype(np.float64)
    tolerance = np.full(len(y), COLOUR_TOLERANCE)
    return Trail(
        np.stack([x, y], axis=1).astype(np.float64), first[chosen],
        [values], [there], [tolerance], [_telling(here, y, x, tolerance)], [_floor(way.noise)],
        fields=fields, stride=way.stride,
    )  # fmt: skip


def probe(here: Sampled, there: Sampled, pairs: Sequence[Sequence[int]]) -> list[Probe | None]:
    """Sample pixels of `here` where motion channels hold values, to look them up in `there`.

    Parameters
    ----------
    here, there
        The frames.
    pairs
        The channels that have to hold values, each time.

    Returns
    -------
    list
        One a pair; None where there are too few pixels, or nothing tells them apart.
    """
    made: dict[bytes, Probe | None] = {}
    for_each = []
    for channels in pairs:
        usable = here.usable & np.isfinite(here.motion[:, list(channels)]).all(axis=-1)
        mask = usable.tobytes()
        if mask not in made:  # mostly all channels hold values at the same pixels
            made[mask] = _probe(here, there, usable)
        for_each.append(made[mask])
    return for_each


def _probe(here: Sampled, there: Sampled, usable: Bool) -> Probe | None:
    """Sample some of the usable pixels of the grid."""
    if here.still is not None:
        still = usable & here.still
        usable = still if np.count_nonzero(still) >= LEAST else usable
    if np.count_nonzero(usable) < LEAST:
        return None
    resting = False
    chosen = _evenly(usable & here.regular)
    if here.position is None:
        chosen, resting = _chosen(usable, here.moving, here.regular, _changes(here, there))
    if len(chosen) < LEAST:
        return None
    y, x = here.y[chosen], here.x[chosen]
    values = _observables(here, there, y, x)
    if not values:
        return None
    return Probe(
        np.stack([x, y], axis=1).astype(np.float64),
        here.motion[chosen],
        [v[0] for v in values],
        [np.ascontiguousarray(v[1]) for v in values],
        [v[2] for v in values],
        [v[3] for v in values],
        [_floor(here.noise) if v[0].shape[1] > 1 else 0.0 for v in values],
        resting,
    )


def _evenly(usable: Bool) -> Index:
    """Return the indices of some of the usable pixels, evenly spread."""
    chosen = np.flatnonzero(usable)
    return chosen[:: max(1, len(chosen) // SAMPLES)]


def _chosen(usable: Bool, moving: Bool, regular: Bool, change: F64) -> tuple[Index, bool]:
    """Choose the pixels to measure by: the moving ones alone if few move and all others rest.

    What rests by its vectors, and is seen to rest, tells nothing: of a hundred pixels of which one
    moves it is 99 % of every reading's success.

    Parameters
    ----------
    usable, moving, regular
        bool [G]; see `Sampled`.
    change
        float64 [G]: how far pixels change at their place, 0 to 1.

    Returns
    -------
    tuple
        Indices, and whether these are the moving pixels before a resting camera.
    """
    even = _evenly(usable & regular)
    movers, resting = usable & moving, usable & regular & ~moving
    few = np.count_nonzero(movers & regular) < FEW_MOVE * np.count_nonzero(usable & regular)
    if not few or np.count_nonzero(movers) < LEAST or not resting.any():
        return even, False
    if float(np.mean(change[resting])) > RESTS * float(np.mean(change[movers])):
        return even, False
    return _evenly(movers), True


def _changes(here: Sampled, there: Sampled) -> F64:
    """Return how far pixels of the grid change at their place, 0 to 1: by colour, else by depth."""
    y, x = here.y, here.x
    if here.perceived is not None and there.perceived is not None:
        apart = here.perceived[y, x].astype(np.float64) - there.perceived[y, x]
        gap = np.linalg.norm(apart, axis=1)
        return np.asarray(np.minimum(gap / COLOUR_TOLERANCE, 1), np.float64)
    if here.depth is None or there.depth is None:
        return np.zeros(len(y))
    depth = np.asarray(here.depth[y, x], np.float64)
    tolerance = DEPTH_TOLERANCE * depth + _steps(depth)
    with np.errstate(invalid="ignore"):
        apart = np.abs(depth - there.depth[y, x]) / tolerance
    return np.asarray(np.where(np.isfinite(apart), np.minimum(apart, 1), 1), np.float64)


def _observables(
    here: Sampled, there: Sampled, y: Index, x: Index
) -> list[tuple[F64, Float32, F64, float]]:
    """Return (values here, image there, tolerance, weight) of what identifies a surface point."""
    if here.position is not None and there.position is not None:
        values = here.position[y, x].astype(np.float64)
        return [(values, there.position, _pixel_size(here.position, y, x), 1.0)]
    out: list[tuple[F64, Float32, F64, float]] = []
    if here.depth is not None and there.depth is not None:
        depth = here.depth[y, x].astype(np.float64)
        every = here.depth[here.y, here.x].astype(np.float64)
        tolerance = DEPTH_TOLERANCE * depth + _steps(every, depth)
        weight = _telling(here.depth[..., None], y, x, tolerance)
        out.append((depth[:, None], there.depth[..., None], tolerance, weight))
    if here.perceived is not None and there.perceived is not None:
        mine = here.perceived[y, x].astype(np.float64)
        tolerance = np.full(len(y), COLOUR_TOLERANCE)
        weight = _telling(here.perceived, y, x, tolerance)
        out.append((mine, there.perceived, tolerance, weight))
    return out


def _floor(noise: float) -> float:
    """Return the error of colours by noise alone: of three channels, the mean of a distance."""
    return min(0.92 * noise / COLOUR_TOLERANCE, 1.0)


def _telling(image: Float32, y: Index, x: Index, tolerance: F64) -> float:
    """Return by how much an image's values tell points apart, 0 to 1.

    That is how much more they differ far away than beside a pixel. Constant values differ nowhere,
    coarse ones seldom, and noise differs everywhere alike.
    """
    height, width, channels = image.shape
    mine = image[y, x].astype(np.float64).reshape(len(y), channels)
    differ = []
    for reach in (1, max(8, width // FAR)):
        each = []
        for dy, dx in ((0, reach), (reach, 0), (0, -reach), (-reach, 0)):
            at = np.clip(y + dy, 0, height - 1), np.clip(x + dx, 0, width - 1)
            with np.errstate(invalid="ignore"):
                gap = np.linalg.norm(image[at] - mine, axis=1) / tolerance
            each.append(float(np.mean(np.where(np.isfinite(gap), np.minimum(gap, 1), 1))))
        differ.append(float(np.mean(each)))
    return max(differ[1] - differ[0], 0.0)


def _steps(every: F64, depth: F64 | None = None) -> F64:
    """Return the distance to the next value where depth was rounded to levels; else 0.

    Parameters
    ----------
    every
        Depths of the whole frame's grid.
    depth
        Those whose distances are wanted; `every` itself without.
    """
    wanted = every if depth is None else depth
    levels = np.unique(every[np.isfinite(every)])
    if not LEVELS <= len(levels) <= len(every) // (2 * GRID):
        return np.zeros(len(wanted))
    gaps = np.diff(levels)
    # Some levels are missing beside a pixel's own: the smaller gap is nearer to the step.
    least = np.minimum(np.append(gaps, np.inf), np.insert(gaps, 0, np.inf))
    return np.asarray(least[np.clip(np.searchsorted(levels, wanted), 0, len(levels) - 1)])


def _count_depths(
    xy: F64,
    shift: Float32,
    there: Float32,
    depth: F64,
    tolerance: F64,
    losses: F64,
    resting: bool,
) -> None:
    """Write how far depths are from those found, as the camera has moved meanwhile."""
    target = xy + shift.astype(np.float64)
    found = np.empty_like(depth)
    gather.sample_points(there, target, found)
    wanted = depth if resting else _depth_later(depth, found, xy, tolerance)
    gather.write_point_losses(found, wanted, tolerance, losses)


def _depth_later(depth: F64, found: F64, xy: F64, tolerance: F64) -> F64:
    """Return the depth [N, 1] that static points have in the other frame, as its camera moved.

    That is linear in a point's place (x z, y z, z): the four coefficients are fitted to what was
    found there, robustly. Unfitted, a camera's way forward spoke for half the right vectors.
    """
    seen = np.isfinite(found[:, 0])
    x, y = (xy / xy.max() - 0.5).T
    z = depth[:, 0]
    terms = np.stack([x * z, y * z, z, np.ones_like(z)], axis=1) / tolerance[:, None]
    known, values = terms[seen], found[seen, 0] / tolerance[seen]
    predicted = z[seen] / tolerance[seen]
    if len(known) < 50:
        return depth
    for _ in range(4):
        weighted = known / (1.0 + (values - predicted) ** 2)[:, None]
        fitted = np.linalg.lstsq(weighted.T @ known, weighted.T @ values, rcond=None)[0]
        predicted = known @ fitted
    return np.asarray((terms @ fitted * tolerance)[:, None])


def _pixel_size(position: Float32, y: Index, x: Index) -> F64:
    """World-space size of a pixel, plus the rounding of positions stored as half."""
    p = position[y, x].astype(np.float64)
    steps = [
        np.minimum(
            np.linalg.norm(p - position[y - dy, x - dx], axis=1),
            np.linalg.norm(p - position[y + dy, x + dx], axis=1),
        )
        for dy, dx in ((0, 1), (1, 0))
    ]
    size = np.maximum(steps[0], steps[1])
    largest = np.abs(p).max(axis=1)
    with np.errstate(over="ignore"):
        half = bool((position[y, x].astype(np.float16) == position[y, x]).all())
    return np.asarray(size + largest * (2.0**-10 if half else 2.0**-22) + 1e-12)
