"""Coverage: surfaces that meet in a pixel of a slot share it, as far as each covers it.

A pixel of a key frame has the surface at its centre, so an edge that is moved to a slot is off by
up to half a pixel, and hard. Here pixels beside an edge are taken at several places inside: for
each place the key frames' surfaces are moved again, and the one that lies there is sampled. The
mean of all places is the pixel's colour. An opaque surface stays opaque, as shares add up to 1.

PSNR in dB of `softsplat` without it and with it: town 33.45, 34.03; market 28.49, 29.29; lab 37.63,
37.88. `s6` gains 0.4, 0.2 and 0.0 dB.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Bool, Float32, GBuffer
from exwarp_cli.kernels import blend
from exwarp_cli.kernels.silhouettes import MOTION_GAP, find_moving_edges
from exwarp_cli.runtime.frame_pool import pool
from exwarp_cli.synthesis.geometry import SlotField, moved_on
from exwarp_cli.synthesis.warp import Mover

Index = npt.NDArray[np.intp]

PLACES = tuple((x, y) for x in (-1 / 3, 1 / 3) for y in (-1 / 3, 1 / 3))
"""Where a pixel is taken, from its centre, +x right, +y down."""

ROW = 1024
"""Pixels in a row of the arrays that pixels beside edges are gathered in."""


@dataclass(frozen=True)
class Side:
    """A key frame whose surfaces are moved to a slot.

    Attributes
    ----------
    gbuffer
        Of the key frame.
    motion
        float32 [H, W, 2], pixels: from the key frame to the slot; NaN where unknown.
    reach
        Of the motion, from `reach_of`.
    """

    gbuffer: GBuffer
    motion: Float32
    reach: Float32

    def moved(self, offset: Float32 | None = None) -> SlotField:
        """Return the motion field back from the slot's pixels.

        Parameters
        ----------
        offset
            float32 [2], pixels: from the pixels' centres to the places that are asked for. The
            field is then counted from there as if it were the centre.
        """
        if offset is None:
            return moved_on(self.gbuffer, self.motion, self.reach)
        height, width, _ = self.motion.shape
        # As rows of 2 W values, as arrays with a last axis of two are slow.
        motion = self.motion.reshape(height, 2 * width) - np.tile(offset, width)
        return moved_on(self.gbuffer, motion.reshape(self.motion.shape), self.reach - offset[1])


@dataclass(frozen=True)
class _Line:
    """What one key frame shows at one place inside each of N pixels.

    Attributes
    ----------
    way
        float32 [N, 2], pixels: from the place to its source; NaN where there is none.
    offset
        float32 [2], pixels: from a pixel's centre to the place.
    hole
        bool [N].
    """

    way: Float32
    offset: Float32
    hole: Bool

    def take(self, chosen: Bool, pixels: Index, width: int) -> SlotField:
        """Return a motion field of some of the pixels, from pixels of [h, ROW].

        Parameters
        ----------
        chosen
            bool [N].
        pixels
            Flat indices of those chosen.
        width
            Of the frame.
        """
        # Colour is sampled halfway to the centre: at the place itself the mean of several blurs
        # textures (0.2 dB on lab), at the centre edges are too near (0.2 dB on market).
        field = self.way[chosen] + self.offset / np.float32(2)
        places = np.arange(len(pixels))
        rows, columns = np.divmod(pixels, width)
        field[:, 0] += (columns - places % ROW).astype(np.float32)
        field[:, 1] += (rows - places // ROW).astype(np.float32)
        hole = _in_rows(self.hole[chosen], fill=True)
        unknown = np.zeros(hole.shape, np.float32)
        return SlotField(_in_rows(field, fill=np.nan), unknown, hole)


@dataclass(frozen=True)
class _Place:
    """One place of all pixels that an edge passes through, gathered to [h, ROW].

    Attributes
    ----------
    movers
        Of each key frame.
    share
        float32 [h, ROW]: weight of the second key frame; None with one.
    seen
        bool [h, ROW]: some key frame shows what lies there.
    """

    movers: tuple[Mover, ...]
    share: Float32 | None
    seen: Bool


@dataclass(frozen=True)
class _Crossed:
    """The pixels that an edge passes through.

    Attributes
    ----------
    index
        int [N]: which they are.
    places
        Inside each of them.
    """

    index: Index
    places: tuple[_Place, ...]


class Coverage:
    """Gives the pixels of a slot that edges pass through the mean of several places inside them.

    Parameters
    ----------
    sides
        The key frame before the slot, or both around it.
    fields
        From the slot to each of them.
    time
        Of the slot in the key interval.
    linear
        As for `Mover`.
    """

    def __init__(
        self,
        sides: Sequence[Side],
        fields: Sequence[SlotField],
        time: float,
        linear: bool = False,
    ) -> None:
        self._sides, self._fields, self._time, self._linear = sides, fields, time, linear
        self._crossed: _Crossed | None = None

    def cover(self, codes: Sequence[Float32], out: Float32) -> None:
        """Write a layer's pixels that an edge passes through; the first layer is the beauty.

        Parameters
        ----------
        codes
            float32 [H, W, C] of each key frame, from `Mover.codes`.
        out
            float32 [H, W, C], changed; its holes are filled. A place that no key frame shows has
            the pixel's own colour.
        """
        crossed = self._crossed or self._find()
        if self._linear:  # else no layers follow, and places are memory
            self._crossed = crossed
        count, channels, weight = len(crossed.index), out.shape[2], np.float32(1 / len(PLACES))
        if not count:
            return
        pixels = out.reshape(-1, channels)
        own = pixels[crossed.index]
        total = np.zeros((count, channels), np.float32)
        for place in crossed.places:
            colour, seen = _colour_at(place, codes)
            shown = colour.reshape(-1, channels)[:count]
            total += weight * np.where(seen.reshape(-1)[:count, None], shown, own)
        pixels[crossed.index] = total

    def _find(self) -> _Crossed:
        """Find the pixels that edges pass through, and what lies at the places inside them."""
        beside = np.flatnonzero(_beside_edges(self._fields))
        centres = [field.field.reshape(-1, 2)[beside] for field in self._fields]
        found = [self._look(offset, beside) for offset in np.array(PLACES, np.float32)]
        crossed = np.zeros(len(beside), np.bool_)
        for lines, _, _ in found:
            for line, centre in zip(lines, centres, strict=True):
                crossed |= _differs(line.way, centre)
        index, width = beside[crossed], self._fields[0].depth.shape[1]
        places = []
        for lines, share, hole in found:
            movers = tuple(Mover(line.take(crossed, index, width), self._linear) for line in lines)
            shares = None if share is None else _in_rows(share[crossed])
            places.append(_Place(movers, shares, ~_in_rows(hole[crossed], fill=True)))
        return _Crossed(index, tuple(places))

    def _look(self, offset: Float32, beside: Index) -> tuple[list[_Line], Float32 | None, Bool]:
        """Return what each side shows at a place, the second one's weight, and what none shows.

        The weight is None with one side.
        """
        fields = [side.moved(offset) for side in self._sides]
        lines = [
            _Line(field.field.reshape(-1, 2)[beside] - offset, offset, field.hole.flat[beside])
            for field in fields
        ]
        if len(fields) == 1:
            return lines, None, lines[0].hole
        share, hole = _share_of_second(fields[0], fields[1], self._time)
        return lines, share.flat[beside], hole.flat[beside]


def _differs(way: Float32, centre: Float32) -> Bool:
    """Return which of some pixels, bool [N], move otherwise than their centre, [N, 2] each."""
    same = (np.abs(way - centre) <= MOTION_GAP) | (np.isnan(way) & np.isnan(centre))
    return np.asarray(~(same[:, 0] & same[:, 1]))


def _in_rows(values: np.ndarray, fill: float = 0) -> np.ndarray:
    """Return values [N, ...] as [h, ROW, ...]."""
    count = -(-len(values) // ROW) * ROW
    out = np.full((count, *values.shape[1:]), fill, values.dtype)
    out[: len(values)] = values
    return out.reshape(-1, ROW, *values.shape[1:])


def _colour_at(place: _Place, codes: Sequence[Float32]) -> tuple[Float32, Bool]:
    """Return what one place shows, float32 [h, ROW, C], and where anything does."""
    found = [mover.move(each) for mover, each in zip(place.movers, codes, strict=True)]
    (first, lost), *rest = found
    if place.share is None:
        return first, place.seen & ~lost
    second, second_lost = rest[0]
    # A source that is not finite, or outside its frame, leaves all to the other one.
    share = np.where(lost, np.float32(1), np.where(second_lost, np.float32(0), place.share))
    blend.mix_frames(first, second, share, first)
    return first, place.seen & ~(lost & second_lost)


def _share_of_second(before: SlotField, after: SlotField, time: float) -> tuple[Float32, Bool]:
    """Return the weight of the second of two key frames, and what neither shows."""
    share: Float32 = pool.empty(before.depth.shape, np.float32)
    depth: Float32 = pool.empty(before.depth.shape, np.float32)
    hole: Bool = pool.empty(before.depth.shape, np.bool_)
    sides = [(side.depth, side.hole, side.fringe) for side in (before, after)]
    blend.write_later_weights(*sides, np.float32(time), share, depth, hole)
    return share, hole


def _beside_edges(fields: Sequence[SlotField]) -> Bool:
    """Find pixels with another surface that moves otherwise, or a hole, among their 3x3.

    Those of any of some fields, but not of its fringe: colour there is that of a nearer surface.
    What moves as one keeps the mixed colour of its edges, which places inside would blur.
    """
    found: Bool = np.zeros(fields[0].depth.shape, np.bool_)
    for field in fields:
        find_moving_edges(field.depth, field.field, field.fringe, found)
    return found
