"""Least and greatest of the values that a buffer shows, by bands of rows and channel."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import parallel, part
from exwarp_cli.kernels._row_bands import Share, turns

F32 = npt.NDArray[np.float32]
B8 = npt.NDArray[np.bool_]

ROWS_PER_BAND = 32
"""Rows whose ends, and whose histogram, are found together; also the grain of the parallel loop."""


@part
def finite_ends(values: F32, shown: B8) -> tuple[np.float32, np.float32]:
    """Return the least and greatest finite value that counts of rows [R, W]."""
    least, most = np.float32(np.inf), np.float32(-np.inf)
    for i in range(shown.shape[0]):
        for j in range(shown.shape[1]):
            value = values[i, j]
            if shown[i, j] and abs(value) < np.float32(np.inf):
                least, most = min(least, value), max(most, value)
    return least, most


@parallel
def extents(values: F32, shown: B8, out: F32, share: Share) -> None:
    """Write the least and greatest value of each band of rows and channel.

    Parameters
    ----------
    values
        float32 [H, W, C].
    shown
        bool [H, W]: pixels that count.
    out
        float32 [ceil(H / ROWS_PER_BAND), C, 2], written: least and greatest of the finite values
        that count; +inf and -inf where there are none.
    """
    for band in turns(out.shape[0], share):
        rows = slice(band * ROWS_PER_BAND, (band + 1) * ROWS_PER_BAND)
        for c in range(values.shape[2]):
            out[band, c, 0], out[band, c, 1] = finite_ends(values[rows, :, c], shown[rows])
