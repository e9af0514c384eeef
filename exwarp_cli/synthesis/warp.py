"""W: a slot's frame as key frames' colour, moved from one side or both (paper, II-B and III-B).

Also coverage: surfaces that meet in a pixel of a slot share it, as far as each covers it. A pixel
of a key frame has the surface at its centre, so an edge that is moved to a slot is off by up to
half a pixel, and hard. Pixels beside an edge are therefore taken at several places inside. For each
place the key frames' surfaces are moved again, and the surface that lies there is sampled; the mean
of all places is the pixel's colour. An opaque surface stays opaque, as shares add up to 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Bool, Float32, GBuffer, Int32, nonfinite_pixels
from exwarp_cli.kernels import blend, gather, holes, resample
from exwarp_cli.kernels.silhouettes import MOTION_GAP, find_moving_edges
from exwarp_cli.runtime.frame_pool import pool
from exwarp_cli.synthesis.camera import Index
from exwarp_cli.synthesis.motion_fields import SlotField, splat_motion

# How far to look for background, as a share of the frame's longer side.
FILL_REACH = 0.25

# The sky counts as this many times as far as the furthest surface when holes are filled.
BEYOND = 2.0

# Colour is sampled, filled and blended as a display shows it, not in linear light. PSNR in dB, SSIM
# and sharpness (mean gradient over truth's) of 24 frames of the scene market by `softsplat`:
# bilinear in linear light 26.98, .927, .88; Lanczos-3 in linear light 27.42, .938, 1.00; in log
# light 27.58; as shown 27.67, and blended as shown 27.73, .940, 1.00. Catmull-Rom in log light has
# 27.53 and .97, Lanczos-4 what Lanczos-3 has.
LANCZOS = resample.lanczos_weights()

# Where a pixel beside an edge is taken, from its centre, +x right, +y down. PSNR in dB of
# `softsplat` without coverage and with it: town 33.45, 34.03; market 28.49, 29.29; lab 37.63,
# 37.88. `s6` gains 0.4, 0.2 and 0.0 dB.
PLACES = np.array([(x, y) for x in (-1 / 3, 1 / 3) for y in (-1 / 3, 1 / 3)], np.float32)

# Pixels in a row of the arrays that pixels beside edges are gathered in.
ROW = 1024


@dataclass(frozen=True)
class Warped:
    """A warped frame before its holes are filled."""

    pixels: Float32  # [H, W, C], as `Mover.codes` has them; 0 or the frame's edge colour in holes
    depth: Float32  # [H, W] of the visible surface
    # [H, W]: no source, another surface, outside the source, a non-finite source pixel, or the
    # outline that a surface leaves beside its hole.
    hole: Bool
    fringe: Bool  # [H, W]: colour mixed with a nearer surface that has moved on


@dataclass(eq=False)
class Mover:
    """Moves colour along one motion field: the beauty first, then its layers."""

    source: SlotField
    # Whether colour stays scene-linear, so that layers which add up to the beauty still do. It is
    # 0.2 dB worse than colour as shown.
    linear: bool = False
    # [h, w], with `linear`: how sharp the beauty is, 0 bilinear to 1 Lanczos-3, and its layers are.
    limit: Float32 | None = field(default=None, init=False)

    def codes(self, pixels: Float32) -> Float32:
        """Return scene-linear colour as it is moved."""
        return pixels if self.linear else linear_to_srgb(pixels)

    def light(self, codes: Float32) -> Float32:
        """Invert `codes`, in place."""
        return codes if self.linear else srgb_to_linear(codes)

    def move(
        self,
        codes: Float32,  # [H, W, C], from `codes`
    ) -> tuple[Float32, Bool]:
        """Return moved colour by Lanczos-3, and where it is unseen.

        Colour, float32 [h, w, C], has the motion field's size. Each channel of the beauty is within
        the range of the 3x3 pixels around; 0 where nothing finite lies there, the edge's colour
        outside the frame. Unseen, bool [h, w], are both of these, and where the source shows
        another surface.
        """
        field = self.source.field
        out: Float32 = pool.empty((*field.shape[:2], codes.shape[2]), np.float32)
        unseen: Bool = pool.empty(field.shape[:2], np.bool_)
        if self.linear:
            leads = self.limit is None
            if self.limit is None:
                self.limit = pool.empty(field.shape[:2], np.float32)
            resample.resample_alike(codes, field, LANCZOS, self.limit, leads, out, unseen)
        else:
            resample.resample(codes, field, LANCZOS, out, unseen)
        np.logical_or(unseen, self.source.hole, out=unseen)
        return out, unseen

    def warp(self, codes: Float32) -> Warped:
        """Return moved colour with its depth, holes (ghosts among them) and fringe."""
        out, hole = self.move(codes)
        np.logical_or(hole, self.source.ghosts, out=hole)
        return Warped(out, self.source.depth, hole, self.source.fringe)

    def warp_alone(self, pixels: Float32) -> Float32:
        """Return a frame, scene-linear, moved and its holes filled as by `fill_holes`."""
        out, hole = self.move(self.codes(pixels))
        return self.light(fill_holes(out, self.source.depth, hole))


def sample_bilinear(
    pixels: Float32,  # [H, W, C]
    field: Float32,  # [H, W, 2], pixels; NaN where there is no end
) -> tuple[Float32, Bool]:
    """Sample data, not colour, at the end of a motion field.

    Returns float32 [H, W, C]: 0 where nothing finite lies there, the edge's colour outside the
    frame; and where either is so, bool [H, W].
    """
    out: Float32 = pool.empty(pixels.shape, np.float32)
    unseen: Bool = pool.empty(pixels.shape[:2], np.bool_)
    gather.gather_bilinear(pixels, field, out, unseen)
    return out, unseen


def linear_to_srgb(pixels: Float32) -> Float32:
    """Encode scene-linear colour [H, W, 3 or more] by the sRGB curve, alpha unchanged.

    The curve continues below 0 and above 1.
    """
    out: Float32 = pool.empty(pixels.shape, np.float32)
    resample.encode_srgb(pixels, out)
    return out


def srgb_to_linear(codes: Float32) -> Float32:
    """Invert `linear_to_srgb`, in place."""
    resample.decode_srgb(codes, codes)
    return codes


def fill_nonfinite(pixels: Float32) -> Float32:
    """Return a frame whose non-finite pixels are filled from around them; itself if it has none."""
    broken = nonfinite_pixels(pixels)
    if not broken.any():
        return pixels
    clean = np.where(broken[..., None], np.float32(0), pixels)
    return fill_holes(clean, np.ones(broken.shape, np.float32), broken)


def fill_holes(
    # [H, W, C]; C-contiguous pixels are changed and returned, which spares a copy.
    pixels: Float32,
    depth: Float32,  # [H, W] of the visible surface, +inf background; NaN where unknown
    hole: Bool,
) -> Float32:
    """Return a frame with its holes filled from what is visible around them.

    Where the surface in a hole is known (slot G-buffers, or a source outside the frame) it is
    filled from the same surface, else from the background.
    """
    depth = np.ascontiguousarray(depth)
    around = find_hole_neighbours(depth, hole)
    if around is None:
        return pixels
    out = np.ascontiguousarray(pixels)
    holes.fill_holes(out, depth, *around)
    return out


class HoleNeighbourhood(NamedTuple):
    """The holes of a frame, and what is visible around them."""

    first: Int32  # [H + 1]: how many holes there are in all rows above each
    column: Int32  # [N]: their columns, row by row
    cap: np.float32  # depth at which everything further counts as equally far, scene units
    steps: npt.NDArray[np.int16]  # [8, N], from :func:`exwarp_cli.kernels.holes.ray_march_visible`


def find_hole_neighbours(depth: Float32, hole: Bool) -> HoleNeighbourhood | None:
    """Find what is visible around holes; parameters as of `fill_holes`. None without holes."""
    hole = np.ascontiguousarray(hole)
    rows, columns = np.nonzero(hole)
    if not len(rows):
        return None
    first = np.searchsorted(rows, np.arange(len(hole) + 1)).astype(np.int32)
    column = columns.astype(np.int32)
    furthest = float(depth[~hole & (depth < np.inf)].max(initial=0))
    cap = BEYOND * furthest if furthest > 0 else 1.0
    reach = min(int(FILL_REACH * max(hole.shape)) + 1, 32000)
    steps = np.empty((len(holes.DIRECTIONS), len(column)), np.int16)
    holes.ray_march_visible(hole, first, column, reach, steps)
    return HoleNeighbourhood(first, column, np.float32(cap), steps)


def mix_by_depth(
    # The key frames on both sides, warped to the slot. The pixels of `before` are overwritten.
    before: Warped,
    after: Warped,
    time: float,  # of the slot in the key interval, 0 < time < 1
) -> tuple[Float32, Float32, Bool]:
    """Blend two warped key frames as softmax splatting does, with the renderer's exact motion.

    Each side weighs by its nearness in time, times a softmax over its depth; a side that does not
    see the surface weighs nothing, so disocclusions come from the side that sees them.

    Returns what `fill_holes` takes: colour, float32 [H, W, C]; the depth of the nearer side,
    float32 [H, W]; and what neither side sees, bool [H, W].
    """
    depth: Float32 = pool.empty(before.depth.shape, np.float32)
    hole: Bool = pool.empty(before.hole.shape, np.bool_)
    later: Float32 = pool.empty(before.depth.shape, np.float32)
    first, second = ((side.depth, side.hole, side.fringe) for side in (before, after))
    blend.write_later_weights(first, second, np.float32(time), later, depth, hole)
    # In place: three frames of 1920x1080 in several threads are memory.
    blend.mix_frames(before.pixels, after.pixels, later, before.pixels)
    return before.pixels, depth, hole


def cross_fade(before: Float32, after: Float32, time: float) -> Float32:
    """Mix two layers [H, W, C] at a time, 0 to 1; non-finite pixels are filled from around."""
    first, second = fill_nonfinite(before), fill_nonfinite(after)
    with np.errstate(over="ignore", invalid="ignore"):  # of the largest floats
        return (first + np.float32(time) * (second - first)).astype(np.float32)


@dataclass(frozen=True)
class CoverageSide:
    """A key frame whose surfaces are moved to a slot."""

    gbuffer: GBuffer
    motion: Float32  # [H, W, 2], pixels: from the key frame to the slot; NaN where unknown

    def moved(self, offset: Float32 | None = None) -> SlotField:
        """Return the motion field back from the slot's pixels.

        With `offset`, float32 [2] in pixels, from places beside their centres, as if these were
        the centres.
        """
        motion = self.motion
        if offset is not None:
            height, width, _ = motion.shape
            # As rows of 2 W values, because arrays with a last axis of two are slow.
            rows = motion.reshape(height, 2 * width) - np.tile(offset, width)
            motion = rows.reshape(motion.shape)
        return splat_motion(self.gbuffer, motion)


@dataclass(frozen=True)
class _Place:
    """One place inside all N pixels that an edge passes through."""

    offset: Float32  # [2], pixels, from the centre
    vectors: list[Float32]  # of each key frame, [N, 2] pixels, to its source; NaN without one
    holes: list[Bool]  # of each key frame, [N]
    share: Float32 | None  # [N]: weight of the second key frame; None with one
    hole: Bool  # [N]: no key frame shows what lies there


@dataclass(frozen=True)
class _PlaceMovers:
    """What samples one place, for pixels gathered to [h, ROW]."""

    movers: list[Mover]  # of each key frame
    share: Float32 | None
    visible: Bool


@dataclass(eq=False)
class Coverage:
    """Gives the pixels of a slot that edges pass through the mean of several places inside them."""

    sides: Sequence[CoverageSide]  # the key frame before the slot, or both around it
    fields: Sequence[SlotField]  # from the slot to each of them
    time: float  # of the slot in the key interval
    linear: bool = False  # as for `Mover`
    _crossed: tuple[Index, list[_PlaceMovers]] | None = field(default=None, init=False)

    def cover(
        self,
        codes: Sequence[Float32],  # float32 [H, W, C] of each key frame, from `Mover.codes`
        # float32 [H, W, C], changed; its holes are filled. A place that no key frame shows has the
        # pixel's own colour.
        out: Float32,
    ) -> None:
        """Overwrite a layer's pixels that an edge passes through; the first layer is the beauty."""
        index, places = self._crossed or self._find_crossed()
        if self.linear:  # else no layers follow, and places are memory
            self._crossed = index, places
        count, channels, weight = len(index), out.shape[2], np.float32(1 / len(PLACES))
        if not count:
            return
        pixels = out.reshape(-1, channels)
        centre = pixels[index]
        total = np.zeros((count, channels), np.float32)
        for place in places:
            moved = [mover.move(each) for mover, each in zip(place.movers, codes, strict=True)]
            colour, lost = moved[0]
            if place.share is not None:
                second, second_lost = moved[1]
                # A source that is not finite, or outside its frame, leaves all to the other one.
                share = np.where(second_lost, np.float32(0), place.share)
                share[lost] = 1
                blend.mix_frames(colour, second, share, colour)
                lost &= second_lost
            visible = (place.visible & ~lost).reshape(-1)[:count, None]
            total += weight * np.where(visible, colour.reshape(-1, channels)[:count], centre)
        pixels[index] = total

    def _find_crossed(self) -> tuple[Index, list[_PlaceMovers]]:
        """Find the pixels that edges pass through, and what lies at the places inside them."""
        near_edges: Bool = np.zeros(self.fields[0].depth.shape, np.bool_)
        # Not in a fringe, whose colour is that of a nearer surface. What moves as one keeps the
        # mixed colour of its edges, which places inside would blur.
        for source in self.fields:
            find_moving_edges(source.depth, source.field, source.fringe, near_edges)
        index = np.flatnonzero(near_edges)
        centres = [field.field.reshape(-1, 2)[index] for field in self.fields]
        places = [self._look(offset, index) for offset in PLACES]
        crossed = np.zeros(len(index), np.bool_)
        for place in places:
            for vectors, centre in zip(place.vectors, centres, strict=True):
                unknown = np.isnan(vectors) & np.isnan(centre)
                same = (np.abs(vectors - centre) <= MOTION_GAP) | unknown
                crossed |= ~(same[:, 0] & same[:, 1])
        index = index[crossed]
        rows, columns = np.divmod(index, self.fields[0].depth.shape[1])
        order = np.arange(len(index))
        gathered = []
        for place in places:
            movers = []
            for vectors, hole_mask in zip(place.vectors, place.holes, strict=True):
                # Colour is sampled halfway to the centre: at the place itself the mean of several
                # blurs textures (0.2 dB on lab), at the centre edges are too near (0.2 dB on
                # market).
                ends = vectors[crossed] + place.offset / np.float32(2)
                ends[:, 0] += (columns - order % ROW).astype(np.float32)
                ends[:, 1] += (rows - order // ROW).astype(np.float32)
                hole = _in_rows(hole_mask[crossed], fill=True)
                no_depth = np.zeros(hole.shape, np.float32)
                source = SlotField(_in_rows(ends, fill=np.nan), no_depth, hole)
                movers.append(Mover(source, self.linear))
            share = None if place.share is None else _in_rows(place.share[crossed])
            visible = ~_in_rows(place.hole[crossed], fill=True)
            gathered.append(_PlaceMovers(movers, share, visible))
        return index, gathered

    def _look(self, offset: Float32, index: Index) -> _Place:
        """Return what each side shows at a place inside some pixels."""
        fields = [side.moved(offset) for side in self.sides]
        vectors = [field.field.reshape(-1, 2)[index] - offset for field in fields]
        holes = [field.hole.flat[index] for field in fields]
        if len(fields) == 1:
            return _Place(offset, vectors, holes, None, holes[0])
        shape = fields[0].depth.shape
        share, depth = pool.empty(shape, np.float32), pool.empty(shape, np.float32)
        hole: Bool = pool.empty(shape, np.bool_)
        first, second = ((field.depth, field.hole, field.fringe) for field in fields)
        blend.write_later_weights(first, second, np.float32(self.time), share, depth, hole)
        return _Place(offset, vectors, holes, share.flat[index], hole.flat[index])


def _in_rows(values: np.ndarray, fill: float = 0) -> np.ndarray:
    """Return values [N, ...] as [h, ROW, ...]."""
    count = -(-len(values) // ROW) * ROW
    out = np.full((count, *values.shape[1:]), fill, values.dtype)
    out[: len(values)] = values
    return out.reshape(-1, ROW, *values.shape[1:])
