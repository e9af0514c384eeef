"""The layers of an interval's frames, read with it."""

from __future__ import annotations

from dataclasses import dataclass

from exwarp_cli.io.channels import ChannelRef
from exwarp_cli.io.exr.template import Plane
from exwarp_cli.io.layer_store import Planes
from exwarp_cli.pipeline.contents import Content


@dataclass(frozen=True)
class LayerFrames:
    """Layers around the slots of one interval.

    Attributes
    ----------
    before, after
        Those of the key frames on both sides; `after` only where it is used.
    older
        Those of the key frame before, where points are led on from there.
    slots
        For each slot what its own file has, by the key frames' channels; empty without.
    """

    before: Planes
    after: Planes | None
    older: Planes | None
    slots: tuple[Planes, ...]


class LayerReader:
    """Reads the layers of a view, interval by interval; what several share is read once."""

    def __init__(self, content: Content) -> None:
        self._content = content
        self._keys, self._slots = content.stores()

    @property
    def looks_back(self) -> bool:
        """Whether the key frame before is of use where the next one is not."""
        return self._content.looks_back

    def read(self, key: int, lookahead: bool, older: int | None) -> LayerFrames:
        """Read an interval.

        Parameters
        ----------
        key
            Index of the key frame.
        lookahead
            Whether the next one is used.
        older
            Index of the one before, where it is.
        """
        numbers = self._content.source.timeline.numbers
        before = self._keys.frame(numbers[key])
        after = self._keys.frame(numbers[key + 1]) if lookahead else None
        back = None if older is None else self._keys.frame(numbers[older])
        self.forget(key)
        return LayerFrames(before, after, back, self._rendered(key))

    def require(self, key: int) -> None:
        """Read a key frame's layers ahead; raises InputError where that fails."""
        self._keys.frame(self._content.source.timeline.numbers[key])

    def forget(self, key: int) -> None:
        """Drop what no interval after this one needs."""
        self._keys.keep(self._content.source.timeline.numbers[key : key + 2])

    def _rendered(self, key: int) -> tuple[Planes, ...]:
        """Read what the slots' own files have; () where one of them has no file."""
        if self._slots is None:
            return ()
        source = self._content.source
        numbers = [source.slot_number(slot) for slot in source.timeline.between(key)]
        known = [number for number in numbers if number is not None]
        if len(known) < len(numbers):
            return ()
        found = tuple(self._named(self._slots.frame(number)) for number in known)
        self._slots.keep(())
        return found

    def _named(self, planes: Planes) -> Planes:
        """Return a slot's planes by the key frames' channels."""
        found: dict[ChannelRef, Plane] = {}
        for layer in self._content.beside:
            other = self._content.rendered.get(layer)
            if other is not None:
                own = {ref.component: ref for ref in other.refs}
                found |= {ref: planes[own[ref.component]] for ref in layer.refs}
        return found
