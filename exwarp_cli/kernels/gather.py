"""Backward sampling of images along motion fields and at scattered places."""

from __future__ import annotations

import math

import numpy as np

from exwarp_cli.kernels._compile import ParallelKernel, device_function, inline, kernel
from exwarp_cli.kernels._row_bands import Band, band_range
from exwarp_cli.kernels.array_types import B8, F32, F64

U64 = np.uint64

MAX_DISTANCE = np.float32(1e7)  # Pixels from the frame's corner beyond which nothing is sampled


@inline
def _interpolate_pixel(
    pixels: F32,  # [H W C]
    # at: index of the upper left neighbour, steps to the right and lower ones
    at: tuple[U64, U64, U64],
    fx: np.float32,  # weight of the right neighbours
    fy: np.float32,  # weight of the lower neighbours
    channels: int,
    out: F32,  # [w C], written from `place` on
    place: int,
) -> bool:
    """Interpolate four neighbours bilinearly; return whether all values are finite."""
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


@device_function
def sample_border(
    pixels: F32, shape: tuple[int, int, int], x: np.float32, y: np.float32, out: F32, place: int
) -> bool:
    """Sample where neighbours may lie outside the image; those get the edge's colour.

    Return whether all values are finite. Else, and far from the image, 0 is written.
    """
    height, width, channels = shape
    if abs(x) < MAX_DISTANCE and abs(y) < MAX_DISTANCE:  # no for NaN
        left, top = math.floor(x), math.floor(y)
        fx, fy = x - np.float32(left), y - np.float32(top)
        x0, x1 = min(max(left, 0), width - 1), min(max(left + 1, 0), width - 1)
        y0, y1 = min(max(top, 0), height - 1), min(max(top + 1, 0), height - 1)
        x1 = x0 if fx == 0 else x1
        y1 = y0 if fy == 0 else y1
        first, right = U64((y0 * width + x0) * channels), U64((x1 - x0) * channels)
        at = first, right, U64((y1 - y0) * width * channels)
        if _interpolate_pixel(pixels, at, fx, fy, channels, out, place):
            return True
    for c in range(channels):
        out[U64(place) + U64(c)] = np.float32(0)
    return False


@inline
def sample_pixel(
    pixels: F32, shape: tuple[int, int, int], x: np.float32, y: np.float32, out: F32, place: int
) -> bool:
    """Write the pixel at (x, y), or 0; return whether it is finite, and within a pixel's area."""
    height, width, channels = shape
    if (x >= 0) & (y >= 0) & (x < np.float32(width - 1)) & (y < np.float32(height - 1)):
        left, top = np.int32(x), np.int32(y)  # rounds down
        fx, fy = x - np.float32(left), y - np.float32(top)
        first = U64((top * np.int32(width) + left) * np.int32(channels))
        # A sample of weight 0 must not spread its NaN: whole-pixel motion copies exactly.
        at = first, U64(0 if fx == 0 else channels), U64(0 if fy == 0 else width * channels)
        if _interpolate_pixel(pixels, at, fx, fy, channels, out, place):
            return True
    is_finite = sample_border(pixels, shape, x, y, out, place)
    within = x >= -0.5 and y >= -0.5 and x <= width - 0.5 and y <= height - 0.5
    return bool(is_finite and within)


@ParallelKernel
def gather_bilinear(
    image: F32,  # [H, W, C], fewer than 2^31 values
    field: F32,  # [h, w, 2] px, +x right, +y down, from `out` to the source; NaN without one
    out: F32,  # [h, w, C], written; 0 without a source, the edge's colour outside the image
    hole: B8,  # [h, w], written: no source, one outside the pixel areas, or a non-finite sample
    band: Band,
) -> None:
    """Sample `image` bilinearly at x + field(x) and mark what cannot be sampled."""
    pixels, channels = np.ascontiguousarray(image).reshape(-1), image.shape[2]
    for i in band_range(out.shape[0], band):
        line, target = np.ascontiguousarray(field[i]).reshape(-1), out[i].reshape(-1)
        row_hole = hole[i]
        for j in range(out.shape[1]):
            # Unsigned indices need no test for counting from the end.
            x = np.float32(j) + line[U64(2 * j)]
            y = np.float32(i) + line[U64(2 * j + 1)]
            row_hole[U64(j)] = not sample_pixel(pixels, image.shape, x, y, target, channels * j)


Area = tuple[int, int, int, int]

BOUNDS_RADIUS = 2  # Pixels on each side of a place that count: a window of 5x5

ALPHA_CHANNEL = 3  # The channel that holds alpha, where there are more than three


@inline
def _raise_pixel(
    pixels: F32,  # [H W C]
    area: Area,  # first pixel, rows, columns, and the frame's width
    channels: int,
    clear: bool,
    sign: np.float32,
    bound: F32,  # [h w C], changed from `at` on
    at: int,
) -> None:
    begin, rows, columns, width = area
    for i in range(rows):
        for j in range(columns):
            first = U64((begin + i * width + j) * channels)
            if clear and pixels[first + U64(ALPHA_CHANNEL)] != 0:
                continue
            for c in range(channels):
                value = np.float32(sign * pixels[first + U64(c)])
                place = U64(at) + U64(c)
                # Without branches, and false for NaN.
                more = (value > bound[place]) & (value < np.float32(np.inf))
                bound[place] = value if more else bound[place]


@ParallelKernel
def raise_bounds(
    pixels: F32,  # [H, W, C]; non-finite values do not count
    field: F32,  # [h, w, 2] px from the slot to the frame; beyond the frame its edge counts
    wanted: B8,  # [h, w]: pixels whose bounds are raised
    clear: bool,  # only pixels with an alpha of 0 count
    sign: np.float32,  # 1 for upper bounds, -1 for lower ones, which are negated
    bound: F32,  # [h, w, C], changed; -inf without a bound so far
    band: Band,
) -> None:
    """Raise bounds to the maximum of `sign` times a frame's values around a motion field's ends."""
    height, width, channels = pixels.shape
    flat, bounds = pixels.reshape(-1), bound.reshape(-1)
    right, bottom = np.float32(pixels.shape[1] - 1), np.float32(pixels.shape[0] - 1)
    for i in band_range(field.shape[0], band):
        for j in range(field.shape[1]):
            x, y = np.float32(j) + field[i, j, 0], np.float32(i) + field[i, j, 1]
            if wanted[i, j] and not math.isnan(x) and not math.isnan(y):
                x = min(max(x, np.float32(0)), right)
                y = min(max(y, np.float32(0)), bottom)
                # Nothing negative is left, so converting rounds down.
                row, column = int(y + np.float32(0.5)), int(x + np.float32(0.5))
                top, left = max(row - BOUNDS_RADIUS, 0), max(column - BOUNDS_RADIUS, 0)
                rows = min(row + BOUNDS_RADIUS + 1, height) - top
                columns = min(column + BOUNDS_RADIUS + 1, width) - left
                area = top * width + left, rows, columns, width
                at = (i * field.shape[1] + j) * channels
                # With a number that the compiler knows, channels take a fraction of the time.
                if channels == 4:
                    _raise_pixel(flat, area, 4, clear, sign, bounds, at)
                elif channels == 3:
                    _raise_pixel(flat, area, 3, False, sign, bounds, at)
                else:
                    _raise_pixel(flat, area, channels, clear, sign, bounds, at)


@ParallelKernel
def clamp_to_bounds(
    bound: F32,  # [H, W, C], `sign` times the bounds; -inf for a bound of 0
    wanted: B8,  # [H, W]: pixels that are clamped; [0, 0] for all
    sign: np.float32,  # 1 for upper bounds, -1 for lower ones
    channels: int,  # number of channels that are clamped
    frame: F32,  # [H, W, C], changed
    band: Band,
) -> None:
    """Clamp a frame to upper bounds, or to lower ones."""
    height, width, _ = frame.shape
    for i in band_range(height, band):
        for j in range(width):
            if wanted.size == 0 or wanted[i, j]:
                for c in range(channels):
                    most = bound[i, j, c] if bound[i, j, c] > -np.inf else np.float32(0)
                    if sign * frame[i, j, c] > most:
                        frame[i, j, c] = sign * most + np.float32(0)  # no negative zero


@kernel
def sample_points(
    image: F32,  # [H, W, C]
    target: F64,  # [N, 2], x and y in pixels
    samples: F64,  # [N, C], written; NaN outside the pixels' centres
) -> None:
    """Sample an image bilinearly at scattered places."""
    height, width, channels = image.shape
    for n in range(target.shape[0]):
        x, y = target[n, 0], target[n, 1]
        if not (x >= 0 and y >= 0 and x <= width - 1 and y <= height - 1):
            for c in range(channels):
                samples[n, c] = np.nan
            continue
        left, top = np.int64(math.floor(x)), np.int64(math.floor(y))
        right, low = min(left + 1, width - 1), min(top + 1, height - 1)
        fx, fy = x - np.float64(left), y - np.float64(top)
        for c in range(channels):
            a, b = np.float64(image[top, left, c]), np.float64(image[top, right, c])
            upper = a * (1 - fx) + b * fx
            a, b = np.float64(image[low, left, c]), np.float64(image[low, right, c])
            lower = a * (1 - fx) + b * fx
            samples[n, c] = upper * (1 - fy) + lower * fy
