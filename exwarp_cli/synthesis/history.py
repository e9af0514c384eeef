"""A slot's surfaces, and where they were in the key frames before the last one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, GBuffer, KeyFrame
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.kernels.follow import follow
from exwarp_cli.synthesis.camera import Scene, scene_of, seen_by
from exwarp_cli.synthesis.geometry import SlotField, matched, reproject
from exwarp_cli.synthesis.surface import lookup, reprojected
from exwarp_cli.synthesis.trajectory import displacement, stencil_of

SAME_POINT = 2.0
"""Pixels of the key frame within which two samples show the same surface point."""


@dataclass(frozen=True)
class Past:
    """An older key frame.

    Attributes
    ----------
    frame
        F_k-1 or F_k-2, on the window of F_k; its motion is settled.
    motion
        float32 [H, W, 2], pixels: where the points of the key frame after it (F_k for F_k-1) are
        in this one, minus where they are there; NaN where unknown.
    """

    frame: KeyFrame
    motion: Float32


@dataclass(frozen=True)
class LookBack:
    """What is known of a slot's surfaces.

    Attributes
    ----------
    surface
        The slot's G-buffer.
    fields
        For F_k-1 and F_k-2, as far as they are there, float32 [H, W, 2]: motion from the slot to
        them, NaN where unknown.
    hidden
        For each of them, bool [H, W]: it does not show the surface point.
    unknown
        bool [H, W]: no frame tells what the slot shows there; depth is NaN.
    """

    surface: GBuffer
    fields: tuple[Float32, ...]
    hidden: tuple[Bool, ...]
    unknown: Bool


def look_back(
    slot: int, back: SlotField, key: GBuffer, past: Sequence[Past], slots: Sequence[GBuffer]
) -> LookBack:
    """Find a slot's surfaces in the older key frames.

    Parameters
    ----------
    slot
        1 to 3.
    back
        Motion field from the slot to the key frame.
    key
        G-buffer of F_k with settled motion.
    past
        F_k-1 and F_k-2, as far as they are there.
    slots
        G-buffers of slots 1 to 3 with settled motion; empty when only key frames have them.
    """
    if slots:
        return _rendered(slot, slots[slot - 1], back, key, past)
    return _reprojected(slot, back, key, past)


def step_back(back: SlotField, there: Float32, before: SlotField) -> SlotField:
    """Return the motion field from a slot to the one before it, from key G-buffers alone.

    Parameters
    ----------
    back
        Motion field from the slot to the key frame.
    there
        float32 [H, W, 2]: motion from the key frame to the slot before.
    before
        Motion field from the slot before to the key frame.

    Returns
    -------
    SlotField
        A hole is what the slot before shows another point of the key frame at, over SAME_POINT
        pixels away.
    """
    field = back.field + lookup(there, back.field, np.nan)
    shown = field + lookup(before.field, field, np.nan)
    away = np.abs(shown - back.field).max(axis=-1)
    hole = ~(away <= SAME_POINT)
    return SlotField(field, back.depth, hole, np.zeros_like(hole))


def _reprojected(slot: int, back: SlotField, key: GBuffer, past: Sequence[Past]) -> LookBack:
    """Look back from key G-buffers alone.

    The key frame's surfaces are moved to the slot, and followed back from the key frame. What it
    does not show comes from the one before, moved on as its own vectors foretell: less exact, but
    the only rendered picture of what has just been disoccluded.
    """
    newer, moved = key, back.field.copy()
    sources = [(newer, moved.copy())]
    fields: list[Float32] = []
    hidden: list[Bool] = []
    lost = np.isnan(moved[..., 0])
    for step in past:
        older = step.frame.gbuffer
        if older is None:
            break
        gone = matched(newer, older, step.motion, FACTOR).hole
        lost = lost | lookup(gone, moved, True)
        follow(step.motion, stencil_of(newer), _ids(newer, moved), _unforeseen(moved), moved)
        if not fields and older.has_motion:
            foretold = reproject(older, 1 + slot / FACTOR)
            new = np.isnan(moved[..., 0]) & ~np.isnan(foretold.field[..., 0])
            moved[new] = foretold.field[new]
            lost[new] = False
            sources.append((older, foretold.field))
        fields.append(moved.copy())
        hidden.append(lost)
        newer = older
    surface, unknown = reprojected(sources)
    return LookBack(surface, tuple(fields), tuple(hidden), unknown)


def _ids(gbuffer: GBuffer, field: Float32) -> np.ndarray:
    """Return the ids that lie at the end of a field; [0, 0] when unknown."""
    stencil = stencil_of(gbuffer)
    return lookup(stencil, field, np.int32(0)) if stencil.size else stencil


def _unforeseen(moved: Float32) -> Float32:
    return np.full_like(moved, np.nan)


def _rendered(
    slot: int, surface: GBuffer, back: SlotField, key: GBuffer, past: Sequence[Past]
) -> LookBack:
    """Look back from the slot's own G-buffer, also at what the last key frame does not show."""
    newer, moved, here = key, back.field.copy(), scene_of(surface)
    fields, hidden = [], []
    for count, step in enumerate(past, start=1):
        older = step.frame.gbuffer
        if older is None:
            break
        steps = slot + FACTOR * count
        foreseen = displacement(surface, -steps) - displacement(surface, FACTOR - steps)
        follow(step.motion, stencil_of(newer), stencil_of(surface), foreseen, moved)
        placed = _placed(moved, here, older, surface)
        fields.append(placed)
        hidden.append(matched(surface, older, placed, steps).hole)
        newer = older
    known = np.zeros(surface.window.shape, np.bool_)
    return LookBack(surface, tuple(fields), tuple(hidden), known)


def _placed(moved: Float32, here: Scene | None, older: GBuffer, surface: GBuffer) -> Float32:
    """Place what stands still by the cameras, where world positions are known."""
    there = None if here is None else scene_of(older)
    if here is None or there is None or there.camera is None or surface.stencil is None:
        return moved.copy()
    still = surface.stencil == 0
    return np.where(still[..., None], seen_by(here, there.camera), moved)
