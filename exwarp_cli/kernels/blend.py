"""The two key frames around a slot: blended by depth and time, or chosen pixel by pixel."""

from __future__ import annotations

import math

import numpy as np

from exwarp_cli.kernels._compile import ParallelKernel, device_function, inline
from exwarp_cli.kernels._row_bands import Band, band_range
from exwarp_cli.kernels.array_types import B8, F32, I16, I32
from exwarp_cli.kernels.holes import DIRECTIONS

Visibility = tuple[F32, B8, B8]

# Exponent of the depth weight: a surface twice as near outweighs the other 1000 to 1.
DEPTH_EXPONENT = 10

MIN_DEPTH_RATIO = np.float32(1e-3)

# Relative difference of depth below which two places may be on one surface.
SAME_DEPTH = np.float32(0.1)

# Weight of a ghost outline: used where the other side sees nothing (worth 0.2 dB).
GHOST_WEIGHT = np.float32(0.02)


@device_function
def _depth_weight(depth: np.float32, nearest: np.float32, hole: bool, ghost: bool) -> np.float32:
    """Return (nearest / depth) ** DEPTH_EXPONENT, less for a ghost, 0 for a hole."""
    ratio = max(nearest / depth, MIN_DEPTH_RATIO)
    ratio = ratio if depth != nearest else np.float32(1)
    weight = np.float32(1)
    for _ in range(DEPTH_EXPONENT):
        weight *= ratio
    weight = weight * GHOST_WEIGHT if ghost else weight
    return np.float32(0) if hole | math.isnan(depth) else weight


@inline
def _same_depth(first: np.float32, second: np.float32) -> bool:
    """Return whether two depths may be those of one surface; background is one, NaN is none."""
    return bool((first == second) | (abs(first - second) <= SAME_DEPTH * min(first, second)))


@device_function
def _has_near_depth(depth: F32, hole: B8, at: tuple[int, int], target: np.float32) -> bool:
    """Return whether one of the 3x3 pixels of [H, W] about a place is visible at a depth."""
    height, width = depth.shape
    near = False
    for i in range(max(at[0] - 1, 0), min(at[0] + 2, height)):
        for j in range(max(at[1] - 1, 0), min(at[1] + 2, width)):
            near |= (not hole[i, j]) & _same_depth(depth[i, j], target)
    return near


@ParallelKernel
def write_later_weights(
    before: Visibility,  # depth [H, W] (+inf background, NaN unknown), hole, ghost; as `after`
    after: Visibility,
    time: np.float32,  # of the slot in the key interval, 0 < time < 1
    later: F32,  # [H, W], written, 0 to 1; 0 in holes
    depth: F32,  # [H, W], written: the nearer of both depths
    hole: B8,  # [H, W], written: neither side sees the surface
    band: Band,
) -> None:
    """Write the weight of the later key frame in the colour of a slot to which both are warped.

    Niklaus and Liu, Softmax Splatting, CVPR 2020, equation 14, with log depth for importance.

    The pixels of a key frame have the surface of their centre, so edges moved to the slot are off
    by up to half a pixel. If one side shows the nearer surface and the other the one behind, and
    each has the other surface beside that pixel, the edge passes through the pixel: it is shared,
    and time alone decides, so that the edge covers a share of it.
    """
    # At shared edges the nearer surface would always win, and moving things would be up to a pixel
    # too wide (1.5 % of town's pixels). The mean of both sides there is 1.1 to 1.6 dB better on
    # three scenes.
    height, width = later.shape
    first, first_hole, first_ghost = before
    second, second_hole, second_ghost = after
    shared = np.empty(width, np.bool_)
    for i in band_range(height, band):
        for j in range(width):
            a, b = first[i, j], second[i, j]
            is_lost = first_hole[i, j] | second_hole[i, j] | math.isnan(a) | math.isnan(b)
            shared[j] = not is_lost and not _same_depth(a, b)
            if shared[j]:
                shared[j] = _has_near_depth(first, first_hole, (i, j), b)
                shared[j] &= _has_near_depth(second, second_hole, (i, j), a)
        early_depth, early_hole, early_ghost = first[i], first_hole[i], first_ghost[i]
        late_depth, late_hole, late_ghost = second[i], second_hole[i], second_ghost[i]
        for j in range(width):
            x, nearest = early_depth[j], late_depth[j]
            nearest = x if (x < nearest) | math.isnan(nearest) else nearest
            early = _depth_weight(x, nearest, early_hole[j], early_ghost[j])
            late = _depth_weight(late_depth[j], nearest, late_hole[j], late_ghost[j])
            early = np.float32(1) - time if shared[j] else early * (np.float32(1) - time)
            late = time if shared[j] else late * time
            seen = early + late > 0
            depth[i, j], hole[i, j] = nearest, not seen
            later[i, j] = late / (early + late) if seen else np.float32(0)


@ParallelKernel
def mix_frames(
    before: F32,  # before, after: [H, W, C]
    after: F32,
    later: F32,  # [H, W], 0 to 1: weight of `after`
    out: F32,  # [H, W, C], written; may be `before`
    band: Band,
) -> None:
    """Mix two frames."""
    _, width, channels = out.shape
    weights = np.empty(width * channels, np.float32)
    mixed = np.empty(width * channels, np.float32)
    for i in band_range(later.shape[0], band):
        for j in range(width):
            for c in range(channels):
                weights[j * channels + c] = later[i, j]
        first = np.ascontiguousarray(before[i]).reshape(-1)
        second = np.ascontiguousarray(after[i]).reshape(-1)
        # From the heavier side: exact where it counts alone, whatever the other holds.
        for k in range(mixed.size):  # `out` may be `before`, for which loops are slow
            early, late, remainder = first[k], second[k], np.float32(1) - weights[k]
            forward = early + weights[k] * (late - early)
            backward = late + remainder * (early - late)
            mixed[k] = forward if weights[k] < np.float32(0.5) else backward
        target = out[i].reshape(-1)
        for k in range(mixed.size):
            target[k] = mixed[k]


@ParallelKernel
def mix_candidates(
    mixed: F32,  # [H, W, C], the first candidate
    sides: tuple[F32, F32, F32, F32],  # the four others, [H, W, C]
    weights: F32,  # [5, h, w], in the order of the candidates; their sum is 1
    corner: tuple[int, int],  # row and column of the part's first pixel
    out: F32,  # [H, W, C], written in the part
    band: Band,
) -> None:
    """Write the weighted mean of the candidates of each pixel of a part of a frame."""
    # As the first candidate plus weighted differences: equal candidates stay as they are, whatever
    # the rounded weights sum to.
    _, height, width = weights.shape
    channels = mixed.shape[2]
    for i in band_range(height, band):
        row = corner[0] + i
        for j in range(width):
            column = corner[1] + j
            for c in range(channels):
                centre = mixed[row, column, c]
                value = centre
                for k, side in enumerate(sides):
                    value += np.float32(weights[1 + k, i, j]) * (side[row, column, c] - centre)
                out[row, column, c] = value


SourceSide = tuple[F32, F32, F32, B8, B8]

# Relative difference of depth up to which two pixels may show the same surface.
SAME_SURFACE_DEPTH = np.float32(0.1)

# Share of the best similarity of depth above which distance alone decides.
SIMILAR_SHARE = 0.8


@inline
def _is_same_surface(a: np.float32, b: np.float32) -> bool:
    """Return whether two depths may be those of one surface; background is like background only."""
    # Below, not up to: infinity differs from a number by as much as it measures.
    return bool(a == b or abs(a - b) < SAME_SURFACE_DEPTH * max(abs(a), abs(b)))


@inline
def _source_pixel(i: int, j: int, field: F32, wanted: np.float32, depth: F32) -> int:
    """Return the source pixel, flat, that a field leads to; -1 outside.

    It is the nearest one, unless its depth is of another surface than `wanted` and that of another
    of the four around is not.
    """
    # A patch of surface reaches beyond the middle between two pixels.
    height, width = depth.shape
    x, y = np.float32(j) + field[i, j, 0], np.float32(i) + field[i, j, 1]
    if not (x >= -0.5 and y >= -0.5 and x <= width - 0.5 and y <= height - 0.5):
        return -1
    # Nothing negative is left, so converting rounds down, and takes half the time of math.floor.
    column = min(np.int64(np.int32(x + np.float32(0.5))), width - 1)
    row = min(np.int64(np.int32(y + np.float32(0.5))), height - 1)
    if math.isnan(wanted) or _is_same_surface(wanted, depth[row, column]):
        return int(row * width + column)
    best, shortest = int(row * width + column), np.float32(np.inf)
    left, top = np.int32(x + np.float32(1)) - 1, np.int32(y + np.float32(1)) - 1
    for corner in range(4):
        p, q = left + corner % 2, top + corner // 2
        if p < 0 or q < 0 or p >= width or q >= height:
            continue
        distance = (x - np.float32(p)) ** 2 + (y - np.float32(q)) ** 2
        if distance < shortest and _is_same_surface(wanted, depth[q, p]):
            best, shortest = int(q * width + p), distance
    return best


@inline
def _visible_source(i: int, j: int, side: SourceSide) -> tuple[int, np.float32]:
    """Return the source pixel, flat, of a slot's pixel, and its trust; -1 and 0 without one."""
    field, depth, source, hole, ghost = side
    if hole[i, j] or math.isnan(depth[i, j]):
        return -1, np.float32(0)
    pixel = _source_pixel(i, j, field, depth[i, j], source)
    trust = GHOST_WEIGHT if ghost[i, j] else np.float32(1)
    return pixel, trust if pixel >= 0 else np.float32(0)


@ParallelKernel
def choose_sources(
    # before: per key frame: field [H, W, 2] px from the slot, NaN if none; depth that the slot
    # shows; depth of its own pixels; hole; ghost [H, W]
    before: SourceSide,
    after: SourceSide,  # as `before`; arrays without rows if there is none
    time: np.float32,  # of the slot in the key interval, 0 < time < 1
    pixel: I32,  # [H, W], written: the source pixel, counted along the rows; -1 in holes
    later: B8,  # [H, W], written: it lies in the key frame after
    depth: F32,  # [H, W], written: the nearer of both depths
    hole: B8,  # [H, W], written: neither side sees the surface
    band: Band,
) -> None:
    """Choose, in one of two key frames, the pixel that shows the surface of each slot pixel.

    It is that of the key frame nearest in time that sees the surface, the earlier of two equally
    near. A ghost counts only where the other side sees nothing.
    """
    # The weights by depth that blend colour chose worse: 3 to 17 % more wrong ids on four scenes,
    # as the splatted edge of the nearer surface is half a pixel too wide.
    height, width = pixel.shape
    has_after = after[0].shape[0] > 0
    for i in band_range(height, band):
        for j in range(width):
            source, a = _visible_source(i, j, before)
            depth[i, j] = before[1][i, j]
            later[i, j] = False
            if has_after:
                if after[1][i, j] < depth[i, j] or math.isnan(depth[i, j]):
                    depth[i, j] = after[1][i, j]
                later_source, b = _visible_source(i, j, after)
                if b * time > a * (np.float32(1) - time):
                    source = later_source
                    later[i, j] = True
            pixel[i, j] = source
            hole[i, j] = source < 0


@ParallelKernel
def adopt_sources(
    # pixel: from `choose_sources`, as is `later`; changed in holes, its own place if nothing is
    # visible
    pixel: I32,
    later: B8,
    depth: F32,  # from `choose_sources`
    first: I32,  # the holes, as for `holes.ray_march_visible`; as `column`
    column: I32,
    cap: np.float32,  # scene units; all that is further counts as equally far
    steps: I16,  # [8, N], from `holes.ray_march_visible`
    band: Band,
) -> None:
    """Give holes the source of the visible pixel around them that they belong to.

    Of the pixels seen in eight directions, those about as similar in depth as the best count, and
    of these the nearest. Depths are compared with the hole's surface, or, if unknown, with the
    furthest.
    """
    height, width = depth.shape
    ways = len(DIRECTIONS)
    far = np.empty(ways, np.float64)
    for i in band_range(height, band):
        for hole in range(first[i], first[i + 1]):
            j = np.int64(column[hole])
            furthest = np.float64(0)
            for way in range(ways):
                away = np.int64(steps[way, hole])
                seen = depth[i + DIRECTIONS[way][0] * away, j + DIRECTIONS[way][1] * away]
                far[way] = np.float64(min(seen, cap))
                furthest = max(furthest, far[way]) if away > 0 else furthest
            known = not math.isnan(depth[i, j])
            wanted = np.float64(min(depth[i, j], cap)) if known else furthest
            best, shortest, y, x = 0.0, np.int64(0), np.int64(-1), np.int64(-1)
            for sweep in range(2):  # first the best similarity, then the pixels close to it
                for way in range(ways):
                    dy, dx = DIRECTIONS[way]
                    away = np.int64(steps[way, hole])
                    if away > 0:
                        most = max(far[way], wanted)
                        similarity = min(far[way], wanted) / most if most > 0 else 1.0
                        length = away * away * (dy * dy + dx * dx)
                        if sweep == 0:
                            best = max(best, similarity)
                        elif similarity >= SIMILAR_SHARE * best and (y < 0 or length < shortest):
                            shortest, y, x = length, i + dy * away, j + dx * away
            # Its own place if nothing is visible.
            pixel[i, j] = pixel[y, x] if y >= 0 else np.int32(i * width + j)
            later[i, j] = y >= 0 and later[y, x]


@ParallelKernel
def sample_surface(
    image: F32,  # [H, W, C]
    depth: F32,  # [H, W] of its pixels, +inf background
    field: F32,  # [H, W, 2] px; NaN without an end
    # out: [H, W, C], written, from the pixels at the depth of the nearest one; NaN for ends outside
    out: F32,
    band: Band,
) -> None:
    """Sample along a field bilinearly, from one surface only."""
    height, width, channels = image.shape
    for i in band_range(out.shape[0], band):
        for j in range(out.shape[1]):
            end = _source_pixel(i, j, field, np.float32(np.nan), depth)
            for c in range(channels):
                out[i, j, c] = np.float32(np.nan) if end < 0 else np.float32(0)
            if end < 0:
                continue
            surface_depth = depth[end // width, end % width]
            x, y = np.float32(j) + field[i, j, 0], np.float32(i) + field[i, j, 1]
            left, top = np.int32(x + np.float32(1)) - 1, np.int32(y + np.float32(1)) - 1
            total = np.float32(0)
            for corner in range(4):
                p = min(max(left + corner % 2, 0), width - 1)
                q = min(max(top + corner // 2, 0), height - 1)
                fx = abs(np.float32(1 - corner % 2) - (x - np.float32(left)))
                fy = abs(np.float32(1 - corner // 2) - (y - np.float32(top)))
                weight = fx * fy
                if weight == 0 or not _is_same_surface(depth[q, p], surface_depth):
                    continue
                total += weight
                for c in range(channels):
                    out[i, j, c] += weight * image[q, p, c]
            for c in range(channels):
                out[i, j, c] /= total
