"""Where the points of one instant are at others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from exwarp_cli.domain.frame import Float32, GBuffer, Int32
from exwarp_cli.kernels import splat
from exwarp_cli.kernels import splat as rows
from exwarp_cli.kernels.point_motion import CLOSE_DEPTH, follow_points
from exwarp_cli.runtime.frame_pool import pool
from exwarp_cli.synthesis.camera import Index, scene_of, seen_by
from exwarp_cli.synthesis.rounding import EXACT, coarser, depth_step


def stencil_of(gbuffer: GBuffer) -> Int32:
    """Return the ids, int32 [H, W], or [0, 0] when unknown."""
    return gbuffer.stencil if gbuffer.stencil is not None else np.zeros((0, 0), np.int32)


def distances_of(gbuffer: GBuffer) -> Float32:
    """Return the depths, float32 [H, W], or [0, 0] when unknown."""
    return gbuffer.depth if gbuffer.depth is not None else np.zeros((0, 0), np.float32)


def displacement(gbuffer: GBuffer, time: float) -> Float32:
    """Return where points of a frame are at another time, minus where they are.

    Parameters
    ----------
    gbuffer
        With settled motion.
    time
        In steps of the vectors (key intervals, or slots); negative is earlier.

    Returns
    -------
    float32 [H, W, 2]
        With n the displacement to the next frame and p to the previous one, the parabola
        through both, t (n - p) / 2 + t² (n + p) / 2; else t n, or -t p, constant velocity. Rigid
        objects that turn go on arcs, see `curved`.
    """
    return _displacement(gbuffer, time, np.zeros((0, 0, 2), np.float32))


def displaced(gbuffer: GBuffer, time: float) -> tuple[Float32, Float32]:
    """Return what `displacement` does, and what `reach_of` does of that."""
    reach = np.empty(rows.row_extents_shape(gbuffer.window.shape), np.float32)
    return _displacement(gbuffer, time, reach), reach


def reach_of(motion: Float32) -> Float32:
    """Return which rows displacements [H, W, 2] lead to, as splatting wants it."""
    reach = np.empty(rows.row_extents_shape(motion.shape), np.float32)
    rows.splat_row_extents(motion, reach)
    return reach


def _displacement(gbuffer: GBuffer, time: float, reach: Float32) -> Float32:
    """Return displacements, and write which rows they lead to, unless `reach` is [0, 0, 2]."""
    t = np.float32(time)
    after, before = gbuffer.to_next, gbuffer.to_previous
    if after is not None and before is not None:
        out: Float32 = pool.empty(after.shape, np.float32)
        ways = np.ascontiguousarray(before), np.ascontiguousarray(after)
        splat.quadratic_displacement(*ways, t, out, reach)
        if not len(gbuffer.turning):
            return out
    elif after is not None:
        out = t * after
    else:
        assert before is not None
        out = -t * before
    if len(gbuffer.turning) and 0 < abs(time) < 1:
        out.reshape(-1, 2)[gbuffer.turning] = curved(gbuffer, gbuffer.turning, time)
    if reach.size:
        rows.splat_row_extents(out, reach)
    return out


def curved(gbuffer: GBuffer, index: Index, time: float) -> Float32:
    """Return the `displacement` of points that turn, -1 < time < 1.

    At the neighbouring frames, and halfway to them, points are where the rigid motion has them.
    Between, they are on the polynomials of time through these places: quartic with vectors both
    ways, else quadratic.

    Parameters
    ----------
    gbuffer
        With `bend`.
    index
        Flat indices of the points' pixels.
    time
        As for `displacement`.

    Returns
    -------
    float32 [N, 2]
        Pixels.
    """
    assert gbuffer.bend is not None
    earlier, later = (half.reshape(-1, 2)[index] for half in gbuffer.bend)
    straight, t = uncurved(gbuffer, index, time), np.float32(time)
    if gbuffer.to_next is None or gbuffer.to_previous is None:
        own = later if time > 0 else earlier
        out: Float32 = straight + 4 * abs(t) * (1 - abs(t)) * own
        return out
    odd, even = t * (1 - t * t) / np.float32(0.75), t * t * (1 - t * t) / np.float32(0.375)
    out = straight + (even + odd) * later + (even - odd) * earlier
    return out


def uncurved(gbuffer: GBuffer, index: Index, time: float) -> Float32:
    """Return where vectors alone lead some points: parabolas, or constant velocity.

    Parameters and result are those of `curved`; no jerk is looked for.
    """
    t, half = np.float32(time), np.float32(0.5)
    before, after = gbuffer.to_previous, gbuffer.to_next
    if before is None or after is None:
        one, way = (before, -t) if after is None else (after, t)
        assert one is not None
        out: Float32 = way * one.reshape(-1, 2)[index]
        return out
    p, n = before.reshape(-1, 2)[index], after.reshape(-1, 2)[index]
    out = half * t * (n - p) + half * t * t * (n + p)
    return out


def followed(start: GBuffer, others: Sequence[GBuffer], way: int) -> Float32:
    """Follow the points of one instant through others, one step beyond the last of them.

    Parameters
    ----------
    start
        With settled motion.
    others
        The instants after it if `way` is 1, before it if -1, the nearest first; with settled motion
        that way.
    way
        1 or -1.

    Returns
    -------
    float32 [H, W, 2]
        Displacement in pixels over one step more than there are others. Where another surface
        hides a point on its way, by its id or its depth, it goes on as its own vectors foretell.
    """
    step = start.to_next if way > 0 else start.to_previous
    assert step is not None
    moved = step.copy()
    before = displacement(start, way) if others else moved
    own = distances_of(start)
    rounded = depth_step(own) if others else EXACT
    for count, other in enumerate(others, start=2):
        after = displacement(start, way * count)
        step = other.to_next if way > 0 else other.to_previous
        assert step is not None
        there = distances_of(other)
        ids, depths = (stencil_of(other), stencil_of(start)), (there, own)
        steps = coarser(rounded, depth_step(there))
        close = np.float32(CLOSE_DEPTH * (count - 1))
        follow_points(step, ids, depths, steps, close, after - before, moved)
        before = after
    return moved


def span_motion(steps: Sequence[GBuffer], way: int) -> Float32:
    """Return the motion from the first of successive instants to the last.

    Parameters
    ----------
    steps
        At least two, in the order in which the motion runs, with settled motion to the instant
        that comes next; the last needs none.
    way
        1 if that is forward in time, -1 if back.

    Returns
    -------
    float32 [H, W, 2]
        Pixels. What stands still follows the recovered cameras, what moves is followed from
        instant to instant.
    """
    start, *others = steps[:-1]
    moved = followed(start, others, way)
    here, there = scene_of(start), scene_of(steps[-1])
    if here is None or there is None or there.camera is None or start.stencil is None:
        return moved
    still = start.stencil == 0
    return np.where(still[..., None], seen_by(here, there.camera), moved)
