"""A slot's layers from the key frames': every layer moves as the beauty does.

What may be mixed (colour) is sampled, filled and blended by the very steps that make the beauty.
What may not (ids, normals, Cryptomatte …) is copied from one source pixel, the same for all layers.
Positions, depth and vectors are then brought from the source's time to the slot's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from exwarp_cli.domain.decision import HELD, HOLD, PATHS
from exwarp_cli.domain.frame import Bool, Float32, GBuffer, Int32, nonfinite_pixels
from exwarp_cli.domain.motion import MotionConvention
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.kernels import blend
from exwarp_cli.synthesis.camera import scene_of
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.look_ahead import LookAhead
from exwarp_cli.synthesis.methods import Predicted
from exwarp_cli.synthesis.motion_fields import SlotField, depth_of, find_holes, find_still
from exwarp_cli.synthesis.residual_flow import CarriedLight
from exwarp_cli.synthesis.trajectory import displacement
from exwarp_cli.synthesis.warp import cross_fade, fill_nonfinite, find_hole_neighbours

# Share of its depth by which a point may come nearer or go away within a key interval. Where it
# seems to be more, it is another surface: on thin wires, whose pixels' footprints decide nothing.
MAX_DEPTH_CHANGE = 0.25


@dataclass(frozen=True)
class PixelSources:
    """The source of every pixel of a slot. One for all layers: their values stay together."""

    pixel: Int32  # [H, W]: the source pixel, counted along the rows of the key frame
    later: Bool  # [H, W]: it lies in the key frame after the slot
    # [H, W]: no key frame shows what is there, so the pixel has the source of one of the visible
    # pixels around, or its own place in the key frame before where there is none.
    hole: Bool
    depth: Float32  # [H, W] of what the pixel shows, +inf background, NaN unknown

    def take(self, before: np.ndarray, after: np.ndarray | None = None) -> np.ndarray:
        """Copy a layer's values of any type, bit for bit.

        `before` and `after` are [H, W, ...] of the key frames on both sides; `after` only where one
        is used.
        """
        out = np.take(before.reshape(-1, *before.shape[2:]), self.pixel, axis=0)
        if after is not None and self.later.any():
            flat = after.reshape(-1, *after.shape[2:])
            out[self.later] = np.take(flat, self.pixel[self.later], axis=0)
        return out

    def mend(
        self,
        planes: Sequence[np.ndarray],  # [H, W] of any types, changed: the layer's channels
        # 0, or infinity where the layer is a depth; there infinities may stay.
        nothing: float = 0.0,
    ) -> None:
        """Replace what is not finite in a slot's layer, all of whose values stay together.

        On a surface by the values of one of the pixels around that have some, as in holes. On the
        background, of which renderers write NaN and infinities too, and where no such pixel is
        near, by `nothing`.
        """
        floats = [plane for plane in planes if plane.dtype.kind == "f"]
        broken = np.logical_or.reduce(
            [
                np.isnan(plane) if np.isinf(nothing) else nonfinite_pixels(plane[..., None])
                for plane in floats
            ]
            or [False]
        )
        if not broken.any():
            return
        # Nothing is like an unknown depth.
        depth = np.where(np.isnan(self.depth), np.float32(0), self.depth)
        alone = np.arange(self.pixel.size, dtype=np.int32).reshape(self.pixel.shape)
        source, later = alone.copy(), np.zeros(self.pixel.shape, np.bool_)
        around = find_hole_neighbours(depth, broken)
        assert around is not None
        blend.adopt_sources(source, later, depth, *around)
        empty = broken & (np.isinf(depth) | (source == alone))
        taken = broken & ~empty
        for plane in planes:
            plane[taken] = plane.reshape(-1)[source[taken]]
            plane[empty] = nothing if plane.dtype.kind == "f" else 0


def unmoved_sources(
    shape: tuple[int, int], depth: Float32 | None = None, later: bool = False
) -> PixelSources:
    """Return the sources of a slot that shows a key frame as it is; `depth` is that frame's."""
    pixel = np.arange(shape[0] * shape[1], dtype=np.int32).reshape(shape)
    depth = np.ones(shape, np.float32) if depth is None else depth
    return PixelSources(pixel, np.full(shape, later), np.zeros(shape, np.bool_), depth)


def moved_sources(
    # From the slot to the key frames before and after it.
    back: SlotField,
    # G-buffers of these.
    key: GBuffer,
    forward: SlotField | None = None,
    following: GBuffer | None = None,
    # Of the slot in the key interval; 0 leaves all weight to the key frame before.
    time: float = 0.0,
) -> PixelSources:
    """Return the sources of a slot that shows one moved key frame, or those on both sides."""
    before = back.field, back.depth, depth_of(key), back.hole, back.fringe
    empty, mask = np.zeros((0, 0), np.float32), np.zeros((0, 0), np.bool_)
    after: blend.SourceSide = np.zeros((0, 0, 2), np.float32), empty, empty, mask, mask
    if forward is not None and following is not None:
        depths = forward.depth, depth_of(following)
        after = forward.field, *depths, forward.hole, forward.fringe
    shape = back.depth.shape
    pixel, depth = np.empty(shape, np.int32), np.empty(shape, np.float32)
    later, hole = np.empty(shape, np.bool_), np.empty(shape, np.bool_)
    blend.choose_sources(before, after, np.float32(time), pixel, later, depth, hole)
    around = find_hole_neighbours(depth, hole)
    if around is not None:
        blend.adopt_sources(pixel, later, depth, *around)
    return PixelSources(pixel, later, hole, depth)


@dataclass(frozen=True)
class PointMotion:
    """Where the points of one key frame are in a neighbouring one."""

    field: Float32  # [H, W, 2], pixels
    lost: Bool  # [H, W]: the neighbour does not show the point, or it is background
    still: Bool | None  # [H, W]: the point stands still in the world; None without a camera
    depth: Float32  # [H, W] of the neighbour's pixels

    def change(
        self,
        # [H, W, C]: the layer in both key frames.
        here: Float32,
        there: Float32,
        fixed: bool,  # whether it stays the same where a point stands still, as world positions do
    ) -> Float32:
        """Return how a layer's values change on the way, float32 [H, W, C]; 0 if unknown."""
        change = np.empty_like(here)
        blend.sample_surface(there, self.depth, self.field, change)
        with np.errstate(invalid="ignore", over="ignore"):
            change -= here
        change[self.lost | ~np.isfinite(change).all(axis=-1)] = 0
        if fixed and self.still is not None:
            change[self.still] = 0
        return change


def lead_points(
    # On one window, with settled motion that spans a key interval.
    here: GBuffer,
    there: GBuffer,
    way: int,  # 1 to the next key frame, -1 to the one before
) -> PointMotion:
    """Lead the points of a key frame to a neighbouring one."""
    field = displacement(here, way)
    depth, later = depth_of(here), depth_of(there)
    sampled = np.empty((*depth.shape, 1), np.float32)
    blend.sample_surface(later[..., None], later, field, sampled)
    with np.errstate(invalid="ignore"):
        same = np.abs(sampled[..., 0] - depth) <= np.float32(MAX_DEPTH_CHANGE) * depth
    lost = find_holes(here, there, field, FACTOR) | ~same  # background, too: inf - inf is NaN
    return PointMotion(field, lost, find_still(here, scene_of(here)), later)


@dataclass(frozen=True)
class LayerMotion:
    """How an interval's points move from key frame to key frame, computed lazily."""

    key: GBuffer  # G-buffer of the key frame before the slots
    following: GBuffer | None = None  # that of the one after them, where it is used
    # That of the one before `key`; only used where there is no `following`.
    older: GBuffer | None = None

    @cached_property
    def across(self) -> tuple[PointMotion, PointMotion]:
        """From the key frame to the one after, and from that back; only with `following`."""
        assert self.following is not None
        ahead = lead_points(self.key, self.following, 1)
        return ahead, lead_points(self.following, self.key, -1)

    @cached_property
    def past(self) -> PointMotion | None:
        """From the key frame to the one before it."""
        return None if self.older is None else lead_points(self.key, self.older, -1)


@dataclass(frozen=True)
class LayerRetimer:
    """Makes the layers of one slot.

    With `warp` or `mixer`, key frames are moved. Without, they are not: colour is that of both
    cross-faded, or the key frame's at time 0, and the rest is that of the one nearer in time.
    """

    time: float  # of the slot, in key intervals after the key frame; 0 where that is repeated
    sources: PixelSources  # of values that are not mixed
    back: SlotField | None = None  # from the slot to the key frames, as far as they are used
    forward: SlotField | None = None
    frames: tuple[Float32, ...] = ()  # beauty of the key frames that are used, [H, W, C]
    warp: CarriedLight | None = None  # moves the key frame
    mixer: LookAhead | None = None  # mixes both

    def colour(
        self,
        # float32 [H, W, C] of the key frames on both sides, scene-linear, premultiplied where there
        # is an alpha; `after` only where it is used.
        before: Float32,
        after: Float32 | None = None,
    ) -> Float32:
        """Make a layer of values that may be mixed, exactly as the beauty is made."""
        # If a network made the beauty, light is not followed yet.
        if self.warp is not None:
            return self.warp.make(before, self.frames[0])
        if self.time == 0:
            return fill_nonfinite(before)
        assert after is not None
        if self.mixer is not None:
            return self.mixer.make(before, after, self.frames)
        return cross_fade(before, after, self.time)

    def moved(
        self,
        course: LayerMotion | None,  # of the interval; None where no motion is known
        # float32 [H, W, C] of the key frames before and after the slot, and of the one before
        # those; None if absent.
        layers: tuple[Float32 | None, ...],
        # Whether a point that stands still keeps its value exactly, as world positions do.
        fixed: bool,
    ) -> Float32:
        """Make a layer of values that belong to a point and change as it moves.

        Those of the source, and their linear change between the key frames where both show the
        point; with one key frame only, as they have changed since the one before it.
        """
        before, after, older = layers
        assert before is not None
        if course is None or self.back is None:
            return self.sources.take(before, after)
        time = np.float32(self.time)
        if self.forward is None:
            if older is None or course.past is None:
                return self.sources.take(before)
            return self.sources.take(before - time * course.past.change(before, older, fixed))
        assert after is not None
        ahead, behind = course.across
        return self.sources.take(
            before + time * ahead.change(before, after, fixed),
            after + (np.float32(1) - time) * behind.change(after, before, fixed),
        )

    def vectors(
        self,
        convention: MotionConvention,  # how the channels are read
        # [H, W, C]: all motion channels as written; `after` only where it is used.
        before: Float32,
        after: Float32 | None = None,
    ) -> Float32:
        """Make the motion channels, in the renderer's own convention.

        They lead from where a point is at the slot's time to where it is one key interval earlier
        and later, as those of the key frames do from there. On the parabola through both, with n
        the displacement to the next key frame and p to the previous one, n becomes n + t (n + p)
        and p becomes p - t (n + p) after the time t; with one of them alone, at constant velocity,
        they stay as they are.
        """
        raw: Float32 = self.sources.take(before, after)
        if self.back is None or convention.to_previous is None or convention.to_next is None:
            return raw
        earlier, later = convention.to_previous.apply(raw), convention.to_next.apply(raw)
        time = np.where(self.sources.later, self.time - 1, self.time).astype(np.float32)
        change = time[..., None] * (earlier + later)
        changed = (np.isfinite(change) & (change != 0)).any(axis=-1)
        moved = convention.to_next.write(later + change, raw)
        moved = convention.to_previous.write(earlier - change, moved)
        # What does not change, or cannot be read, keeps its very value.
        return np.where(changed[..., None], moved, raw)


def make_retimer(
    interval: Interval,  # that the beauty was made from; its motion fields are used again
    slot: int,  # 1 or more
    # The beauty. Where a network made it, which knows no other layers, they are moved instead.
    shown: Predicted,
) -> LayerRetimer:
    """Choose how the layers of a slot are made, so that they go with its beauty."""
    name, shape = shown.method, interval.key.image.pixels.shape[:2]
    key, following = interval.key.gbuffer, interval.following
    path = PATHS.get(name.upper())
    if path is not None and HOLD in path.made_by:  # warps alone go to any number of slots
        while slot and path.made_by[slot - 1] == HOLD:
            slot -= 1  # a repeat of what the slot before showed
    if name in ("hold", HELD) or slot == 0:
        depth = None if key is None else depth_of(key)
        return LayerRetimer(0.0, unmoved_sources(shape, depth))
    time = interval.time(slot)
    if name == "blend" or not interval.has_motion:
        later = time > 0.5
        nearer = following.gbuffer if later and following is not None else key
        depth = None if nearer is None else depth_of(nearer)
        return LayerRetimer(time, unmoved_sources(shape, depth, later))
    assert key is not None
    back = interval.back(slot)
    if path is not None or following is None:
        sources, frames = moved_sources(back, key), (interval.key.image.pixels,)
        warp = interval.warp(slot)
        return LayerRetimer(time, sources, back, None, frames, warp)
    forward = interval.forward(slot)
    assert following.gbuffer is not None
    sources = moved_sources(back, key, forward, following.gbuffer, time)
    both = interval.key.image.pixels, following.image.pixels
    mixer = interval.look_ahead(slot)
    return LayerRetimer(time, sources, back, forward, both, mixer=mixer)
