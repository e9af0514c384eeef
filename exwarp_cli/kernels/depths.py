"""Distances out of a depth channel."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels.jit import serial

F32 = npt.NDArray[np.float32]


@serial
def known_depths(depth: F32, far: np.float32, out: F32) -> None:
    """Write distances [N] that are above 0 and below `far`, +inf for all others and NaN."""
    infinite = np.float32(np.inf)
    for n in range(out.size):
        value = depth[n]
        out[n] = value if np.float32(0) < value < far else infinite
