"""Features of an instant from its G-buffer and the one before (paper, "List of features")."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.features import Features
from exwarp_cli.domain.frame import Bool, Float32, GBuffer, Int32
from exwarp_cli.kernels import blocks, emd, labelling

BLOCK = 16
"""Side of the blocks whose mean motion the variance is taken of, pixels."""

MIN_AREA, MIN_PIXELS = 1e-4, 4
"""Objects smaller than this share of the frame, or than this many pixels, are not counted: leaves
and sparks would outnumber what matters for warping."""


def observe(now: GBuffer, before: GBuffer | None, span: int) -> Features:
    """Return the features of an instant.

    Parameters
    ----------
    now
        Its geometry. What is missing gives 0; a stencil may be filled in from elsewhere.
    before
        Geometry of the instant before, on the same window; None at the first, whose earth mover's
        distances are 0.
    span
        Slots between the two instants, which the motion vectors span too: 1 with G-buffers of every
        slot, 4 with those of key frames.

    Raises
    ------
    ValueError
        When the windows differ, or the span is not positive.

    Notes
    -----
    Background counts for nothing but the resolution. All features are per slot: distances are
    divided by the span, variances by its square.
    """
    if span < 1:
        raise ValueError(f"features span {span} slots; give 1 or more")
    if before is not None and before.window != now.window:
        raise ValueError(f"features of {now.window} cannot be compared with {before.window}")
    shown = ~now.background
    moved = (0.0, 0.0)
    if before is not None:
        moved = _moved(before, now, shown)
    var_x, var_y = _variances(now, shown)
    return Features(
        objects=0 if now.stencil is None else count_objects(now.stencil),
        emd_normal=moved[0] / span,
        emd_position=moved[1] / span,
        var_x=var_x / span**2,
        var_y=var_y / span**2,
        width=now.window.width,
        height=now.window.height,
        distance=distance(now, shown),
    )


def count_objects(stencil: Int32) -> int:
    """N_d: connected areas of one id above 0, of MIN_AREA and MIN_PIXELS at least; int32 [H, W]."""
    labels = np.empty(stencil.shape, np.int32)
    areas = np.empty(labelling.label(stencil, labels) + 1, np.int64)
    labelling.measure_areas(labels, areas)
    least = max(MIN_AREA * stencil.size, MIN_PIXELS)
    return int((areas[1:] >= least).sum())


def distance(gbuffer: GBuffer, shown: Bool) -> float:
    """Median distance from the camera of the pixels that count, scene units; 0 when unknown.

    Without depth the median distance of the positions from their mean stands in: the camera's own
    place is not known, but the extent of what is seen grows with it.

    Parameters
    ----------
    gbuffer
        Depth counts where it is above 0, positions where all of x, y and z are finite.
    shown
        bool [H, W]: pixels that show a surface.
    """
    if gbuffer.depth is not None:
        return _median(gbuffer.depth[shown & (gbuffer.depth > 0)])
    if gbuffer.position is None:
        return 0.0
    places = gbuffer.position[shown].astype(np.float64)
    places = places[np.isfinite(places).all(axis=-1)]
    return _median(np.linalg.norm(places - places.mean(axis=0), axis=-1)) if len(places) else 0.0


def _median(values: Float32 | npt.NDArray[np.float64]) -> float:
    """Return the median, 0 without values; also 0 where it is so large that it overflows."""
    if not values.size:
        return 0.0
    with np.errstate(over="ignore"):
        median = float(np.median(values, overwrite_input=True))
    return median if math.isfinite(median) else 0.0


def _moved(before: GBuffer, now: GBuffer, shown: Bool) -> tuple[float, float]:
    """EMD_Wn and EMD_Wp over the whole span; 0 for what either instant lacks."""
    shown_before = ~before.background

    def mean(one: Float32 | None, other: Float32 | None) -> float:
        if one is None or other is None:
            return 0.0
        return float(emd.distances(one, other, shown_before, shown).mean())

    return mean(before.normal, now.normal), mean(before.position, now.position)


def _variances(gbuffer: GBuffer, shown: Bool) -> tuple[float, float]:
    """Var_x and Var_y over the whole span: of the means of blocks that have one."""
    motion = gbuffer.to_next if gbuffer.to_previous is None else gbuffer.to_previous
    if motion is None:
        return 0.0, 0.0
    height, width = shown.shape
    means = np.empty((-(-height // BLOCK), -(-width // BLOCK), 2))
    blocks.block_means(motion, shown, BLOCK, means)
    known = means[~np.isnan(means[..., 0])]
    if not len(known):
        return 0.0, 0.0
    var_x, var_y = known.var(axis=0)
    return float(var_x), float(var_y)
