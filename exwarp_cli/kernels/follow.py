"""Following moving points from instant to instant."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import inlined, parallel, part
from exwarp_cli.kernels._row_bands import Share, turns
from exwarp_cli.kernels.holes import DEPTH_TOLERANCE, Steps, same_depth
from exwarp_cli.kernels.surface import end_of

F32 = npt.NDArray[np.float32]
I32 = npt.NDArray[np.int32]
B8 = npt.NDArray[np.bool_]
Vector = tuple[np.float32, np.float32]
Shown = tuple[I32, F32, Steps, np.float32]
"""What an instant shows: ids, depths, the steps that these were rounded to, and how close those of
one surface are sure to be."""

Point = tuple[np.int32, np.float32]
"""A point's id, -2 for any, and its depth, NaN for any; +inf is background."""

LEAST_SCALE = 0.25
"""Pixels by which a vector may differ from the expected one before it counts for less …"""

SCALE = 0.1
"""… and the same as a share of the expected vector's length.

An expected vector chooses between samples that differ, and stands in for those of other surfaces.
Where all four are of the point's, it never enters their mean: as a fifth sample of weight 0.2 it
turned vectors that all say 2.0 into 2.97 where 3.0 was expected.
"""

CLOSE = 0.015
"""Relative change of depth a step up to which a sample is sure to be of the point's surface.

At 120 fps a camera that comes nearer by as much covers the distance in half a second.
"""

LEAST_TRUST = 0.25
"""Trust from which on a sample of a depth between CLOSE and DEPTH_TOLERANCE counts.

On the market square without ids and positions, slots 2 and 3 warped from the key frame, dB:
bilinear composition 23.20 and 21.71, a fifth sample 23.63 and 22.46, choosing without depths 23.42
and 22.05, with them 23.62 and 22.45. Over three steps of simulated leaves at like depths, error in
pixels, median / 90th / 99th percentile: composition 0.10 / 1.32 / 3.40, a fifth sample 0.02 / 0.16
/ 0.66, choosing without depths 0.00 / 0.62 / 2.77, with them 0.00 / 0.11 / 1.41; where depths are
further apart 0.00 / 0.09 / 0.55.
"""

OTHER, DOUBTFUL, SAME = 0, 1, 2


@inlined
def trust(
    vx: np.float32, vy: np.float32, ex: np.float32, ey: np.float32, scale: np.float32
) -> np.float32:
    """Return how much a vector counts beside the expected one, 0 to 1."""
    away_x, away_y = (vx - ex) / scale, (vy - ey) / scale
    doubt = np.float32(1) + away_x * away_x + away_y * away_y
    return np.float32(1) / (doubt * doubt)


@inlined
def scale_of(ex: np.float32, ey: np.float32) -> np.float32:
    """Return by how much a vector may differ from the expected one before it counts for less."""
    return max(np.float32(LEAST_SCALE), np.float32(SCALE) * np.sqrt(ex * ex + ey * ey))


@inlined
def likeness(shown: Shown, point: Point, q: np.uint64, p: np.uint64) -> int:
    """Return whether a pixel shows the point's surface: OTHER, DOUBTFUL or SAME."""
    stencil, depth, rounded, close = shown
    ident, own = point
    if ident != np.int32(-2) and stencil[q, p] != ident:
        return OTHER
    if math.isnan(own):
        return SAME
    there = depth[q, p]
    if math.isinf(there) or math.isinf(own):
        return SAME if there == own else OTHER
    if same_depth(there, own, close, rounded):
        return SAME
    # What moves by itself may come nearer at any speed; its far side may also pass behind its near.
    moves = ident > np.int32(0)
    return DOUBTFUL if moves or same_depth(there, own, DEPTH_TOLERANCE, rounded) else OTHER


@inlined
def floor_of(value: np.float32) -> int:
    """Return the next whole number below a small value; `math.floor` is a call."""
    whole = np.int64(value)
    return int(whole - 1 if value < np.float32(whole) else whole)


@part
def any_step(
    step: F32, shown: Shown, point: Point, place: Vector, hope: Vector
) -> tuple[np.float32, np.float32]:
    """Do as `step_at` with samples of which some may lie outside, show others, or be NaN."""
    height, width, _ = step.shape
    one = np.float32(1)
    (x, y), (ex, ey) = place, hope
    foreseen = not math.isnan(ex + ey)
    total, sum_x, sum_y = np.float32(0), np.float32(0), np.float32(0)
    scale = scale_of(ex, ey)
    near = x > -one and y > -one and x < width and y < height  # no for NaN
    left, top = (floor_of(x), floor_of(y)) if near else (-2, -2)
    fx, fy = x - np.float32(left), y - np.float32(top)
    counted, seen, best = 0, np.float32(0), np.float32(0)
    for corner in range(4):
        p, q = left + corner % 2, top + corner // 2
        if not (0 <= p < width and 0 <= q < height):
            continue
        row, column = np.uint64(q), np.uint64(p)  # no test for counting from the end
        like = likeness(shown, point, row, column)
        if like == OTHER:
            continue
        vx, vy = step[row, column, 0], step[row, column, 1]
        if math.isnan(vx + vy):
            continue
        weight = (fx if corner % 2 else one - fx) * (fy if corner // 2 else one - fy)
        if foreseen:
            trusted = trust(vx, vy, ex, ey, scale)
            if like == DOUBTFUL and trusted < np.float32(LEAST_TRUST):
                continue
            counted, seen, best = counted + 1, seen + weight, max(best, trusted)
            weight *= trusted
        total += weight
        sum_x += weight * vx
        sum_y += weight * vy
    if foreseen and counted < 4:
        # In place of samples of others, as they are written of the surface nowhere.
        rest = max(one - seen, np.float32(0)) * (best if total > 0 else one)
        total += rest
        sum_x += rest * ex
        sum_y += rest * ey
    if total > 0:
        return sum_x / total, sum_y / total
    return np.float32(np.nan), np.float32(np.nan)


@inlined
def four_around(
    step: F32, shown: Shown, point: Point, place: Vector, hope: Vector
) -> tuple[np.float32, np.float32, np.float32]:
    """Return the sum of the weights, and the weighted sums of x and y, where all samples count.

    Weights of 0 where they do not, or may not: see `step_at`. Added up in the same order as in
    `any_step`, they are the same bits.
    """
    height, width, _ = step.shape
    zero, one = np.float32(0), np.float32(1)
    (x, y), (ex, ey) = place, hope
    if not (x >= zero and y >= zero and x < width - 1 and y < height - 1):  # no for NaN
        return zero, zero, zero
    left, top = np.int64(x), np.int64(y)
    x0, x1 = np.uint64(left), np.uint64(left + 1)  # no test for counting from the end
    y0, y1 = np.uint64(top), np.uint64(top + 1)
    if point[0] != np.int32(-2) or not math.isnan(point[1]):
        least = min(likeness(shown, point, y0, x0), likeness(shown, point, y0, x1))
        least = min(least, likeness(shown, point, y1, x0), likeness(shown, point, y1, x1))
        if least != SAME:
            return zero, zero, zero
    ax, ay, bx, by = step[y0, x0, 0], step[y0, x0, 1], step[y0, x1, 0], step[y0, x1, 1]
    cx, cy, dx, dy = step[y1, x0, 0], step[y1, x0, 1], step[y1, x1, 0], step[y1, x1, 1]
    fx, fy = x - np.float32(left), y - np.float32(top)
    a, b = (one - fx) * (one - fy), fx * (one - fy)
    c, d = (one - fx) * fy, fx * fy
    total, sum_x, sum_y = zero, zero, zero
    if not math.isnan(ex + ey):
        scale = scale_of(ex, ey)
        a, b = a * trust(ax, ay, ex, ey, scale), b * trust(bx, by, ex, ey, scale)
        c, d = c * trust(cx, cy, ex, ey, scale), d * trust(dx, dy, ex, ey, scale)
    total = total + a + b + c + d
    sum_x = sum_x + a * ax + b * bx + c * cx + d * dx
    sum_y = sum_y + a * ay + b * by + c * cy + d * dy
    return total, sum_x, sum_y


@inlined
def step_at(
    step: F32, shown: Shown, point: Point, place: Vector, hope: Vector
) -> tuple[np.float32, np.float32]:
    """Return a point's motion over a step: the expected one where no sample tells, else NaN.

    Mostly all four samples count. One after the other, with a test at each, they took 1.2 to 1.8
    times as long.

    Parameters
    ----------
    step, shown
        As for :func:`follow`; ids, depths and their steps.
    point
        What is known of it.
    place, hope
        Where it is, and which motion is expected of it; x and y.
    """
    total, sum_x, sum_y = four_around(step, shown, point, place, hope)
    if total > 0 and not math.isnan(sum_x + sum_y):
        return sum_x / total, sum_y / total
    found: Vector = any_step(step, shown, point, place, hope)
    return found


@parallel
def follow(
    step: F32,
    stencils: tuple[I32, I32],
    depths: tuple[F32, F32],
    rounded: Steps,
    close: np.float32,
    expected: F32,
    moved: F32,
    share: Share,
) -> None:
    """Move points on by one step: moved(x) += step(x + moved(x)).

    Parameters
    ----------
    step
        float32 [H, W, 2], pixels: motion over the step at each pixel of the instant that the points
        have reached; NaN where unknown.
    stencils
        int32 [H, W]: ids at that instant, and of the points; [0, 0] when unknown.
    depths
        float32 [H, W], scene units: those at that instant, and of the points; +inf background,
        [0, 0] when unknown.
    rounded
        The steps that depths, and their inverse, were rounded to.
    close
        Relative difference of depths up to which a sample is sure to be of the point's surface.
    expected
        float32 [H, W, 2], pixels: motion over the step as it is foreseen from where the points
        started; NaN where it is not, [0, 0, 2] where it is nowhere.
    moved
        float32 [H, W, 2], pixels, changed: how far the points have come; NaN where unknown, and
        where neither samples nor an expectation lead on.

    Notes
    -----
    The mean of the four bilinear samples, in which a sample of another surface does not count: one
    of another id, or of another depth. Where depth leaves that open, one counts if its vector is as
    expected. Where those that count differ, one counts the less the further it is from what is
    expected: thin things that pass each other have many vectors within a pixel. The expected vector
    itself stands in for samples that do not count, so the point goes on as expected where none
    does.
    """
    height, width, _ = moved.shape
    stencil, own = stencils
    depth, away = depths
    known, hoped = stencil.size > 0 and own.size > 0, expected.size > 0
    deep = depth.size > 0 and away.size > 0
    for i in turns(height, share):
        for j in range(width):
            x, y = np.float32(j) + moved[i, j, 0], np.float32(i) + moved[i, j, 1]
            ident = own[i, j] if known else np.int32(-2)
            reach = away[i, j] if deep else np.float32(np.nan)
            ex, ey = np.float32(np.nan), np.float32(np.nan)
            if hoped:
                ex, ey = expected[i, j, 0], expected[i, j, 1]
            shown, point = (stencil, depth, rounded, close), (ident, reach)
            step_x, step_y = step_at(step, shown, point, (x, y), (ex, ey))
            moved[i, j, 0] += step_x
            moved[i, j, 1] += step_y


@parallel
def follow_shown(
    step: F32,
    stencil: I32,
    gone: B8,
    moved: F32,
    lost: B8,
    led: F32,
    missed: B8,
    share: Share,
) -> None:
    """Move points on by one step as :func:`follow` does, as what the instant shows there.

    Parameters
    ----------
    step, stencil
        As there. The id of a point is that of the pixel which it has reached; 0 beyond the frame.
    gone
        bool [H, W]: pixels of the instant whose surface is not seen after the step.
    moved, lost
        float32 [H, W, 2], pixels, and bool [H, W]: how far points have come, and which are lost.
    led, missed
        The same after the step, written. Lost are then also those that have reached such a pixel,
        or none.
    """
    height, width, _ = moved.shape
    nowhere = np.float32(np.nan), np.float32(np.nan)
    anywhere, exact = step[:0, :0, 0], (np.float32(0), np.float32(0))
    for i in turns(height, share):
        for j in range(width):
            mx, my = moved[i, j, 0], moved[i, j, 1]
            q, p = end_of(i, j, mx, my, height, width)
            missed[i, j] = lost[i, j] or q < 0 or gone[q, p]
            ident = np.int32(-2)
            if stencil.size > 0:
                ident = stencil[q, p] if q >= 0 else np.int32(0)
            place = np.float32(j) + mx, np.float32(i) + my
            shown = stencil, anywhere, exact, np.float32(0)
            point = ident, np.float32(np.nan)
            step_x, step_y = step_at(step, shown, point, place, nowhere)
            led[i, j, 0], led[i, j, 1] = mx + step_x, my + step_y
