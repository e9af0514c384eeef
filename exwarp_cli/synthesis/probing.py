"""Looking surface points up in a neighbouring frame: how well a displacement explains it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Float32, GBuffer
from exwarp_cli.kernels import lookup

F64 = npt.NDArray[np.float64]

SAMPLES = 6000
"""Pixels looked up of each frame, out of GRID times as many on a regular grid."""

GRID = 5

LEAST = 100
"""Samples below which a frame says nothing."""

DEPTH_TOLERANCE = 0.02
"""Relative error of depth that counts as a miss."""


@dataclass(frozen=True)
class Instant:
    """A frame of a pair: geometry, raw motion channels, and colour where there is some."""

    number: int
    gbuffer: GBuffer
    motion: Float32
    colour: Float32 | None


@dataclass
class Probe:
    """Sampled pixels of one frame, to be looked up in its neighbour.

    Values of one component are depth, others are fixed to the surface point.
    """

    xy: F64
    raw: F64
    here: list[F64]
    there: list[Float32]
    tolerance: list[F64]

    def error(self, displacement: F64, count: int | None = None) -> float:
        """Return the mean error of displacements [N, 2], 0 (all find themselves) to 1."""
        part = slice(None) if count is None else slice(None, None, max(1, len(self.xy) // count))
        target = self.xy[part] + displacement
        losses = np.empty((len(self.here), len(target)))
        for loss, here, there, whole in zip(
            losses, self.here, self.there, self.tolerance, strict=True
        ):
            wanted, tolerance = np.ascontiguousarray(here[part]), np.ascontiguousarray(whole[part])
            found = np.empty_like(wanted)
            lookup.look_up(there, target, found)
            if wanted.shape[1] == 1:
                wanted = _depth_later(wanted, found, self.xy[part], tolerance)
            lookup.count_misses(found, wanted, tolerance, loss)
        return float(np.mean(losses))


def probe(here: Instant, there: Instant, channels: Sequence[int]) -> Probe | None:
    """Sample pixels of `here` where these motion channels hold values, to look them up in `there`.

    Returns None where there are too few of them, or nothing tells them apart.
    """
    height, width, _ = here.motion.shape
    grid = np.arange(0, height * width, max(1, height * width // (GRID * SAMPLES)))
    y, x = np.divmod(grid, width)
    usable = (y > 0) & (y < height - 1) & (x > 0) & (x < width - 1)
    usable &= np.isfinite(here.motion[y, x][:, list(channels)]).all(axis=-1)
    if here.gbuffer.depth is not None:
        usable &= np.isfinite(here.gbuffer.depth[y, x])
    if here.gbuffer.position is not None:
        usable &= np.isfinite(here.gbuffer.position[y, x]).all(axis=-1)
    if here.gbuffer.stencil is not None and here.gbuffer.position is not None:
        # World positions of what moves are not found again. In leaves that move over
        # half of the frame no reading was better than none.
        still = usable & (here.gbuffer.stencil[y, x] == 0)
        usable = still if np.count_nonzero(still) >= LEAST else usable
    chosen = np.flatnonzero(usable)
    if len(chosen) < LEAST:
        return None
    chosen = chosen[:: max(1, len(chosen) // SAMPLES)]
    y, x = y[chosen], x[chosen]
    values = _observables(here, there, y, x)
    if not values:
        return None
    return Probe(
        np.stack([x, y], axis=1).astype(np.float64),
        here.motion[y, x].astype(np.float64),
        [v[0] for v in values],
        [np.ascontiguousarray(v[1]) for v in values],
        [v[2] for v in values],
    )


def _observables(
    here: Instant, there: Instant, y: npt.NDArray[np.intp], x: npt.NDArray[np.intp]
) -> list[tuple[F64, Float32, F64]]:
    """Return (values here, image there, tolerance) of what identifies a surface point."""
    a, b = here.gbuffer, there.gbuffer
    if a.position is not None and b.position is not None:
        return [(a.position[y, x].astype(np.float64), b.position, _pixel_size(a.position, y, x))]
    out: list[tuple[F64, Float32, F64]] = []
    if a.depth is not None and b.depth is not None:
        depth = a.depth[y, x][:, None].astype(np.float64)
        out.append((depth, b.depth[..., None], DEPTH_TOLERANCE * depth[:, 0]))
    if here.colour is not None and there.colour is not None:
        mine, other = _perceived(here.colour), _perceived(there.colour)
        out.append((mine[y, x].astype(np.float64), other, np.full(len(y), 0.15)))
    return out


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


def _pixel_size(position: Float32, y: npt.NDArray[np.intp], x: npt.NDArray[np.intp]) -> F64:
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


def _perceived(colour: Float32) -> Float32:
    """Scene-linear RGB compressed roughly as the eye does, float32 [H, W, 3]."""
    return np.sqrt(np.maximum(np.nan_to_num(colour[..., :3], posinf=0, neginf=0), 0))
