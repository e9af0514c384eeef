"""Object ids out of channels of floats."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import compiled

F32 = npt.NDArray[np.float32]
I32 = npt.NDArray[np.int32]

LEAST, GREATEST = np.float32(-1), np.float32(2**31 - 128)
MIXED = np.float32(0.02)
"""A fraction from which an id is a mixture of two."""


@compiled
def whole_ids(ids: F32, out: I32) -> None:
    """Round ids to whole numbers, within int32; -1 where a fraction or NaN tells of mixed ones.

    `ids` and `out` are [N].
    """
    infinite = np.float32(np.inf)
    for n in range(out.size):
        value = ids[n] if abs(ids[n]) < infinite else LEAST
        whole = min(max(np.rint(value), LEAST), GREATEST)
        out[n] = np.int32(whole) if abs(value - whole) < MIXED else np.int32(-1)
