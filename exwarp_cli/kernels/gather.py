"""Backward sampling of an image along a motion field.

Some pixels of a row are worked off at a time, in passes: places and weights in a loop without
branches, then the mixing of all whether they have a source or not, then the few that lie at the
border or nowhere, again.
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

Work = tuple[I32, F32, B8, B8]
"""Room for SPAN pixels: places and weights, line by line, what lies inside, and what is finite."""

RGB, RGBA = 3, 4

SPAN = 256
"""Pixels of a row that are worked off at a time: what is known of them stays in the cache."""

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
    corner: tuple[int, int],
    line: F32,
    shape: tuple[int, int, int],
    places: I32,
    weights: F32,
    inside: B8,
) -> None:
    """Write where the pixels of a span come from, for those with four neighbours in the image.

    Parameters
    ----------
    corner
        Row and column of the first.
    line
        float32 [2 w], x and y by turns: the motion field.
    shape
        H, W, C of the image.
    places
        int32 [3 SPAN], written: `at` of :func:`mix`; any, but inside the image, for other pixels.
    weights
        float32 [2 SPAN], written: those of :func:`mix`.
    inside
        bool [w], written: 0 <= x < W - 1 and 0 <= y < H - 1.
    """
    width, channels = np.int32(shape[1]), np.int32(shape[2])
    end_x, end_y = np.float32(shape[1] - 1), np.float32(shape[0] - 1)
    for j in range(line.size // 2):
        x = np.float32(corner[1] + j) + line[2 * j]
        y = np.float32(corner[0]) + line[2 * j + 1]
        lies = (x >= 0) & (y >= 0) & (x < end_x) & (y < end_y)
        x, y = x if lies else np.float32(0), y if lies else np.float32(0)
        left, top = np.int32(x), np.int32(y)  # rounds down
        fx, fy = x - np.float32(left), y - np.float32(top)
        weights[j], weights[SPAN + j] = fx, fy
        places[j] = (top * width + left) * channels
        # A sample of weight 0 must not spread its NaN: whole-pixel motion copies exactly.
        places[SPAN + j] = np.int32(0) if fx == 0 else channels
        places[2 * SPAN + j] = np.int32(0) if fy == 0 else width * channels
        inside[j] = lies


@part
def mix_span(pixels: F32, channels: int, places: I32, weights: F32, out: F32, finite: B8) -> None:
    """Mix the pixels of a span.

    Parameters
    ----------
    pixels, channels
        As in :func:`mix`.
    places, weights
        From :func:`write_places`.
    out
        float32 [w C], written.
    finite
        bool [w], written: whether all values of a pixel are.
    """
    count, safe = finite.size, pixels.size - LANES
    for j in range(count if channels == RGBA else 0):
        at = U64(places[j]), U64(places[SPAN + j]), U64(places[2 * SPAN + j])
        finite[j] = mix_four(pixels, at, weights[j], weights[SPAN + j], out, U64(4 * j)) == 15
    # The fourth value of RGB is the next pixel's first, which is written after it.
    last = count - 1 if channels == RGB else 0
    for j in range(0 if channels == RGBA else count):
        first, right, below = places[j], places[SPAN + j], places[2 * SPAN + j]
        at = U64(first), U64(right), U64(below)
        fx, fy = weights[j], weights[SPAN + j]
        if j < last and first + right + below <= safe:
            finite[j] = (mix_four(pixels, at, fx, fy, out, U64(3 * j)) & 7) == 7
        else:
            finite[j] = mix(pixels, at, fx, fy, channels, out, channels * j)


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
    corner: tuple[int, int],
    line: F32,
    pixels: F32,
    shape: tuple[int, int, int],
    work: Work,
    out: F32,
    hole: B8,
) -> None:
    """Mark the holes of a span, and write anew what is a hole or lies at the border.

    Parameters as in :func:`write_places` and :func:`mix_span`; `hole` is bool [w], written.
    """
    rest, _, inside, finite = work  # places are mixed already
    height, width, channels = shape
    for j in range(hole.size):
        hole[j] = not (inside[j] & finite[j])
    count = np.int64(0)
    for j in range(hole.size):
        rest[np.uint64(count)] = j
        count += np.int64(hole[j])
    for k in range(count):
        j = int(rest[k])
        shown = False
        if not inside[j]:
            x = np.float32(corner[1] + j) + line[2 * j]
            y = np.float32(corner[0]) + line[2 * j + 1]
            if abs(x) < FURTHEST and abs(y) < FURTHEST:
                shown = sample_border(pixels, shape, x, y, out, j * channels)
                within = x >= -0.5 and y >= -0.5 and x <= width - 0.5 and y <= height - 0.5
                hole[j] = not (shown and within)
        if not shown:
            for c in range(channels):
                out[j * channels + c] = np.float32(0.0)


@part
def gather_span(
    corner: tuple[int, int],
    line: F32,
    pixels: F32,
    shape: tuple[int, int, int],
    work: Work,
    out: F32,
    hole: B8,
) -> None:
    """Sample some pixels of a row, the first at `corner`, its row and column.

    `line` is float32 [2 w], `pixels` [H W C], `out` [w C]; `work` is room for SPAN pixels.
    """
    places, weights, inside, finite = work
    write_places(corner, line, shape, places, weights, inside)
    mix_span(pixels, shape[2], places, weights, out, finite[: hole.size])
    settle_rest(corner, line, pixels, shape, work, out, hole)


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
    pixels, channels = np.ascontiguousarray(image).reshape(-1), image.shape[2]
    places, weights = np.empty(3 * SPAN, np.int32), np.empty(2 * SPAN, np.float32)
    work = places, weights, np.empty(SPAN, np.bool_), np.empty(SPAN, np.bool_)
    for i in turns(out.shape[0], share):
        line, target = np.ascontiguousarray(field[i]).reshape(-1), out[i].reshape(-1)
        for start in range(0, out.shape[1], SPAN):
            end = min(start + SPAN, out.shape[1])
            some, made = line[2 * start : 2 * end], target[start * channels : end * channels]
            gather_span((i, start), some, pixels, image.shape, work, made, hole[i, start:end])


gather_bilinear = parallel(gather_bilinear_text)
gather_bilinear_serial = serial(gather_bilinear_text)
