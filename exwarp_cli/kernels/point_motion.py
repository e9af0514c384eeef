"""Moving points from instant to instant, by vectors or cameras, and the surfaces at their ends."""

from __future__ import annotations

import math

import numpy as np

from exwarp_cli.kernels._compile import ParallelKernel, device_function, inline
from exwarp_cli.kernels._row_bands import Band, band_range
from exwarp_cli.kernels.array_types import B8, F32, F64, I32
from exwarp_cli.kernels.gather import sample_border
from exwarp_cli.kernels.holes import DEPTH_TOLERANCE, Steps, same_depth

Parts = tuple[F32, F32, F32, F32]
Colours = tuple[F32, F32]


@inline
def _nearest_end(
    i: int, j: int, move_x: np.float32, move_y: np.float32, height: int, width: int
) -> tuple[int, int]:
    """Return row and column of the pixel nearest to the end of (i, j); -1 beyond the frame."""
    # In double precision: ends often lie between pixels, and float32 rounds them the other way.
    x = np.float64(j) + np.float64(move_x) + 0.5
    y = np.float64(i) + np.float64(move_y) + 0.5
    if x >= 0 and y >= 0 and x <= width and y <= height:  # no for NaN
        return min(int(y), height - 1), min(int(x), width - 1)
    return -1, -1


@device_function
def _clear_surface(target: Parts, colours: Colours, i: int, j: int, place: int) -> None:
    for part in range(len(target)):
        for c in range(target[part].shape[2]):
            target[part][i, j, c] = np.float32(0 if part > 0 else np.nan)
    for k in range(len(colours)):
        if colours[k].size > 0:
            colours[k][place : place + 3] = np.float32(0)


@ParallelKernel
def copy_surface(
    field: F32,  # [H, W, 2] px from the slot to the frame; NaN where it shows nothing
    # source: depth first, normal, roughness, metallic of the frame, [H, W, 1 or 3], by nearest
    # pixel; [0, 0, 0] if unknown
    source: Parts,
    colours: Colours,  # albedo and specular of the frame, [H W 3], bilinear; [0] if unknown
    target: Parts,  # the slot's, changed; may be empty where the frame's are
    target_colours: Colours,
    unknown: B8,  # [H, W], changed: pixels that become known are removed
    blanks: bool,  # parts become NaN (depth) or 0 where nothing is known
    band: Band,
) -> None:
    """Copy a frame's surfaces to the slot's pixels that have none yet."""
    height, width, _ = field.shape
    shape = (height, width, 3)
    for i in band_range(height, band):
        for j in range(width):
            if not unknown[i, j]:
                continue
            q, p = _nearest_end(i, j, field[i, j, 0], field[i, j, 1], height, width)
            place = (i * width + np.int64(j)) * 3
            if q >= 0:
                unknown[i, j] = False
                for part in range(len(source)):
                    for c in range(source[part].shape[2]):
                        target[part][i, j, c] = source[part][q, p, c]
                x, y = np.float32(j) + field[i, j, 0], np.float32(i) + field[i, j, 1]
                for k in range(len(colours)):
                    if colours[k].size > 0:
                        sample_border(colours[k], shape, x, y, target_colours[k], place)
            elif blanks:
                _clear_surface(target, target_colours, i, j, place)


Vector = tuple[np.float32, np.float32]
# What an instant shows: ids, depths, the steps that these were rounded to, and how close those of
# one surface are sure to be.
InstantSurface = tuple[I32, F32, Steps, np.float32]

# A point's id, -2 for any, and its depth, NaN for any; +inf is background.
PointIdentity = tuple[np.int32, np.float32]

# Pixels by which a vector may differ from the expected one before it counts for less …
MIN_SCALE = 0.25

# … and the same as a share of the expected vector's length.
# A vector back is expected to lead to where the point was. What comes nearer changes its depth and
# speed as its own vectors do not foretell. By vectors back `exwarp` gained 0.15, 0.20 and 0.01 dB
# at slots 1 to 3 of market, 0.19, 0.07 and 0.61 dB on a shot of things that come near.
# An expected vector chooses between samples that differ, and stands in for those of other surfaces.
# Where all four are of the point's, it never enters their mean: as a fifth sample of weight 0.2 it
# turned vectors that all say 2.0 into 2.97 where 3.0 was expected.
RELATIVE_SCALE = 0.1

# Relative change of depth a step up to which a sample is sure to be of the point's surface.
# At 120 fps a camera that comes nearer by as much covers the distance in half a second.
CLOSE_DEPTH = 0.015

# Trust from which on a sample of a depth between CLOSE and DEPTH_TOLERANCE counts.
# On the market square without ids and positions, slots 2 and 3 warped from the key frame, dB:
# bilinear composition 23.20 and 21.71, a fifth sample 23.63 and 22.46, choosing without depths
# 23.42 and 22.05, with them 23.62 and 22.45. Over three steps of simulated leaves at like depths,
# error in pixels, median / 90th / 99th percentile: composition 0.10 / 1.32 / 3.40, a fifth sample
# 0.02 / 0.16 / 0.66, choosing without depths 0.00 / 0.62 / 2.77, with them 0.00 / 0.11 / 1.41;
# where depths are further apart 0.00 / 0.09 / 0.55.
MIN_TRUST = 0.25

OTHER_SURFACE, MAYBE_SAME, SAME = 0, 1, 2


@inline
def _match_surface(shown: InstantSurface, point: PointIdentity, q: np.uint64, p: np.uint64) -> int:
    stencil, depth, rounded, close = shown
    ident, point_depth = point
    if ident != np.int32(-2) and stencil[q, p] != ident:
        return OTHER_SURFACE
    if math.isnan(point_depth):
        return SAME
    sample_depth = depth[q, p]
    if math.isinf(sample_depth) or math.isinf(point_depth):
        return SAME if sample_depth == point_depth else OTHER_SURFACE
    if same_depth(sample_depth, point_depth, close, rounded):
        return SAME
    # Dynamic objects may approach at any speed, and their far side may pass behind their near.
    moves = ident > np.int32(0)
    return (
        MAYBE_SAME
        if moves or same_depth(sample_depth, point_depth, DEPTH_TOLERANCE, rounded)
        else OTHER_SURFACE
    )


@inline
def _distrust(found: Vector, expected: Vector) -> np.float32:
    """Return the squared distance of a vector from the expected one; see MIN_SCALE."""
    (x, y), (ex, ey) = found, expected
    scale = max(np.float32(MIN_SCALE), np.float32(RELATIVE_SCALE) * np.sqrt(ex * ex + ey * ey))
    away_x, away_y = (x - ex) / scale, (y - ey) / scale
    out: np.float32 = away_x * away_x + away_y * away_y
    return out


@inline
def _point_step(
    vectors: tuple[F32, F32],  # as `shown`: see `follow_points`
    shown: InstantSurface,
    point: PointIdentity,
    place: Vector,  # position of the point
    expected: Vector,  # its expected motion
    origin: Vector,  # from there to where it was one step before
) -> Vector:
    """Return a point's motion over a step: the expected one, or NaN, if no sample counts."""
    step, back = vectors
    height, width, _ = step.shape
    unit = np.float32(1)
    (x, y), (ex, ey) = place, expected
    has_expected = not math.isnan(ex + ey)
    total, sum_x, sum_y = np.float32(0), np.float32(0), np.float32(0)
    near = x > -unit and y > -unit and x < width and y < height  # no for NaN
    left, top = (int(np.floor(x)), int(np.floor(y))) if near else (-2, -2)
    fx, fy = x - np.float32(left), y - np.float32(top)
    counted, covered, best = 0, np.float32(0), np.float32(0)
    for corner in range(4):
        p, q = left + corner % 2, top + corner // 2
        if not (0 <= p < width and 0 <= q < height):
            continue
        row, column = np.uint64(q), np.uint64(p)  # no test for counting from the end
        likeness = _match_surface(shown, point, row, column)
        if likeness == OTHER_SURFACE:
            continue
        vx, vy = step[row, column, 0], step[row, column, 1]
        if math.isnan(vx + vy):
            continue
        weight = (fx if corner % 2 else unit - fx) * (fy if corner // 2 else unit - fy)
        if has_expected:
            distrust = _distrust((vx, vy), expected)
            if back.size > 0:
                astray = _distrust((back[row, column, 0], back[row, column, 1]), origin)
                distrust = distrust if math.isnan(astray) else astray
            trust = unit / ((unit + distrust) * (unit + distrust))
            if likeness == MAYBE_SAME and trust < np.float32(MIN_TRUST):
                continue
            counted, covered, best = counted + 1, covered + weight, max(best, trust)
            weight *= trust
        total += weight
        sum_x += weight * vx
        sum_y += weight * vy
    if has_expected and counted < 4:
        # In place of samples of other surfaces.
        missing = max(unit - covered, np.float32(0)) * (best if total > 0 else unit)
        total += missing
        sum_x += missing * ex
        sum_y += missing * ey
    if total > 0:
        return sum_x / total, sum_y / total
    return np.float32(np.nan), np.float32(np.nan)


@ParallelKernel
def follow_points(
    # vectors: [H, W, 2] px over the step, and back over the one before, at the instant's pixels;
    # NaN where unknown, those back may be [0, 0, 2]
    vectors: tuple[F32, F32],
    stencils: tuple[I32, I32],  # [H, W] ids at that instant, and of the points; [0, 0] if unknown
    # depths: [H, W] at that instant, and of the points; +inf background, [0, 0] if unknown
    depths: tuple[F32, F32],
    rounded: Steps,  # steps to which depths, and their inverse, were rounded
    close: np.float32,  # relative difference of depths of one surface
    # expected: the same of the points, as predicted and as they came; NaN where unknown, both
    # [0, 0, 2] everywhere
    expected: tuple[F32, F32],
    moved: F32,  # [H, W, 2] px, changed: way of the points so far; NaN where unknown
    band: Band,
) -> None:
    """Move points on by one step: moved(x) += step(x + moved(x)).

    Each point takes the mean of the bilinear samples of its own surface, by id and depth. Where
    depth leaves that open, a sample counts if its vector back leads to where the point was, or
    without vectors back if its vector is as expected; the further from that, the less it counts.
    The expected vector replaces samples that do not count.
    """
    height, width, _ = moved.shape
    stencil, point_ids = stencils
    depth, point_depths = depths
    ahead, behind = expected
    has_ids, has_expected = stencil.size > 0 and point_ids.size > 0, ahead.size > 0
    has_depths = depth.size > 0 and point_depths.size > 0
    for i in band_range(height, band):
        for j in range(width):
            x, y = np.float32(j) + moved[i, j, 0], np.float32(i) + moved[i, j, 1]
            point_id = point_ids[i, j] if has_ids else np.int32(-2)
            point_depth = point_depths[i, j] if has_depths else np.float32(np.nan)
            onward = origin = np.float32(np.nan), np.float32(np.nan)
            if has_expected:
                onward = ahead[i, j, 0], ahead[i, j, 1]
                origin = behind[i, j, 0], behind[i, j, 1]
            shown, point = (stencil, depth, rounded, close), (point_id, point_depth)
            step_x, step_y = _point_step(vectors, shown, point, (x, y), onward, origin)
            moved[i, j, 0] += step_x
            moved[i, j, 1] += step_y


@ParallelKernel
def follow_visible(
    step: F32,  # as `stencil`: see `follow_points`; the id is 0 beyond the frame
    stencil: I32,
    hidden: B8,  # [H, W]: pixels of the instant whose surface is hidden after the step
    moved: F32,  # [H, W, 2] px: way of the points
    lost: B8,  # [H, W]: points that are lost
    next_moved: F32,  # [H, W, 2], written: `moved` after the step
    # next_lost: [H, W], written: `lost` after the step, also at hidden pixels and beyond the frame
    next_lost: B8,
    band: Band,
) -> None:
    """Move points on like `follow_points`, with the id of the pixel that they have reached."""
    height, width, _ = moved.shape
    nowhere = np.float32(np.nan), np.float32(np.nan)
    vectors = step, step[:0, :0]
    anywhere, exact = step[:0, :0, 0], (np.float32(0), np.float32(0))
    for i in band_range(height, band):
        for j in range(width):
            mx, my = moved[i, j, 0], moved[i, j, 1]
            q, p = _nearest_end(i, j, mx, my, height, width)
            next_lost[i, j] = lost[i, j] or q < 0 or hidden[q, p]
            ident = np.int32(-2)
            if stencil.size > 0:
                ident = stencil[q, p] if q >= 0 else np.int32(0)
            place = np.float32(j) + mx, np.float32(i) + my
            shown = stencil, anywhere, exact, np.float32(0)
            point = ident, np.float32(np.nan)
            step_x, step_y = _point_step(vectors, shown, point, place, nowhere, nowhere)
            next_moved[i, j, 0], next_moved[i, j, 1] = mx + step_x, my + step_y


@inline
def rigid_displacement(
    position: F32, depth: F32, camera: F64, at_infinity: F64, i: int, j: int
) -> tuple[np.float32, np.float32]:
    """Return how pixel (i, j) moves if its point is static; NaN if it is behind the camera.

    Arrays are those of `write_rigid_motion`.
    """
    x, y = np.float64(j), np.float64(i)
    if math.isinf(depth[i, j]):
        u = at_infinity[0, 0] * x + at_infinity[0, 1] * y + at_infinity[0, 2]
        v = at_infinity[1, 0] * x + at_infinity[1, 1] * y + at_infinity[1, 2]
        w = at_infinity[2, 0] * x + at_infinity[2, 1] * y + at_infinity[2, 2]
    else:
        a, b, c, d = x, y, 1.0, 1.0 / np.float64(depth[i, j])
        if position.shape[0] > 0:
            a = np.float64(position[i, j, 0])
            b = np.float64(position[i, j, 1])
            c = np.float64(position[i, j, 2])
            d = np.float64(1.0)
        u = camera[0, 0] * a + camera[0, 1] * b + camera[0, 2] * c + camera[0, 3] * d
        v = camera[1, 0] * a + camera[1, 1] * b + camera[1, 2] * c + camera[1, 3] * d
        w = camera[2, 0] * a + camera[2, 1] * b + camera[2, 2] * c + camera[2, 3] * d
    if w > 0:
        return np.float32(u / w - x), np.float32(v / w - y)
    return np.float32(np.nan), np.float32(np.nan)


@ParallelKernel
def write_rigid_motion(
    position: F32,  # [H, W, 3], world space; or [0, 0, 3], then depth places the points
    depth: F32,  # [H, W], along the camera's axis; +inf is background, at infinity
    camera: F64,  # [3, 4]: projects (X, Y, Z, 1), or without positions (x, y, 1, 1/depth) in pixels
    at_infinity: F64,  # [3, 3]: projects (x, y, 1) of a background pixel
    selected: B8,  # [H, W]: the pixels that are written; [0, 0] for all
    # keep_unseen: pixels keep their motion where the point is behind the other camera, else they
    # become NaN
    keep_unseen: bool,
    out: F32,  # [H, W, 2] px, written
    band: Band,
) -> None:
    """Write the displacement of pixels to another camera's frame, if their points are static."""
    height, width = depth.shape
    has_selection = selected.shape[0] > 0
    for i in band_range(height, band):
        for j in range(width):
            if has_selection and not selected[i, j]:
                continue
            x, y = rigid_displacement(position, depth, camera, at_infinity, i, j)
            if not (keep_unseen and math.isnan(x)):
                out[i, j, 0], out[i, j, 1] = x, y
