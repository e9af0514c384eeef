"""Backward sampling of an image along a motion field."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import inlined, parallel, part
from exwarp_cli.kernels._row_bands import Share, turns

F32 = npt.NDArray[np.float32]
B8 = npt.NDArray[np.bool_]
U64 = np.uint64

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
def show_border(
    pixels: F32, shape: tuple[int, int, int], x: np.float32, y: np.float32, out: F32, place: int
) -> bool:
    """Sample where neighbours lie outside, and return whether that lies in the pixels' areas."""
    height, width, channels = shape
    shown = sample_border(pixels, shape, x, y, out, place)
    if not shown:
        clear(out, place, channels)
    within = x >= -0.5 and y >= -0.5 and x <= width - 0.5 and y <= height - 0.5
    return shown and bool(within)


@part
def clear(out: F32, place: int, channels: int) -> None:
    """Write 0 to the values of a pixel."""
    for c in range(channels):
        out[U64(place) + U64(c)] = np.float32(0.0)


@inlined
def sample(
    pixels: F32, shape: tuple[int, int, int], x: np.float32, y: np.float32, out: F32, place: int
) -> bool:
    """Write what lies at (x, y), 0 where nothing does, and return whether something finite does."""
    height, width, channels = shape
    if (x >= 0) & (y >= 0) & (x < np.float32(width - 1)) & (y < np.float32(height - 1)):
        left, top = np.int32(x), np.int32(y)  # rounds down
        fx, fy = x - np.float32(left), y - np.float32(top)
        first = U64((top * np.int32(width) + left) * np.int32(channels))
        # A sample of weight 0 must not spread its NaN: whole-pixel motion copies exactly.
        at = first, U64(0 if fx == 0 else channels), U64(0 if fy == 0 else width * channels)
        if mix(pixels, at, fx, fy, channels, out, place):
            return True
    elif abs(x) < FURTHEST and abs(y) < FURTHEST:
        return bool(show_border(pixels, shape, x, y, out, place))
    clear(out, place, channels)
    return False


@parallel
def gather_bilinear(image: F32, field: F32, out: F32, hole: B8, share: Share) -> None:
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
    """
    pixels, channels = np.ascontiguousarray(image).reshape(-1), image.shape[2]
    for i in turns(out.shape[0], share):
        line, target = np.ascontiguousarray(field[i]).reshape(-1), out[i].reshape(-1)
        unseen = hole[i]
        for j in range(out.shape[1]):
            # Unsigned indices need no test for counting from the end.
            x = np.float32(j) + line[U64(2 * j)]
            y = np.float32(i) + line[U64(2 * j + 1)]
            unseen[U64(j)] = not sample(pixels, image.shape, x, y, target, channels * j)
