"""The interface between ExWarp and a network that mixes both key frames around a slot.

The network is shown candidate colours of each pixel, and answers with their weights. So what it
makes lies within what its candidates hold, and every layer of a frame is mixed alike: light passes
still add up to the beauty.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol, runtime_checkable

from exwarp_cli.domain.extrapolator import Tile
from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.network import NetworkGiven, NetworkInterface

SIDES = 4
"""Key frames moved to the slot: the one before and the one after it, by the motion of surfaces;
then both again, by that of light, too."""

CANDIDATES = 1 + SIDES
"""Candidates of a pixel: what `softsplat` makes, then each side.

With the 3x3 pixels of each side as candidates the network was 0.07 dB better, and made the picture
soft: mean gradients 7.4 % below the truth's, where `softsplat` is 4.6 % and centres alone are, too.
"""

LOOKAHEAD = "lookahead"
"""Name of the method."""

LOOKS_AHEAD = NetworkInterface(
    version="exwarp.lookahead/1",
    inputs={"colour": 3 * (1 + SIDES), "masks": 6, "depth": 2, "agreement": 1},
    required=("colour", "masks"),
    output="weights",
    made=CANDIDATES,
)
"""Picture inputs, float32 [1, channels, H, W]:

colour
    As shown (sRGB's curve, going on above 1 and below 0): what `softsplat` makes, then the sides in
    their order. What a side does not show has the colour that `softsplat` makes there.
masks
    1 where a side shows nothing (4, in their order); then 1 where the outline of a nearer surface
    is mixed into what the key frame before, and after, shows.
depth
    log2 of the depth of the surface that the key frame before, and after, shows, in scene units,
    -7 to 14; 13.3 for the background and where it is not known. Only differences mean something.
agreement
    0 to 1: by how much moving light makes both sides agree.

The output, ``weights``, is float32 [1, 5, H, W]: not negative, their sum 1.
"""


@runtime_checkable
class LookAheadNetwork(Protocol):
    """A network that weighs candidates, ready to run."""

    @property
    def checksum(self) -> str:
        """SHA-256 of the model's file, in hexadecimal digits."""

    def weigh(self, inputs: NetworkGiven) -> Iterator[tuple[Tile, Float32]]:
        """Yield the weights of each tile of a slot: float32 [CANDIDATES, h, w]."""
