"""Following many displacements at once, to see how far values are from those wanted."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import compiled

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]


@compiled
def count_misses_of(
    xy: F64, shifts: F32, image: F32, wanted: F64, tolerance: F64, place: int, losses: F64
) -> None:
    """Write how far values found along displacements are from those wanted, from 0 to 1.

    As `lookup.look_up` and `lookup.count_misses`, one after the other for each displacement. Those
    twice as many calls and what lies between them took twice as long.

    Parameters
    ----------
    xy
        float64 [N, 2]: places, pixels.
    shifts
        float32 [K, N, 2]: what is added to each, K times.
    image
        float32 [H, W, C], sampled bilinearly.
    wanted
        float64 [N, C].
    tolerance
        float64 [N]: the distance that counts 1, as do greater ones and those not known, such as
        those outside the pixels' centres.
    place, losses
        float64 [K, P, N], written at [:, place].
    """
    height, width, channels = image.shape
    for k in range(shifts.shape[0]):
        for n in range(xy.shape[0]):
            x, y = xy[n, 0] + np.float64(shifts[k, n, 0]), xy[n, 1] + np.float64(shifts[k, n, 1])
            if not (x >= 0 and y >= 0 and x <= width - 1 and y <= height - 1):
                losses[k, place, n] = 1.0
                continue
            left, top = np.int64(math.floor(x)), np.int64(math.floor(y))
            right, low = min(left + 1, width - 1), min(top + 1, height - 1)
            fx, fy = x - np.float64(left), y - np.float64(top)
            square = np.float64(0)
            for c in range(channels):
                a, b = np.float64(image[top, left, c]), np.float64(image[top, right, c])
                upper = a * (1 - fx) + b * fx
                a, b = np.float64(image[low, left, c]), np.float64(image[low, right, c])
                lower = a * (1 - fx) + b * fx
                gap = upper * (1 - fy) + lower * fy - wanted[n, c]
                square += gap * gap
            distance = math.sqrt(square) / tolerance[n]
            losses[k, place, n] = distance if distance < 1 else 1.0
