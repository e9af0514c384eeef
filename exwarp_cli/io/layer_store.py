"""Layers of frames as they are in the files, read once for all the slots that show them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping

import numpy as np

from exwarp_cli.io.channels import ChannelRef, Role
from exwarp_cli.io.exr.template import Plane
from exwarp_cli.io.frames import read_planes
from exwarp_cli.io.layers import Kind, Layer
from exwarp_cli.io.nonfinite import count_broken
from exwarp_cli.io.shot import Shot

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
        self, shot: Shot, layers: Collection[Layer], more: Iterable[ChannelRef] = ()
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
        self._layers = tuple(layers)
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
            self._shot.nonfinite.note(number, dict(self._broken(found)))
        return self._frames[number]

    def _broken(self, found: Planes) -> Iterator[tuple[str, int]]:
        """Count the pixels of layers that are not finite; those of a role have its name."""
        roles = {refs: role for role, refs in self._shot.layout.roles.items()}
        for layer in self._layers:
            role = roles.get(layer.refs)
            counted = Role.DEPTH if layer.kind is Kind.DEPTH else role
            count = count_broken((found[ref].values for ref in layer.refs), counted)
            yield layer.name if role is None else role.value, count

    def keep(self, numbers: Iterable[int]) -> None:
        """Drop all other frames."""
        self._frames = {n: self._frames[n] for n in numbers if n in self._frames}


def _kept(values: np.ndarray, half: bool) -> np.ndarray:
    """Return a plane of its own, so that the part that it was decoded with can be freed."""
    if half and values.dtype == np.float32:
        with np.errstate(over="ignore"):  # another frame may hold the channel as float
            return values.astype(np.float16)
    return np.ascontiguousarray(values)
