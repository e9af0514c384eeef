"""Features of an instant from its G-buffer and the one before (paper, "List of features")."""

from __future__ import annotations

import math

import numpy as np

from exwarp_cli.domain.decision import Features
from exwarp_cli.domain.frame import Bool, Float32, GBuffer, Int32
from exwarp_cli.kernels.connected_components import measure_component_areas
from exwarp_cli.kernels.frame_statistics import (
    ValueDistribution,
    block_means,
    earth_movers_distances,
    positive_median,
)

BLOCK = 16  # side of the blocks whose mean motion has the variance, pixels

# Objects smaller than this share of the frame, or than this many pixels, are not counted: leaves
# and sparks would outnumber what matters for warping.
MIN_AREA, MIN_PIXELS = 1e-4, 4


class FrameStatistics:
    """The statistics of an instant's geometry that are compared with another instant's."""

    def __init__(self, gbuffer: GBuffer) -> None:
        self.window = gbuffer.window
        self.shown: Bool = ~gbuffer.background  # pixels that show a surface
        self.normals, self.positions = (
            None if part is None else ValueDistribution(part, self.shown)
            for part in (gbuffer.normal, gbuffer.position)
        )
        self._parts = _geometry_parts(gbuffer)

    def are_of(self, gbuffer: GBuffer) -> bool:
        """Return whether they were computed from these very arrays."""
        return all(a is b for a, b in zip(self._parts, _geometry_parts(gbuffer), strict=True))


def _geometry_parts(gbuffer: GBuffer) -> tuple[Float32 | None, ...]:
    return gbuffer.depth, gbuffer.normal, gbuffer.position


def observe(now: GBuffer, before: GBuffer | None, span: int) -> Features:
    """Return the features of an instant; see `compare`, which reuses statistics."""
    earlier = None if before is None else FrameStatistics(before)
    return compare(now, FrameStatistics(now), earlier, span)


def compare(
    now: GBuffer, statistics: FrameStatistics, before: FrameStatistics | None, span: int
) -> Features:
    """Return the features of an instant, per slot.

    `statistics` are those of `now`, whose stencil may be filled in from elsewhere; missing parts
    give 0. `before` are those of the instant before, on the same window; without them, at the
    first, earth mover's distances are 0. `span` is the number of slots between the two instants,
    which the motion vectors span too: 1 with G-buffers of every slot, 4 with those of key frames.

    ValueError: the windows differ, or the span is not positive.
    """
    # Background counts for nothing but the resolution.
    if span < 1:
        raise ValueError(f"features span {span} slots; give 1 or more")
    if before is not None and before.window != now.window:
        raise ValueError(f"features of {now.window} cannot be compared with {before.window}")
    emd_normal, emd_position = 0.0, 0.0
    if before is not None:
        emd_normal = _mean_distance(before.normals, statistics.normals)
        emd_position = _mean_distance(before.positions, statistics.positions)
    var_x, var_y = _motion_variances(now, statistics.shown)
    return Features(
        objects=0 if now.stencil is None else count_objects(now.stencil),
        emd_normal=emd_normal / span,
        emd_position=emd_position / span,
        var_x=var_x / span**2,
        var_y=var_y / span**2,
        width=now.window.width,
        height=now.window.height,
        distance=_median_distance(now, statistics.shown),
    )


def count_objects(stencil: Int32) -> int:
    """Return N_d: the connected areas of one id above 0, of at least MIN_AREA and MIN_PIXELS."""
    areas = np.empty(stencil.size + 1, np.int64)
    count = measure_component_areas(stencil, areas)
    least = max(MIN_AREA * stencil.size, MIN_PIXELS)
    return int((areas[1:count] >= least).sum())


def _median_distance(gbuffer: GBuffer, shown: Bool) -> float:
    """Return the median distance from the camera, scene units; 0 when unknown."""
    if gbuffer.depth is not None:
        with np.errstate(over="ignore"):
            return _finite_or_zero(positive_median(gbuffer.depth, shown))
    # Without depth, the median distance of the positions from their mean: the camera's place is
    # unknown, but the extent of the visible scene grows with the distance.
    if gbuffer.position is None:
        return 0.0
    places = gbuffer.position[shown].astype(np.float64)
    places = places[np.isfinite(places).all(axis=-1)]
    if not len(places):
        return 0.0
    with np.errstate(over="ignore"):
        away = np.linalg.norm(places - places.mean(axis=0), axis=-1)
        return _finite_or_zero(np.median(away, overwrite_input=True))


def _finite_or_zero(median: np.floating) -> float:
    return float(median) if math.isfinite(median) else 0.0


def _mean_distance(before: ValueDistribution | None, now: ValueDistribution | None) -> float:
    if before is None or now is None:
        return 0.0
    return float(earth_movers_distances(before, now).mean())


def _motion_variances(gbuffer: GBuffer, shown: Bool) -> tuple[float, float]:
    """Return Var_x and Var_y, over the whole span, of the means of blocks."""
    motion = gbuffer.to_next if gbuffer.to_previous is None else gbuffer.to_previous
    if motion is None:
        return 0.0, 0.0
    height, width = shown.shape
    means = np.empty((-(-height // BLOCK), -(-width // BLOCK), 2))
    block_means(motion, shown, BLOCK, means)
    block_values = means[~np.isnan(means[..., 0])]
    if not len(block_values):
        return 0.0, 0.0
    var_x, var_y = block_values.var(axis=0)
    return float(var_x), float(var_y)
