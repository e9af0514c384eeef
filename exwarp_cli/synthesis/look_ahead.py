"""Softsplat: the key frames on both sides of a slot, moved to it and mixed.

Niklaus and Liu, "Softmax Splatting for Video Frame Interpolation", CVPR 2020, with the renderer's
motion in place of estimated flow; light that moves against the surfaces follows a residual flow.
In the method `lookahead` a network weighs both sides, pixel by pixel.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.network_api import LookAheadNetwork
from exwarp_cli.runtime.frame_pool import pool
from exwarp_cli.synthesis.candidates import Candidates, Weights
from exwarp_cli.synthesis.coverage import Coverage
from exwarp_cli.synthesis.geometry import SlotField
from exwarp_cli.synthesis.residual import agreement, along, disagreement, flow_of
from exwarp_cli.synthesis.risk import Evidence, Tiles, evidence_of_sides
from exwarp_cli.synthesis.warp import Mover, Warped, blend_by_depth, mix_by_depth


class LookAhead:
    """Makes the colour of a slot from the key frames on both sides: its beauty, then its layers.

    Parameters
    ----------
    back, forward
        Motion fields from the slot to the key frames before and after it.
    time
        Of the slot in the key interval, 0 < time < 1.
    linear
        As for `Mover`.
    coverage
        Of the pixels beside edges; None where each has the surface of its centre.
    network
        That weighs what both sides show; None for the weights of softmax splatting.
    tiles
        For which `evidence` is kept; None for none.
    """

    def __init__(
        self,
        back: SlotField,
        forward: SlotField,
        time: float,
        linear: bool = False,
        coverage: Coverage | None = None,
        network: LookAheadNetwork | None = None,
        tiles: Tiles | None = None,
    ) -> None:
        self._sides = Mover(back, linear), Mover(forward, linear)
        self._time = time
        self._linear = linear
        self._coverage = coverage
        self._network = network
        self._weights: Weights = []
        self._shifted: tuple[Mover, Mover] | None = None
        self._weight = np.zeros((0, 0), np.float32)
        self._tiles = tiles
        self.evidence: Evidence | None = None
        """What was seen of the beauty's tiles while it was made."""

    @property
    def weighs(self) -> bool:
        """Whether a network weighs what both sides show."""
        return self._network is not None

    @property
    def has_beauty(self) -> bool:
        """Whether the beauty was made, so that layers may follow."""
        return self._shifted is not None

    def make(self, before: Float32, after: Float32) -> Float32:
        """Make a layer of the slot; the first is the beauty, which tells how light moves.

        Parameters
        ----------
        before, after
            float32 [H, W, C], scene-linear, of the key frames.

        Returns
        -------
        float32 [H, W, C]
            Scene-linear.
        """
        codes = self._sides[0].codes(before), self._sides[1].codes(after)
        plain = self._sides[0].warp(codes[0]), self._sides[1].warp(codes[1])
        leads = self._shifted is None
        if self._shifted is None:
            apart = disagreement(*plain)
            self._shifted = self._follow_light(plain, apart)
            shifted = _moved(self._shifted, codes, plain)
            self._weight = agreement(apart, *shifted)
            self._look_at(plain, shifted)
        else:
            shifted = _moved(self._shifted, codes, plain)
        candidates = (*plain, *shifted)
        if self._network is not None:  # blending writes over the first of each pair
            plain, shifted = (_with_own_pixels(plain), _with_own_pixels(shifted))
        out = blend_by_depth(*plain, self._time)
        if self._coverage is not None:
            self._coverage.cover(codes, out)
        del codes
        moving, _, _ = mix_by_depth(*shifted, self._time)  # no weight where neither side sees
        moving -= out
        moving *= self._weight[..., None]
        out += moving
        del moving
        if self._network is not None:
            layer = Candidates(out, candidates, self._weight, self._time, self._linear)
            if leads:
                out, self._weights = layer.weigh(self._network, keep=self._linear)
            else:
                out = layer.mix(self._weights)
        return self._sides[0].light(out)

    def _look_at(self, plain: tuple[Warped, Warped], shifted: tuple[Warped, Warped]) -> None:
        """Keep what is seen of both sides, before they are mixed."""
        if self._tiles is not None:
            field = self._sides[0].source.field
            self.evidence = evidence_of_sides(
                self._tiles, plain, shifted, self._weight, field, self._linear
            )

    def _follow_light(self, plain: tuple[Warped, Warped], apart: Float32) -> tuple[Mover, Mover]:
        """Move each side its share of the way, so that both meet at the slot's time."""
        flow = flow_of(*plain, self._linear)
        time = np.float32(self._time)
        before, after = (side.source for side in self._sides)
        return (
            Mover(along(plain[0], before, -time * flow, apart), self._linear),
            Mover(along(plain[1], after, (np.float32(1) - time) * flow, apart), self._linear),
        )


def _with_own_pixels(pair: tuple[Warped, Warped]) -> tuple[Warped, Warped]:
    """Return two sides, of which the pixels of the first may be changed."""
    return replace(pair[0], pixels=pool.copy(pair[0].pixels)), pair[1]


def _moved(
    movers: tuple[Mover, Mover], codes: tuple[Float32, Float32], plain: tuple[Warped, Warped]
) -> tuple[Warped, Warped]:
    """Warp both key frames along the flow; outlines are those of the surfaces."""
    first, second = (mover.warp(each) for mover, each in zip(movers, codes, strict=True))
    return replace(first, fringe=plain[0].fringe), replace(second, fringe=plain[1].fringe)
