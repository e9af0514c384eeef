"""A slot's surfaces, and where they were in the key frames before the last one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, GBuffer, KeyFrame
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.kernels import point_motion
from exwarp_cli.runtime.frame_pool import IN_MEMORY, ScratchFrames, pool
from exwarp_cli.synthesis import motion_fields
from exwarp_cli.synthesis.camera import Scene, camera_after, place_still, scene_of
from exwarp_cli.synthesis.gbuffer_values import EXACT
from exwarp_cli.synthesis.trajectory import displacement, stencil_of
from exwarp_cli.synthesis.warp import sample_bilinear

# Pixels of the key frame within which two samples show the same surface point.
SAME_POINT = 2.0

# Factor by which the light on the same surfaces may differ in an older key frame. Beyond, it was a
# fade, a flash or a lamp: the network painted speckles of the other light, up to 120 of 255 after a
# black key frame.
LIGHT_CHANGE = 2.0

# Parts that a slot takes over from the nearest pixel: what networks receive of a surface, and depth
# to fill holes by.
NEAREST = ("depth", "normal", "roughness", "metallic")

# Parts that are sampled bilinearly, as colour is, so that they cancel where colour is divided by
# them.
SMOOTH = ("albedo", "specular")

# Rows that are looked up at a time.
ROWS = 64

# What the kernels take for expected motion that is not known, and depths that are not compared.
_UNFORESEEN = (np.zeros((0, 0, 2), np.float32),) * 2
_UNCOMPARED = (np.zeros((0, 0), np.float32),) * 2


@dataclass(frozen=True)
class OlderKeyFrame:
    """An older key frame."""

    frame: KeyFrame  # F_k-1 or F_k-2, on the window of F_k; its motion is settled
    # [H, W, 2], pixels: where the points of the key frame after it (F_k for F_k-1) are in this one,
    # minus where they are there; NaN where unknown.
    motion: Float32
    guessed: bool = False  # `motion` is that to the frame after, reversed: no vectors lead back

    @cached_property
    def scene(self) -> Scene | None:
        """The frame's points."""
        return None if self.frame.gbuffer is None else scene_of(self.frame.gbuffer)

    @cached_property
    def stands(self) -> Bool | None:
        """bool [H, W]: what stands still in the world; None if no camera is recovered."""
        gbuffer, scene = self.frame.gbuffer, self.scene
        if gbuffer is None or scene is None or scene.camera is None:
            return None
        return motion_fields.find_still(gbuffer, scene)


def older_key_frames(
    # Successive ones, the newest first, on one window, with settled motion between key frames.
    keys: Sequence[KeyFrame],
) -> tuple[OlderKeyFrame, ...]:
    """Return all key frames but the first as older ones of it, by their own vectors."""
    older_frames = []
    for newer, older in pairwise(keys):
        assert newer.gbuffer is not None
        guessed = newer.gbuffer.to_previous is None
        older_frames.append(OlderKeyFrame(older, displacement(newer.gbuffer, -1), guessed))
    return tuple(older_frames)


def is_lit_alike(
    # [H, W, 3 or more], scene-linear, moved to one instant.
    frame: Float32,
    other: Float32,
    both: Bool,  # [H, W]: where both show the surface
) -> bool:
    """Return True if the surfaces that two frames show have about the same light in both."""
    lights = []
    for pixels in (frame, other):
        # A mean of roots: highlights dominate a mean, a dark background dominates a median.
        roots = (np.sqrt(np.abs(pixels[..., c])) for c in range(3))
        lights.append(sum(float(np.sum(root, where=both, dtype=np.float64)) for root in roots) ** 2)
    return max(lights) <= LIGHT_CHANGE * min(lights)


@dataclass(frozen=True)
class HistorySamples:
    """What is known of a slot's surfaces."""

    surface: GBuffer  # the slot's; from key G-buffers alone without ids, positions and motion
    # For F_k-1 and F_k-2, as far as they exist, [H, W, 2]: motion from the slot; NaN where unknown.
    fields: tuple[Float32, ...]
    hidden: tuple[Bool, ...]  # for each of them, [H, W]: it does not show the surface point
    unknown: Bool  # [H, W]: no frame shows the slot's surface; depth is NaN


def look_back_reprojected(
    time: float,  # of the slot, in key intervals after the key frame
    back: motion_fields.SlotField,  # motion field from the slot to the key frame
    key: GBuffer,  # of F_k, with settled motion
    past: Sequence[OlderKeyFrame],  # F_k-1 and F_k-2, as far as they exist
    scene: Scene | None,  # the key frame's points; only used where there are older key frames
    scratch: ScratchFrames = IN_MEMORY,  # where large arrays are kept
) -> HistorySamples:
    """Find a slot's surfaces in the older key frames, from key G-buffers alone.

    The key frame's surfaces are moved to the slot, and followed back from the key frame. What it
    does not show comes from the ones before, moved on to the slot: the only rendered pictures of
    what has just been disoccluded.
    """
    newer, moved = key, back.field
    camera = None
    if past and scene is not None and scene.camera is not None:
        motion = displacement(key.without("bend"), time)
        camera = camera_after(scene, motion, key.stencil)
    sources = [(newer, back.field)]
    fields: list[Float32] = []
    hidden: list[Bool] = []
    lost = np.isnan(moved[..., 0])
    for count, older in enumerate(past, start=1):
        gbuffer = older.frame.gbuffer
        if gbuffer is None:
            break
        # What the key frame after it shows, and this one does not.
        gone = motion_fields.find_holes(newer, gbuffer, older.motion, FACTOR)
        scratch.page_out()
        led, missed = pool.empty(moved.shape, np.float32), pool.empty(lost.shape, np.bool_)
        point_motion.follow_visible(older.motion, stencil_of(newer), gone, moved, lost, led, missed)
        moved, lost = led, missed
        if gbuffer.has_motion:
            # What stands still is placed by the camera of the slot. What moves by itself is moved
            # from the last older key frame alone: from the one before that, it is unknown.
            if count > 1:
                motion = np.full(moved.shape, np.nan, np.float32)
            else:
                motion = displacement(gbuffer, count + time)
            if camera is not None and older.scene is not None and older.stands is not None:
                place_still(older.scene, camera, older.stands, motion)
            scratch.page_out()
            predicted = motion_fields.splat_motion(gbuffer, motion).field
            # Points of unknown origin get the predicted place.
            fills = np.isnan(moved[..., 0]) & ~np.isnan(predicted[..., 0])
            moved[fills], lost[fills] = predicted[fills], False
            sources.append((gbuffer, predicted))
        fields.append(moved)
        hidden.append(lost)
        newer = gbuffer
    scratch.page_out()
    gbuffer, unknown = _reproject_surfaces(sources)
    return HistorySamples(gbuffer, tuple(fields), tuple(hidden), unknown)


def look_back_rendered(
    slot: int,  # 1 to 3
    gbuffer: GBuffer,  # of the slot, with settled motion
    back: motion_fields.SlotField,  # motion field from the slot to the key frame
    # As of `look_back_reprojected`, but for the scene: the slot's points.
    key: GBuffer,
    past: Sequence[OlderKeyFrame],
    scene: Scene | None,
    scratch: ScratchFrames = IN_MEMORY,
) -> HistorySamples:
    """Find a slot's surfaces in the older key frames, also what the last key frame does not show.

    By the slot's own G-buffer.
    """
    newer, moved = key, pool.copy(back.field)
    fields, hidden = [], []
    for count, older in enumerate(past, start=1):
        scratch.page_out()
        if older.frame.gbuffer is None:
            break
        # Its own vectors predict a point so many slots ago badly: with them older frames were up to
        # 1.4 dB further from the truth where things move. Depth shows a hidden point only where
        # something else predicts its motion.
        ids = stencil_of(newer), stencil_of(gbuffer)
        vectors = older.motion, _UNFORESEEN[0]
        point_motion.follow_points(
            vectors, ids, _UNCOMPARED, EXACT, np.float32(0), _UNFORESEEN, moved
        )
        placed, there = moved.copy(), older.scene
        camera = None if there is None else there.camera
        if scene is not None and camera is not None and gbuffer.stencil is not None:
            place_still(scene, camera, gbuffer.stencil == 0, placed)
        fields.append(placed)
        newer = older.frame.gbuffer
        hidden.append(motion_fields.find_holes(gbuffer, newer, placed, slot + FACTOR * count))
    nothing = np.zeros(gbuffer.window.shape, np.bool_)
    return HistorySamples(gbuffer, tuple(fields), tuple(hidden), unknown=nothing)


def _reproject_surfaces(
    # G-buffers on one window, each with the motion field float32 [H, W, 2] from the slot to it, NaN
    # where it shows nothing of the slot. Each pixel comes from the first that shows it.
    sources: Sequence[tuple[GBuffer, Float32]],
) -> tuple[GBuffer, Bool]:
    """Return a slot's G-buffer, taken from other frames', and where nothing shows what is there.

    It has those parts out of NEAREST and SMOOTH that the first source has, and a depth in any case.
    Where nothing shows what is there, bool [H, W], depth is NaN, and all else is 0.
    """
    first, motion = sources[0]
    first = replace(first, depth=motion_fields.depth_of(first))
    parts: dict[str, Any] = {}
    for name in NEAREST:
        if (array := getattr(first, name)) is not None:
            parts[name] = pool.empty(array.shape, array.dtype)
    # Nearly all of it: four times as fast for the whole frame as pixel by pixel.
    for name in SMOOTH:
        if (array := getattr(first, name)) is not None:
            parts[name], _ = sample_bilinear(array, motion)
    unknown = np.ones(first.window.shape, np.bool_)

    def plane(name: str, values: Float32 | None) -> Float32:
        """Return what the kernel takes, nothing for what is not taken over."""
        if values is None or name not in parts:
            return np.zeros((0, 0, 0), np.float32)
        return np.ascontiguousarray(values).reshape(*values.shape[:2], -1)

    for count, (gbuffer, motion) in enumerate(sources):
        own = {name: getattr(gbuffer, name) for name in (*NEAREST, *SMOOTH)}
        own["depth"] = motion_fields.depth_of(gbuffer)
        if count == 0:  # SMOOTH is there already
            own |= dict.fromkeys(SMOOTH)
        point_motion.copy_surface(
            motion,
            tuple(plane(name, own[name]) for name in NEAREST),
            tuple(plane(name, own[name]).reshape(-1) for name in SMOOTH),
            tuple(plane(name, parts.get(name)) for name in NEAREST),
            tuple(plane(name, parts.get(name)).reshape(-1) for name in SMOOTH),
            unknown,
            count == 0,
        )
    return GBuffer(first.window, **parts), unknown


def step_back(
    # Motion fields to the key frame, from the slot and from the slot before.
    back: motion_fields.SlotField,
    there: Float32,  # [H, W, 2]: motion from the key frame to the slot before
    before: motion_fields.SlotField,
) -> motion_fields.SlotField:
    """Return the motion field from a slot to the one before it, from key G-buffers alone.

    A hole is what the slot before shows another point of the key frame at, over SAME_POINT pixels
    away.
    """
    field = back.field + _nearest_at_end(there, back.field)
    to_key = field + _nearest_at_end(before.field, field)
    miss = np.abs(to_key - back.field).max(axis=-1)
    return motion_fields.SlotField(field, back.depth, ~(miss <= SAME_POINT))


def _nearest_at_end(array: Float32, field: Float32) -> Float32:
    """Return the pixel [H, W, C] nearest to the end of a motion field; NaN outside the frame."""
    height, width = field.shape[:2]
    out = np.full_like(array, np.nan)
    for first in range(0, height, ROWS):  # as float64 places are larger than a plane
        rows = slice(first, min(first + ROWS, height))
        x = np.arange(width) + field[rows, :, 0] + 0.5
        y = np.arange(rows.start, rows.stop)[:, None] + field[rows, :, 1] + 0.5
        inside = (x >= 0) & (y >= 0) & (x <= width) & (y <= height)  # False for NaN
        left = np.minimum(x[inside].astype(np.intp), width - 1)
        top = np.minimum(y[inside].astype(np.intp), height - 1)
        out[rows][inside] = array[top, left]
    return out
