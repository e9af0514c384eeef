"""Which pixel of which key frame a slot shows: what must not be mixed is copied by it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, Int32, broken_pixels
from exwarp_cli.kernels import nearest
from exwarp_cli.synthesis.geometry import SlotField
from exwarp_cli.synthesis.warp import look_around

FROM_KEY = np.float32(0)
"""Time at which the key frame before has all the weight."""


@dataclass(frozen=True)
class Sources:
    """The source of every pixel of a slot. One for all layers: their values stay together.

    Attributes
    ----------
    pixel
        int32 [H, W]: the source pixel, counted along the rows of the key frame.
    later
        bool [H, W]: it lies in the key frame after the slot.
    hole
        bool [H, W]: no key frame shows what is there, so the pixel has the source of one of the
        visible pixels around, or its own place in the key frame before where there is none.
    depth
        float32 [H, W] of what the pixel shows, +inf background, NaN unknown.
    """

    pixel: Int32
    later: Bool
    hole: Bool
    depth: Float32

    def take(self, before: np.ndarray, after: np.ndarray | None = None) -> np.ndarray:
        """Copy a layer's values of any type, bit for bit.

        Parameters
        ----------
        before, after
            [H, W, ...] of the key frames on both sides; `after` only where one is used.
        """
        out = np.take(_flat(before), self.pixel, axis=0)
        if after is not None and self.later.any():
            out[self.later] = np.take(_flat(after), self.pixel[self.later], axis=0)
        return out

    def mend(self, planes: Sequence[np.ndarray], nothing: float = 0.0) -> None:
        """Replace what is not finite in a slot's layer, all of whose values stay together.

        On a surface by the values of one of the pixels around that have some, as in holes. On the
        background, of which renderers write NaN and infinities too, and where none is in sight, by
        what says that nothing is there.

        Parameters
        ----------
        planes
            [H, W] of any types, changed: the layer's channels.
        nothing
            What says so: 0, or infinity where the layer is a depth; there infinities may stay.
        """
        count = np.isnan if np.isinf(nothing) else _broken
        kinds = [plane for plane in planes if plane.dtype.kind == "f"]
        broken = np.logical_or.reduce([count(plane) for plane in kinds] or [False])
        if not broken.any():
            return
        # Of what is not known nothing is like it.
        depth = np.where(np.isnan(self.depth), np.float32(0), self.depth)
        alone = np.arange(self.pixel.size, dtype=np.int32).reshape(self.pixel.shape)
        source, later = alone.copy(), np.zeros(self.pixel.shape, np.bool_)
        around = look_around(depth, broken)
        assert around is not None
        nearest.adopt(source, later, depth, *around)
        empty = broken & (np.isinf(depth) | (source == alone))
        taken = broken & ~empty
        for plane in planes:
            plane[taken] = _flat(plane)[source[taken]]
            plane[empty] = nothing if plane.dtype.kind == "f" else 0


def _broken(plane: np.ndarray) -> Bool:
    """bool [H, W]: where a channel is not finite."""
    return broken_pixels(plane[..., None])


def in_place(shape: tuple[int, int], depth: Float32 | None = None, later: bool = False) -> Sources:
    """Return the sources of a slot that shows a key frame as it is; `depth` is that frame's."""
    pixel = np.arange(shape[0] * shape[1], dtype=np.int32).reshape(shape)
    known = np.ones(shape, np.float32) if depth is None else depth
    return Sources(pixel, np.full(shape, later), np.zeros(shape, np.bool_), known)


def moved_from(back: SlotField, key: Float32) -> Sources:
    """Return the sources of a slot that shows a moved key frame.

    Parameters
    ----------
    back
        From the slot to the key frame.
    key
        float32 [H, W]: the depth of the key frame's pixels, +inf background.
    """
    depth, mask = np.zeros((0, 0), np.float32), np.zeros((0, 0), np.bool_)
    nothing = np.zeros((0, 0, 2), np.float32), depth, depth, mask, mask
    return _chosen(_side(back, key), nothing, FROM_KEY)


def moved_between(
    back: SlotField, forward: SlotField, keys: tuple[Float32, Float32], time: float
) -> Sources:
    """Return the sources of a slot that shows the moved key frames on both sides.

    Parameters
    ----------
    back, forward
        From the slot to the key frames before and after it.
    keys
        float32 [H, W] each: the depth of their pixels, +inf background.
    time
        Of the slot in the key interval, 0 < time < 1.
    """
    sides = _side(back, keys[0]), _side(forward, keys[1])
    return _chosen(*sides, np.float32(time))


def _side(source: SlotField, key: Float32) -> nearest.Side:
    return source.field, source.depth, key, source.hole, source.fringe


def _chosen(before: nearest.Side, after: nearest.Side, time: np.float32) -> Sources:
    """Choose the sources, and give the holes those of what is visible around them."""
    shape = before[1].shape
    pixel, depth = np.empty(shape, np.int32), np.empty(shape, np.float32)
    later, hole = np.empty(shape, np.bool_), np.empty(shape, np.bool_)
    nearest.choose(before, after, time, pixel, later, depth, hole)
    around = look_around(depth, hole)
    if around is not None:
        nearest.adopt(pixel, later, depth, *around)
    return Sources(pixel, later, hole, depth)


def _flat(array: np.ndarray) -> np.ndarray:
    return array.reshape(-1, *array.shape[2:])
