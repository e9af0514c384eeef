"""The range that a slot's colour lies in: that of the key frames around the places it comes from.

A network may answer anything. What is sampled bilinearly, filled and blended lies in this range by
itself, as all of that mixes source pixels with weights from 0 to 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.kernels import gather, holes
from exwarp_cli.runtime.frame_pool import pool
from exwarp_cli.synthesis.geometry import SlotField
from exwarp_cli.synthesis.warp import Around, look_around, sampled

CLEAR = 2.0**-25
"""Largest alpha that counts as 0: half floats round it to 0."""

SIGNS = (np.float32(-1), np.float32(1))
"""Of lower bounds, which are kept negated, and of upper ones."""

EVERYWHERE = np.zeros((0, 0), np.bool_)
"""What the kernel takes for all pixels."""


@dataclass(frozen=True)
class Side:
    """A key frame that a slot's colour comes from.

    Attributes
    ----------
    pixels
        float32 [H, W, C], scene-linear; the fourth channel is alpha.
    field
        float32 [H, W, 2], pixels: from the slot to the frame.
    seen
        bool [H, W]: the frame shows the slot's surface.
    """

    pixels: Float32
    field: Float32
    seen: Bool


@dataclass(frozen=True)
class Sources:
    """What a slot's frame is made from.

    Attributes
    ----------
    sides
        Key frames that count wherever they show the slot's surface.
    older
        Key frames that count in holes: where none of `sides` shows the surface.
    depth
        float32 [H, W] of the slot's surface, by which holes are filled; NaN where it is unknown.
    warp
        float32 [H, W, C]: W's frame, which counts too; None for none. Light that it carries on, and
        the other surface of a pixel at an edge, may come from farther off.
    """

    sides: tuple[Side, ...]
    older: tuple[Side, ...]
    depth: Float32
    warp: Float32 | None = None


def sources_between(
    frames: tuple[Float32, Float32], fields: tuple[SlotField, SlotField]
) -> Sources:
    """Return the key frames on both sides of a slot as its sources.

    Parameters
    ----------
    frames
        float32 [H, W, C] of the key frames before and after the slot.
    fields
        Motion fields from the slot to them.
    """
    sides = tuple(
        Side(pixels, field.field, ~(sampled(pixels, field.field)[1] | field.hole))
        for pixels, field in zip(frames, fields, strict=True)
    )
    return Sources(sides, (), np.fmin(fields[0].depth, fields[1].depth))


def hold_within(frame: Float32, sources: Sources) -> None:
    """Hold each channel of a slot's frame within the range of the 5x5 source pixels at its places.

    In a hole the range is that of what fills it, together with that of the older key frames; where
    neither is there, that of the whole key frames. Where the slot's alpha is 0, only source pixels
    whose alpha is 0 count: so there is no colour but light without matte, as of fire and glows. An
    alpha that is 0 everywhere is no matte, and all source pixels count.

    Parameters
    ----------
    frame
        float32 [H, W, C], finite; changed.
    sources
        What it is made from.
    """
    hole = ~np.logical_or.reduce([side.seen for side in sources.sides])
    around = look_around(sources.depth, hole)
    for sign in SIGNS:
        bound = _bounds(sources, hole, around, sign, clear=False)
        gather.clamp_to_bounds(bound, EVERYWHERE, sign, frame.shape[2], frame)
        del bound
    clear = _clear(frame)
    if clear is None:
        return
    for sign in SIGNS:
        bound = _bounds(sources, hole, around, sign, clear=True)
        gather.clamp_to_bounds(bound, clear, sign, gather.ALPHA_CHANNEL, frame)
        del bound


def hold_in_range(frame: Float32, frames: Sequence[Float32]) -> None:
    """Hold each channel of a slot's frame within its range in whole frames.

    For a network whose places are unknown: no motion vectors tell them. Alpha as in `hold_within`.

    Parameters
    ----------
    frame
        float32 [H, W, C], finite; changed.
    frames
        float32 [H, W, C]: what it is made from.
    """
    for sign in SIGNS:
        bound = np.broadcast_to(_range(frames, sign, clear=False), frame.shape)
        gather.clamp_to_bounds(bound, EVERYWHERE, sign, frame.shape[2], frame)
    clear = _clear(frame)
    if clear is None:
        return
    for sign in SIGNS:
        bound = np.broadcast_to(_range(frames, sign, clear=True), frame.shape)
        gather.clamp_to_bounds(bound, clear, sign, gather.ALPHA_CHANNEL, frame)


def _clear(frame: Float32) -> Bool | None:
    """bool [H, W]: where alpha is 0; None where it is so nowhere."""
    if frame.shape[2] <= gather.ALPHA_CHANNEL:
        return None
    clear: Bool = np.abs(frame[..., gather.ALPHA_CHANNEL]) <= CLEAR
    return clear if clear.any() else None


def _bounds(
    sources: Sources, hole: Bool, around: Around | None, sign: np.float32, clear: bool
) -> Float32:
    """Return `sign` times the bounds of all pixels, float32 [H, W, C]; -inf for 0.

    `clear` has only source pixels count whose alpha is 0.
    """
    shape = (*hole.shape, sources.sides[0].pixels.shape[2])
    bound: Float32 = pool.empty(shape, np.float32)
    bound.fill(-np.inf)
    for side in sources.sides:
        _raise(bound, side, side.seen, sign, clear)
    if around is None:
        return _raised_to_warp(bound, sources.warp, sign, clear)
    bound[np.isneginf(bound)] = 0  # where alpha is 0 in no source pixel: what is mixed in holes
    holes.fill_holes(bound, sources.depth, around.first, around.column, around.cap, around.steps)
    lone = ~around.steps.any(axis=0)
    if lone.any():
        rows = np.repeat(np.arange(len(hole)), np.diff(around.first))
        ends = _range([side.pixels for side in sources.sides], sign, clear)
        bound[rows[lone], around.column[lone]] = ends
    for side in sources.older:
        _raise(bound, side, side.seen & hole, sign, clear)
    return _raised_to_warp(bound, sources.warp, sign, clear)


def _raised_to_warp(bound: Float32, warp: Float32 | None, sign: np.float32, clear: bool) -> Float32:
    """Return bounds, raised to those of W's frame."""
    if warp is None:
        return bound
    own = sign * warp
    if clear:
        own[np.abs(warp[..., gather.ALPHA_CHANNEL]) > CLEAR] = -np.inf
    np.maximum(bound, own, out=bound)
    return bound


def _raise(bound: Float32, side: Side, wanted: Bool, sign: np.float32, clear: bool) -> None:
    """Raise the bounds of some pixels to those of a key frame."""
    pixels = np.ascontiguousarray(side.pixels)
    gather.raise_bounds(pixels, side.field, wanted, clear, sign, bound)


def _range(frames: Sequence[Float32], sign: np.float32, clear: bool) -> Float32:
    """Return `sign` times the bounds of whole frames, float32 [C]; -inf where nothing counts."""
    ends = np.full(frames[0].shape[2], -np.inf, np.float32)
    for pixels in frames:
        counts = pixels[..., gather.ALPHA_CHANNEL] == 0 if clear else np.True_
        for c in range(len(ends)):
            values = sign * pixels[..., c]
            counting = counts & np.isfinite(values)
            ends[c] = max(ends[c], np.max(values, where=counting, initial=-np.inf))
    return ends
