"""Displacements at any time from those to both neighbouring key frames."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.compiled.shares import WHOLE, Share, turns
from exwarp_cli.kernels.jit import parallel, serial

F32 = npt.NDArray[np.float32]


def parabola_text(
    before: F32, after: F32, time: np.float32, out: F32, share: Share = WHOLE
) -> None:
    """Write t (n - p) / 2 + t² (n + p) / 2 for p = `before` and n = `after`.

    Parameters
    ----------
    before, after
        float32 [H, W, 2], pixels, displacement to the previous and to the next key frame; NaN
        where unknown: then t n or -t p alone, constant velocity.
    time
        t, in steps of the vectors, either sign. Between -1 and 1 points are led between places that
        are known; beyond, what an older frame showed is foretold (up to 2.75 key intervals), and
        half the sum of both vectors counts t² times.
    out
        float32 [H, W, 2], written; NaN where both are unknown.
    share
        Which turns are taken: those of :func:`~exwarp_cli.compiled.shares.turns`.
    """
    height, width, _ = after.shape
    half, square = np.float32(0.5) * time, np.float32(0.5) * time * time
    for i in turns(height, share):
        for j in range(width):
            for c in range(2):
                p, n = before[i, j, c], after[i, j, c]
                if math.isnan(p):
                    out[i, j, c] = time * n
                elif math.isnan(n):
                    out[i, j, c] = -time * p
                else:
                    out[i, j, c] = half * (n - p) + square * (n + p)


parabola = parallel(parabola_text)
parabola_serial = serial(parabola_text)
