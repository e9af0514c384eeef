"""Motion fields of slots, from G-buffers of key frames or of slots; and what moves by itself."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, GBuffer, Int32, combine_3x3
from exwarp_cli.kernels import holes, silhouettes, splat
from exwarp_cli.runtime.frame_pool import pool
from exwarp_cli.synthesis import trajectory
from exwarp_cli.synthesis.camera import (
    Index,
    Scene,
    camera_after,
    place_still,
    scene_of,
    seen_by,
    standing,
)
from exwarp_cli.synthesis.gbuffer_values import coarser, depth_step, normal_step, relative_step

# Radians by which the normal of one dynamic surface may turn from slot to slot: ExtraNet's
# constant, which it applies over one step; over three slots it took spinning objects for holes.
TURN_PER_SLOT = math.acos(0.98)

# Pixels by which a static pixel's rendered vector may miss the camera's motion.
STATIC_TOLERANCE = 0.25

# The same for a vector inside a surface, where slow motion has to show. Of points that stand still
# 99 % missed by less than 0.02 px in three shots, by 0.08 in one, and by 0.11 with half-float
# passes. At STATIC_TOLERANCE half of what moved was taken for standing still in slots 1/120 s
# apart; at 0.02 the ground of half-float shots fell into pieces.
SLOW_TOLERANCE = 0.1

# Share of its pixels that have to move for an object to count as moving. Of objects that stand
# still none had any; of those that move, three quarters or more, and what turns slowly about its
# middle up to two fifths. Of plants in the wind five in six reached it over a key interval of
# 1/30 s, of what was near them a quarter, through their edges.
MOVING_SHARE = 0.1

# What kernels take for G-buffer parts that are not known.
_NO_PLANE, _NO_VECTORS = np.zeros((0, 0), np.float32), np.zeros((0, 0, 3), np.float32)
_NO_IDS = np.zeros((0, 0), np.int32)

Scenes = tuple[Scene | None, Scene | None, Scene | None]


@dataclass(frozen=True)
class SlotField:
    """Where a slot's pixels come from."""

    # [H, W, 2], pixels, +x right, +y down: from the slot to the source frame; NaN where unknown.
    field: Float32
    depth: Float32  # [H, W] of the surface that the slot shows; NaN where unknown
    hole: Bool  # [H, W]: the source does not show this surface point
    source: Float32 | None = None  # depth of the source's pixels; None if no colour is mixed

    @cached_property
    def fringe(self) -> Bool:
        """bool [H, W]: the source's colour is mixed with a nearer surface that has moved on."""
        # Moving the mixed pixels with the nearer surface instead, by widening it by a pixel, lost
        # 0.2 dB with one key frame and 0.5 dB with two: a ring of old background went along.
        if self.source is None:
            return np.zeros(self.depth.shape, np.bool_)
        out: Bool = pool.empty(self.depth.shape, np.bool_)
        silhouettes.find_ghosts(self.field, self.depth, self.source, out)
        return out

    @cached_property
    def ghosts(self) -> Bool:
        """bool [H, W]: the outline that a surface leaves beside its hole; filled as the hole is."""
        # `s6` gains 0.4 dB on courtyard, 0.2 on arena, 0.1 on market, `softsplat` 0.2, 0.0 and
        # 0.1; lab loses 0.02. Filling outlines beside no hole lost `s6` 0.1 dB on lab and town.
        if self.source is None:
            return self.fringe
        out: Bool = self.fringe & combine_3x3(self.hole, np.logical_or, mode="edge")
        return out


def depth_of(gbuffer: GBuffer) -> Float32:
    """Return a depth to order surfaces by, float32 [H, W], +inf for background."""
    if gbuffer.depth is not None:
        return gbuffer.depth
    # World positions alone do not tell their distance: all surfaces count as equally near.
    if gbuffer.position is None:
        return np.ones(gbuffer.window.shape, np.float32)
    return np.where(gbuffer.background, np.inf, 1.0).astype(np.float32)


def settle_motion(gbuffer: GBuffer) -> GBuffer:
    """Give every pixel its own surface's motion.

    Renderers filter vectors like colour, so at silhouettes they are mixtures, off by up to 8 px,
    and background has none. Static pixels and the background get the motion of the recovered
    cameras, rigid objects one motion each, moving edges of others that of their inside.
    """
    if not gbuffer.has_motion:
        return gbuffer
    scene, vectors = scene_of(gbuffer), (gbuffer.to_previous, gbuffer.to_next)
    position = _NO_VECTORS if scene is None else np.ascontiguousarray(scene.position)
    surfaces = position, depth_of(gbuffer), trajectory.stencil_of(gbuffer), edges_of(gbuffer)
    rendered = tuple(
        _NO_PLANE if each is None else np.ascontiguousarray(each).reshape(len(each), -1)
        for each in vectors
    )
    settled = tuple(pool.empty(each.shape, np.float32) for each in rendered)
    # To the frames before and after: for points, and for background at infinity.
    cameras = np.full((2, 2, 3, 4), np.nan)
    for (near, far), motion in zip(cameras, vectors, strict=True):
        if scene is None or motion is None:
            continue
        camera = camera_after(scene, motion, gbuffer.stencil)
        if camera is not None:
            near[:] = camera
            far[:, :3], far[:, 3] = camera[:, :3] @ scene.to_ray, 1.0
    silhouettes.clean_vectors(rendered, surfaces, cameras, np.float32(STATIC_TOLERANCE), settled)
    bend = trajectory.move_rigidly(gbuffer, scene, cameras, settled)
    before, after = (
        None if old is None else new.reshape(old.shape)
        for old, new in zip(vectors, settled, strict=True)
    )
    return replace(gbuffer, to_previous=before, to_next=after, bend=bend)


def edges_of(gbuffer: GBuffer) -> Bool:
    """Mark pixels with another surface among their eight neighbours, bool [H, W]."""
    out: Bool = pool.empty(gbuffer.window.shape, np.bool_)
    silhouettes.find_edges(depth_of(gbuffer), trajectory.stencil_of(gbuffer), out)
    return out


def find_still(gbuffer: GBuffer, scene: Scene | None) -> Bool | None:
    """Mark pixels that move as the camera's motion has it; None if no camera is recovered."""
    step = gbuffer.to_next if gbuffer.to_next is not None else gbuffer.to_previous
    if step is None or scene is None:
        return None
    camera = camera_after(scene, step, gbuffer.stencil)
    return None if camera is None else standing(scene, camera, step, STATIC_TOLERANCE)


def reproject(
    gbuffer: GBuffer,  # with settled motion
    time: float,  # of the slot, in key intervals from this key frame; negative is earlier
) -> SlotField:
    """Return the motion field of a slot from a key frame's G-buffer alone."""
    return splat_motion(gbuffer, trajectory.displacement(gbuffer, time))


def splat_motion(
    gbuffer: GBuffer,
    # [H, W, 2], pixels: where each of the frame's pixels moves; NaN for nowhere.
    motion: Float32,
) -> SlotField:
    """Return the motion field back to a frame from where its surfaces move to."""
    spans = -(-motion.shape[1] // splat.REACH_SPAN)
    extents, depth = np.empty((len(motion), spans + 1, 2), np.float32), depth_of(gbuffer)
    splat.splat_row_extents(motion, extents)
    field, near = pool.empty(motion.shape, np.float32), pool.empty(depth.shape, np.float32)
    splat.splat(motion, depth, extents, field, near)
    hole: Bool = pool.empty(depth.shape, np.bool_)
    return SlotField(field, near, np.isnan(near, out=hole), depth)


def fill_unknown(field: SlotField, fallback: SlotField) -> SlotField:
    """Return a motion field with that of `fallback`, of the same slot, where it is unknown."""
    empty = np.isnan(field.depth)
    return SlotField(
        np.where(empty[..., None], fallback.field, field.field),
        np.where(empty, fallback.depth, field.depth),
        field.hole & fallback.hole,
        field.source,
    )


def compose(
    # G-buffers from the one beside the key frame to that of the slot, with settled motion to the
    # slot beside them that way.
    slots: Sequence[GBuffer],
    key: GBuffer,  # G-buffer of the key frame's instant
    way: int,  # -1 if the key frame is before the slots, 1 if it is after them
    # Points of the slot, of the instant beside it, and of the key frame; found if None.
    scenes: Scenes | None = None,
) -> SlotField:
    """Return the motion field from a slot to a key frame, through the slots between them."""
    *others, slot = slots
    if scenes is None:
        scenes = scene_of(slot), scene_of(others[-1] if others else key), scene_of(key)
    step = slot.to_next if way > 0 else slot.to_previous
    assert step is not None
    field = trajectory.trace_points(slot, others[::-1], way)
    scene, adjacent, last = (
        None if each is None or each.camera is None else each for each in scenes
    )
    if scene is not None and adjacent is not None and last is not None:
        # What stands still is placed by the cameras: followed motion goes astray where a nearer
        # surface covers the point in between, though slot and key frame both show it.
        assert adjacent.camera is not None and last.camera is not None
        still = np.isinf(scene.depth) | standing(scene, adjacent.camera, step, STATIC_TOLERANCE)
        place_still(scene, last.camera, still, field, kept=True)
    return field_between(slot, key, field, len(slots))


def field_between(slot: GBuffer, key: GBuffer, field: Float32, count: int) -> SlotField:
    """Test the motion field between two instants, `count` slots apart, for holes."""
    return SlotField(field, depth_of(slot), find_holes(slot, key, field, count), depth_of(key))


def find_holes(slot: GBuffer, key: GBuffer, field: Float32, count: int) -> Bool:
    """Find holes, bool [H, W], of a motion field between two instants, `count` slots apart."""
    depths = depth_of(slot), depth_of(key)
    stencils, positions, normals = (_NO_IDS,) * 2, (_NO_VECTORS,) * 2, (_NO_VECTORS,) * 2
    if slot.stencil is not None and key.stencil is not None:
        stencils = slot.stencil, key.stencil
        # Without ids a moving point is not distinguishable from another one: its world position
        # changes too.
        if slot.position is not None and key.position is not None:
            positions = slot.position, key.position
    turn = 0.0  # that rounding alone may explain
    if slot.normal is not None and key.normal is not None:
        normals = slot.normal, key.normal
        turn = math.sqrt(3) * max(map(normal_step, normals))
    nothing = np.float32(0)
    if positions[0].size:  # which are compared instead of depths
        steps = nothing, nothing, np.float32(max(map(relative_step, positions)))
    else:
        steps = *coarser(*map(depth_step, depths)), nothing
    cosine = math.cos(min(count * TURN_PER_SLOT + turn, math.pi))
    hole = np.empty(depths[0].shape, np.bool_)
    holes.mark_holes(
        field, depths, stencils, positions, normals, (np.float32(cosine), *steps), hole
    )
    return hole


def find_moving(
    now: GBuffer,  # with settled motion
    before: GBuffer | None,  # the instant that `to_previous` leads to; None where there is none
    # `now` before its motion was settled, if available: settled motion has no slow motion, and
    # counts at edges alone then.
    raw: GBuffer | None,
) -> Bool | None:
    """Find the pixels whose world position changes; background never does.

    Returns bool [H, W]; None if no camera is recovered.
    """
    scene = scene_of(now)
    # World positions of both instants give both cameras, however much of the frame moves. The
    # camera that fits the vectors best takes more than half of them to stand still: in a shot of
    # leaves in the wind it was not found in every other frame.
    previous = None if before is None or before.position is None else scene_of(before)
    if (
        now.to_previous is None
        or scene is None
        or scene.camera is None
        or previous is None
        or previous.camera is None
    ):
        still = find_still(now, scene)
        return None if still is None else np.asarray(~still & ~now.background)
    rigid = seen_by(scene, previous.camera)
    with np.errstate(invalid="ignore"):  # unknown vectors differ
        moves = ~(np.abs(now.to_previous - rigid).max(axis=-1) <= STATIC_TOLERANCE)
        if raw is not None and raw.to_previous is not None:
            # At edges a vector is a mixture, or the nearest inside's; one of them may be wrong.
            differs = ~(np.abs(raw.to_previous - rigid).max(axis=-1) <= SLOW_TOLERANCE)
            moves = differs & (moves | ~edges_of(raw))
    return np.asarray(moves & ~now.background)


def moving_ids(
    objects: Int32,  # [H, W], id of whatever is visible; 0 background, negative where ids mix
    moves: Bool,  # [H, W], from `find_moving`
) -> frozenset[int]:
    """Return the ids of the objects at least MOVING_SHARE of whose pixels move."""
    values, sizes, starts = _runs(objects)
    if not values.size:
        return frozenset()
    counts = np.add.reduceat(moves.ravel().astype(np.int64), starts)
    ids, which = np.unique(values, return_inverse=True)
    total = np.bincount(which, sizes)
    moving = ids[(np.bincount(which, counts) >= MOVING_SHARE * total) & (ids > 0)]
    return frozenset(moving.tolist())


def select_ids(objects: Int32, ids: Collection[int]) -> Int32:
    """Return a stencil, int32 [H, W], of these objects, 0 elsewhere; negative ids stay."""
    values, sizes, _ = _runs(objects)
    selected = (values < 0) | np.isin(values, np.array(sorted(ids), np.int32))
    stencil = np.repeat(np.where(selected, values, 0), sizes)
    return np.asarray(stencil.reshape(objects.shape), dtype=np.int32)


def _runs(objects: Int32) -> tuple[Int32, Index, Index]:
    """Return the id, length and start of each run of equal ids."""
    # Neighbours mostly have the same id: sorting runs of them takes a tenth of the time.
    flat = objects.ravel()
    if not flat.size:
        return flat, np.zeros(0, np.intp), np.zeros(0, np.intp)
    starts = np.concatenate(([0], np.flatnonzero(flat[1:] != flat[:-1]) + 1))
    return flat[starts], np.diff(starts, append=flat.size), starts
