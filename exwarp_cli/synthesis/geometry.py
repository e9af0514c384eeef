"""Motion fields of slots, from the G-buffers of key frames or of the slots themselves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, GBuffer, combine_3x3
from exwarp_cli.kernels import holes, silhouettes, splat
from exwarp_cli.runtime.frame_pool import pool
from exwarp_cli.synthesis.camera import (
    Scene,
    camera_after,
    cameras_around,
    place_still,
    scene_of,
    standing,
)
from exwarp_cli.synthesis.rigid import move_rigidly
from exwarp_cli.synthesis.rounding import coarser, depth_step, normal_step, relative_step
from exwarp_cli.synthesis.trajectory import displaced, followed, reach_of, stencil_of

TURN_PER_SLOT = math.acos(0.98)
"""Radians by which the normal of one dynamic surface may turn from slot to slot: ExtraNet's
constant, which it applies over one step; over three slots it took spinning objects for holes."""

STATIC_TOLERANCE = 0.25
"""Pixels by which a static pixel's rendered vector may miss the camera's motion."""

Scenes = tuple[Scene | None, Scene | None, Scene | None]

_NOWHERE = np.zeros((0, 0), np.float32)


@dataclass(frozen=True)
class SlotField:
    """Where a slot's pixels come from.

    Attributes
    ----------
    field
        float32 [H, W, 2], pixels, +x right, +y down: from the slot to the source frame; NaN where
        nothing is known.
    depth
        float32 [H, W]: depth of the surface that the slot shows; NaN where nothing is known.
    hole
        bool [H, W]: the source does not show this surface point.
    source
        float32 [H, W]: depth of the source's pixels; None where its colour is nowhere mixed.
    """

    field: Float32
    depth: Float32
    hole: Bool
    source: Float32 | None = None

    @cached_property
    def fringe(self) -> Bool:
        """bool [H, W]: where the source's colour is mixed with a nearer surface that has moved on.

        Moving the mixed pixels with the nearer surface instead, by widening it by a pixel, lost 0.2
        dB with one key frame and 0.5 dB with two: a ring of old background went along.
        """
        if self.source is None:
            return np.zeros(self.depth.shape, np.bool_)
        out: Bool = pool.empty(self.depth.shape, np.bool_)
        silhouettes.find_ghosts(self.field, self.depth, self.source, out)
        return out

    @cached_property
    def ghosts(self) -> Bool:
        """bool [H, W]: the outline that a surface leaves beside the hole where it was.

        It is filled as the hole is. `s6` gains 0.4 dB on courtyard, 0.2 on arena, 0.1 on market,
        `softsplat` 0.2, 0.0 and 0.1; lab loses 0.02. Filling outlines that no hole is beside lost
        `s6` 0.1 dB on lab and town.
        """
        if self.source is None:
            return self.fringe
        out: Bool = self.fringe & combine_3x3(self.hole, np.logical_or, mode="edge")
        return out


def depth_of(gbuffer: GBuffer) -> Float32:
    """Return a depth to order surfaces by, float32 [H, W], +inf for background.

    Without a depth pass the distance of the world positions from their common centre of projection
    is not known either, so all surfaces count as equally near.
    """
    if gbuffer.depth is not None:
        return gbuffer.depth
    if gbuffer.position is None:
        return np.ones(gbuffer.window.shape, np.float32)
    return np.where(gbuffer.background, np.inf, 1.0).astype(np.float32)


def settle_motion(gbuffer: GBuffer) -> GBuffer:
    """Give every pixel its own surface's motion.

    Renderers filter vectors like colour, so at silhouettes they are mixtures, and background has
    none. Static pixels and the background get the motion of the recovered cameras, rigid objects
    one motion of their own, moving edges of others that of their inside. A mixture was found to be
    off by up to 8 px.
    """
    if not gbuffer.has_motion:
        return gbuffer
    scene, vectors = scene_of(gbuffer), (gbuffer.to_previous, gbuffer.to_next)
    depth, stencil = depth_of(gbuffer), stencil_of(gbuffer)
    edge: Bool = pool.empty(depth.shape, np.bool_)
    silhouettes.find_edges(depth, stencil, edge)
    position = _NOWHERE if scene is None else _flat(scene.position)
    surfaces = position, depth, stencil, edge
    given = tuple(_NOWHERE if way is None else _flat(way) for way in vectors)
    found = tuple(pool.empty(way.shape, np.float32) for way in given)
    cameras = cameras_around(scene, vectors, gbuffer.stencil)
    silhouettes.clean_vectors(given, surfaces, cameras, np.float32(STATIC_TOLERANCE), found)
    bend = move_rigidly(gbuffer, scene, cameras, found)
    before, after = (
        None if way is None else settled.reshape(way.shape)
        for way, settled in zip(vectors, found, strict=True)
    )
    return replace(gbuffer, to_previous=before, to_next=after, bend=bend)


def _flat(array: Float32) -> Float32:
    """Return [H, W, C] as rows [H, W C]."""
    height, width, channels = array.shape
    return np.ascontiguousarray(array).reshape(height, width * channels)


def stands_still(gbuffer: GBuffer, scene: Scene | None) -> Bool | None:
    """bool [H, W]: pixels that move as the camera's motion has it; None where no camera tells."""
    step = gbuffer.to_next if gbuffer.to_next is not None else gbuffer.to_previous
    if step is None or scene is None:
        return None
    camera = camera_after(scene, step, gbuffer.stencil)
    return None if camera is None else standing(scene, camera, step, STATIC_TOLERANCE)


def reproject(gbuffer: GBuffer, time: float) -> SlotField:
    """Return the motion field of a slot from a key frame's G-buffer alone.

    Parameters
    ----------
    gbuffer
        With settled motion.
    time
        Of the slot, in key intervals from this key frame; negative is earlier.
    """
    return moved_on(gbuffer, *displaced(gbuffer, time))


def moved_on(gbuffer: GBuffer, motion: Float32, reach: Float32 | None = None) -> SlotField:
    """Return the motion field back from where a frame's surfaces come to lie.

    Parameters
    ----------
    gbuffer
        Of the frame.
    motion
        float32 [H, W, 2], pixels: where each of its pixels moves; NaN for nowhere.
    reach
        Of the motion, from `reach_of`, where it is known.
    """
    reach = reach_of(motion) if reach is None else reach
    depth = depth_of(gbuffer)
    field, near = pool.empty(motion.shape, np.float32), pool.empty(depth.shape, np.float32)
    splat.splat(motion, depth, reach, field, near)
    hole: Bool = pool.empty(depth.shape, np.bool_)
    return SlotField(field, near, np.isnan(near, out=hole), depth)


def completed(field: SlotField, other: SlotField) -> SlotField:
    """Return a motion field with that of another one, of the same slot, where it knows nothing."""
    empty = np.isnan(field.depth)
    return SlotField(
        np.where(empty[..., None], other.field, field.field),
        np.where(empty, other.depth, field.depth),
        field.hole & other.hole,
        field.source,
    )


def compose_back(slots: Sequence[GBuffer], key: GBuffer) -> list[SlotField]:
    """Return the motion fields of slots 1, 2 … to their key frame.

    Parameters
    ----------
    slots
        G-buffers of the slots after the key frame, in order, with settled motion to the previous
        slot.
    key
        G-buffer of the key frame's instant.
    """
    return _chain(slots, key, -1)


def composed_back(slots: Sequence[GBuffer], key: GBuffer, scenes: Scenes) -> SlotField:
    """Return the motion field of the last of some slots to their key frame.

    Parameters
    ----------
    slots, key
        As for `compose_back`, up to that slot.
    scenes
        The points of that slot, of the instant before it, and of the key frame.
    """
    return _composed(slots, key, scenes, -1)


def compose_forward(slots: Sequence[GBuffer], key: GBuffer) -> list[SlotField]:
    """Return the motion fields of slots to the key frame after them, by their to-next vectors."""
    return _chain(slots[::-1], key, 1)[::-1]


def _chain(slots: Sequence[GBuffer], key: GBuffer, way: int) -> list[SlotField]:
    """Follow each slot's points to a key frame, the nearest first; `way` is -1 back in time."""
    last, *each = (scene_of(gbuffer) for gbuffer in (key, *slots))
    scenes = zip(each, [last, *each[:-1]], strict=True)
    return [
        _composed(slots[:count], key, (*pair, last), way)
        for count, pair in enumerate(scenes, start=1)
    ]


def _composed(slots: Sequence[GBuffer], key: GBuffer, scenes: Scenes, way: int) -> SlotField:
    """Follow the last slot's points through the others to a key frame.

    What stands still is placed by the cameras instead: followed motion goes astray where a nearer
    surface covers the point in between, though slot and key frame both show it.
    """
    *others, slot = slots
    here, before, last = scenes
    step = slot.to_next if way > 0 else slot.to_previous
    assert step is not None
    field = followed(slot, others[::-1], way)
    still = _still(here, before, step)
    if still is not None and here is not None and last is not None and last.camera is not None:
        place_still(here, last.camera, still, field, kept=True)
    return matched(slot, key, field, len(slots))


def _still(here: Scene | None, before: Scene | None, step: Float32) -> Bool | None:
    """Return which points of a slot stand still; None without world positions.

    A point does if its step to the neighbouring slot is the cameras'.
    """
    if here is None or before is None or here.camera is None or before.camera is None:
        return None
    return np.isinf(here.depth) | standing(here, before.camera, step, STATIC_TOLERANCE)


def matched(slot: GBuffer, key: GBuffer, field: Float32, count: int) -> SlotField:
    """Test the motion field between two instants, `count` slots apart, for holes."""
    hole = unmatched(slot, key, field, count)
    return SlotField(field, depth_of(slot), hole, depth_of(key))


def unmatched(slot: GBuffer, key: GBuffer, field: Float32, count: int) -> Bool:
    """Find holes, bool [H, W], of a motion field between two instants, `count` slots apart."""
    depth = depth_of(slot)
    stencils = (
        (stencil_of(slot), stencil_of(key))
        if slot.stencil is not None and key.stencil is not None
        else (np.zeros((0, 0), np.int32),) * 2
    )
    none = np.zeros((0, 0, 3), np.float32)
    positions = (none, none)
    # Without ids a moving point is not distinguishable from another one: its world position
    # changes too.
    if stencils[0].size and slot.position is not None and key.position is not None:
        positions = (slot.position, key.position)
    normals = (none, none)
    if slot.normal is not None and key.normal is not None:
        normals = (slot.normal, key.normal)
    hole = np.empty(depth.shape, np.bool_)
    depths = depth, depth_of(key)
    cosine = math.cos(min(count * TURN_PER_SLOT + _turn_of(normals), math.pi))
    limits = np.float32(cosine), *_steps_of(depths, positions)
    holes.mark_holes(field, depths, stencils, positions, normals, limits, hole)
    return hole


def _steps_of(
    depths: tuple[Float32, Float32], positions: tuple[Float32, Float32]
) -> tuple[np.float32, np.float32, np.float32]:
    """Return the steps that depths, their inverse and positions of two instants were rounded to."""
    nothing = np.float32(0)
    if positions[0].size:  # which are compared instead of depths
        return nothing, nothing, np.float32(max(relative_step(p) for p in positions))
    return *coarser(*map(depth_step, depths)), nothing


def _turn_of(normals: tuple[Float32, Float32]) -> float:
    """Return by which angle, radians, rounding alone may turn a normal between two instants."""
    if not normals[0].size:
        return 0.0
    return math.sqrt(3) * max(normal_step(normal) for normal in normals)
