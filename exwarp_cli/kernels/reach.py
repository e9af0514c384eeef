"""Which target rows the displacements of source rows lead to."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import parallel, part
from exwarp_cli.kernels._row_bands import Share, turns
from exwarp_cli.kernels.patches import FARTHEST

F32 = npt.NDArray[np.float32]

SPAN = 64
"""Pixels of a source row that a band takes or leaves together. With whole rows bands worked off 1.8
times as many pixels as there are, where things move by up to 60 pixels."""


def reach_shape(shape: tuple[int, ...]) -> tuple[int, int, int]:
    """Return the shape of what :func:`row_reach` writes for a frame [H, W]."""
    return shape[0], -(-shape[1] // SPAN) + 1, 2


@part
def span_reach(row: np.float32, line: F32) -> tuple[np.float32, np.float32]:
    """Return the least and the greatest row that the displacements [2 N] of a span lead to.

    By two of them at a time, as each comparison waits for the one before it.
    """
    low, high = np.float32(np.inf), np.float32(-np.inf)
    lower, higher = low, high
    last = line.size - 2
    for j in range(0, line.size, 4):
        y, z = row + line[j + 1], row + line[min(j + 2, last) + 1]
        low, lower = y if y < low else low, z if z < lower else lower
        high, higher = y if y > high else high, z if z > higher else higher
    return min(low, lower), max(high, higher)


@part
def write_reach(i: int, line: F32, reach: F32) -> None:
    """Write the reach [S + 1, 2] of source row i, whose displacements are [2 W]."""
    spans = reach.shape[0] - 1
    low, high = np.float32(np.inf), np.float32(-np.inf)
    for span in range(spans):
        begin, end = 2 * span * SPAN, min(2 * (span + 1) * SPAN, line.size)
        least, most = span_reach(np.float32(i), line[begin:end])
        reach[span, 0], reach[span, 1] = least - FARTHEST, most + FARTHEST
        low, high = min(low, least), max(high, most)
    reach[spans, 0], reach[spans, 1] = low - FARTHEST, high + FARTHEST


@parallel
def row_reach(displacement: F32, reach: F32, share: Share) -> None:
    """Find which target rows each source row touches.

    Parameters
    ----------
    displacement
        As in :func:`exwarp_cli.kernels.splat.splat`.
    reach
        float32 [H, S + 1, 2], written: the least and the greatest row, for each SPAN pixels and for
        the whole row; the greatest is less where nothing is known.
    """
    height, width, _ = displacement.shape
    moves = np.ascontiguousarray(displacement).reshape(height, 2 * width)
    for i in turns(height, share):
        write_reach(i, moves[i], reach[i])
