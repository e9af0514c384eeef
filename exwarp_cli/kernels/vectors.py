"""Reading motion vectors out of raw channels."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import parallel, part
from exwarp_cli.kernels._row_bands import Share, turns

F32 = npt.NDArray[np.float32]


@part
def scale_neighbours(raw: F32, scales: tuple[np.float32, np.float32], out: F32) -> None:
    """Do as `scale_some` by a channel and the next of four, from the first of them on.

    Channels whose place the compiler knows: half of the time.
    """
    for n in range(out.size // 2):
        x, y = raw[4 * n] * scales[0], raw[4 * n + 1] * scales[1]
        known = abs(x + y) < np.float32(np.inf)
        out[2 * n] = x if known else np.float32(np.nan)
        out[2 * n + 1] = y if known else np.float32(np.nan)


@part
def scale_some(
    raw: F32, channels: tuple[int, int], scales: tuple[np.float32, np.float32], out: F32
) -> None:
    """Write two channels times their scales, all of the vectors given."""
    if raw.shape[1] == 4 and channels[1] == channels[0] + 1:
        scale_neighbours(raw.reshape(-1)[channels[0] :], scales, out.reshape(-1))
        return
    for n in range(out.shape[0]):
        x, y = raw[n, channels[0]] * scales[0], raw[n, channels[1]] * scales[1]
        known = math.isfinite(x + y)
        out[n, 0] = x if known else np.float32(np.nan)
        out[n, 1] = y if known else np.float32(np.nan)


@parallel
def scale_vectors(
    raw: F32,
    channels: tuple[int, int],
    scales: tuple[np.float32, np.float32],
    out: F32,
    share: Share,
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
    mine = turns(out.shape[0], share)
    scale_some(raw[mine.start : mine.stop], channels, scales, out[mine.start : mine.stop])
