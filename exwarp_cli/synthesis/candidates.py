"""What a look-ahead network sees of a slot, and what is made of its weights."""

from __future__ import annotations

import numpy as np

from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.network_api import (
    LOOKAHEAD_INTERFACE,
    LookAheadNetwork,
    NetworkPictures,
    Tile,
)
from exwarp_cli.kernels import blend
from exwarp_cli.runtime.frame_pool import pool
from exwarp_cli.synthesis.warp import Warped, as_shown

NEAREST, FURTHEST = np.float32(1e-2), np.float32(1e4)
"""Depths, scene units: nearer and farther ones are given to the network as these."""

Weights = list[tuple[Tile, np.ndarray]]
"""Of each tile of a slot, float16 [5, h, w]."""


class Candidates:
    """The candidate colours of each pixel of a slot, of one layer; inputs of the network.

    Parameters
    ----------
    mixed
        float32 [H, W, C]: what `softsplat` makes.
    sides
        The key frames before and after, moved by surfaces, then by light, too. Their pixels are
        changed: what a side does not show has the colour of `mixed`.
    agreement
        float32 [H, W], from `residual.agreement`.
    time
        Of the slot in its key interval.
    linear
        Whether colour is scene-linear, and not as shown.
    """

    def __init__(
        self,
        mixed: Float32,
        sides: tuple[Warped, Warped, Warped, Warped],
        agreement: Float32,
        time: float,
        linear: bool,
    ) -> None:
        self.time = time
        self._mixed, self._sides, self._agreement, self._linear = mixed, sides, agreement, linear
        for side in sides:
            np.copyto(side.pixels, mixed, where=side.hole[..., None])

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        height, width, _ = self._mixed.shape
        return height, width

    def part(self, rows: slice, columns: slice, room: Float32 | None = None) -> NetworkPictures:
        """Return the network's inputs of some rows and columns; see `LOOKS_AHEAD`."""
        height, width = self.shape
        size = min(rows.stop, height) - rows.start, min(columns.stop, width) - columns.start
        planes = room
        if planes is None or planes.shape[1:] != size:
            planes = np.empty((LOOKAHEAD_INTERFACE.channels, *size), np.float32)
        pictures, first = {}, 0
        for name, count in LOOKAHEAD_INTERFACE.inputs.items():
            pictures[name] = planes[first : first + count]
            first += count
        for i, picture in enumerate((self._mixed, *(side.pixels for side in self._sides))):
            colour = np.ascontiguousarray(picture[rows, columns, :3])
            shown = as_shown(colour) if self._linear else colour
            pictures["colour"][3 * i : 3 * i + 3] = shown.transpose(2, 0, 1)
        before, after = self._sides[:2]
        masks = (*(side.hole for side in self._sides), before.fringe, after.fringe)
        for plane, mask in zip(pictures["masks"], masks, strict=True):
            plane[:] = mask[rows, columns]
        for plane, side in zip(pictures["depth"], (before, after), strict=True):
            depth = side.depth[rows, columns]
            known = np.where(np.isnan(depth), FURTHEST, np.clip(depth, NEAREST, FURTHEST))
            np.log2(known, out=plane)
        pictures["agreement"][0] = self._agreement[rows, columns]
        return NetworkPictures(pictures, self.time)

    def weigh(self, network: LookAheadNetwork, keep: bool) -> tuple[Float32, Weights]:
        """Have a network weigh the candidates.

        Parameters
        ----------
        network
            What it cannot see (another size, NaN) it refuses.
        keep
            Whether the weights are wanted, for further layers: 10 bytes a pixel.

        Returns
        -------
        float32 [H, W, C]
            The slot's colour, coded as the candidates are.
        Weights
            Empty if they are not kept.
        """
        out: Float32 = pool.empty(self._mixed.shape, np.float32)
        kept: Weights = []
        for tile, weights in network.weigh(self):
            # Rounded before they are used, so that the beauty is what its layers add up to.
            rounded = weights.astype(np.float16)
            self._mix(tile, rounded, out)
            if keep:
                kept.append((tile, rounded))
        return out, kept

    def mix(self, weights: Weights) -> Float32:
        """Mix the candidates of another layer by the weights of the beauty."""
        out: Float32 = pool.empty(self._mixed.shape, np.float32)
        for tile, part in weights:
            self._mix(tile, part, out)
        return out

    def _mix(self, tile: Tile, weights: np.ndarray, out: Float32) -> None:
        corner = tile[0].first, tile[1].first
        before, after, lit_before, lit_after = (side.pixels for side in self._sides)
        sides = before, after, lit_before, lit_after
        given = weights.astype(np.float32)
        blend.mix_candidates(self._mixed, sides, given, corner, out)
