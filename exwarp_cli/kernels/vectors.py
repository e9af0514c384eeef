"""Reading motion vectors out of raw channels."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels.jit import serial

F32 = npt.NDArray[np.float32]


@serial
def scale_vectors(
    raw: F32, channels: tuple[int, int], scales: tuple[np.float32, np.float32], out: F32
) -> None:
    """Write two channels times their scales.

    Parameters
    ----------
    raw
        float32 [N, C].
    channels, scales
        Of x and y.
    out
        float32 [N, 2], written; NaN where one of both is not finite, or their sum.
    """
    for n in range(out.shape[0]):
        x, y = raw[n, channels[0]] * scales[0], raw[n, channels[1]] * scales[1]
        known = math.isfinite(x + y)
        out[n, 0] = x if known else np.float32(np.nan)
        out[n, 1] = y if known else np.float32(np.nan)
