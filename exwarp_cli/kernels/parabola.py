"""Displacements at any time from those to both neighbouring key frames."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import parallel, part
from exwarp_cli.kernels._row_bands import Share, turns
from exwarp_cli.kernels.reach import write_reach

F32 = npt.NDArray[np.float32]


SLACK = np.float32(4)
"""Pixels of acceleration in a key interval that are always taken over; half a pixel of way."""


@part
def write_parabola(before: F32, after: F32, time: np.float32, out: F32) -> None:
    """Write displacements [N] of a row, pairs of x and y; see `parabola`."""
    size = abs(time)
    inside = size < np.float32(1)
    # How far a parabola is beside constant velocity, as a share of the acceleration.
    beside = np.float32(0.5) * (size * size - size)
    for k in range(0, out.size, 2):
        # Towards the slot's side, and away from it.
        x, y = (after[k], after[k + 1]) if time > 0 else (before[k], before[k + 1])
        u, v = (before[k], before[k + 1]) if time > 0 else (after[k], after[k + 1])
        bend_x, bend_y = x + u, y + v
        room = np.float32(2 * math.sqrt(x * x + y * y)) + SLACK
        bend = np.float32(math.sqrt(bend_x * bend_x + bend_y * bend_y))
        limit = (room / bend) ** 2 if inside and bend > room else np.float32(1)
        share = limit * beside
        curved_x, curved_y = size * x + share * bend_x, size * y + share * bend_y
        steady_x = -size * u if math.isnan(x) else size * x
        steady_y = -size * v if math.isnan(y) else size * y
        out[k] = steady_x if math.isnan(bend_x) else curved_x
        out[k + 1] = steady_y if math.isnan(bend_y) else curved_y


@parallel
def parabola(before: F32, after: F32, time: np.float32, out: F32, reach: F32, share: Share) -> None:
    """Write t (n - p) / 2 + t² (n + p) / 2 for p = `before` and n = `after`.

    Within a key interval, an acceleration n + p of more than twice the way in it would turn the
    motion round. It is then taken for a jerk at the key frame, and counts by the square of what is
    right of it. A camera that is thrown round at a key frame had bent the interval before by 7 px.

    Parameters
    ----------
    before, after
        float32 [H, W, 2], pixels, displacement to the previous and to the next key frame; NaN
        where unknown: then t n or -t p alone, constant velocity.
    time
        t, in steps of the vectors, either sign. Between -1 and 1 points are led between places that
        are known; beyond, what an older frame showed is predicted (up to 2.75 key intervals), and
        half the sum of both vectors counts t² times.
    out
        float32 [H, W, 2], written; NaN where both are unknown.
    reach
        Written as by :func:`~exwarp_cli.kernels.reach.row_reach`, row by row, which finds each
        in the processor's cache; [0, 0, 2] where it is not needed.
    """
    for i in turns(after.shape[0], share):
        line = out[i].reshape(-1)
        write_parabola(before[i].reshape(-1), after[i].reshape(-1), time, line)
        if reach.shape[0] > 0:
            write_reach(i, line, reach[i])
