"""A slot's layers from the key frames': every layer moves as the beauty does.

What may be mixed (colour) is sampled, filled and blended by the very steps that make the beauty.
What may not (ids, normals, Cryptomatte …) is copied from one source pixel, the same for all layers.
Positions, depth and vectors are then brought from the source's time to the slot's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

import numpy as np

from exwarp_cli.domain.decision import HELD, HOLD, PATHS
from exwarp_cli.domain.frame import Bool, Float32, GBuffer, Int32, nonfinite_pixels
from exwarp_cli.domain.motion import MotionConvention
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.kernels import blend
from exwarp_cli.synthesis.camera import scene_of
from exwarp_cli.synthesis.carried_light import CarriedLight
from exwarp_cli.synthesis.geometry import SlotField, depth_of, stands_still, unmatched
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.look_ahead import LookAhead
from exwarp_cli.synthesis.methods import Predicted
from exwarp_cli.synthesis.trajectory import displacement
from exwarp_cli.synthesis.warp import cross_fade, look_around, repair

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
        blend.adopt_sources(source, later, depth, *around)
        empty = broken & (np.isinf(depth) | (source == alone))
        taken = broken & ~empty
        for plane in planes:
            plane[taken] = _flat(plane)[source[taken]]
            plane[empty] = nothing if plane.dtype.kind == "f" else 0


def _broken(plane: np.ndarray) -> Bool:
    """bool [H, W]: where a channel is not finite."""
    return nonfinite_pixels(plane[..., None])


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


def _side(source: SlotField, key: Float32) -> blend.SourceSide:
    return source.field, source.depth, key, source.hole, source.fringe


def _chosen(before: blend.SourceSide, after: blend.SourceSide, time: np.float32) -> Sources:
    """Choose the sources, and give the holes those of what is visible around them."""
    shape = before[1].shape
    pixel, depth = np.empty(shape, np.int32), np.empty(shape, np.float32)
    later, hole = np.empty(shape, np.bool_), np.empty(shape, np.bool_)
    blend.choose_sources(before, after, time, pixel, later, depth, hole)
    around = look_around(depth, hole)
    if around is not None:
        blend.adopt_sources(pixel, later, depth, *around)
    return Sources(pixel, later, hole, depth)


def _flat(array: np.ndarray) -> np.ndarray:
    return array.reshape(-1, *array.shape[2:])


LARGEST_CHANGE = 0.25
"""Share of its depth by which a point may come nearer or go away within a key interval. Where it
seems to be more, it is another surface: on thin wires, whose pixels' footprints tell nothing."""


class Manner(Enum):
    """How a slot's layers come from the key frames'."""

    REPEAT = "repeat"
    """The key frame's, unmoved."""

    FADE = "fade"
    """Both key frames', unmoved: colour cross-faded, the rest that of the one nearer in time."""

    WARP = "warp"
    """The key frame's, moved."""

    BLEND = "blend"
    """Both key frames', moved, and blended by depth and time."""


@dataclass(frozen=True)
class Passage:
    """Where the points of one key frame are in a neighbouring one.

    Attributes
    ----------
    field
        float32 [H, W, 2], pixels.
    lost
        bool [H, W]: the neighbour does not show the point, or it is background.
    still
        bool [H, W]: the point stands still in the world; None where no camera tells.
    depth
        float32 [H, W] of the neighbour's pixels.
    """

    field: Float32
    lost: Bool
    still: Bool | None
    depth: Float32

    def change(self, here: Float32, there: Float32, fixed: bool) -> Float32:
        """Return by how much a layer's values change on the way, float32 [H, W, C].

        Parameters
        ----------
        here, there
            float32 [H, W, C]: the layer in both key frames.
        fixed
            Whether it stays the same where a point stands still, as world positions do.

        Returns
        -------
        float32 [H, W, C]
            0 where that is not known.
        """
        found = np.empty_like(here)
        blend.sample_surface(there, self.depth, self.field, found)
        with np.errstate(invalid="ignore", over="ignore"):
            found -= here
        found[self.lost | ~np.isfinite(found).all(axis=-1)] = 0
        if fixed and self.still is not None:
            found[self.still] = 0
        return found


def passage(here: GBuffer, there: GBuffer, way: int) -> Passage:
    """Lead the points of a key frame to a neighbouring one.

    Parameters
    ----------
    here, there
        On one window, with settled motion that spans a key interval.
    way
        1 to the next key frame, -1 to the one before.
    """
    field = displacement(here, way)
    depth, later = depth_of(here), depth_of(there)
    found = np.empty((*depth.shape, 1), np.float32)
    blend.sample_surface(later[..., None], later, field, found)
    with np.errstate(invalid="ignore"):
        same = np.abs(found[..., 0] - depth) <= np.float32(LARGEST_CHANGE) * depth
    lost = unmatched(here, there, field, FACTOR) | ~same  # background, too: inf - inf is NaN
    return Passage(field, lost, stands_still(here, scene_of(here)), later)


class Course:
    """How an interval's points move from key frame to key frame; worked out when first asked for.

    Parameters
    ----------
    key
        G-buffer of the key frame before the slots.
    following
        That of the one after them, where it is used.
    older
        That of the one before `key`; only used where there is no `following`.
    """

    def __init__(
        self, key: GBuffer, following: GBuffer | None = None, older: GBuffer | None = None
    ) -> None:
        self._key, self._following, self._older = key, following, older

    @cached_property
    def ahead(self) -> Passage | None:
        """From the key frame to the one after."""
        return None if self._following is None else passage(self._key, self._following, 1)

    @cached_property
    def behind(self) -> Passage | None:
        """From the key frame after to the one before."""
        return None if self._following is None else passage(self._following, self._key, -1)

    @cached_property
    def past(self) -> Passage | None:
        """From the key frame to the one before it."""
        return None if self._older is None else passage(self._key, self._older, -1)


@dataclass(frozen=True)
class Retiming:
    """How the layers of one slot are made.

    Attributes
    ----------
    manner
        Of all layers alike.
    time
        Of the slot, in key intervals after the key frame; 0 where the key frame is repeated.
    sources
        Where values come from that are not mixed.
    back, forward
        From the slot to the key frames before and after it, as far as they are used.
    frames
        Beauty of the key frames that are used, float32 [H, W, C]: layers go as it goes.
    warp, mixer
        What moves the key frame, or mixes both, for all layers of the slot; None where not used.
    """

    manner: Manner
    time: float
    sources: Sources
    back: SlotField | None = None
    forward: SlotField | None = None
    frames: tuple[Float32, ...] = ()
    warp: CarriedLight | None = None
    mixer: LookAhead | None = None

    def colour(self, before: Float32, after: Float32 | None = None) -> Float32:
        """Make a layer of values that may be mixed, exactly as the beauty is made.

        Parameters
        ----------
        before, after
            float32 [H, W, C] of the key frames on both sides, scene-linear, premultiplied where
            there is an alpha; `after` only where it is used.
        """
        # A network may have made the beauty, which light then does not go by yet.
        if self.warp is not None:
            if not self.warp.has_beauty:
                self.warp.make(self.frames[0])
            return self.warp.make(before)
        if self.mixer is not None:
            if not self.mixer.has_beauty:
                self.mixer.make(*self.frames)
            assert after is not None
            return self.mixer.make(before, after)
        if self.manner is Manner.REPEAT:
            return repair(before)
        assert after is not None
        return cross_fade(before, after, self.time)

    def data(self, before: np.ndarray, after: np.ndarray | None = None) -> np.ndarray:
        """Make a layer of values [H, W, ...] of any type that must not be mixed."""
        return self.sources.take(before, after)

    def moved(
        self, course: Course | None, layers: tuple[Float32 | None, ...], fixed: bool
    ) -> Float32:
        """Make a layer of values that belong to a point and change as it moves.

        Those of the source, and their linear change between the key frames where both show the
        point; with one key frame only, as they have changed since the one before it.

        Parameters
        ----------
        course
            Of the interval; None where no motion is known.
        layers
            float32 [H, W, C] of the key frames before and after the slot, and of the one before
            those; None for what is not there.
        fixed
            Whether a point that stands still keeps its value exactly, as world positions do.
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
        assert after is not None and course.ahead is not None and course.behind is not None
        return self.sources.take(
            before + time * course.ahead.change(before, after, fixed),
            after + (np.float32(1) - time) * course.behind.change(after, before, fixed),
        )

    def vectors(
        self, convention: MotionConvention, before: Float32, after: Float32 | None = None
    ) -> Float32:
        """Make the motion channels, in the renderer's own convention.

        They lead from where a point is at the slot's time to where it is one key interval earlier
        and later, as those of the key frames do from there. On the parabola through both, with n
        the displacement to the next key frame and p to the previous one, n becomes n + t (n + p)
        and p becomes p - t (n + p) after the time t; with one of them alone, at constant velocity,
        they stay as they are.

        Parameters
        ----------
        convention
            How the channels are read.
        before, after
            float32 [H, W, C]: all motion channels as written; `after` only where it is used.
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


def retiming(interval: Interval, slot: int, shown: Predicted) -> Retiming:
    """Find out how the layers of a slot are made, so that they go with its beauty.

    Parameters
    ----------
    interval
        As the beauty was made from; its motion fields are used again.
    slot
        1 or more.
    shown
        The beauty. Where a network made it, which knows no other layers, they are moved instead.
    """
    name, shape = shown.method, interval.key.image.pixels.shape[:2]
    key, following = interval.key.gbuffer, interval.following
    path = PATHS.get(name.upper())
    if path is not None and HOLD in path.made_by:  # warps alone go to any number of slots
        while slot and path.made_by[slot - 1] == HOLD:
            slot -= 1  # a repeat of what the slot before showed
    if name in ("hold", HELD) or slot == 0:
        return Retiming(Manner.REPEAT, 0.0, in_place(shape, _depth(key)))
    time = interval.time(slot)
    if name == "blend" or not interval.has_motion:
        later = time > 0.5
        shows = following.gbuffer if later and following is not None else key
        return Retiming(Manner.FADE, time, in_place(shape, _depth(shows), later))
    assert key is not None
    back = interval.back(slot)
    if path is not None or following is None:
        sources, frames = moved_from(back, depth_of(key)), (interval.key.image.pixels,)
        return Retiming(Manner.WARP, time, sources, back, None, frames, interval.warp(slot))
    forward = interval.forward(slot)
    assert following.gbuffer is not None
    depths = depth_of(key), depth_of(following.gbuffer)
    sources = moved_between(back, forward, depths, time)
    both = interval.key.image.pixels, following.image.pixels
    mixer = interval.look_ahead(slot)
    return Retiming(Manner.BLEND, time, sources, back, forward, both, mixer=mixer)


def _depth(gbuffer: GBuffer | None) -> Float32 | None:
    """Return the depth of a key frame's pixels; None where no geometry tells."""
    return None if gbuffer is None else depth_of(gbuffer)
