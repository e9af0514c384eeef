"""Forward splatting of displacements into a backward motion field, with a depth test.

Each source pixel is a small patch of surface. The gradient of its displacement says how the patch
is stretched and turned. So the target pixels that it covers, and the place in the source of each,
are exact to first order: no cracks where the image grows, no rounding to whole pixels.

Nearly all patches lie on the centres of at most two target pixels. For these, all but the depth
test runs in loops without branches, which LLVM vectorises. Other patches are visited one by one.
"""

from __future__ import annotations

import math

import numpy as np

from exwarp_cli.kernels._compile import ParallelKernel, device_function, inline
from exwarp_cli.kernels._row_bands import Band, band_range
from exwarp_cli.kernels.array_types import F32, I32

Matrix = tuple[np.float32, np.float32, np.float32, np.float32]
Motion = tuple[F32, F32, F32]
Landings = tuple[I32, F32, F32]

# Largest change of displacement between neighbours of one surface, pixels per pixel.
SAME_SURFACE = np.float32(0.5)

# Half the side of a patch: a little over 0.5, so that neighbours leave no gaps.
OVERLAP = np.float32(0.54)

# Area of a pixel's patch, square pixels, up to which it is turned over or edge-on.
LEAST_AREA = np.float32(0.05)

# More than a patch reaches: OVERLAP times its stretch, at most 1 + 2 * SAME_SURFACE, pixels.
PATCH_REACH = np.float32(2)

NO_TARGET = np.int32(-1)
# Instead of the place where a patch lands: on no pixel's centre, on more than two.
MANY_TARGETS = np.int32(-2)


@device_function
def _write_slopes(before: F32, here: F32, after: F32, out: F32) -> None:
    """Write the change of displacement per pixel, from neighbours on the same surface.

    All [2 W], x and y in turn. 0 without such neighbours: NaN, and what lies outside, counts as
    another surface.
    """
    for k in range(out.size):
        left, right = here[k] - before[k], after[k] - here[k]
        left_same = abs(left) < SAME_SURFACE
        right_same = abs(right) < SAME_SURFACE
        single = left if left_same else (right if right_same else np.float32(0))
        out[k] = np.float32(0.5) * (left + right) if left_same & right_same else single


@device_function
def _jacobian(across: F32, down: F32, j: int) -> Matrix:
    """Return the Jacobian of x -> x + d(x) at a column, row by row, from the slopes of d."""
    a, b = np.float32(1) + across[2 * j], down[2 * j]
    c, d = across[2 * j + 1], np.float32(1) + down[2 * j + 1]
    return a, b, c, d


@inline
def _patch_bounds(
    x: np.float32, y: np.float32, matrix: Matrix, size: tuple[int, int, int]
) -> Matrix:
    """Return first and last row, first and last column that may lie on a patch around (x, y).

    `size`: first target row, the one after the last, the frame's width. The last comes before the
    first for a patch outside.
    """
    a, b, c, d = matrix
    reach_x = OVERLAP * (abs(a) + abs(b))
    reach_y = OVERLAP * (abs(c) + abs(d))
    first_row = np.ceil(max(y - reach_y, np.float32(size[0])))
    last_row = np.floor(min(y + reach_y, np.float32(size[1] - 1)))
    first_column = np.ceil(max(x - reach_x, np.float32(0)))
    last_column = np.floor(min(x + reach_x, np.float32(size[2] - 1)))
    return first_row, last_row, first_column, last_column


@inline
def _source_in_patch(
    rx: np.float32, ry: np.float32, matrix: Matrix, determinant: np.float32
) -> tuple[np.float32, np.float32, bool]:
    """Return x and y in the source pixel of a target pixel, and whether the patch covers it.

    (rx, ry) leads from the patch's centre to the target pixel.
    """
    a, b, c, d = matrix
    u = (d * rx - b * ry) / determinant
    v = (a * ry - c * rx) / determinant
    return u, v, bool((abs(u) <= OVERLAP) & (abs(v) <= OVERLAP))


@device_function
def _write_places(
    start: tuple[int, int],  # row and column of the first source pixel
    motion: Motion,  # displacement and its slopes along x and y, [2 N] each, x and y in turn
    size: tuple[int, int, int],  # as in `_patch_bounds`
    # landings: target index or NO_TARGET or MANY_TARGETS, and x, y to the source: [2 N] each
    landings: Landings,
) -> None:
    """Write where the patches of a span of a source row land, on up to two target pixels each."""
    (line, across, down), (place, found_x, found_y) = motion, landings
    count = line.size // 2
    top, bottom, right = np.float32(size[0]), np.float32(size[1] - 1), np.float32(size[2] - 1)
    i, first_row, width = np.float32(start[0]), np.int32(size[0]), np.int32(size[2])
    zero, one = np.float32(0), np.float32(1)
    for n in range(count):
        j = np.float32(start[1] + n)
        matrix = _jacobian(across, down, n)
        a, b, c, d = matrix
        x, y = j + line[2 * n], i + line[2 * n + 1]
        determinant = a * d - b * c
        # A patch reaches less than 2 pixels. What lies farther off, infinite or NaN, must not come
        # to the conversion to integers.
        is_valid = determinant > LEAST_AREA
        is_valid &= (y > top - PATCH_REACH) & (y < bottom + PATCH_REACH)
        is_valid &= (x > -PATCH_REACH) & (x < right + PATCH_REACH)
        row, last_row, column, last_column = _patch_bounds(x, y, matrix, size)
        is_valid &= (row <= last_row) & (column <= last_column)
        more_x, more_y = last_column - column, last_row - row
        many = is_valid & (more_x + more_y > one)
        u, v, is_hit = _source_in_patch(column - x, row - y, matrix, determinant)
        index = np.int32(row if is_valid else top) - first_row
        index = index * width + np.int32(column if is_valid else zero)
        place[n] = MANY_TARGETS if many else (index if is_valid & is_hit else NO_TARGET)
        found_x[n], found_y[n] = j + u - column, i + v - row
        column += one if more_x > zero else zero
        row += one if more_y > zero else zero
        u, v, is_hit = _source_in_patch(column - x, row - y, matrix, determinant)
        has_second = is_valid & (more_x + more_y == one) & is_hit
        place[count + n] = (
            index + (np.int32(1) if more_x > zero else width) if has_second else NO_TARGET
        )
        found_x[count + n], found_y[count + n] = j + u - column, i + v - row


# Pixels of a source row that a strip visits or skips together. With whole rows strips visited 1.8
# times as many pixels as there are, where things move by up to 60 pixels.
REACH_SPAN = 64


@ParallelKernel
def splat_row_extents(
    displacement: F32,  # as in `splat`
    # extents: [H, S + 1, 2], written: least and greatest row of each REACH_SPAN pixels, then of the
    # row
    extents: F32,
    band: Band,
) -> None:
    """Find which target rows each source row touches."""
    height, spans = displacement.shape[0], extents.shape[1] - 1
    for i in band_range(height, band):
        line, row = np.ascontiguousarray(displacement[i]).reshape(-1), np.float32(i)
        low, high = np.float32(np.inf), np.float32(-np.inf)
        for span in range(spans):
            moves = line[2 * span * REACH_SPAN : min(2 * (span + 1) * REACH_SPAN, line.size)]
            # Two at a time, as each comparison waits for the one before it.
            least, most = np.float32(np.inf), np.float32(-np.inf)
            lesser, greater = least, most
            last = moves.size - 2
            for j in range(0, moves.size, 4):
                y, z = row + moves[j + 1], row + moves[min(j + 2, last) + 1]
                least, lesser = y if y < least else least, z if z < lesser else lesser
                most, greater = y if y > most else most, z if z > greater else greater
            least, most = min(least, lesser), max(most, greater)
            extents[i, span, 0], extents[i, span, 1] = least - PATCH_REACH, most + PATCH_REACH
            low, high = min(low, least), max(high, most)
        extents[i, spans, 0], extents[i, spans, 1] = low - PATCH_REACH, high + PATCH_REACH


# Pixels of acceleration in a key interval that are always applied; half a pixel of way.
FREE_ACCELERATION = np.float32(4)


@ParallelKernel
def quadratic_displacement(
    # before: [H, W, 2] px to the previous and (`after`) next key frame; NaN: constant velocity
    before: F32,
    after: F32,
    # time: t, in steps of the vectors; beyond -1 to 1 motion is extrapolated, up to 2.75 intervals
    time: np.float32,
    out: F32,  # [H, W, 2], written; NaN where both are unknown
    band: Band,
) -> None:
    """Write t (n - p) / 2 + t² (n + p) / 2 for p = `before` and n = `after`.

    Within a key interval, an acceleration n + p of more than twice the way would turn the motion
    round. It counts as a jerk at the key frame, and is reduced by the square of the allowed share.
    """
    size = abs(time)
    inside = size < np.float32(1)
    # How far a parabola is beside constant velocity, as a share of the acceleration.
    offset = np.float32(0.5) * (size * size - size)
    for i in band_range(after.shape[0], band):
        line, past, future = out[i].reshape(-1), before[i].reshape(-1), after[i].reshape(-1)
        for k in range(0, line.size, 2):
            # Towards the slot's side, and away from it.
            x, y = (future[k], future[k + 1]) if time > 0 else (past[k], past[k + 1])
            u, v = (past[k], past[k + 1]) if time > 0 else (future[k], future[k + 1])
            bend_x, bend_y = x + u, y + v
            allowance = np.float32(2 * math.sqrt(x * x + y * y)) + FREE_ACCELERATION
            bend = np.float32(math.sqrt(bend_x * bend_x + bend_y * bend_y))
            limit = (allowance / bend) ** 2 if inside and bend > allowance else np.float32(1)
            factor = limit * offset
            curved_x, curved_y = size * x + factor * bend_x, size * y + factor * bend_y
            steady_x = -size * u if math.isnan(x) else size * x
            steady_y = -size * v if math.isnan(y) else size * y
            line[k] = steady_x if math.isnan(bend_x) else curved_x
            line[k + 1] = steady_y if math.isnan(bend_y) else curved_y


ROWS_PER_STRIP = 32


@device_function
def _splat_span(
    start: tuple[int, int],  # as `motion`, `size`: see `_write_places`
    motion: Motion,
    depth: F32,  # [N]
    size: tuple[int, int, int],
    buffers: tuple[Landings, I32],  # `landings` of `_write_places`; [2 N + 1]: targets that exist
    field: F32,  # [2 W R], the target rows
    near: F32,  # [W R]
) -> None:
    """Write the patches of a span of a source row where they are nearest."""
    (line, across, down), (landings, order) = motion, buffers
    place, found_x, found_y = landings
    _write_places(start, motion, size, landings)
    count, length = depth.size, np.int64(0)
    for k in range(count):
        order[np.uint64(length)] = k
        length += np.int64(place[k] != NO_TARGET)
        order[np.uint64(length)] = count + k
        length += np.int64(place[count + k] != NO_TARGET)
    for k in range(length):
        target = np.uint64(order[k])
        n = np.uint64(target if target < depth.size else target - np.uint64(depth.size))
        # Strictly nearer wins, so an equal depth keeps the earlier source pixel, whatever the
        # number of threads.
        if place[target] >= 0:
            p = np.uint64(place[target])
            if depth[n] < near[p] or math.isnan(near[p]):
                near[p] = depth[n]
                field[np.uint64(2) * p] = found_x[target]
                field[np.uint64(2) * p + np.uint64(1)] = found_y[target]
        else:
            m = np.int64(n)
            matrix = _jacobian(across, down, m)
            a, b, c, d = matrix
            i, j = np.float32(start[0]), np.float32(start[1] + m)
            x, y = j + line[2 * m], i + line[2 * m + 1]
            first_row, last_row, first_column, last_column = _patch_bounds(x, y, matrix, size)
            for row in range(int(first_row), int(last_row) + 1):
                for column in range(int(first_column), int(last_column) + 1):
                    rx, ry = np.float32(column) - x, np.float32(row) - y
                    u, v, is_hit = _source_in_patch(rx, ry, matrix, a * d - b * c)
                    p = np.uint64((row - size[0]) * size[2] + column)
                    if is_hit and (depth[n] < near[p] or math.isnan(near[p])):
                        near[p] = depth[n]
                        field[np.uint64(2) * p] = j + u - np.float32(column)
                        field[np.uint64(2) * p + np.uint64(1)] = i + v - np.float32(row)


@device_function
def _next_run(extents: F32, first: int, rows: tuple[int, int]) -> tuple[int, int]:
    """Return the next spans that touch the target rows; two equal ones if none do."""
    spans = extents.shape[0] - 1
    begin = first
    while begin < spans and (extents[begin, 1] < rows[0] or extents[begin, 0] > rows[1] - 1):
        begin += 1
    end = begin
    while end < spans and extents[end, 1] >= rows[0] and extents[end, 0] <= rows[1] - 1:
        end += 1
    return begin, end


@device_function
def _write_motion(
    i: int,
    columns: tuple[int, int],  # the first, and the one after the last
    displacement: F32,  # [H, 2 W], x and y in turn
    padded: F32,  # [2 N + 4], written: the displacement, with one pixel more at either end
    across: F32,  # [2 N], written
    down: F32,  # [2 N], written
) -> None:
    """Write the displacement of a span of source row i, and its slopes."""
    height, twice = displacement.shape
    begin, end = 2 * columns[0], 2 * columns[1]
    current = displacement[i, begin:end]
    for k in range(2):
        padded[k] = displacement[i, begin - 2 + k] if begin > 0 else np.float32(np.nan)
        padded[current.size + 2 + k] = (
            displacement[i, end + k] if end < twice else np.float32(np.nan)
        )
    for k in range(current.size):  # as a slice, it took a second more to compile
        padded[k + 2] = current[k]
    _write_slopes(padded[: current.size], current, padded[4 : current.size + 4], across)
    if i > 0 and i + 1 < height:
        _write_slopes(displacement[i - 1, begin:end], current, displacement[i + 1, begin:end], down)
        return
    nowhere = np.full(current.size, np.nan, np.float32)
    above = displacement[i - 1, begin:end] if i > 0 else nowhere
    below = displacement[i + 1, begin:end] if i + 1 < height else nowhere
    _write_slopes(above, current, below, down)


@ParallelKernel
def splat(
    displacement: F32,  # [H, W, 2] px, +x right, +y down, from source to target; NaN where unknown
    depth: F32,  # [H, W], smaller is nearer; +inf for background
    extents: F32,  # [H, S + 1, 2], from `splat_row_extents`
    field: F32,  # [H, W, 2], written: from a target pixel to its source; NaN where nothing lands
    near: F32,  # [H, W], written: depth of what landed; NaN where nothing did
    band: Band,
) -> None:
    """Splat displacements forward with a depth test."""
    # Each strip of target rows visits, in order, the source rows that can reach it. So the result
    # does not depend on the number of threads.
    height, width, _ = displacement.shape
    moves = np.ascontiguousarray(displacement).reshape(height, 2 * width)
    padded = np.empty(2 * width + 4, np.float32)
    across, down = np.empty(2 * width, np.float32), np.empty(2 * width, np.float32)
    place, order = np.empty(2 * width, np.int32), np.empty(2 * width + 1, np.int32)
    found_x, found_y = np.empty(2 * width, np.float32), np.empty(2 * width, np.float32)
    for strip in band_range((height + ROWS_PER_STRIP - 1) // ROWS_PER_STRIP, band):
        top = strip * ROWS_PER_STRIP
        rows = top, min(top + ROWS_PER_STRIP, height)
        places, depths = field[top : rows[1]].reshape(-1), near[top : rows[1]].reshape(-1)
        for k in range(places.size):
            places[k] = np.float32(np.nan)
        for k in range(depths.size):
            depths[k] = np.float32(np.nan)
        for i in range(height):
            if extents[i, -1, 1] < rows[0] or extents[i, -1, 0] > rows[1] - 1:
                continue
            begin, end = _next_run(extents[i], 0, rows)
            while begin < end:
                first, last = begin * REACH_SPAN, min(end * REACH_SPAN, width)
                count = last - first
                slopes = across[: 2 * count], down[: 2 * count]
                _write_motion(i, (first, last), moves, padded, *slopes)
                motion = (padded[2 : 2 * count + 2], *slopes)
                landings = place[: 2 * count], found_x[: 2 * count], found_y[: 2 * count]
                size, buffers = (rows[0], rows[1], width), (landings, order)
                _splat_span((i, first), motion, depth[i, first:last], size, buffers, places, depths)
                begin, end = _next_run(extents[i], end, rows)
