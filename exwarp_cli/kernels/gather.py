"""Backward sampling of an image along a motion field.

A row is worked off in passes: places and weights in a loop without branches, then the mixing of all
pixels whether they have a source or not, then the few that lie at the border or nowhere, again.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.compiled.shares import WHOLE, Share, turns
from exwarp_cli.kernels.jit import inlined, parallel, part, serial
from exwarp_cli.kernels.lanes import LANES, mix_four

F32 = npt.NDArray[np.float32]
I32 = npt.NDArray[np.int32]
B8 = npt.NDArray[np.bool_]
U64 = np.uint64
Places = tuple[I32, I32, I32]

RGB, RGBA = 3, 4

FURTHEST = np.float32(1e7)
"""Pixels from the frame's corner beyond which nothing is sampled."""


@part
def clamp(value: int, low: int, high: int) -> int:
    """Return the value, or the nearer bound."""
    return min(max(value, low), high)


@inlined
def mix(
    pixels: F32,
    at: tuple[U64, U64, U64],
    fx: np.float32,
    fy: np.float32,
    channels: int,
    out: F32,
    place: int,
) -> bool:
    """Mix four neighbours bilinearly and return whether all values are finite.

    Parameters
    ----------
    pixels
        float32 [H W C].
    at
        Where in `pixels` the upper left neighbour begins, and how far the others are right of it
        and below. Unsigned indices need no test for counting from the end.
    fx, fy
        Weights of the right and the lower neighbours.
    channels
        C.
    out
        float32 [w C], written from `place` on.
    """
    first, right, below = at
    check = np.float32(0)
    for c in range(channels):
        p = first + np.uint64(c)
        upper = pixels[p] * (np.float32(1) - fx) + pixels[p + right] * fx
        lower = pixels[p + below] * (np.float32(1) - fx) + pixels[p + below + right] * fx
        value = upper * (np.float32(1) - fy) + lower * fy
        check += value * np.float32(0)  # NaN from infinity and NaN on
        out[np.uint64(place) + np.uint64(c)] = value
    return bool(check == 0)


@part
def write_places(
    i: int, line: F32, shape: tuple[int, int, int], places: Places, fx: F32, fy: F32, inside: B8
) -> None:
    """Write where the pixels of a row come from, for those with four neighbours in the image.

    Parameters
    ----------
    i
        The row.
    line
        float32 [2 w], x and y by turns: the motion field.
    shape
        H, W, C of the image.
    places
        int32 [w] each, written: `at` of :func:`mix`; any, but inside the image, for other pixels.
    fx, fy
        float32 [w], written: the weights of :func:`mix`.
    inside
        bool [w], written: 0 <= x < W - 1 and 0 <= y < H - 1.
    """
    first, right, below = places
    width, channels = np.int32(shape[1]), np.int32(shape[2])
    end_x, end_y = np.float32(shape[1] - 1), np.float32(shape[0] - 1)
    for j in range(inside.size):
        x, y = np.float32(j) + line[2 * j], np.float32(i) + line[2 * j + 1]
        lies = (x >= 0) & (y >= 0) & (x < end_x) & (y < end_y)
        x, y = x if lies else np.float32(0), y if lies else np.float32(0)
        left, top = np.int32(x), np.int32(y)  # rounds down
        fx[j], fy[j] = x - np.float32(left), y - np.float32(top)
        first[j] = (top * width + left) * channels
        # A sample of weight 0 must not spread its NaN: whole-pixel motion copies exactly.
        right[j] = np.int32(0) if fx[j] == 0 else channels
        below[j] = np.int32(0) if fy[j] == 0 else width * channels
        inside[j] = lies


@part
def mix_row(
    pixels: F32, channels: int, places: Places, fx: F32, fy: F32, out: F32, finite: B8
) -> None:
    """Mix the pixels of a row.

    Parameters
    ----------
    pixels, channels
        As in :func:`mix`.
    places, fx, fy
        From :func:`write_places`.
    out
        float32 [w C], written.
    finite
        bool [w], written: whether all values of a pixel are.
    """
    first, right, below = places
    count = finite.size
    safe = pixels.size - LANES
    if channels == RGBA:
        for j in range(count):
            at = U64(first[j]), U64(right[j]), U64(below[j])
            finite[j] = mix_four(pixels, at, fx[j], fy[j], out, U64(4 * j)) == 15
    elif channels == RGB:
        # The fourth value is the next pixel's first, which is written after it.
        for j in range(count - 1):
            at = U64(first[j]), U64(right[j]), U64(below[j])
            if first[j] + right[j] + below[j] <= safe:
                finite[j] = (mix_four(pixels, at, fx[j], fy[j], out, U64(3 * j)) & 7) == 7
            else:
                finite[j] = mix(pixels, at, fx[j], fy[j], 3, out, 3 * j)
        j = count - 1
        at = U64(first[j]), U64(right[j]), U64(below[j])
        finite[j] = mix(pixels, at, fx[j], fy[j], 3, out, 3 * j)
    else:
        for j in range(count):
            at = U64(first[j]), U64(right[j]), U64(below[j])
            finite[j] = mix(pixels, at, fx[j], fy[j], channels, out, channels * j)


@part
def sample_border(
    pixels: F32, shape: tuple[int, int, int], x: np.float32, y: np.float32, out: F32, place: int
) -> bool:
    """Sample where neighbours may lie outside, which have the edge's colour; as :func:`mix`."""
    height, width, channels = shape
    left, top = math.floor(x), math.floor(y)
    fx, fy = x - np.float32(left), y - np.float32(top)
    x0, x1 = clamp(left, 0, width - 1), clamp(left + 1, 0, width - 1)
    y0, y1 = clamp(top, 0, height - 1), clamp(top + 1, 0, height - 1)
    x1 = x0 if fx == 0 else x1
    y1 = y0 if fy == 0 else y1
    at = (
        U64((y0 * width + x0) * channels),
        U64((x1 - x0) * channels),
        U64((y1 - y0) * width * channels),
    )
    return bool(mix(pixels, at, fx, fy, channels, out, place))


@part
def settle_rest(
    i: int,
    line: F32,
    pixels: F32,
    shape: tuple[int, int, int],
    inside: B8,
    finite: B8,
    out: F32,
    hole: B8,
) -> None:
    """Mark the holes of a row, and write anew what is a hole or lies at the border.

    Parameters as in :func:`write_places` and :func:`mix_row`; `hole` is bool [w], written.
    """
    height, width, channels = shape
    for j in range(hole.size):
        hole[j] = not (inside[j] & finite[j])
    rest, count = np.empty(hole.size + 1, np.int32), np.int64(0)
    for j in range(hole.size):
        rest[np.uint64(count)] = j
        count += np.int64(hole[j])
    for k in range(count):
        j = int(rest[k])
        shown = False
        if not inside[j]:
            x, y = np.float32(j) + line[2 * j], np.float32(i) + line[2 * j + 1]
            if abs(x) < FURTHEST and abs(y) < FURTHEST:
                shown = sample_border(pixels, shape, x, y, out, j * channels)
                within = x >= -0.5 and y >= -0.5 and x <= width - 0.5 and y <= height - 0.5
                hole[j] = not (shown and within)
        if not shown:
            for c in range(channels):
                out[j * channels + c] = np.float32(0.0)


@part
def gather_row(
    i: int, line: F32, pixels: F32, shape: tuple[int, int, int], out: F32, hole: B8
) -> None:
    """Sample row i; `line` is float32 [2 w], `pixels` [H W C] and `out` [w C]."""
    count = hole.size
    first, right, below = (
        np.empty(count, np.int32),
        np.empty(count, np.int32),
        np.empty(count, np.int32),
    )
    fx, fy = np.empty(count, np.float32), np.empty(count, np.float32)
    inside, finite = np.empty(count, np.bool_), np.empty(count, np.bool_)
    places = (first, right, below)
    write_places(i, line, shape, places, fx, fy, inside)
    mix_row(pixels, shape[2], places, fx, fy, out, finite)
    settle_rest(i, line, pixels, shape, inside, finite, out, hole)


def gather_bilinear_text(image: F32, field: F32, out: F32, hole: B8, share: Share = WHOLE) -> None:
    """Sample `image` bilinearly at x + field(x) and mark what cannot be sampled.

    Parameters
    ----------
    image
        float32 [H, W, C], of less than 2^31 values.
    field
        float32 [h, w, 2], pixels, +x right, +y down, from a pixel of `out` to its source; NaN where
        there is none.
    out
        float32 [h, w, C], written; 0 where there is no source, the edge's colour where the source
        lies outside the image.
    hole
        bool [h, w], written: no source, a source outside the image's pixel areas, or a non-finite
        value among the samples.
    share
        Which turns are taken: those of :func:`~exwarp_cli.compiled.shares.turns`.
    """
    pixels = np.ascontiguousarray(image).reshape(-1)
    for i in turns(out.shape[0], share):
        line, target = np.ascontiguousarray(field[i]).reshape(-1), out[i].reshape(-1)
        gather_row(i, line, pixels, image.shape, target, hole[i])


gather_bilinear = parallel(gather_bilinear_text)
gather_bilinear_serial = serial(gather_bilinear_text)
