"""Forward splatting of displacements into a backward motion field, with a depth test.

Nearly all patches lie on the centres of one or two target pixels, or none. For these everything but
the depth test is worked out in loops without branches, which take several pixels at once; patches
on more centres are gone through one by one.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import inlined, parallel, part
from exwarp_cli.kernels._row_bands import Share, turns
from exwarp_cli.kernels.patches import (
    NOTHING,
    Landings,
    Matrix,
    Motion,
    box,
    jacobian,
    source_in_patch,
    write_places,
    write_slopes,
)
from exwarp_cli.kernels.reach import SPAN

F32 = npt.NDArray[np.float32]
I32 = npt.NDArray[np.int32]

ROWS_PER_BAND = 32


@inlined
def splat_patch(
    at: tuple[int, int],
    move: tuple[np.float32, np.float32],
    matrix: Matrix,
    z: np.float32,
    size: tuple[int, int, int],
    field: F32,
    near: F32,
) -> None:
    """Write one patch where it is nearest; `at` is the source pixel, row and column."""
    i, j = np.float32(at[0]), np.float32(at[1])
    x, y = j + move[0], i + move[1]
    a, b, c, d = matrix
    first_row, last_row, first_column, last_column = box(x, y, matrix, size)
    for row in range(int(first_row), int(last_row) + 1):
        for column in range(int(first_column), int(last_column) + 1):
            rx, ry = np.float32(column) - x, np.float32(row) - y
            u, v, lands = source_in_patch(rx, ry, matrix, a * d - b * c)
            p = np.uint64((row - size[0]) * size[2] + column)
            if lands and (z < near[p] or math.isnan(near[p])):
                near[p] = z
                field[np.uint64(2) * p] = j + u - np.float32(column)
                field[np.uint64(2) * p + np.uint64(1)] = i + v - np.float32(row)


@part
def list_landings(place: I32, turns: I32) -> int:
    """List which places there are, pixel by pixel, and return how many.

    `place` is from :func:`~exwarp_cli.kernels.patches.write_places`, `turns` int32 [2 N + 1],
    written. A branch for each of the places took longer than the rest.
    """
    count, listed = place.size // 2, np.int64(0)
    for n in range(count):
        turns[np.uint64(listed)] = n
        listed += np.int64(place[n] != NOTHING)
        turns[np.uint64(listed)] = count + n
        listed += np.int64(place[count + n] != NOTHING)
    return int(listed)


@part
def splat_span(
    start: tuple[int, int],
    motion: Motion,
    depth: F32,
    size: tuple[int, int, int],
    buffers: tuple[Landings, I32],
    field: F32,
    near: F32,
) -> None:
    """Write the patches of a span of a source row where they are nearest.

    Parameters
    ----------
    start, motion, size
        As in :func:`~exwarp_cli.kernels.patches.write_places`.
    depth
        float32 [N].
    buffers
        `landings` of :func:`~exwarp_cli.kernels.patches.write_places`, `turns` of
        :func:`list_landings`.
    field, near
        float32 [2 W R] and [W R]: the target rows.
    """
    (line, across, down), (landings, turns) = motion, buffers
    place, found_x, found_y = landings
    write_places(start, motion, size, landings)
    for k in range(list_landings(place, turns)):
        turn = np.uint64(turns[k])
        n = np.uint64(turn if turn < depth.size else turn - np.uint64(depth.size))
        # Strictly nearer wins, so an equal depth keeps the earlier source pixel, whatever the
        # number of threads.
        if place[turn] >= 0:
            p = np.uint64(place[turn])
            if depth[n] < near[p] or math.isnan(near[p]):
                near[p] = depth[n]
                field[np.uint64(2) * p] = found_x[turn]
                field[np.uint64(2) * p + np.uint64(1)] = found_y[turn]
        else:
            m = np.int64(n)
            at, move = (start[0], start[1] + m), (line[2 * m], line[2 * m + 1])
            splat_patch(at, move, jacobian(across, down, m), depth[n], size, field, near)


@part
def next_run(reach: F32, first: int, rows: tuple[int, int]) -> tuple[int, int]:
    """Return the next spans, from `first` on, that touch the target rows; two equal ones if none.

    `reach` is float32 [S + 1, 2], that of a source row from `row_reach`.
    """
    spans = reach.shape[0] - 1
    begin = first
    while begin < spans and (reach[begin, 1] < rows[0] or reach[begin, 0] > rows[1] - 1):
        begin += 1
    end = begin
    while end < spans and reach[end, 1] >= rows[0] and reach[end, 0] <= rows[1] - 1:
        end += 1
    return begin, end


@part
def write_motion(
    i: int, columns: tuple[int, int], displacement: F32, padded: F32, across: F32, down: F32
) -> None:
    """Write the displacement of a span of source row i, and its slopes.

    Parameters
    ----------
    columns
        The first and the one after the last.
    displacement
        float32 [H, 2 W], x and y by turns.
    padded
        float32 [2 N + 4], written: the displacement, with that of a pixel more at either end.
    across, down
        float32 [2 N], written.
    """
    height, twice = displacement.shape
    begin, end = 2 * columns[0], 2 * columns[1]
    here = displacement[i, begin:end]
    for k in range(2):
        padded[k] = displacement[i, begin - 2 + k] if begin > 0 else np.float32(np.nan)
        padded[here.size + 2 + k] = displacement[i, end + k] if end < twice else np.float32(np.nan)
    for k in range(here.size):  # as a slice, it took a second more to compile
        padded[k + 2] = here[k]
    write_slopes(padded[: here.size], here, padded[4 : here.size + 4], across)
    if i > 0 and i + 1 < height:
        write_slopes(displacement[i - 1, begin:end], here, displacement[i + 1, begin:end], down)
        return
    nowhere = np.full(here.size, np.nan, np.float32)
    above = displacement[i - 1, begin:end] if i > 0 else nowhere
    below = displacement[i + 1, begin:end] if i + 1 < height else nowhere
    write_slopes(above, here, below, down)


@part
def splat_band(
    displacement: F32, depth: F32, reach: F32, rows: tuple[int, int], field: F32, near: F32
) -> None:
    """Splat all source rows into the target rows [rows[0], rows[1]).

    `displacement` is float32 [H, 2 W], `field` float32 [2 W R] and `near` [W R].
    """
    height, width = depth.shape
    padded = np.empty(2 * width + 4, np.float32)
    across, down = np.empty(2 * width, np.float32), np.empty(2 * width, np.float32)
    place, turns = np.empty(2 * width, np.int32), np.empty(2 * width + 1, np.int32)
    found_x, found_y = np.empty(2 * width, np.float32), np.empty(2 * width, np.float32)
    size = (rows[0], rows[1], width)
    for i in range(height):
        if reach[i, -1, 1] < rows[0] or reach[i, -1, 0] > rows[1] - 1:
            continue
        begin, end = next_run(reach[i], 0, rows)
        while begin < end:
            first, last = begin * SPAN, min(end * SPAN, width)
            count = last - first
            slopes = across[: 2 * count], down[: 2 * count]
            write_motion(i, (first, last), displacement, padded, *slopes)
            motion = (padded[2 : 2 * count + 2], *slopes)
            landings = place[: 2 * count], found_x[: 2 * count], found_y[: 2 * count]
            buffers = landings, turns
            splat_span((i, first), motion, depth[i, first:last], size, buffers, field, near)
            begin, end = next_run(reach[i], end, rows)


@parallel
def splat(displacement: F32, depth: F32, reach: F32, field: F32, near: F32, share: Share) -> None:
    """Splat displacements forward with a depth test.

    Parameters
    ----------
    displacement
        float32 [H, W, 2], pixels, +x right, +y down, from a source pixel to the target; NaN where
        unknown.
    depth
        float32 [H, W], smaller is nearer; +inf for background, which everything hides.
    reach
        float32 [H, S + 1, 2], from :func:`~exwarp_cli.kernels.reach.row_reach`.
    field
        float32 [H, W, 2], written: from a target pixel to its source; NaN where nothing lands.
    near
        float32 [H, W], written: depth of what landed; NaN where nothing did.

    Notes
    -----
    Target rows are dealt out in bands and each band visits the source rows that can reach it, in
    order; so the result is that of one thread, bit for bit.
    """
    height, width, _ = displacement.shape
    moves = np.ascontiguousarray(displacement).reshape(height, 2 * width)
    for band in turns((height + ROWS_PER_BAND - 1) // ROWS_PER_BAND, share):
        begin = band * ROWS_PER_BAND
        end = min(begin + ROWS_PER_BAND, height)
        places, depths = field[begin:end].reshape(-1), near[begin:end].reshape(-1)
        for k in range(places.size):
            places[k] = np.float32(np.nan)
        for k in range(depths.size):
            depths[k] = np.float32(np.nan)
        splat_band(moves, depth, reach, (begin, end), places, depths)
