"""The least and greatest values of a frame around the places that a slot's pixels come from."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import inlined, parallel
from exwarp_cli.kernels._row_bands import Share, turns

F32 = npt.NDArray[np.float32]
B8 = npt.NDArray[np.bool_]
U64 = np.uint64

Area = tuple[int, int, int, int]

REACH = 2
"""Pixels on each side of a place that count: a window of 5x5."""

ALPHA = 3
"""The channel that holds alpha, where there are more than three."""


@inlined
def raise_pixel(
    pixels: F32, area: Area, channels: int, clear: bool, sign: np.float32, bound: F32, at: int
) -> None:
    """Raise a pixel's bounds to `sign` times the values in a part of a frame.

    Parameters
    ----------
    pixels
        float32 [H W C].
    area
        Where it begins, in pixels; its rows and columns; and the frame's width.
    channels
        C.
    clear, sign
        As in :func:`raise_bounds`.
    bound
        float32 [h w C], changed from `at` on.
    """
    begin, rows, columns, width = area
    for i in range(rows):
        for j in range(columns):
            first = U64((begin + i * width + j) * channels)
            if clear and pixels[first + U64(ALPHA)] != 0:
                continue
            for c in range(channels):
                value = np.float32(sign * pixels[first + U64(c)])
                place = U64(at) + U64(c)
                # Without branches, and false for NaN.
                more = (value > bound[place]) & (value < np.float32(np.inf))
                bound[place] = value if more else bound[place]


@parallel
def raise_bounds(
    pixels: F32,
    field: F32,
    wanted: B8,
    clear: bool,
    sign: np.float32,
    bound: F32,
    share: Share,
) -> None:
    """Raise bounds to the greatest of `sign` times a frame's values around a motion field's ends.

    Parameters
    ----------
    pixels
        float32 [H, W, C] of the frame. What is not finite does not count.
    field
        float32 [h, w, 2], pixels: from the slot to the frame. Beyond the frame its edge counts.
    wanted
        bool [h, w]: whose bounds are raised.
    clear
        Whether only pixels of the frame with an alpha of 0 count.
    sign
        1 for upper bounds; -1 for lower ones, which are negated.
    bound
        float32 [h, w, C], changed; -inf where there is no bound yet.
    """
    height, width, channels = pixels.shape
    flat, made = pixels.reshape(-1), bound.reshape(-1)
    right, bottom = np.float32(pixels.shape[1] - 1), np.float32(pixels.shape[0] - 1)
    for i in turns(field.shape[0], share):
        for j in range(field.shape[1]):
            x, y = np.float32(j) + field[i, j, 0], np.float32(i) + field[i, j, 1]
            if wanted[i, j] and not math.isnan(x) and not math.isnan(y):
                x = min(max(x, np.float32(0)), right)
                y = min(max(y, np.float32(0)), bottom)
                # Nothing negative is left, so converting rounds down.
                row, column = int(y + np.float32(0.5)), int(x + np.float32(0.5))
                top, left = max(row - REACH, 0), max(column - REACH, 0)
                rows = min(row + REACH + 1, height) - top
                columns = min(column + REACH + 1, width) - left
                area = top * width + left, rows, columns, width
                at = (i * field.shape[1] + j) * channels
                # With a number that the compiler knows, channels take a fraction of the time.
                if channels == 4:
                    raise_pixel(flat, area, 4, clear, sign, made, at)
                elif channels == 3:
                    raise_pixel(flat, area, 3, False, sign, made, at)
                else:
                    raise_pixel(flat, area, channels, clear, sign, made, at)


@parallel
def hold(bound: F32, wanted: B8, sign: np.float32, channels: int, frame: F32, share: Share) -> None:
    """Hold a frame below upper bounds, or above lower ones.

    Parameters
    ----------
    bound
        float32 [H, W, C], `sign` times the bounds; -inf for a bound of 0.
    wanted
        bool [H, W]: the pixels that are held; [0, 0] for all.
    sign
        1 for upper bounds, -1 for lower ones.
    channels
        How many are held.
    frame
        float32 [H, W, C], changed.
    """
    height, width, _ = frame.shape
    for i in turns(height, share):
        for j in range(width):
            if wanted.size == 0 or wanted[i, j]:
                for c in range(channels):
                    most = bound[i, j, c] if bound[i, j, c] > -np.inf else np.float32(0)
                    if sign * frame[i, j, c] > most:
                        frame[i, j, c] = sign * most + np.float32(0)  # no negative zero
