"""The interface between ExWarp and an extrapolation network."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from exwarp_cli.domain.frame import Float32

INTERFACE = "exwarp.extrapolator/1"
"""Version of the inputs below; models state it in their metadata."""

HISTORY = 3
"""Rendered frames that the network sees: F_k, F_k-1 and F_k-2."""

INPUTS = {"warped": 6, "mask": 1, "features": 6, "history": 4 * HISTORY}
"""Channels of the picture inputs, float32 [1, channels, H, W] each."""

TIME = "time"
"""The scalar input, float32 [1]; a network may do without it."""

OUTPUT = "colour"
"""The only output, float32 [1, 3, H, W]."""


@dataclass(frozen=True)
class NetworkInputs:
    """What an extrapolation network is given for one slot (ExtraNet's inputs).

    Colour is demodulated, scene-linear, as sign(x) log(1 + |x|), and without alpha.

    Attributes
    ----------
    warped
        float32 [6, H, W]: F_k warped to the slot with holes at 0, then with holes filled from the
        background.
    mask
        float32 [1, H, W]: 1 where F_k shows the slot's surface, 0 in holes.
    features
        float32 [6, H, W] of the slot: world normal (3, background and unknown 0), depth (0 to 1,
        1 is background, unknown 0.5), roughness (unknown 0.5), metallic (unknown 0).
    history
        float32 [12, H, W]: F_k, F_k-1, F_k-2 moved to the slot, newest first, each as colour (3)
        and mask (1). Colour is what lies at the end of the motion, in holes too. The oldest is
        repeated where there are fewer.
    time
        Of the slot in its key interval: 0.25, 0.5 or 0.75.
    """

    warped: Float32
    mask: Float32
    features: Float32
    history: Float32
    time: float

    @property
    def pictures(self) -> dict[str, Float32]:
        """The picture inputs by name, without the batch axis."""
        return {name: getattr(self, name) for name in INPUTS}

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        height, width = self.mask.shape[1:]
        return height, width

    def part(self, rows: slice, columns: slice, room: Float32 | None = None) -> NetworkInputs:
        """Return the inputs of some rows and columns; views of these, so no room is taken."""
        parts = {name: planes[:, rows, columns] for name, planes in self.pictures.items()}
        return NetworkInputs(**parts, time=self.time)


class Inputs(Protocol):
    """What a network is given for one slot, as a whole or part by part as it is wanted.

    The properties are those of `NetworkInputs`, of the whole frame.
    """

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""

    @property
    def time(self) -> float:
        """Of the slot in its key interval."""

    @property
    def warped(self) -> Float32:
        """float32 [6, H, W]."""

    @property
    def mask(self) -> Float32:
        """float32 [1, H, W]."""

    @property
    def features(self) -> Float32:
        """float32 [6, H, W]."""

    @property
    def history(self) -> Float32:
        """float32 [12, H, W]."""

    @property
    def pictures(self) -> dict[str, Float32]:
        """The picture inputs by name."""

    def part(self, rows: slice, columns: slice, room: Float32 | None = None) -> NetworkInputs:
        """Return the inputs of some rows and columns.

        Parameters
        ----------
        rows, columns
            Beyond the frame, its edge may be repeated, or be left out.
        room
            float32 [C, h, w], for all channels of so many rows and columns: may be written and
            returned. Fresh memory, cleared by the system, took three times as long to fill.
        """


class Extrapolator(Protocol):
    """A network that is ready to run."""

    @property
    def checksum(self) -> str:
        """SHA-256 of the model's file, in hexadecimal digits."""

    def __call__(self, inputs: Inputs) -> Float32:
        """Return the slot's colour, float32 [3, H, W], encoded as the inputs are; any H and W."""
