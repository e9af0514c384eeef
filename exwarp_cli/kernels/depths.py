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


@serial
def hide_marked(normals: F32, out: F32) -> None:
    """Write +inf to distances, out [N], whose normal is (-1, -1, -1), normals [3 N].

    Comparisons of the whole array took 20 times as long.
    """
    mark = np.float32(-1)
    for n in range(out.size):
        x, y, z = normals[3 * n], normals[3 * n + 1], normals[3 * n + 2]
        out[n] = np.float32(np.inf) if (x == mark) & (y == mark) & (z == mark) else out[n]
