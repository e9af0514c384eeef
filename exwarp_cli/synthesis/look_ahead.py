"""Softsplat: the key frames on both sides of a slot, moved to it and mixed.

Niklaus and Liu, "Softmax Splatting for Video Frame Interpolation", CVPR 2020, with the renderer's
motion in place of estimated flow; light that moves against the surfaces follows a residual flow.
In the method `lookahead` a network weighs both sides, pixel by pixel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from exwarp_cli.domain import network_api
from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.kernels import blend
from exwarp_cli.runtime.frame_pool import pool
from exwarp_cli.synthesis import warp
from exwarp_cli.synthesis.mosaic import Mosaic, Tiles, lay_tiles
from exwarp_cli.synthesis.predicted_error import TileEvidence, evidence_of_sides
from exwarp_cli.synthesis.residual_flow import add_flow, disagreement, flow_weight, search_flow

# Depths, scene units: nearer and farther ones are given to the network as these.
NEAREST, FURTHEST = np.float32(1e-2), np.float32(1e4)


@dataclass(eq=False)
class LookAhead:
    """Makes the colour of a slot from the key frames on both sides: its beauty, then its layers."""

    # Along the motion fields to the key frames before and after the slot.
    sides: tuple[warp.Mover, warp.Mover]
    time: float  # of the slot in the key interval, 0 < time < 1
    # Of the pixels beside edges; None where each has the surface of its centre.
    coverage: warp.Coverage | None = None
    # That weighs what both sides show; None for the weights of softmax splatting.
    network: network_api.LookAheadNetwork | None = None
    tiles: Tiles | None = None  # for which `evidence` of the beauty is kept; None for none
    # Chooses the tiles, bool [rows, columns], in which the network weighs, by their evidence; None
    # for all.
    choose: Callable[[TileEvidence], Bool] | None = None
    evidence: TileEvidence | None = field(default=None, init=False)
    # Tiles in which the network weighed; None without a choice.
    chosen: Bool | None = field(default=None, init=False)
    # Of the beauty, for further layers: what the network answered, what moves along light as well,
    # and how far that is followed, [H, W].
    _weights: list[tuple[network_api.KeptPart, np.ndarray]] = field(
        default_factory=list, init=False
    )
    _light: tuple[tuple[warp.Mover, warp.Mover], Float32] | None = field(default=None, init=False)

    def make(
        self,
        # [H, W, C], scene-linear: the layer in the key frames, and the beauty, from which light is
        # followed. It is needed where nothing was made before; without, the layer is the beauty.
        before: Float32,
        after: Float32,
        beauty: Sequence[Float32] = (),
    ) -> Float32:
        """Make a layer of the slot, scene-linear float32 [H, W, C]; the first is the beauty."""
        if beauty and self._light is None:
            self.make(beauty[0], beauty[1])
        linear, time = self.sides[0].linear, np.float32(self.time)
        codes = self.sides[0].codes(before), self.sides[1].codes(after)
        plain = self.sides[0].warp(codes[0]), self.sides[1].warp(codes[1])
        if leads := self._light is None:
            apart, flow = disagreement(*plain), search_flow(*plain, linear)
            # Each side is moved its share of the way, so that both meet at the slot's time.
            movers = tuple(
                warp.Mover(add_flow(side, mover.source, share * flow, apart), linear)
                for side, mover, share in zip(
                    plain, self.sides, (-time, np.float32(1) - time), strict=True
                )
            )
        else:
            movers, weight = self._light
        before_light, after_light = (
            replace(mover.warp(each), fringe=side.fringe)  # outlines are those of the surfaces
            for mover, each, side in zip(movers, codes, plain, strict=True)
        )
        shifted = before_light, after_light
        if leads:
            weight = flow_weight(apart, *shifted)
            self._light = (movers[0], movers[1]), weight
            if self.tiles is not None:
                motion = self.sides[0].source.field
                self.evidence = evidence_of_sides(
                    self.tiles, plain, shifted, weight, motion, linear
                )
        sides = (*plain, *shifted)
        if self.network is not None:  # mixing overwrites the pixels of the first of each pair
            plain, shifted = (
                (replace(first, pixels=pool.copy(first.pixels)), second)
                for first, second in (plain, shifted)
            )
        out = warp.fill_holes(*warp.mix_by_depth(*plain, self.time))
        if self.coverage is not None:
            self.coverage.cover(codes, out)
        del codes
        moving, _, _ = warp.mix_by_depth(*shifted, self.time)  # no weight where neither side sees
        moving -= out
        moving *= weight[..., None]
        out += moving
        del moving
        if self.network is not None:
            for side in sides:
                np.copyto(side.pixels, out, where=side.hole[..., None])
            layer = Candidates(out, sides, weight, self.time, linear)
            out = layer.mix(self._weigh(self.network, layer) if leads else self._weights)
        return self.sides[0].light(out)

    def _weigh(
        self, network: network_api.LookAheadNetwork, beauty: Candidates
    ) -> Iterable[tuple[network_api.KeptPart, np.ndarray]]:
        """Have a network weigh the beauty's candidates; return float16 [5, h, w] of each tile."""
        if self.choose is not None and self.evidence is not None:
            self.chosen = self.choose(self.evidence)
        if self.tiles is None or self.chosen is None or self.chosen.all():
            answers = network.weigh(beauty)
        else:
            answers = beauty.weigh_in(network, Mosaic.of(self.tiles), self.chosen)
        # Rounded before they are used, so that the beauty is what its layers add up to.
        weights = ((tile, answer.astype(np.float16)) for tile, answer in answers)
        if not beauty.linear:  # no layers follow; weights take 10 bytes a pixel
            return weights
        self._weights = list(weights)
        return self._weights


@dataclass(frozen=True, eq=False)
class Candidates:
    """The candidate colours of each pixel of a slot, of one layer: inputs of the network."""

    mixed: Float32  # [H, W, C]: what `softsplat` makes
    # The key frames before and after, moved by surfaces, then by light as well. What a side does
    # not show has the colour of `mixed`.
    sides: tuple[warp.Warped, warp.Warped, warp.Warped, warp.Warped]
    agreement: Float32  # [H, W], from `flow_weight`
    time: float  # of the slot in its key interval
    linear: bool  # whether colour is scene-linear, and not as shown

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        height, width, _ = self.mixed.shape
        return height, width

    def part(
        self, rows: slice, columns: slice, room: Float32 | None = None
    ) -> network_api.NetworkPictures:
        """Return the network's inputs of some rows and columns; see `LOOKAHEAD_INTERFACE`."""
        height, width = self.shape
        size = min(rows.stop, height) - rows.start, min(columns.stop, width) - columns.start
        planes = room
        if planes is None or planes.shape[1:] != size:
            planes = np.empty((network_api.LOOKAHEAD_INTERFACE.channels, *size), np.float32)
        pictures = network_api.LOOKAHEAD_INTERFACE.split(planes)
        for i, picture in enumerate((self.mixed, *(side.pixels for side in self.sides))):
            colour = np.ascontiguousarray(picture[rows, columns, :3])
            shown = warp.linear_to_srgb(colour) if self.linear else colour
            pictures["colour"][3 * i : 3 * i + 3] = shown.transpose(2, 0, 1)
        before, after = self.sides[:2]
        masks = (*(side.hole for side in self.sides), before.fringe, after.fringe)
        for plane, mask in zip(pictures["masks"], masks, strict=True):
            plane[:] = mask[rows, columns]
        for plane, side in zip(pictures["depth"], (before, after), strict=True):
            depth = side.depth[rows, columns]
            depth = np.where(np.isnan(depth), FURTHEST, np.clip(depth, NEAREST, FURTHEST))
            np.log2(depth, out=plane)
        pictures["agreement"][0] = self.agreement[rows, columns]
        return network_api.NetworkPictures(pictures, self.time)

    def weigh_in(
        self, network: network_api.LookAheadNetwork, mosaic: Mosaic, chosen: Bool
    ) -> Iterator[tuple[network_api.KeptPart, np.ndarray]]:
        """Yield the weights of each row of tiles; what `softsplat` makes counts beside chosen ones.

        Weights change smoothly there, so that no seam shows in any layer.
        """
        weights = np.zeros((network_api.CANDIDATES, *self.shape), np.float16)

        def weigh(rows: slice, columns: slice) -> Float32:
            region = network_api.InputRegion(self, rows, columns)
            out = np.empty((network_api.CANDIDATES, *region.shape), np.float32)
            for (down, across), planes in network.weigh(region):
                out[:, down, across] = planes
            return out

        answers = ((*part, weigh(part[1], part[2])) for part in mosaic.parts(chosen))
        lay_tiles(mosaic, answers, weights)
        ramp, (_, width) = mosaic.weight(chosen), self.shape
        for top, bottom in mosaic.down:
            part, share = weights[:, top:bottom], ramp[top:bottom]
            part[1:] *= share
            part[0] = 1 - share * (1 - part[0])
            yield (slice(top, bottom), slice(0, width)), part

    def mix(self, weights: Iterable[tuple[network_api.KeptPart, np.ndarray]]) -> Float32:
        """Mix the candidates by weights, float16 [5, h, w] of each tile.

        Returns the slot's colour, float32 [H, W, C], coded as the candidates are.
        """
        out: Float32 = pool.empty(self.mixed.shape, np.float32)
        sides = tuple(side.pixels for side in self.sides)
        for (down, across), part in weights:
            corner = down.start, across.start
            blend.mix_candidates(self.mixed, sides, part.astype(np.float32), corner, out)
        return out
