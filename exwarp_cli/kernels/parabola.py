"""Displacements at any time from those to both neighbouring key frames."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import parallel, part
from exwarp_cli.kernels._row_bands import Share, turns
from exwarp_cli.kernels.reach import write_reach

F32 = npt.NDArray[np.float32]


@part
def write_parabola(before: F32, after: F32, time: np.float32, out: F32) -> None:
    """Write displacements [N] of a row; see `parabola`."""
    half, square = np.float32(0.5) * time, np.float32(0.5) * time * time
    for k in range(out.size):
        p, n = before[k], after[k]
        both = half * (n - p) + square * (n + p)
        alone = -time * p if math.isnan(n) else both
        out[k] = time * n if math.isnan(p) else alone


@parallel
def parabola(before: F32, after: F32, time: np.float32, out: F32, reach: F32, share: Share) -> None:
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
    reach
        Written as by :func:`~exwarp_cli.kernels.reach.row_reach`, row by row, which finds each
        in the processor's cache; [0, 0, 2] where nobody asks.
    """
    for i in turns(after.shape[0], share):
        line = out[i].reshape(-1)
        write_parabola(before[i].reshape(-1), after[i].reshape(-1), time, line)
        if reach.shape[0] > 0:
            write_reach(i, line, reach[i])
