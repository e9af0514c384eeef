"""Looking scattered points up in an image."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import compiled

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]


@compiled
def look_up(image: F32, target: F64, found: F64) -> None:
    """Sample an image bilinearly at scattered places.

    Parameters
    ----------
    image
        float32 [H, W, C].
    target
        float64 [N, 2]: x and y, pixels.
    found
        float64 [N, C], written: NaN for places outside the pixels' centres.
    """
    height, width, channels = image.shape
    for n in range(target.shape[0]):
        x, y = target[n, 0], target[n, 1]
        if not (x >= 0 and y >= 0 and x <= width - 1 and y <= height - 1):
            for c in range(channels):
                found[n, c] = np.nan
            continue
        left, top = np.int64(math.floor(x)), np.int64(math.floor(y))
        right, low = min(left + 1, width - 1), min(top + 1, height - 1)
        fx, fy = x - np.float64(left), y - np.float64(top)
        for c in range(channels):
            a, b = np.float64(image[top, left, c]), np.float64(image[top, right, c])
            upper = a * (1 - fx) + b * fx
            a, b = np.float64(image[low, left, c]), np.float64(image[low, right, c])
            lower = a * (1 - fx) + b * fx
            found[n, c] = upper * (1 - fy) + lower * fy


@compiled
def count_misses(found: F64, wanted: F64, tolerance: F64, losses: F64) -> None:
    """Write how far values are from those wanted, from 0 to 1.

    Parameters
    ----------
    found, wanted
        float64 [N, C].
    tolerance
        float64 [N]: the distance that counts 1, as do greater ones and those not known.
    losses
        float64 [N], written.
    """
    for n in range(losses.size):
        square = np.float64(0)
        for c in range(found.shape[1]):
            gap = found[n, c] - wanted[n, c]
            square += gap * gap
        distance = math.sqrt(square) / tolerance[n]
        losses[n] = distance if distance < 1 else 1.0
