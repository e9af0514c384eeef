"""Sampling of an image along a motion field by Lanczos-3, held to the pixels around.

Lanczos: Duchon, "Lanczos Filtering in One and Two Dimensions", J. Appl. Meteorology 18, 1979. The
bound keeps overshoot at edges out, which would be light or darkness that was never rendered.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import inlined, parallel, part
from exwarp_cli.kernels._row_bands import Share, turns
from exwarp_cli.kernels.gather import clamp, sample

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
B8 = npt.NDArray[np.bool_]
U64 = np.uint64

RADIUS = 3
TAPS = 2 * RADIUS

RGBA = 4
"""Channels of a frame with alpha, which is the last."""

PHASES = 1024
"""Steps of a pixel that have weights. A place is rounded to the nearest step."""


def lanczos_weights() -> F32:
    """Return the weights of Lanczos-3, as `weights_of` does."""
    return weights_of(lambda x: np.sinc(x) * np.sinc(x / RADIUS))


def weights_of(kernel: Callable[[F64], F64]) -> F32:
    """Return the weights of the taps for each phase, float32 [PHASES + 1, TAPS]; rows sum to 1.

    Tap RADIUS - 1 is the pixel at or before the place. At phases 0 and PHASES one weight is 1.

    Parameters
    ----------
    kernel
        From distances, pixels, to weights, which need not sum to 1; 0 beyond RADIUS.
    """
    offset = np.arange(1 - RADIUS, RADIUS + 1)[None] - np.arange(PHASES + 1)[:, None] / PHASES
    weights = kernel(offset)
    weights /= weights.sum(axis=1, keepdims=True)
    weights[[0, -1]] = 0
    weights[0, RADIUS - 1] = weights[-1, RADIUS] = 1
    return weights.astype(np.float32)


@inlined
def held(value: np.float32, low: np.float32, high: np.float32) -> np.float32:
    """Return a value within bounds."""
    return min(max(value, low), high)


@inlined
def inner_place(first: int, size: int) -> bool:
    """True if all taps from `first` on are inside an axis."""
    return (first >= 0) & (first + TAPS <= size)


@inlined
def sum_taps(
    pixels: F32, start: int, steps: tuple[int, int], corner: int, weights: tuple[F32, F32]
) -> tuple[np.float32, np.float32, np.float32]:
    """Return a channel's weighted sum of TAPS x TAPS pixels, and its least and greatest of the 3x3.

    Parameters
    ----------
    pixels
        float32 [H W C].
    start
        Where the channel's first tap is.
    steps
        From a row to the next, and from a pixel to the next.
    corner
        Which of the taps the upper left of the 3x3 is, counted along a row of TAPS.
    weights
        float32 [TAPS] across and down.
    """
    pitch, channels = steps
    across, down = weights
    value = np.float32(0)
    for p in range(TAPS):
        line = np.float32(0)
        for q in range(TAPS):
            line += across[q] * pixels[U64(start + p * pitch + q * channels)]
        value += down[p] * line
    upper = start + corner // TAPS * pitch + corner % TAPS * channels
    low = high = pixels[U64(upper + pitch + channels)]
    for p in range(3):
        for q in range(3):
            near = pixels[U64(upper + p * pitch + q * channels)]
            low, high = min(low, near), max(high, near)
    return value, low, high


@part
def sample_inside(
    pixels: F32, width: int, channels: int, at: tuple[int, int], weights: tuple[F32, F32], out: F32
) -> bool:
    """Write the weighted sum of TAPS x TAPS pixels, held to the 3x3 about the nearest.

    Parameters
    ----------
    pixels
        float32 [H W C].
    width, channels
        W and C.
    at
        Where in `pixels` the first tap is, and which of the taps the upper left of the 3x3 is,
        counted along a row of TAPS.
    weights
        float32 [TAPS] across and down.
    out
        float32 [C], written.

    Returns
    -------
    bool
        True if all taps are finite.
    """
    first, corner = at
    pitch = width * channels
    check = np.float32(0)
    for c in range(channels):
        value, low, high = sum_taps(pixels, first + c, (pitch, channels), corner, weights)
        check += value * np.float32(0)  # NaN from infinity and NaN on
        out[c] = held(value, low, high)
    return bool(check == 0)


@part
def taps_at(
    x: np.float32, y: np.float32, table: F32
) -> tuple[tuple[int, int], int, tuple[F32, F32]]:
    """Return the column and row of the first tap, the corner of the 3x3, and weights, of a place.

    See :func:`sample_inside` for the corner and the weights.
    """
    left, top = math.floor(x), math.floor(y)
    across = table[round((x - np.float32(left)) * np.float32(PHASES))]
    down = table[round((y - np.float32(top)) * np.float32(PHASES))]
    row, column = math.floor(y + 0.5) - top, math.floor(x + 0.5) - left
    corner = (row + RADIUS - 2) * TAPS + column + RADIUS - 2
    return (left - RADIUS + 1, top - RADIUS + 1), corner, (across, down)


@part
def copy_patch(pixels: F32, shape: tuple[int, int, int], at: tuple[int, int], patch: F32) -> None:
    """Copy the taps of a place to float32 [TAPS TAPS C]; those outside have the edge's colour."""
    height, width, channels = shape
    left, top = at
    for p in range(TAPS):
        y = clamp(top + p, 0, height - 1)
        for q in range(TAPS):
            x = clamp(left + q, 0, width - 1)
            for c in range(channels):
                patch[(p * TAPS + q) * channels + c] = pixels[(y * width + x) * channels + c]


@part
def limit_inside(
    pixels: F32,
    width: int,
    channels: int,
    at: tuple[int, int],
    weights: tuple[F32, F32],
    smooth: F32,
    sharp: F32,
) -> np.float32:
    """Write the unbounded sum of TAPS x TAPS pixels, and return how much of it stays in bounds.

    Parameters
    ----------
    pixels, width, channels, at, weights
        As for :func:`sample_inside`.
    smooth
        float32 [C], the bilinear sample, which is always in bounds.
    sharp
        float32 [C], written.

    Returns
    -------
    float
        The largest part from 0 to 1 of the way from `smooth` to `sharp` on which all channels stay
        within the 3x3 about the nearest pixel; 0 if a tap is not finite.
    """
    first, corner = at
    pitch = width * channels
    check, limit = np.float32(0), np.float32(1)
    for c in range(channels):
        value, low, high = sum_taps(pixels, first + c, (pitch, channels), corner, weights)
        check += value * np.float32(0)
        sharp[c] = value
        bound = held(value, low, high)
        if bound != value:
            part_of = (bound - smooth[c]) / (value - smooth[c])
            limit = min(limit, max(part_of, np.float32(0)))
    return limit if check == 0 else np.float32(0)


@part
def sharpen(smooth: F32, sharp: F32, limit: np.float32) -> None:
    """Move colour [C] some of the way to another, which may be broken in a layer alone."""
    check = np.float32(0)
    for c in range(smooth.size):
        check += sharp[c] * np.float32(0)
    if limit > 0 and check == 0:
        for c in range(smooth.size):
            smooth[c] += limit * (sharp[c] - smooth[c])


@parallel
def resample_alike(
    image: F32, field: F32, table: F32, limit: F32, leads: bool, out: F32, hole: B8, share: Share
) -> None:
    """Sample `image` as `resample` does, but linearly: sums of layers stay sums.

    Parameters
    ----------
    image, field, table, out, hole
        As for :func:`resample`, but scene-linear. Only what leads is held to the 3x3 pixels.
    limit
        float32 [h, w], 0 bilinear to 1 Lanczos-3: written if `leads`, so that no channel leaves the
        3x3 pixels; else read.
    leads
        True for the beauty, False for the layers that follow it.
    """
    height, width, channels = image.shape
    pixels = np.ascontiguousarray(image).reshape(-1)
    patch, sharp = np.empty(TAPS * TAPS * channels, np.float32), np.empty(channels, np.float32)
    for i in turns(out.shape[0], share):
        line, target = np.ascontiguousarray(field[i]).reshape(-1), out[i].reshape(-1)
        for j in range(out.shape[1]):
            x = np.float32(j) + line[U64(2 * j)]
            y = np.float32(i) + line[U64(2 * j + 1)]
            hole[i, j] = not sample(pixels, image.shape, x, y, target, channels * j)
            if hole[i, j]:
                if leads:
                    limit[i, j] = 0
                continue
            first, corner, weights = taps_at(x, y, table)
            smooth = target[channels * j : channels * (j + 1)]
            if inner_place(first[0], width) and inner_place(first[1], height):
                at = (first[1] * width + first[0]) * channels, corner
                within = limit_inside(pixels, width, channels, at, weights, smooth, sharp)
            else:
                copy_patch(pixels, image.shape, first, patch)
                within = limit_inside(patch, TAPS, channels, (0, corner), weights, smooth, sharp)
            if leads:
                clear = channels == RGBA and (
                    smooth[RGBA - 1] + within * (sharp[RGBA - 1] - smooth[RGBA - 1]) <= 0
                )
                limit[i, j] = np.float32(0) if clear else within
            sharpen(smooth, sharp, limit[i, j])


@parallel
def resample(image: F32, field: F32, table: F32, out: F32, hole: B8, share: Share) -> None:
    """Sample `image` at x + field(x) by Lanczos-3 and mark what cannot be sampled.

    Parameters
    ----------
    image
        float32 [H, W, C], of less than 2^31 values. A display's curve suits it best: see
        :func:`exwarp_cli.synthesis.warp.linear_to_srgb`.
    field
        float32 [h, w, 2], pixels, +x right, +y down, from a pixel of `out` to its source; NaN where
        there is none.
    table
        From :func:`lanczos_weights`.
    out
        float32 [h, w, C], written: within the range of the 3x3 pixels about the nearest to the
        source; 0 where there is no source, the edge's colour where it lies outside the image. Where
        not all taps are finite, bilinear.
    hole
        bool [h, w], written: no source, a source outside the image's pixel areas, or a non-finite
        value among the samples.
    """
    height, width, channels = image.shape
    pixels = np.ascontiguousarray(image).reshape(-1)
    patch = np.empty(TAPS * TAPS * channels, np.float32)
    for i in turns(out.shape[0], share):
        line, target = np.ascontiguousarray(field[i]).reshape(-1), out[i].reshape(-1)
        unseen = hole[i]
        for j in range(out.shape[1]):
            x = np.float32(j) + line[U64(2 * j)]
            y = np.float32(i) + line[U64(2 * j + 1)]
            place = channels * j
            near = x >= -0.5 and y >= -0.5 and x <= width - 0.5 and y <= height - 0.5
            if near:
                first, corner, weights = taps_at(x, y, table)
                whole = target[place : place + channels]
                if inner_place(first[0], width) and inner_place(first[1], height):
                    start = (first[1] * width + first[0]) * channels
                    at = start, corner
                    finite = sample_inside(pixels, width, channels, at, weights, whole)
                else:
                    copy_patch(pixels, image.shape, first, patch)
                    finite = sample_inside(patch, TAPS, channels, (0, corner), weights, whole)
                # Colour must not be where the bound has made alpha 0.
                clear = channels == RGBA and whole[RGBA - 1] <= 0
                if finite and not clear:
                    unseen[j] = False
                    continue
            unseen[j] = not sample(pixels, image.shape, x, y, target, place)
