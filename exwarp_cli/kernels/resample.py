"""Lanczos-3 resampling along motion fields, and the sRGB curve that it works in.

Duchon, "Lanczos Filtering in One and Two Dimensions", J. Appl. Meteorology 18, 1979. Results are
clamped to the pixels around, so that edges do not overshoot. The curve is that of IEC 61966-2-1,
odd below 0 and continued above 1.
"""

from __future__ import annotations

import math

import numpy as np

from exwarp_cli.kernels._compile import ParallelKernel, inline
from exwarp_cli.kernels._row_bands import Band, band_range
from exwarp_cli.kernels.array_types import B8, F32
from exwarp_cli.kernels.gather import sample_pixel

U64 = np.uint64

RADIUS = 3
TAPS = 2 * RADIUS

RGBA = 4  # channels of a frame with alpha, which is the last

PHASES = 1024  # steps of a pixel that have weights; places are rounded to the nearest one


def lanczos_weights() -> F32:
    """Return the weights of Lanczos-3 for each phase, float32 [PHASES + 1, TAPS]; rows sum to 1.

    Tap RADIUS - 1 is the pixel at or before the place.
    """
    offset = np.arange(1 - RADIUS, RADIUS + 1)[None] - np.arange(PHASES + 1)[:, None] / PHASES
    weights = np.sinc(offset) * np.sinc(offset / RADIUS)
    weights /= weights.sum(axis=1, keepdims=True)
    weights[[0, -1]] = 0
    weights[0, RADIUS - 1] = weights[-1, RADIUS] = 1
    return weights.astype(np.float32)


@inline
def _sum_taps(
    pixels: F32,  # [H W C]
    start: int,  # index of the channel's first tap
    steps: tuple[int, int],  # from a row to the next, and from a pixel to the next
    corner: int,  # the tap that is the upper left of the 3x3, counted along a row of TAPS
    weights: tuple[F32, F32],  # [TAPS] across and down
) -> tuple[np.float32, np.float32, np.float32]:
    """Return a channel's weighted sum of TAPS x TAPS pixels, and the range of the 3x3."""
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


Taps = tuple[F32, int, int, int, tuple[F32, F32]]


@inline
def _find_taps(
    pixels: F32,  # [H W C]
    shape: tuple[int, int, int],
    x: np.float32,
    y: np.float32,
    table: F32,
    patch: F32,  # [TAPS TAPS C], written where taps lie outside, which get the edge's colour
) -> Taps:
    """Return what `_sum_taps` needs of a place: pixels, step of a row, start, corner, weights."""
    height, width, channels = shape
    left, top = math.floor(x), math.floor(y)
    across = table[round((x - np.float32(left)) * np.float32(PHASES))]
    down = table[round((y - np.float32(top)) * np.float32(PHASES))]
    row, column = math.floor(y + 0.5) - top, math.floor(x + 0.5) - left
    corner = (row + RADIUS - 2) * TAPS + column + RADIUS - 2
    left, top = left - RADIUS + 1, top - RADIUS + 1
    if left >= 0 and top >= 0 and left + TAPS <= width and top + TAPS <= height:
        first = (top * width + left) * channels
        return pixels, width * channels, first, corner, (across, down)
    for p in range(TAPS):
        i = min(max(top + p, 0), height - 1)
        for q in range(TAPS):
            j = min(max(left + q, 0), width - 1)
            for c in range(channels):
                patch[(p * TAPS + q) * channels + c] = pixels[(i * width + j) * channels + c]
    return patch, TAPS * channels, 0, corner, (across, down)


@ParallelKernel
def resample_alike(
    image: F32,  # scene-linear; other arrays as for `resample`
    field: F32,
    table: F32,
    limit: F32,  # [h, w], 0 bilinear to 1 Lanczos-3: written if `leads`, else read
    leads: bool,  # True for the beauty, whose channels stay within the 3x3 pixels; False for layers
    out: F32,
    hole: B8,
    band: Band,
) -> None:
    """Sample like `resample`, but linearly, so that layers still sum to the beauty."""
    channels = image.shape[2]
    pixels = np.ascontiguousarray(image).reshape(-1)
    patch, sharp = np.empty(TAPS * TAPS * channels, np.float32), np.empty(channels, np.float32)
    for i in band_range(out.shape[0], band):
        line, target = np.ascontiguousarray(field[i]).reshape(-1), out[i].reshape(-1)
        for j in range(out.shape[1]):
            x = np.float32(j) + line[U64(2 * j)]
            y = np.float32(i) + line[U64(2 * j + 1)]
            hole[i, j] = not sample_pixel(pixels, image.shape, x, y, target, channels * j)
            if hole[i, j]:
                if leads:
                    limit[i, j] = 0
                continue
            smooth = target[channels * j : channels * (j + 1)]
            taps, pitch, first, corner, weights = _find_taps(
                pixels, image.shape, x, y, table, patch
            )
            steps, check = (pitch, channels), np.float32(0)
            within = np.float32(1)  # the part of the way to `sharp` that stays in bounds
            for c in range(channels):
                value, low, high = _sum_taps(taps, first + c, steps, corner, weights)
                sharp[c] = value
                check += value * np.float32(0)  # NaN from infinity and NaN on
                bound = min(max(value, low), high)
                if bound != value:
                    share = (bound - smooth[c]) / (value - smooth[c])
                    within = min(within, max(share, np.float32(0)))
            within = within if check == 0 else np.float32(0)
            if leads:
                clear = channels == RGBA and (
                    smooth[RGBA - 1] + within * (sharp[RGBA - 1] - smooth[RGBA - 1]) <= 0
                )
                limit[i, j] = np.float32(0) if clear else within
            if limit[i, j] > 0 and check == 0:
                for c in range(channels):
                    smooth[c] += limit[i, j] * (sharp[c] - smooth[c])


@ParallelKernel
def resample(
    image: F32,  # [H, W, C], fewer than 2^31 values; best display-encoded
    field: F32,  # [h, w, 2] px, +x right, +y down, from `out` to the source; NaN without one
    table: F32,  # from `lanczos_weights`
    out: F32,  # [h, w, C], written; 0 without a source, the edge's colour outside the image
    hole: B8,  # [h, w], written: no source, one outside the pixel areas, or a non-finite sample
    band: Band,
) -> None:
    """Sample `image` at x + field(x) by Lanczos-3, and mark what cannot be sampled.

    Values stay within the range of the 3x3 pixels about the nearest to the source. Where not all
    taps are finite, the sample is bilinear.
    """
    height, width, channels = image.shape
    pixels = np.ascontiguousarray(image).reshape(-1)
    patch = np.empty(TAPS * TAPS * channels, np.float32)
    for i in band_range(out.shape[0], band):
        line, target = np.ascontiguousarray(field[i]).reshape(-1), out[i].reshape(-1)
        row_hole = hole[i]
        for j in range(out.shape[1]):
            x = np.float32(j) + line[U64(2 * j)]
            y = np.float32(i) + line[U64(2 * j + 1)]
            place = channels * j
            near = x >= -0.5 and y >= -0.5 and x <= width - 0.5 and y <= height - 0.5
            if near:
                taps, pitch, first, corner, weights = _find_taps(
                    pixels, image.shape, x, y, table, patch
                )
                check = np.float32(0)
                steps = (pitch, channels)
                for c in range(channels):
                    value, low, high = _sum_taps(taps, first + c, steps, corner, weights)
                    check += value * np.float32(0)  # NaN from infinity and NaN on
                    target[place + c] = min(max(value, low), high)
                # Colour must not be where the bound has made alpha 0.
                clear = channels == RGBA and target[place + RGBA - 1] <= 0
                if check == 0 and not clear:
                    row_hole[j] = False
                    continue
            row_hole[j] = not sample_pixel(pixels, image.shape, x, y, target, place)


COLOUR_CHANNELS = 3  # channels with a curve


@ParallelKernel
def encode_srgb(pixels: F32, out: F32, band: Band) -> None:
    """Write the sRGB codes of scene-linear pixels [H, W, C]; alpha is copied."""
    for i in band_range(pixels.shape[0], band):
        line, codes = pixels[i], out[i]
        for j in range(line.shape[0]):
            for c in range(line.shape[1]):
                value = line[j, c]
                if c < COLOUR_CHANNELS:
                    size = abs(value)
                    curved = np.float32(1.055) * size ** np.float32(1 / 2.4) - np.float32(0.055)
                    code = np.float32(12.92) * size if size <= np.float32(0.0031308) else curved
                    value = -code if value < 0 else code
                codes[j, c] = value


@ParallelKernel
def decode_srgb(codes: F32, out: F32, band: Band) -> None:
    """Invert `encode_srgb`; `out` may be `codes`."""
    for i in band_range(codes.shape[0], band):
        line, pixels = codes[i], out[i]
        for j in range(line.shape[0]):
            for c in range(line.shape[1]):
                value = line[j, c]
                if c < COLOUR_CHANNELS:
                    size = abs(value)
                    curved = ((size + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
                    linear = size / np.float32(12.92) if size <= np.float32(0.04045) else curved
                    value = -linear if value < 0 else linear
                pixels[j, c] = value
