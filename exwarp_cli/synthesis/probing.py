"""Looking surface points up in a neighbouring frame: how well a displacement explains it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.kernels import lookup, misses
from exwarp_cli.synthesis.sampling import LEAST, SAMPLES, Index, Sampled

F64 = npt.NDArray[np.float64]

DEPTH_TOLERANCE = 0.02
"""Relative error of depth that counts as a miss."""

COLOUR_TOLERANCE = 0.15
"""Distance of perceived colours that counts as a miss."""


@dataclass(frozen=True)
class Probe:
    """Sampled pixels of one frame, to be looked up in its neighbour.

    Values of one component are depth, others are fixed to the surface point.
    """

    xy: F64
    raw: Float32
    here: list[F64]
    there: list[Float32]
    tolerance: list[F64]

    def part(self, count: int | None) -> slice:
        """Return which samples stand for all where only about so many are looked up."""
        return slice(None, None, 1 if count is None else max(1, len(self.xy) // count))

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
                    _count_depths(xy, shift, there, wanted, tolerance, loss)
            else:
                misses.count_misses_of(xy, shifts, there, wanted, tolerance, index, losses)
        return np.asarray(losses.reshape(len(shifts), -1).mean(axis=1))


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
    chosen = np.flatnonzero(usable)
    if len(chosen) < LEAST:
        return None
    chosen = chosen[:: max(1, len(chosen) // SAMPLES)]
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
    )


def _observables(
    here: Sampled, there: Sampled, y: Index, x: Index
) -> list[tuple[F64, Float32, F64]]:
    """Return (values here, image there, tolerance) of what identifies a surface point."""
    if here.position is not None and there.position is not None:
        values = here.position[y, x].astype(np.float64)
        return [(values, there.position, _pixel_size(here.position, y, x))]
    out: list[tuple[F64, Float32, F64]] = []
    if here.depth is not None and there.depth is not None:
        depth = here.depth[y, x][:, None].astype(np.float64)
        out.append((depth, there.depth[..., None], DEPTH_TOLERANCE * depth[:, 0]))
    if here.perceived is not None and there.perceived is not None:
        mine = here.perceived[y, x].astype(np.float64)
        out.append((mine, there.perceived, np.full(len(y), COLOUR_TOLERANCE)))
    return out


def _count_depths(
    xy: F64, shift: Float32, there: Float32, depth: F64, tolerance: F64, losses: F64
) -> None:
    """Write how far depths are from those found, as the camera has moved meanwhile."""
    target = xy + shift.astype(np.float64)
    found = np.empty_like(depth)
    lookup.look_up(there, target, found)
    lookup.count_misses(found, _depth_later(depth, found, xy, tolerance), tolerance, losses)


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
