"""Features of the tiles of a slot, by which a policy chooses what makes each of them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.tiles import TILE_FEATURES
from exwarp_cli.synthesis.interval import Interval

F64 = npt.NDArray[np.float64]


def tile_features(interval: Interval, slot: int) -> F64:
    """Return what is known of a slot's tiles before any of them is made.

    Parameters
    ----------
    interval
        With motion. Its next key frame is not looked at.
    slot
        1 or more.

    Returns
    -------
    float64 [rows, columns, 6]
        In the order of `TILE_FEATURES`; the key residuals are 0 after the first key frame of a
        shot. Earth mover's distances of the tiles' normals and positions, as the paper has them of
        frames, were tried as well: at a quarter of the area the choice was no better for them, and
        they took 20 ms a tile.
    """
    tiles, back, time = interval.tiles, interval.back(slot), interval.time(slot)
    # Of points that nothing tells of there is no variance either.
    field = np.nan_to_num(tiles.sample(back.field)).astype(np.float64) / time
    marks = [tiles.sample(mask).astype(np.float64) for mask in (back.hole, back.ghosts)]
    moments = [field[..., axis] ** power for power in (1, 2) for axis in (0, 1)]
    holes, outlines, x, y, xx, yy = tiles.means([*marks, *moments])
    variances = (np.maximum(square - mean**2, 0) for square, mean in ((xx, x), (yy, y)))
    residual = interval.residual
    none = np.zeros_like(holes)
    of_keys = (none, none) if residual is None else (residual.light, residual.motion)
    found = np.stack([holes, outlines, *variances, *of_keys], axis=-1)
    assert found.shape[-1] == len(TILE_FEATURES)
    return found
