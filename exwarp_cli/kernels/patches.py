"""Patches of surface: where the pixels of a frame come to lie in another.

Every source pixel is a small patch of surface. Its displacement's gradient says how the patch is
stretched and turned, so the target pixels that it covers, and where in the source each of them
comes from, are exact to first order: no cracks where the image grows, no rounding to whole pixels.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import inlined, part

F32 = npt.NDArray[np.float32]
I32 = npt.NDArray[np.int32]
Matrix = tuple[np.float32, np.float32, np.float32, np.float32]
Motion = tuple[F32, F32, F32]
Landings = tuple[I32, F32, F32]

SAME_SURFACE = np.float32(0.5)
"""Largest change of displacement between neighbours of one surface, pixels per pixel."""

OVERLAP = np.float32(0.54)
"""Half the side of a patch: a little over 0.5, so that neighbours leave no gaps."""

LEAST_AREA = np.float32(0.05)
"""Area of a pixel's patch, square pixels, up to which it is turned over or edge-on."""

FARTHEST = np.float32(2)
"""More than a patch reaches: OVERLAP times its stretch, at most 1 + 2 * SAME_SURFACE, pixels."""

NOTHING = np.int32(-1)
MANY = np.int32(-2)
"""Instead of the place where a patch lands: on no pixel's centre, on more than two."""


@part
def write_slopes(before: F32, here: F32, after: F32, out: F32) -> None:
    """Write the change of displacement per pixel, from neighbours of the same surface.

    All float32 [2 W], x and y by turns. 0 where there are none: NaN neighbours count as another
    surface, and so does what lies outside the frame.
    """
    for k in range(out.size):
        left, right = here[k] - before[k], after[k] - here[k]
        left_same = abs(left) < SAME_SURFACE
        right_same = abs(right) < SAME_SURFACE
        one = left if left_same else (right if right_same else np.float32(0))
        out[k] = np.float32(0.5) * (left + right) if left_same & right_same else one


@part
def jacobian(across: F32, down: F32, j: int) -> Matrix:
    """Return the Jacobian of x -> x + d(x) at a column, row by row, from the slopes of d."""
    a, b = np.float32(1) + across[2 * j], down[2 * j]
    c, d = across[2 * j + 1], np.float32(1) + down[2 * j + 1]
    return a, b, c, d


@inlined
def box(
    x: np.float32,
    y: np.float32,
    matrix: Matrix,
    size: tuple[int, int, int],
) -> Matrix:
    """Return first and last row, first and last column of what may lie on a patch around (x, y).

    `size` are the first target row, the one after the last, and the frame's width; the last comes
    before the first where the patch lies outside.
    """
    a, b, c, d = matrix
    reach_x = OVERLAP * (abs(a) + abs(b))
    reach_y = OVERLAP * (abs(c) + abs(d))
    first_row = np.ceil(max(y - reach_y, np.float32(size[0])))
    last_row = np.floor(min(y + reach_y, np.float32(size[1] - 1)))
    first_column = np.ceil(max(x - reach_x, np.float32(0)))
    last_column = np.floor(min(x + reach_x, np.float32(size[2] - 1)))
    return first_row, last_row, first_column, last_column


@inlined
def source_in_patch(
    rx: np.float32, ry: np.float32, matrix: Matrix, determinant: np.float32
) -> tuple[np.float32, np.float32, bool]:
    """Return where in its source pixel a target pixel lies, x and y, and whether on the patch.

    `rx`, `ry` is the way to it from the patch's centre.
    """
    a, b, c, d = matrix
    u = (d * rx - b * ry) / determinant
    v = (a * ry - c * rx) / determinant
    return u, v, bool((abs(u) <= OVERLAP) & (abs(v) <= OVERLAP))


@part
def write_places(
    start: tuple[int, int], motion: Motion, size: tuple[int, int, int], landings: Landings
) -> None:
    """Write where the patches of a span of a source row land.

    Parameters
    ----------
    start
        Row and column of the first source pixel.
    motion
        Displacement and its slopes along x and y, float32 [2 N] each, x and y by turns.
    size
        As in :func:`box`.
    landings
        Written, for up to two target pixels of each source pixel: `place` int32 [2 N], all the
        first ones before the second ones, counted from the first of the first target row, or
        NOTHING, or MANY as the first; `found_x` and `found_y` float32 [2 N], the way from there to
        the source.
    """
    (line, across, down), (place, found_x, found_y) = motion, landings
    count = line.size // 2
    top, bottom, right = np.float32(size[0]), np.float32(size[1] - 1), np.float32(size[2] - 1)
    i, first_row, width = np.float32(start[0]), np.int32(size[0]), np.int32(size[2])
    zero, one = np.float32(0), np.float32(1)
    for n in range(count):
        j = np.float32(start[1] + n)
        matrix = jacobian(across, down, n)
        a, b, c, d = matrix
        x, y = j + line[2 * n], i + line[2 * n + 1]
        determinant = a * d - b * c
        # A patch reaches less than 2 pixels. What lies farther off, infinite or NaN, must not come
        # to the conversion to integers.
        shows = determinant > LEAST_AREA
        shows &= (y > top - FARTHEST) & (y < bottom + FARTHEST)
        shows &= (x > -FARTHEST) & (x < right + FARTHEST)
        row, last_row, column, last_column = box(x, y, matrix, size)
        shows &= (row <= last_row) & (column <= last_column)
        more_x, more_y = last_column - column, last_row - row
        many = shows & (more_x + more_y > one)
        u, v, lands = source_in_patch(column - x, row - y, matrix, determinant)
        index = np.int32(row if shows else top) - first_row
        index = index * width + np.int32(column if shows else zero)
        place[n] = MANY if many else (index if shows & lands else NOTHING)
        found_x[n], found_y[n] = j + u - column, i + v - row
        column += one if more_x > zero else zero
        row += one if more_y > zero else zero
        u, v, lands = source_in_patch(column - x, row - y, matrix, determinant)
        twice = shows & (more_x + more_y == one) & lands
        place[count + n] = index + (np.int32(1) if more_x > zero else width) if twice else NOTHING
        found_x[count + n], found_y[count + n] = j + u - column, i + v - row
