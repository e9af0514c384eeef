"""Distances out of a depth channel."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import compiled

F32 = npt.NDArray[np.float32]


@compiled
def known_depths(depth: F32, far: np.float32, out: F32) -> None:
    """Write distances [N] that are above 0 and below `far`, +inf for all others and NaN."""
    infinite = np.float32(np.inf)
    for n in range(out.size):
        value = depth[n]
        out[n] = value if np.float32(0) < value < far else infinite


@compiled
def known_unmarked(depth: F32, normals: F32, far: np.float32, out: F32) -> bool:
    """Do as `known_depths`, and write +inf where the normal is (-1, -1, -1), normals [3 N].

    Returns
    -------
    bool
        Whether all normals are finite, as they are looked at anyway: a pass of its own took as long
        as this.
    """
    infinite, mark = np.float32(np.inf), np.float32(-1)
    finite = True
    for n in range(out.size):
        x, y, z = normals[3 * n], normals[3 * n + 1], normals[3 * n + 2]
        value = depth[n]
        known = (np.float32(0) < value) & (value < far)
        known &= (x != mark) | (y != mark) | (z != mark)
        out[n] = value if known else infinite
        finite &= (abs(x) < infinite) & (abs(y) < infinite) & (abs(z) < infinite)
    return finite
