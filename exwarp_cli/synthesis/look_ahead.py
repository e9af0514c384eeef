"""Softsplat: the key frames on both sides of a slot, moved to it and mixed.

Niklaus and Liu, "Softmax Splatting for Video Frame Interpolation", CVPR 2020, with the renderer's
motion in place of estimated flow; light that moves against the surfaces follows a residual flow.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from exwarp_cli.domain.frame import Float32
from exwarp_cli.synthesis.geometry import SlotField
from exwarp_cli.synthesis.residual import Residual, agreement, along, flow_of
from exwarp_cli.synthesis.warp import Warped, as_light, as_shown, blend_by_depth, warp


@dataclass(frozen=True)
class LookAhead:
    """How the key frames on both sides make the colour of a slot, of all layers alike.

    Attributes
    ----------
    back, forward
        Motion fields from the slot to the key frames before and after it.
    time
        Of the slot in the key interval, 0 < time < 1.
    residual
        How light moves against the surfaces; None before it is searched.
    """

    back: SlotField
    forward: SlotField
    time: float
    residual: Residual | None = None

    def beauty(self, before: Float32, after: Float32) -> tuple[Float32, LookAhead]:
        """Make the slot's beauty, and find out how light moves.

        Parameters
        ----------
        before, after
            float32 [H, W, C], scene-linear: the beauty of the key frames.

        Returns
        -------
        float32 [H, W, C]
            Scene-linear.
        LookAhead
            With the residual motion, for `layer`.
        """
        codes = as_shown(before), as_shown(after)
        plain = self._warped(codes)
        flow = flow_of(*plain)
        shifted = self._shifted(codes, plain, flow)
        residual = Residual(flow, agreement(plain, shifted))
        return self._mixed(plain, shifted, residual), replace(self, residual=residual)

    def layer(self, before: Float32, after: Float32) -> Float32:
        """Make a layer of the slot that goes with its beauty, float32 [H, W, C], scene-linear."""
        assert self.residual is not None
        codes = as_shown(before), as_shown(after)
        plain = self._warped(codes)
        shifted = self._shifted(codes, plain, self.residual.flow)
        return self._mixed(plain, shifted, self.residual)

    def _warped(self, codes: tuple[Float32, Float32]) -> tuple[Warped, Warped]:
        return warp(codes[0], self.back), warp(codes[1], self.forward)

    def _shifted(
        self, codes: tuple[Float32, Float32], plain: tuple[Warped, Warped], flow: Float32
    ) -> tuple[Warped, Warped]:
        """Move each side its share of the way, so that both meet at the slot's time."""
        time = np.float32(self.time)
        return (
            along(codes[0], self.back, plain[0], -time * flow),
            along(codes[1], self.forward, plain[1], (np.float32(1) - time) * flow),
        )

    def _mixed(
        self, plain: tuple[Warped, Warped], shifted: tuple[Warped, Warped], residual: Residual
    ) -> Float32:
        out = blend_by_depth(*plain, self.time)
        moving = blend_by_depth(*shifted, self.time)
        moving -= out
        moving *= residual.weight[..., None]
        out += moving
        return as_light(out)
