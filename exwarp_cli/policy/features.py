"""Features of an instant from its G-buffer and the one before (paper, "List of features")."""

from __future__ import annotations

import math

import numpy as np

from exwarp_cli.domain.decision import Features
from exwarp_cli.domain.frame import Bool, Float32, GBuffer, Int32
from exwarp_cli.kernels import blocks, emd, labelling, medians

BLOCK = 16
"""Side of the blocks whose mean motion the variance is taken of, pixels."""

MIN_AREA, MIN_PIXELS = 1e-4, 4
"""Objects smaller than this share of the frame, or than this many pixels, are not counted: leaves
and sparks would outnumber what matters for warping."""


class Shapes:
    """What of an instant's geometry is compared with another instant's.

    Attributes
    ----------
    window
        What it covers.
    shown
        bool [H, W]: pixels that show a surface.
    normals, positions
        None where there are none.
    """

    def __init__(self, gbuffer: GBuffer) -> None:
        self.window = gbuffer.window
        self.shown: Bool = ~gbuffer.background
        self.normals, self.positions = (
            None if part is None else emd.Values(part, self.shown)
            for part in (gbuffer.normal, gbuffer.position)
        )
        self._parts = _parts(gbuffer)

    def are_of(self, gbuffer: GBuffer) -> bool:
        """Whether they are made of these very arrays."""
        return all(a is b for a, b in zip(self._parts, _parts(gbuffer), strict=True))


def _parts(gbuffer: GBuffer) -> tuple[Float32 | None, ...]:
    return gbuffer.depth, gbuffer.normal, gbuffer.position


def observe(now: GBuffer, before: GBuffer | None, span: int) -> Features:
    """Return the features of an instant; see `compare`, which looks at each instant once."""
    return compare(now, Shapes(now), None if before is None else Shapes(before), span)


def compare(now: GBuffer, shapes: Shapes, before: Shapes | None, span: int) -> Features:
    """Return the features of an instant.

    Parameters
    ----------
    now
        Its geometry. What is missing gives 0; a stencil may be filled in from elsewhere.
    shapes
        Of that.
    before
        Those of the instant before, on the same window; None at the first, whose earth mover's
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
    moved = (0.0, 0.0) if before is None else _moved(before, shapes)
    var_x, var_y = _variances(now, shapes.shown)
    return Features(
        objects=0 if now.stencil is None else count_objects(now.stencil),
        emd_normal=moved[0] / span,
        emd_position=moved[1] / span,
        var_x=var_x / span**2,
        var_y=var_y / span**2,
        width=now.window.width,
        height=now.window.height,
        distance=distance(now, shapes.shown),
    )


def count_objects(stencil: Int32) -> int:
    """N_d: connected areas of one id above 0, of MIN_AREA and MIN_PIXELS at least; int32 [H, W]."""
    areas = np.empty(stencil.size + 1, np.int64)
    count = labelling.measure_areas(stencil, areas)
    least = max(MIN_AREA * stencil.size, MIN_PIXELS)
    return int((areas[1:count] >= least).sum())


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
        with np.errstate(over="ignore"):
            return _known(medians.positive(gbuffer.depth, shown))
    if gbuffer.position is None:
        return 0.0
    places = gbuffer.position[shown].astype(np.float64)
    places = places[np.isfinite(places).all(axis=-1)]
    if not len(places):
        return 0.0
    with np.errstate(over="ignore"):
        away = np.linalg.norm(places - places.mean(axis=0), axis=-1)
        return _known(np.median(away, overwrite_input=True))


def _known(median: np.floating) -> float:
    """Return a median, 0 where there is none, or it is so large that it overflows."""
    return float(median) if math.isfinite(median) else 0.0


def _moved(before: Shapes, now: Shapes) -> tuple[float, float]:
    """EMD_Wn and EMD_Wp over the whole span; 0 for what either instant lacks."""

    def mean(one: emd.Values | None, other: emd.Values | None) -> float:
        return 0.0 if one is None or other is None else float(emd.distances(one, other).mean())

    return mean(before.normals, now.normals), mean(before.positions, now.positions)


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
