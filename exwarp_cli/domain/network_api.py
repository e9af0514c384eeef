"""The interfaces between ExWarp and the networks that it runs.

A large picture is cut into tiles that overlap, so that there are no seams. Near its border a tile
lacks pixels that the network would have seen beyond. What lies within the network's reach of a
border inside the picture is therefore computed but not kept: it is another tile's. Tiles begin and
end at multiples of the network's stride, where its coarsest pixels do.

The look-ahead network weighs candidate colours of each pixel. Its output lies within what the
candidates hold, and every layer of a frame is mixed alike: light passes still sum to the beauty.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import prod
from typing import Protocol, runtime_checkable

import numpy as np

from exwarp_cli.domain.frame import Float32

TIME_INPUT = "time"  # the scalar input, float32 [1]; a network may do without it


@dataclass(frozen=True)
class NetworkInterface:
    """The inputs and the output of one kind of network."""

    version: str  # models state it in their metadata
    inputs: Mapping[str, int]  # channels of the picture inputs, float32 [1, channels, H, W] each
    required: tuple[str, ...]  # inputs that a network must have
    output: str  # name of the only output, float32 [1, made, H, W]
    made: int  # channels of the output

    @property
    def channels(self) -> int:
        """Channels of all picture inputs together."""
        return sum(self.inputs.values())

    def split(self, planes: Float32) -> dict[str, Float32]:
        """Return planes [channels, H, W] by input, as views."""
        ends = np.cumsum(list(self.inputs.values()))[:-1]
        return dict(zip(self.inputs, np.split(planes, ends), strict=True))


@dataclass(frozen=True)
class NetworkPictures:
    """Picture inputs of a network for a slot, or for a part of it."""

    pictures: Mapping[str, Float32]  # float32 [C, H, W] by input
    time: float  # of the slot in its key interval

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        height, width = next(iter(self.pictures.values())).shape[1:]
        return height, width

    def part(self, rows: slice, columns: slice, room: Float32 | None = None) -> NetworkPictures:
        """Return the inputs of some rows and columns; views of these, so no room is taken."""
        parts = {name: planes[:, rows, columns] for name, planes in self.pictures.items()}
        return NetworkPictures(parts, self.time)


@dataclass(frozen=True)
class InputRegion:
    """Some rows and columns of a network's inputs, each from a first to before a last pixel."""

    inputs: LazyInputs
    rows: slice
    columns: slice

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        return self.rows.stop - self.rows.start, self.columns.stop - self.columns.start

    def part(self, rows: slice, columns: slice, room: Float32 | None = None) -> NetworkPictures:
        """Return the inputs of some rows and columns of the region, or beyond its end."""
        down, across = (
            slice(region.start + part.start, region.start + part.stop)
            for region, part in ((self.rows, rows), (self.columns, columns))
        )
        return self.inputs.part(down, across, room)


class LazyInputs(Protocol):
    """Inputs that are computed part by part on demand."""

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""

    def part(self, rows: slice, columns: slice, room: Float32 | None = None) -> NetworkPictures:
        """Return the inputs of some rows and columns.

        Beyond the frame, its edge may be repeated, or be left out. `room`, float32 [C, h, w] for
        all channels, may be written and returned.
        """
        # Fresh memory, cleared by the system, took three times as long to fill.


HISTORY_FRAMES = 3  # rendered frames that the network sees: F_k, F_k-1 and F_k-2

# The interface of ExtraNet's kind. Pictures are float32 [1, channels, H, W]; colour is demodulated,
# scene-linear, as sign(x) log(1 + |x|), and without alpha. The time is 0.25, 0.5 or 0.75.
#
# warped: F_k warped to the slot with holes at 0, then the frame that W makes, with holes filled,
# edges covered and light carried on. mask: 1 where F_k shows the slot's surface, 0 in holes.
# features: world normal (3; background and unknown 0), depth (0 to 1; 1 is background, unknown
# 0.5), roughness (unknown 0.5), metallic (unknown 0). history: F_k, F_k-1, F_k-2 moved to the slot,
# newest first, each as colour (3; in holes too) and mask (1). The oldest is repeated where there
# are fewer.
EXTRAPOLATOR_INTERFACE = NetworkInterface(
    version="exwarp.extrapolator/1",
    inputs={"warped": 6, "mask": 1, "features": 6, "history": 4 * HISTORY_FRAMES},
    required=("warped", "mask"),
    output="colour",
    made=3,
)


class NetworkModel(Protocol):
    """A network that is ready to run."""

    @property
    def checksum(self) -> str:
        """SHA-256 of the model's file, in hexadecimal digits."""


class Extrapolator(NetworkModel, Protocol):
    """A network that makes the colour of a slot."""

    def __call__(self, inputs: LazyInputs) -> Float32:
        """Return the slot's colour, float32 [3, H, W], encoded as the inputs are; any H and W."""


@dataclass(frozen=True)
class TileSpan:
    """A tile along one axis, in pixels of the picture."""

    seen: slice  # what the network sees
    kept: slice  # that of its output which is kept


Tile = tuple[TileSpan, TileSpan]  # rows and columns
KeptPart = tuple[slice, slice]  # rows and columns of the picture that a tile makes


def cut_tiles(
    size: tuple[int, int],  # height and width of the picture, multiples of `stride`
    stride: int,  # where tiles may begin and end
    reach: int,  # px around an input pixel within which it changes the output
    most: int,  # px of a tile; where even the smallest tiles have more, those are taken
) -> tuple[Tile, ...]:
    """Cut a picture into tiles of equal size, with as few pixels in all as possible.

    What they keep covers each pixel once. Only these numbers count, so every part of a sequence is
    cut alike.
    """
    margin = -(-reach // stride)
    cells = [n // stride for n in size]
    # By axis, every number of tiles with their length in strides.
    options: list[list[tuple[int, int]]] = []
    for total in cells:
        options.append([(1, total)])
        for count in range(2, total - 2 * margin + 1):
            length = -(-(total - 2 * margin) // count) + 2 * margin
            if length < options[-1][-1][1]:
                options[-1].append((count, length))
    pairs = [(a, b) for a in options[0] for b in options[1]]
    fitting = [pair for pair in pairs if pair[0][1] * pair[1][1] * stride**2 <= most]
    if fitting:
        # The coarsest pixels computed in all, then the number of tiles
        chosen = min(
            fitting, key=lambda pair: (prod(pair[0]) * prod(pair[1]), pair[0][0] * pair[1][0])
        )
    else:
        chosen = min(pairs, key=lambda pair: pair[0][1] * pair[1][1])
    axes: list[list[TileSpan]] = []
    for total, (count, length) in zip(cells, chosen, strict=True):
        starts = [i * (total - length) // max(count - 1, 1) for i in range(count)]
        firsts = [0, *(start + margin for start in starts[1:])]
        lasts = [*firsts[1:], total]
        axes.append(
            [
                TileSpan(
                    slice(start * stride, (start + length) * stride),
                    slice(first * stride, last * stride),
                )
                for start, first, last in zip(starts, firsts, lasts, strict=True)
            ]
        )
    return tuple((row, column) for row in axes[0] for column in axes[1])


class Interpolator(NetworkModel, Protocol):
    """A network that makes the frame at any time between two, from their colour alone."""

    def __call__(self, before: Float32, after: Float32, time: float) -> Float32:
        """Return the frame at a time, 0 < time < 1, between two frames.

        Frames are float32 [H, W, 3 or 4], finite, scene-linear, with premultiplied alpha.
        """


# Key frames moved to the slot: the one before and the one after it, by the motion of surfaces; then
# both again, with that of light.
SIDES = 4

# What `softsplat` makes, then each side. With the 3x3 pixels of each side as candidates the network
# was 0.07 dB better, and softened the picture: mean gradients 7.4 % below the truth's, where
# `softsplat` and centres alone are 4.6 %.
CANDIDATES = 1 + SIDES

# Picture inputs, float32 [1, channels, H, W]. colour: display-encoded (sRGB, beyond 0 and 1, too),
# what `softsplat` makes, then the sides; pixels that a side lacks have the colour of `softsplat`.
# masks: 1 where a side shows nothing (4); then where the outline of a nearer surface is mixed into
# the key frame before, and after. depth: log2 of the depth in scene units of what the key frame
# before, and after, shows, -7 to 14; 13.3 for background and unknown. Only differences matter.
# agreement: 0 to 1, by how much moving light makes both sides agree.
#
# The output is float32 [1, 5, H, W]: not negative, with a sum of 1.
LOOKAHEAD_INTERFACE = NetworkInterface(
    version="exwarp.lookahead/1",
    inputs={"colour": 3 * (1 + SIDES), "masks": 6, "depth": 2, "agreement": 1},
    required=("colour", "masks"),
    output="weights",
    made=CANDIDATES,
)


@runtime_checkable
class LookAheadNetwork(NetworkModel, Protocol):
    """A network that weighs candidates."""

    def weigh(self, inputs: LazyInputs) -> Iterator[tuple[KeptPart, Float32]]:
        """Yield the weights of each tile of a slot: float32 [CANDIDATES, h, w]."""
