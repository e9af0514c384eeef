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

from exwarp_cli.domain.frame import Bool, Float32, GBuffer, combine_3x3
from exwarp_cli.kernels import blend
from exwarp_cli.runtime.frame_pool import pool
from exwarp_cli.synthesis.geometry import SlotField, moved_on
from exwarp_cli.synthesis.trajectory import displacement
from exwarp_cli.synthesis.warp import Mover

Index = npt.NDArray[np.intp]

PLACES = tuple((x, y) for x in (-1 / 3, 1 / 3) for y in (-1 / 3, 1 / 3))
"""Where a pixel is taken, from its centre, +x right, +y down."""

JUMP = 1.1
"""Factor between the depths of neighbours from which on they are two surfaces."""

APART = np.float32(1 / 8)
"""Pixels by which the motion of neighbours differs from which on they are two surfaces. What moves
as one keeps the mixed colour of its edges, which places inside the pixel would blur."""

ROW = 1024
"""Pixels in a row of the arrays that pixels beside edges are gathered in."""


@dataclass(frozen=True)
class Side:
    """A key frame that is moved to a slot.

    Attributes
    ----------
    gbuffer
        With settled motion.
    time
        Of the slot, in key intervals from this key frame; negative is earlier.
    """

    gbuffer: GBuffer
    time: float


@dataclass(frozen=True)
class _Place:
    """One place of all pixels beside edges, gathered to [h, ROW].

    Attributes
    ----------
    movers
        Of each key frame.
    share
        float32 [h, ROW]: weight of the second key frame; None with one.
    seen
        bool [h, ROW]: some key frame shows what lies there.
    apart
        bool [N]: pixels whose centre shows another surface, or what one side does not see.
    """

    movers: tuple[Mover, ...]
    share: Float32 | None
    seen: Bool
    apart: Bool


class Coverage:
    """Gives the pixels of a slot beside edges the mean of several places inside them.

    Parameters
    ----------
    sides
        The key frame before the slot, or both around it.
    fields
        From the slot to each of them.
    linear
        As for `Mover`.
    """

    def __init__(
        self, sides: Sequence[Side], fields: Sequence[SlotField], linear: bool = False
    ) -> None:
        self._sides, self._fields, self._linear = sides, fields, linear
        self._index = np.flatnonzero(_beside_edges(fields))
        self._places: list[_Place] = []

    def cover(self, codes: Sequence[Float32], out: Float32) -> None:
        """Write a layer's pixels beside edges; the first layer is the beauty.

        Parameters
        ----------
        codes
            float32 [H, W, C] of each key frame, from `Mover.codes`.
        out
            float32 [H, W, C], changed where an edge passes through a pixel; its holes are filled.
            A place that no key frame shows has the pixel's own colour.
        """
        if not len(self._index):
            return
        channels, weight = out.shape[2], np.float32(1 / len(PLACES))
        total = np.zeros((len(self._index), channels), np.float32)
        count = np.zeros(len(self._index), np.float32)
        crossed = np.zeros(len(self._index), np.bool_)
        for place in self._made_places():
            colour, seen = _colour_at(place, codes)
            seen = seen.reshape(-1)[: count.size]
            shown = colour.reshape(-1, channels)[: count.size] * weight
            total += np.where(seen[:, None], shown, np.float32(0))
            count += seen
            crossed |= place.apart
        pixels = out.reshape(-1, channels)
        total += (1 - count * weight)[:, None] * pixels[self._index]
        pixels[self._index[crossed]] = total[crossed]

    def _made_places(self) -> Sequence[_Place]:
        """Return all places; kept for layers only, as they are memory."""
        if self._places:
            return self._places
        motions = [displacement(side.gbuffer, side.time) for side in self._sides]
        made = [self._place(motions, np.array(place, np.float32)) for place in PLACES]
        if self._linear:
            self._places = made
        return made

    def _place(self, motions: Sequence[Float32], offset: Float32) -> _Place:
        fields = []
        apart = np.zeros(len(self._index), np.bool_)
        for side, motion, centre in zip(self._sides, motions, self._fields, strict=True):
            fields.append(moved_on(side.gbuffer, motion - offset))
            apart |= self._differs(fields[-1].field - offset, centre.field)
            # Colour is sampled halfway to the centre: at the place itself the mean of several
            # blurs textures (0.2 dB on lab), at the centre edges are too near (0.2 dB on market).
            fields[-1].field[...] -= offset / np.float32(2)
        share: Float32 | None = None
        hole = fields[0].hole
        if len(fields) == 2:
            share, hole = _share_of_second(fields[0], fields[1], self._sides[0].time)
        movers = tuple(Mover(self._gathered(field), self._linear) for field in fields)
        shares = None if share is None else self._rows_of(share)
        return _Place(movers, shares, ~self._rows_of(hole, fill=True), apart)

    def _differs(self, field: Float32, other: Float32) -> Bool:
        """Return which pixels beside edges have another motion in one field than in another."""
        one, two = (each.reshape(-1, 2)[self._index] for each in (field, other))
        same = (np.abs(one - two) <= APART) | (np.isnan(one) & np.isnan(two))
        return np.asarray(~same.all(axis=1))

    def _gathered(self, source: SlotField) -> SlotField:
        """Return a motion field of the pixels beside edges alone, from pixels of [h, ROW]."""
        width = source.depth.shape[1]
        field = self._rows_of(source.field, fill=np.nan)
        rows, columns = np.divmod(self._index, width)
        places = np.arange(len(self._index))
        lines = field.reshape(-1, 2)
        lines[: len(places), 0] += (columns - places % ROW).astype(np.float32)
        lines[: len(places), 1] += (rows - places // ROW).astype(np.float32)
        return SlotField(field, self._rows_of(source.depth), self._rows_of(source.hole, fill=True))

    def _rows_of(self, values: np.ndarray, fill: float = 0) -> np.ndarray:
        """Return values [H, W, ...] of the pixels beside edges as [h, ROW, ...]."""
        flat = values.reshape(-1, *values.shape[2:])[self._index]
        count = -(-len(flat) // ROW) * ROW
        out = np.full((count, *flat.shape[1:]), fill, values.dtype)
        out[: len(flat)] = flat
        return out.reshape(-1, ROW, *flat.shape[1:])


def _colour_at(place: _Place, codes: Sequence[Float32]) -> tuple[Float32, Bool]:
    """Return what one place shows, float32 [h, ROW, C], and where anything does."""
    found = [mover.move(each) for mover, each in zip(place.movers, codes, strict=True)]
    (first, lost), *rest = found
    if place.share is None:
        return first, place.seen & ~lost
    second, second_lost = rest[0]
    # A source that is not finite, or outside its frame, leaves all to the other one.
    share = np.where(lost, np.float32(1), np.where(second_lost, np.float32(0), place.share))
    blend.mix(first, second, share, first)
    return first, place.seen & ~(lost & second_lost)


def _share_of_second(before: SlotField, after: SlotField, time: float) -> tuple[Float32, Bool]:
    """Return the weight of the second of two key frames, and what neither shows."""
    share: Float32 = pool.empty(before.depth.shape, np.float32)
    depth: Float32 = pool.empty(before.depth.shape, np.float32)
    hole: Bool = pool.empty(before.depth.shape, np.bool_)
    sides = [(side.depth, side.hole, side.fringe) for side in (before, after)]
    blend.weigh(*sides, np.float32(time), share, depth, hole)
    return share, hole


def _beside_edges(fields: Sequence[SlotField]) -> Bool:
    """Find pixels with another surface that moves otherwise, or a hole, among their 3x3.

    Those of any of some fields, but not of its fringe: colour there is that of a nearer surface.
    """
    found: Bool = np.zeros(fields[0].depth.shape, np.bool_)
    for field in fields:
        depth = np.where(np.isnan(field.depth), np.float32(np.inf), field.depth)
        nearest, farthest = (combine_3x3(depth, f, mode="edge") for f in (np.minimum, np.maximum))
        jumps = farthest > np.float32(JUMP) * nearest
        for way in (field.field[..., 0], field.field[..., 1]):
            least, most = (combine_3x3(way, f, mode="edge") for f in (np.minimum, np.maximum))
            # NaN where something is not known.
            found |= jumps & ~(most - least <= APART) & ~field.fringe
    return found
