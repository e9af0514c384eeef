"""The range that a slot's colour lies in: that of the key frames around the places it comes from.

A network may answer anything. What is sampled bilinearly, filled and blended lies in this range by
itself, as all of that mixes source pixels with weights from 0 to 1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.kernels import gather, holes
from exwarp_cli.runtime.frame_pool import pool
from exwarp_cli.synthesis.motion_fields import SlotField
from exwarp_cli.synthesis.warp import HoleNeighbourhood, find_hole_neighbours, sample_bilinear

# Largest alpha that counts as 0: half floats round it to 0.
CLEAR = 2.0**-25

# Of lower bounds, which are negated, and of upper ones.
SIGNS = (np.float32(-1), np.float32(1))

# What the kernel takes for all pixels.
EVERYWHERE = np.zeros((0, 0), np.bool_)


@dataclass(frozen=True)
class ColourSource:
    """A key frame that a slot's colour comes from."""

    pixels: Float32  # [H, W, C], scene-linear; the fourth channel is alpha
    field: Float32  # [H, W, 2], pixels: from the slot to the frame
    seen: Bool  # [H, W]: the frame shows the slot's surface


@dataclass(frozen=True)
class SlotSources:
    """What a slot's frame is made from."""

    sides: tuple[ColourSource, ...]  # they count wherever they show the slot's surface
    older: tuple[ColourSource, ...]  # they count in holes, where none of `sides` shows the surface
    depth: Float32  # [H, W] of the slot's surface, by which holes are filled; NaN where unknown
    # [H, W, C]: W's frame, which counts too; None for none. Light that it carries on, and the other
    # surface of a pixel at an edge, may come from farther away.
    warp: Float32 | None = None


def hold_within(frame: Float32, sources: SlotSources) -> None:
    """Clamp each channel of a slot's frame to the range of the 5x5 source pixels at its places.

    In a hole the range is that of what fills it, together with that of the older key frames; where
    neither exists, that of the whole key frames. Where the slot's alpha is 0, only source pixels
    whose alpha is 0 count: so there is no colour but light without matte, as of fire and glows. An
    alpha that is 0 everywhere is no matte, and all source pixels count.

    `frame` is float32 [H, W, C], finite; changed.
    """
    hole = ~np.logical_or.reduce([side.seen for side in sources.sides])
    around = find_hole_neighbours(sources.depth, hole)
    _clamp(frame, lambda sign, clear: _bounds(sources, hole, around, sign, clear))


def hold_between(
    frame: Float32,  # as in `hold_within`; changed
    frames: tuple[Float32, Float32],  # [H, W, C]: the key frames before and after the slot
    fields: tuple[SlotField, SlotField] | None,  # from the slot to them; None without motion
) -> None:
    """Clamp each channel of a slot's frame as `hold_within` does, to its key frames on both sides.

    Without motion, places are unknown: then to its range in the whole key frames.
    """
    if fields is None:
        _clamp(frame, lambda *kind: np.broadcast_to(_range(frames, *kind), frame.shape))
        return
    sides = tuple(
        ColourSource(pixels, field.field, ~(sample_bilinear(pixels, field.field)[1] | field.hole))
        for pixels, field in zip(frames, fields, strict=True)
    )
    hold_within(frame, SlotSources(sides, (), np.fmin(fields[0].depth, fields[1].depth)))


def _clamp(frame: Float32, bounds: Callable[[np.float32, bool], Float32]) -> None:
    """Clamp a frame, where its alpha is 0 also to the bounds of source pixels whose alpha is 0."""
    channels = frame.shape[2]
    for sign in SIGNS:
        gather.clamp_to_bounds(bounds(sign, False), EVERYWHERE, sign, channels, frame)
    if channels <= gather.ALPHA_CHANNEL:
        return
    clear: Bool = np.abs(frame[..., gather.ALPHA_CHANNEL]) <= CLEAR
    if clear.any():
        for sign in SIGNS:
            gather.clamp_to_bounds(bounds(sign, True), clear, sign, gather.ALPHA_CHANNEL, frame)


def _bounds(
    sources: SlotSources,
    hole: Bool,
    around: HoleNeighbourhood | None,
    sign: np.float32,
    clear: bool,
) -> Float32:
    """Return `sign` times the bounds of all pixels, float32 [H, W, C]; -inf for 0.

    With `clear`, only source pixels count whose alpha is 0.
    """
    shape = (*hole.shape, sources.sides[0].pixels.shape[2])
    bound: Float32 = pool.empty(shape, np.float32)
    bound.fill(-np.inf)
    for side in sources.sides:
        pixels = np.ascontiguousarray(side.pixels)
        gather.raise_bounds(pixels, side.field, side.seen, clear, sign, bound)
    if around is not None:
        bound[np.isneginf(bound)] = 0  # alpha is 0 in no source pixel: what is mixed in holes
        holes.fill_holes(bound, sources.depth, *around)
        lone = ~around.steps.any(axis=0)
        if lone.any():
            rows = np.repeat(np.arange(len(hole)), np.diff(around.first))
            ends = _range([side.pixels for side in sources.sides], sign, clear)
            bound[rows[lone], around.column[lone]] = ends
        for side in sources.older:
            pixels = np.ascontiguousarray(side.pixels)
            gather.raise_bounds(pixels, side.field, side.seen & hole, clear, sign, bound)
    if sources.warp is not None:
        warp = sign * sources.warp
        if clear:
            warp[np.abs(sources.warp[..., gather.ALPHA_CHANNEL]) > CLEAR] = -np.inf
        np.maximum(bound, warp, out=bound)
    return bound


def _range(frames: Sequence[Float32], sign: np.float32, clear: bool) -> Float32:
    """Return `sign` times the bounds of whole frames, float32 [C]; -inf where nothing counts."""
    ends = np.full(frames[0].shape[2], -np.inf, np.float32)
    for pixels in frames:
        counts = pixels[..., gather.ALPHA_CHANNEL] == 0 if clear else np.True_
        for c in range(len(ends)):
            values = sign * pixels[..., c]
            finite = counts & np.isfinite(values)
            ends[c] = max(ends[c], np.max(values, where=finite, initial=-np.inf))
    return ends
