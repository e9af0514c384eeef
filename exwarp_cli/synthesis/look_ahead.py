"""Softsplat: the key frames on both sides of a slot, moved to it and mixed.

Niklaus and Liu, "Softmax Splatting for Video Frame Interpolation", CVPR 2020, with the renderer's
motion in place of estimated flow; light that moves against the surfaces follows a residual flow.
In the method `lookahead` a network weighs both sides, pixel by pixel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.domain.network_api import (
    CANDIDATES,
    LOOKAHEAD_INTERFACE,
    InputRegion,
    KeptPart,
    LookAheadNetwork,
    NetworkPictures,
)
from exwarp_cli.kernels import blend
from exwarp_cli.runtime.frame_pool import pool
from exwarp_cli.synthesis.mosaic import Mosaic, Tiles, run_in_tiles
from exwarp_cli.synthesis.motion_fields import SlotField
from exwarp_cli.synthesis.predicted_error import TileEvidence, evidence_of_sides
from exwarp_cli.synthesis.residual_flow import add_flow, disagreement, flow_weight, search_flow
from exwarp_cli.synthesis.warp import (
    Coverage,
    Mover,
    Warped,
    blend_by_depth,
    linear_to_srgb,
    mix_by_depth,
)

# Depths, scene units: nearer and farther ones are given to the network as these.
NEAREST, FURTHEST = np.float32(1e-2), np.float32(1e4)


class LookAhead:
    """Makes the colour of a slot from the key frames on both sides: its beauty, then its layers."""

    def __init__(
        self,
        # Motion fields from the slot to the key frames before and after it.
        back: SlotField,
        forward: SlotField,
        time: float,  # of the slot in the key interval, 0 < time < 1
        linear: bool = False,  # as for `Mover`
        # Of the pixels beside edges; None where each has the surface of its centre.
        coverage: Coverage | None = None,
        # That weighs what both sides show; None for the weights of softmax splatting.
        network: LookAheadNetwork | None = None,
        tiles: Tiles | None = None,  # for which `evidence` of the beauty is kept; None for none
        # Chooses the tiles, bool [rows, columns], in which the network weighs, by their evidence;
        # None for all.
        choose: Callable[[TileEvidence], Bool] | None = None,
    ) -> None:
        self._sides = Mover(back, linear), Mover(forward, linear)
        self._time = time
        self._linear = linear
        self._coverage = coverage
        self.network = network
        self._weights: list[tuple[KeptPart, np.ndarray]] = []  # of the beauty, for further layers
        self._shifted: tuple[Mover, Mover] | None = None
        self._flow_weight = np.zeros((0, 0), np.float32)
        self._tiles, self._choose = tiles, choose
        self.evidence: TileEvidence | None = None
        self.chosen: Bool | None = None  # tiles in which the network weighed; None without a choice

    @property
    def has_beauty(self) -> bool:
        """Whether the beauty was made, so that layers may follow."""
        return self._shifted is not None

    def make(self, before: Float32, after: Float32) -> Float32:
        """Make a layer of the slot; the first is the beauty, by which light is followed.

        Takes the key frames' and returns the slot's scene-linear float32 [H, W, C].
        """
        codes = self._sides[0].codes(before), self._sides[1].codes(after)
        plain = self._sides[0].warp(codes[0]), self._sides[1].warp(codes[1])
        leads = self._shifted is None
        if self._shifted is None:
            apart = disagreement(*plain)
            flow, time = search_flow(*plain, self._linear), np.float32(self._time)
            # Each side is moved its share of the way, so that both meet at the slot's time.
            first, second = (
                Mover(add_flow(side, mover.source, share * flow, apart), self._linear)
                for side, mover, share in zip(
                    plain, self._sides, (-time, np.float32(1) - time), strict=True
                )
            )
            self._shifted = first, second
        before_light, after_light = (
            replace(mover.warp(each), fringe=side.fringe)  # outlines are those of the surfaces
            for mover, each, side in zip(self._shifted, codes, plain, strict=True)
        )
        shifted = before_light, after_light
        if leads:
            self._flow_weight = flow_weight(apart, *shifted)
            if self._tiles is not None:
                field = self._sides[0].source.field
                self.evidence = evidence_of_sides(
                    self._tiles, plain, shifted, self._flow_weight, field, self._linear
                )
        sides = (*plain, *shifted)
        if self.network is not None:  # mixing overwrites the pixels of the first of each pair
            plain, shifted = (
                (replace(first, pixels=pool.copy(first.pixels)), second)
                for first, second in (plain, shifted)
            )
        out = blend_by_depth(*plain, self._time)
        if self._coverage is not None:
            self._coverage.cover(codes, out)
        del codes
        moving, _, _ = mix_by_depth(*shifted, self._time)  # no weight where neither side sees
        moving -= out
        moving *= self._flow_weight[..., None]
        out += moving
        del moving
        if self.network is not None:
            layer = Candidates(out, sides, self._flow_weight, self._time, self._linear)
            out = layer.mix(self._weigh(self.network, layer) if leads else self._weights)
        return self._sides[0].light(out)

    def _weigh(
        self, network: LookAheadNetwork, beauty: Candidates
    ) -> Iterable[tuple[KeptPart, np.ndarray]]:
        """Have a network weigh the beauty's candidates; return float16 [5, h, w] of each tile."""
        if self._choose is not None and self.evidence is not None:
            self.chosen = self._choose(self.evidence)
        if self._tiles is None or self.chosen is None or self.chosen.all():
            answers = network.weigh(beauty)
        else:
            answers = beauty.weigh_in(network, Mosaic.of(self._tiles), self.chosen)
        # Rounded before they are used, so that the beauty is what its layers add up to.
        weights = ((tile, answer.astype(np.float16)) for tile, answer in answers)
        if not self._linear:  # no layers follow; weights take 10 bytes a pixel
            return weights
        self._weights = list(weights)
        return self._weights


class Candidates:
    """The candidate colours of each pixel of a slot, of one layer: inputs of the network."""

    def __init__(
        self,
        mixed: Float32,  # [H, W, C]: what `softsplat` makes
        # The key frames before and after, moved by surfaces, then by light as well. Their pixels
        # are changed: what a side does not show has the colour of `mixed`.
        sides: tuple[Warped, Warped, Warped, Warped],
        agreement: Float32,  # [H, W], from `flow_weight`
        time: float,  # of the slot in its key interval
        linear: bool,  # whether colour is scene-linear, and not as shown
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
        """Return the network's inputs of some rows and columns; see `LOOKAHEAD_INTERFACE`."""
        height, width = self.shape
        size = min(rows.stop, height) - rows.start, min(columns.stop, width) - columns.start
        planes = room
        if planes is None or planes.shape[1:] != size:
            planes = np.empty((LOOKAHEAD_INTERFACE.channels, *size), np.float32)
        pictures = LOOKAHEAD_INTERFACE.split(planes)
        for i, picture in enumerate((self._mixed, *(side.pixels for side in self._sides))):
            colour = np.ascontiguousarray(picture[rows, columns, :3])
            shown = linear_to_srgb(colour) if self._linear else colour
            pictures["colour"][3 * i : 3 * i + 3] = shown.transpose(2, 0, 1)
        before, after = self._sides[:2]
        masks = (*(side.hole for side in self._sides), before.fringe, after.fringe)
        for plane, mask in zip(pictures["masks"], masks, strict=True):
            plane[:] = mask[rows, columns]
        for plane, side in zip(pictures["depth"], (before, after), strict=True):
            depth = side.depth[rows, columns]
            depth = np.where(np.isnan(depth), FURTHEST, np.clip(depth, NEAREST, FURTHEST))
            np.log2(depth, out=plane)
        pictures["agreement"][0] = self._agreement[rows, columns]
        return NetworkPictures(pictures, self.time)

    def weigh_in(
        self, network: LookAheadNetwork, mosaic: Mosaic, chosen: Bool
    ) -> Iterator[tuple[KeptPart, np.ndarray]]:
        """Yield the weights of each row of tiles; what `softsplat` makes counts beside chosen ones.

        Weights change smoothly there, so that no seam shows in any layer.
        """
        weights = np.zeros((CANDIDATES, *self.shape), np.float16)

        def answer(rows: slice, columns: slice) -> Float32:
            region = InputRegion(self, rows, columns)
            out = np.empty((CANDIDATES, *region.shape), np.float32)
            for (down, across), planes in network.weigh(region):
                out[:, down, across] = planes
            return out

        run_in_tiles(mosaic, chosen, answer, weights)
        ramp, (_, width) = mosaic.weight(chosen), self.shape
        for top, bottom in mosaic.down:
            part, share = weights[:, top:bottom], ramp[top:bottom]
            part[1:] *= share
            part[0] = 1 - share * (1 - part[0])
            yield (slice(top, bottom), slice(0, width)), part

    def mix(self, weights: Iterable[tuple[KeptPart, np.ndarray]]) -> Float32:
        """Mix the candidates by weights, float16 [5, h, w] of each tile.

        Returns the slot's colour, float32 [H, W, C], coded as the candidates are.
        """
        out: Float32 = pool.empty(self._mixed.shape, np.float32)
        sides = tuple(side.pixels for side in self._sides)
        for (down, across), part in weights:
            corner = down.start, across.start
            blend.mix_candidates(self._mixed, sides, part.astype(np.float32), corner, out)
        return out
