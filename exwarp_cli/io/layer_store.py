"""Layers of frames as they are in the files, read once for all the slots that show them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from exwarp_cli.io.channels import ChannelRef
from exwarp_cli.io.frames import read_planes
from exwarp_cli.io.layers import Layer
from exwarp_cli.io.shot import Shot
from exwarp_cli.io.template import Plane

Planes = Mapping[ChannelRef, Plane]
"""Channels of one frame, each in the file's own type and on its own window."""


class LayerStore:
    """Reads channels of frames; a frame stays at hand until it is dropped.

    Parameters
    ----------
    shot
        Whose frames.
    layers
        What is read of them.
    more
        Further channels.
    """

    def __init__(
        self, shot: Shot, layers: Iterable[Layer], more: Iterable[ChannelRef] = ()
    ) -> None:
        self._shot = shot
        groups: dict[tuple[str, int], dict[ChannelRef, bool]] = {}
        for layer in layers:
            for ref, channel in zip(layer.refs, layer.channels, strict=True):
                half = channel.pixel_type == "half"
                groups.setdefault((ref.aov, channel.part), {})[ref] = half
        known = {ref for group in groups.values() for ref in group}
        for ref in more:
            if ref not in known:
                groups.setdefault((ref.aov, -1), {})[ref] = False
        self._groups = tuple(groups.values())
        self._frames: dict[int, Planes] = {}

    def frame(self, number: int) -> Planes:
        """Return the channels of a frame.

        Raises
        ------
        InputError
            When a file is missing, damaged, of another size, or lacks a channel.
        """
        if number not in self._frames:
            found: dict[ChannelRef, Plane] = {}
            # Part by part: what is decoded as float32 takes half the memory once it is half again.
            for group in self._groups:
                planes, windows = read_planes(self._shot, number, list(group))
                for ref, half in group.items():
                    found[ref] = Plane(_kept(planes[ref], half), windows[ref])
            self._frames[number] = found
        return self._frames[number]

    def keep(self, numbers: Iterable[int]) -> None:
        """Drop all other frames."""
        self._frames = {n: self._frames[n] for n in numbers if n in self._frames}


def _kept(values: np.ndarray, half: bool) -> np.ndarray:
    """Return a plane of its own, so that the part that it was decoded with can be freed."""
    if half and values.dtype == np.float32:
        with np.errstate(over="ignore"):  # another frame may hold the channel as float
            return values.astype(np.float16)
    return np.ascontiguousarray(values)
