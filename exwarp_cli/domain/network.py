"""What ONNX networks that ExWarp runs take and give."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from exwarp_cli.domain.frame import Float32

TIME = "time"
"""The scalar input, float32 [1]; a network may do without it."""


@dataclass(frozen=True)
class NetworkInterface:
    """The inputs and the output of one kind of network.

    Attributes
    ----------
    version
        Models state it in their metadata.
    inputs
        Channels of the picture inputs, float32 [1, channels, H, W] each.
    required
        Inputs that a network must have; it may do without the others.
    output
        Name of the only output, float32 [1, made, H, W].
    made
        Channels of the output.
    """

    version: str
    inputs: Mapping[str, int]
    required: tuple[str, ...]
    output: str
    made: int

    @property
    def channels(self) -> int:
        """Channels of all picture inputs together."""
        return sum(self.inputs.values())


@dataclass(frozen=True)
class NetworkPictures:
    """Picture inputs of a network for one slot, or for a part of it.

    Attributes
    ----------
    pictures
        float32 [C, H, W] by input.
    time
        Of the slot in its key interval.
    """

    pictures: Mapping[str, Float32]
    time: float

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        height, width = next(iter(self.pictures.values())).shape[1:]
        return height, width

    def part(self, rows: slice, columns: slice, room: Float32 | None = None) -> NetworkPictures:
        """Return the inputs of some rows and columns; views of these, so no room is taken."""
        parts = {name: planes[:, rows, columns] for name, planes in self.pictures.items()}
        return NetworkPictures(parts, self.time)


class NetworkPart(Protocol):
    """Inputs that are there as a whole."""

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""

    @property
    def time(self) -> float:
        """Of the slot in its key interval."""

    @property
    def pictures(self) -> Mapping[str, Float32]:
        """float32 [C, H, W] by input."""


class NetworkGiven(Protocol):
    """Inputs that are made part by part as they are wanted."""

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""

    def part(self, rows: slice, columns: slice, room: Float32 | None = None) -> NetworkPart:
        """Return the inputs of some rows and columns.

        Parameters
        ----------
        rows, columns
            Beyond the frame, its edge may be repeated, or be left out.
        room
            float32 [C, h, w], for all channels of so many rows and columns: may be written and
            returned. Fresh memory, cleared by the system, took three times as long to fill.
        """
