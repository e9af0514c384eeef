"""Which pixel of which key frame a slot shows: what must not be mixed is copied by it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, Int32
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
    """

    pixel: Int32
    later: Bool
    hole: Bool

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


def in_place(shape: tuple[int, int], later: bool = False) -> Sources:
    """Return the sources of a slot that shows a key frame as it is."""
    pixel = np.arange(shape[0] * shape[1], dtype=np.int32).reshape(shape)
    return Sources(pixel, np.full(shape, later), np.zeros(shape, np.bool_))


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
    return Sources(pixel, later, hole)


def _flat(array: np.ndarray) -> np.ndarray:
    return array.reshape(-1, *array.shape[2:])
