"""Hole detection, and filling from the visible pixels around."""

from __future__ import annotations

import math

import numpy as np

from exwarp_cli.kernels._compile import ParallelKernel, device_function, inline
from exwarp_cli.kernels._row_bands import Band, band_range
from exwarp_cli.kernels.array_types import B8, F32, I16, I32

# Pixel footprints that two world positions of one surface may lie apart: the
# nearest source pixel is up to 0.71 pixels off, and its own sample as much again.
FOOTPRINTS = np.float32(2.0)

# Relative change of depth up to which two pixels may be the same surface, without positions.
DEPTH_TOLERANCE = np.float32(0.1)

# Steps that rounded depths of one point lie apart at most: one, as far as it can be measured.
ROUNDINGS = np.float32(1.1)

# To which values were rounded: a depth's step in scene units, and that of its inverse.
Steps = tuple[np.float32, np.float32]

Limits = tuple[np.float32, np.float32, np.float32, np.float32]


@inline
def same_depth(a: np.float32, b: np.float32, tolerance: np.float32, steps: Steps) -> bool:
    """Return whether two depths, neither of background, differ by at most a share of the larger.

    Rounded depths of one point lie up to a step apart; in the inverse that is |1/a - 1/b|.
    """
    # As a second bound: added to the share, the step hid holes at near outlines (0.1 dB lost).
    rounding = steps[0] + steps[1] * a * b
    return not abs(a - b) > max(tolerance * max(a, b), ROUNDINGS * rounding)


@inline
def _squared_distance(position: F32, i: int, j: int, other: F32, y: int, x: int) -> np.float32:
    squared = np.float32(0.0)
    # Unsigned indices need no test for counting from the end.
    p, q, r, s = np.uint64(i), np.uint64(j), np.uint64(y), np.uint64(x)
    for c in range(3):
        squared += (position[p, q, c] - other[r, s, c]) ** 2
    return squared


@inline
def _other_surface(
    i: int,
    j: int,
    y: int,
    x: int,
    positions: tuple[F32, F32],
    normals: tuple[F32, F32],
    least_cosine: np.float32,
    rounded: np.float32,
) -> bool:
    """Return whether positions (static) or normals (dynamic) at two instants disagree.

    `least_cosine` is that of the normals of one dynamic surface, -2 for a static one. Positions
    disagree beyond FOOTPRINTS of the pixel at (i, j), whose footprint in world space is the sum of
    its spacing on both axes. `rounded` is the step of the positions as a share of each.
    """
    # Unsigned indices need no test for counting from the end.
    p, q, r, s = np.uint64(i), np.uint64(j), np.uint64(y), np.uint64(x)
    if least_cosine > -2:
        now, then = normals
        if now.shape[0] == 0:
            return False
        dot, a, b = np.float32(0), np.float32(0), np.float32(0)
        for c in range(3):
            dot += now[p, q, c] * then[r, s, c]
            a += now[p, q, c] ** 2
            b += then[r, s, c] ** 2
        return bool(dot < least_cosine * math.sqrt(a * b))
    position, source = positions
    if position.shape[0] == 0:
        return False
    squared = _squared_distance(position, i, j, source, y, x)
    # What is within the footprint of one axis needs no roots.
    total, squared_footprints = np.float32(0.0), FOOTPRINTS * FOOTPRINTS
    height, width, _ = position.shape
    for axis in range(2):
        # The nearer neighbour, so that a silhouette beside the pixel does not enlarge it.
        down, right = 1 - axis, axis
        step = np.float32(np.inf)
        if i >= down and j >= right:
            step = min(step, _squared_distance(position, i - down, j - right, position, i, j))
        if i + down < height and j + right < width:
            step = min(step, _squared_distance(position, i + down, j + right, position, i, j))
        if step < np.float32(np.inf):
            if squared <= squared_footprints * step:
                return False
            total += np.float32(math.sqrt(step))
    size = np.float32(0)
    for c in range(3):
        size += abs(position[p, q, c])
    return bool(math.sqrt(squared) > FOOTPRINTS * total + rounded * size)


@ParallelKernel
def mark_holes(
    field: F32,  # [H, W, 2], from the target instant to the source instant; NaN is a hole
    depths: tuple[F32, F32],  # [H, W] at target and source; +inf background
    stencils: tuple[I32, I32],  # [H, W], or [0, 0] if unknown; negative where ids mix
    positions: tuple[F32, F32],  # [H, W, 3], or [0, 0, 3] if unknown
    normals: tuple[F32, F32],  # [H, W, 3], or [0, 0, 3] if unknown
    # limits: cosine of the angle by which a dynamic normal may turn; rounding steps, 0 if none
    limits: Limits,
    hole: B8,  # [H, W], written
    band: Band,
) -> None:
    """Mark pixels whose source along a motion field is not the same surface point.

    ExtraNet's tests: ids differ; the world positions of a static pixel lie further apart than a
    bias that grows with depth and grazing angle; the normal of a dynamic pixel turned. Without
    positions depths are compared. Differences that rounding explains do not count.
    """
    height, width, _ = field.shape
    known_ids = stencils[0].shape[0] > 0
    known_positions = positions[0].shape[0] > 0
    least_cosine, linear, inverse, rounded = limits
    for i in band_range(height, band):
        for j in range(width):
            fx, fy = np.float32(j) + field[i, j, 0], np.float32(i) + field[i, j, 1]
            hole[i, j] = True
            if not (fx >= -0.5 and fy >= -0.5 and fx <= width - 0.5 and fy <= height - 0.5):
                continue
            # None is below 0, where conversion would round up.
            x = min(int(fx + np.float32(0.5)), width - 1)
            y = min(int(fy + np.float32(0.5)), height - 1)
            # Unsigned indices need no test for counting from the end.
            sky = math.isinf(depths[0][np.uint64(i), np.uint64(j)])
            if sky != math.isinf(depths[1][np.uint64(y), np.uint64(x)]):
                continue
            if sky:
                hole[i, j] = False
                continue
            now, then = (stencils[0][i, j], stencils[1][y, x]) if known_ids else (0, 0)
            if now >= 0 and then >= 0 and now != then:
                continue
            cosine = least_cosine if now > 0 else np.float32(-2)
            if _other_surface(i, j, y, x, positions, normals, cosine, rounded):
                continue
            if not known_positions and now <= 0:
                a, b = depths[0][i, j], depths[1][y, x]
                if not same_depth(a, b, DEPTH_TOLERANCE, (linear, inverse)):
                    continue
            hole[i, j] = False


# Steps (rows, columns) in which a hole searches visible pixels: its eight neighbours. Sixteen
# directions scored the same, and a walk along each took 20 times as long as these sweeps.
DIRECTIONS = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))

MIN_WEIGHT = 1e-6


@ParallelKernel
def ray_march_visible(
    hole: B8,  # [H, W]
    first: I32,  # [H + 1]: number of holes in all rows above
    column: I32,  # [N]: the holes' columns, row by row, ascending
    reach: int,  # most steps, 1 to 32,766
    steps: I16,  # [8, N], written: steps to the visible pixel; 0 without one
    band: Band,
) -> None:
    """Find the first visible pixel that a hole sees in each of eight directions."""
    height, width = hole.shape
    unit, limit = np.int16(1), np.int16(reach)
    distances = np.empty((2, width + 2), np.int16)
    for direction in band_range(len(DIRECTIONS), band):
        dy, dx = DIRECTIONS[direction]
        away = steps[direction]
        if dy == 0:
            for i in range(height):
                visited, distance = -2, 0
                for n in range(first[i + 1] - first[i]):
                    k = first[i] + n if dx < 0 else first[i + 1] - 1 - n
                    ahead = column[k] + dx
                    count = distance if ahead == visited else (1 if 0 <= ahead < width else 0)
                    away[k] = count
                    visited, distance = int(column[k]), (count + 1 if 0 < count < reach else 0)
            continue
        # Against the direction, so that pixels read distances that are already known: 1 if visible,
        # else one more than the pixel ahead; 0 out of reach, and beyond the frame. All pixels of a
        # row answer, without branches: a third of the time of holes alone.
        distances[:] = 0
        for row in range(height):
            i = row if dy < 0 else height - 1 - row
            line, current, row_hole = distances[row % 2], distances[1 - row % 2], hole[i]
            for k in range(first[i], first[i + 1]):
                away[k] = line[np.uint64(column[k] + 1 + dx)]
            row_ahead = line[1 + dx : 1 + dx + width]
            for j in range(width):
                step = row_ahead[j]
                next_step = np.int16(step + unit) if (step > 0) & (step < limit) else np.int16(0)
                current[j + 1] = next_step if row_hole[j] else unit


@device_function
def _fill_row(
    at: int,
    size: tuple[int, int],
    depth: F32,
    holes: tuple[int, int],
    column: I32,
    cap: np.float32,
    steps: I16,
    pixels: F32,
) -> None:
    """Fill the holes of a row; `size` is W and C, `at` where it begins in `depth` [H W]."""
    width, channels = size
    begin, end = holes
    columns, count = column[begin:end], end - begin
    far, weights = np.empty((len(DIRECTIONS), count), np.float32), np.empty(count, np.float64)
    wanted, known = np.zeros(count, np.float64), np.empty(count, np.bool_)
    sums, totals = np.zeros(count * channels, np.float64), np.zeros(count, np.float64)
    for way in range(len(DIRECTIONS)):
        stride = DIRECTIONS[way][0] * width + DIRECTIONS[way][1]
        away, seen = steps[way][begin:end], far[way]
        for n in range(count):  # the depth that each hole sees, and the greatest of all directions
            # Unsigned indices need no test for counting from the end: a third less time here.
            ahead = depth[np.uint64(at + columns[n] + np.int64(away[n]) * stride)]
            seen[n] = min(ahead, cap) if away[n] > 0 else np.float32(-1)
            wanted[n] = max(wanted[n], np.float64(seen[n]))
    for n in range(count):  # instead of that, the depth of the hole's own surface where it is known
        own = np.float64(depth[np.uint64(at + columns[n])])
        known[n] = not math.isnan(own)
        wanted[n] = min(own, np.float64(cap)) if known[n] else wanted[n]
    for way in range(len(DIRECTIONS)):
        dy, dx = DIRECTIONS[way]
        away = steps[way][begin:end]
        squared, seen = np.float64(dy * dy + dx * dx), far[way]
        for n in range(count):
            steps_away, visible = np.float64(away[n]), np.float64(seen[n])
            most = max(visible, wanted[n])
            ratio = min(visible, wanted[n]) / most if most > 0 else 1.0
            similarity = ratio * ratio
            similarity = similarity * similarity if known[n] else similarity
            weight = (similarity + MIN_WEIGHT) / (steps_away * steps_away * squared)
            weights[n] = weight if steps_away > 0 else 0.0
            totals[n] += weights[n]
        stride = dy * width + dx
        for n in range(count):
            if weights[n] != 0:
                p = (at + columns[n] + np.int64(away[n]) * stride) * channels
                for c in range(channels):
                    sums[n * channels + c] += weights[n] * np.float64(pixels[p + c])
    for n in range(count):
        p = (at + columns[n]) * channels
        for c in range(channels):
            mean = sums[n * channels + c] / totals[n]
            pixels[p + c] = np.float32(mean) if totals[n] > 0 else np.float32(0)


@ParallelKernel
def fill_holes(
    image: F32,  # [H, W, C], changed in holes
    depth: F32,  # [H, W], +inf background; in holes that of the missing surface, NaN if unknown
    first: I32,  # as `column`: see `ray_march_visible`
    column: I32,
    cap: np.float32,  # scene units; all that is further counts as equally far
    steps: I16,  # [8, N], from `ray_march_visible`
    band: Band,
) -> None:
    """Fill holes from the visible pixels around them.

    Each hole averages the first visible pixels in eight directions. Weights fall with the squared
    distance, and with the ratio of depth to the wanted one: to the fourth power where the hole's
    surface is known, else squared, against the furthest candidate, as a disocclusion shows what
    lies behind.
    """
    # Squares for both lost 0.1 dB with known depth, fourth powers for both 0.04 dB without. A hole
    # that sees nothing becomes 0.
    height, width, channels = image.shape
    flat, pixels = depth.reshape(-1), image.reshape(-1)
    for i in band_range(height, band):
        if first[i] < first[i + 1]:
            holes = (np.int64(first[i]), np.int64(first[i + 1]))
            _fill_row(i * width, (width, channels), flat, holes, column, cap, steps, pixels)
