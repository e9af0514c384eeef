"""Mixing candidate colours of a slot by their weights."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import parallel
from exwarp_cli.kernels._row_bands import Share, turns

F32 = npt.NDArray[np.float32]
Sides = tuple[F32, F32, F32, F32]


@parallel
def mix_candidates(
    mixed: F32, sides: Sides, weights: F32, corner: tuple[int, int], out: F32, share: Share
) -> None:
    """Write the weighted mean of the candidates of each pixel of a part of a frame.

    Parameters
    ----------
    mixed
        float32 [H, W, C], the first candidate.
    sides
        Four of float32 [H, W, C], the others.
    weights
        float32 [5, h, w], in the order of the candidates; their sum is 1.
    corner
        Row and column of the part's first pixel.
    out
        float32 [H, W, C], written in the part.

    Notes
    -----
    As the first candidate and weighted differences from it, so that equal candidates stay as they
    are, whatever the sum of rounded weights is.
    """
    _, height, width = weights.shape
    channels = mixed.shape[2]
    for i in turns(height, share):
        row = corner[0] + i
        for j in range(width):
            column = corner[1] + j
            for c in range(channels):
                centre = mixed[row, column, c]
                value = centre
                for k, side in enumerate(sides):
                    value += np.float32(weights[1 + k, i, j]) * (side[row, column, c] - centre)
                out[row, column, c] = value
