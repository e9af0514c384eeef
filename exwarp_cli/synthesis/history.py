"""A slot's surfaces, and where they were in the key frames before the last one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, GBuffer, KeyFrame
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.kernels import point_motion
from exwarp_cli.kernels.point_motion import follow_points, follow_visible
from exwarp_cli.runtime.frame_pool import IN_MEMORY, ScratchFrames, pool
from exwarp_cli.synthesis.camera import Camera, Index, Scene, camera_by, place_still, scene_of
from exwarp_cli.synthesis.gbuffer_values import EXACT
from exwarp_cli.synthesis.motion_fields import (
    SlotField,
    depth_of,
    find_holes,
    find_still,
    splat_motion,
)
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
_UNFORESEEN = np.zeros((0, 0, 2), np.float32)
_UNCOMPARED = (np.zeros((0, 0), np.float32),) * 2


@dataclass(frozen=True)
class OlderKeyFrame:
    """An older key frame."""

    frame: KeyFrame  # F_k-1 or F_k-2, on the window of F_k; its motion is settled
    # [H, W, 2], pixels: where the points of the key frame after it (F_k for F_k-1) are in this one,
    # minus where they are there; NaN where unknown.
    motion: Float32
    guessed: bool = False  # `motion` is that to the frame after, reversed: no vectors lead back

    _gone: list[tuple[GBuffer, Bool]] = field(default_factory=list, init=False, compare=False)

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
        return find_still(gbuffer, scene)

    def gone(self, newer: GBuffer) -> Bool:
        """bool [H, W]: what the key frame after it, `newer`, shows, and this one does not."""
        if not self._gone or self._gone[0][0] is not newer:
            assert self.frame.gbuffer is not None
            hidden = find_holes(newer, self.frame.gbuffer, self.motion, FACTOR)
            self._gone[:] = [(newer, hidden)]
        return self._gone[0][1]


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


@dataclass(frozen=True)
class KeyHistory:
    """A key frame and the older ones: what all slots that look back from it share, found lazily."""

    key: GBuffer  # of F_k, with settled motion
    past: Sequence[OlderKeyFrame]  # F_k-1 and F_k-2, as far as they exist
    scratch: ScratchFrames = IN_MEMORY  # where large arrays are kept

    @cached_property
    def gone(self) -> tuple[Bool, ...]:
        """For each older key frame with geometry, `OlderKeyFrame.gone`."""
        masks, newer = [], self.key
        for older in self.past:
            if older.frame.gbuffer is None:
                break
            masks.append(older.gone(newer))
            newer = older.frame.gbuffer
            self.scratch.page_out()
        return tuple(masks)

    def camera_at(self, time: float) -> Camera | None:
        """Predict the camera of a slot by the key frame's motion, in world space."""
        scene = self._scene
        if scene is None or scene.camera is None:
            return None

        def motion_at(index: Index) -> Float32:
            before, after = (
                None if vectors is None else vectors.reshape(-1, 2)[index][None]
                for vectors in (self.key.to_previous, self.key.to_next)
            )
            points = replace(self.key, to_previous=before, to_next=after, bend=None)
            motion: Float32 = displacement(points, time)[0]
            return motion

        return camera_by(scene, motion_at, self.key.stencil)

    @cached_property
    def _scene(self) -> Scene | None:
        return scene_of(self.key)


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


def look_back(
    slot: int,  # 1 to 3
    back: SlotField,  # motion field from the slot to the key frame
    # G-buffers of slots 1 to 3 with settled motion; empty when only key frames have them.
    slots: Sequence[GBuffer],
    history: KeyHistory,
    scene: Scene | None = None,  # the slot's points, if its G-buffer has them
) -> HistorySamples:
    """Find a slot's surfaces in the older key frames."""
    if slots:
        return _look_back_rendered(slot, slots[slot - 1], back, history, scene)
    return _look_back_reprojected(slot, back, history)


def _look_back_reprojected(slot: int, back: SlotField, history: KeyHistory) -> HistorySamples:
    """Look back from key G-buffers alone.

    The key frame's surfaces are moved to the slot, and followed back from the key frame. What it
    does not show comes from the ones before, moved on to the slot: the only rendered pictures of
    what has just been disoccluded.
    """
    time, newer, moved = slot / FACTOR, history.key, back.field
    camera = history.camera_at(time) if history.past else None
    sources = [(newer, back.field)]
    fields: list[Float32] = []
    hidden: list[Bool] = []
    lost = np.isnan(moved[..., 0])
    for count, (older, gone) in enumerate(zip(history.past, history.gone, strict=False), start=1):
        gbuffer = older.frame.gbuffer
        assert gbuffer is not None
        history.scratch.page_out()
        led, missed = pool.empty(moved.shape, np.float32), pool.empty(lost.shape, np.bool_)
        follow_visible(older.motion, stencil_of(newer), gone, moved, lost, led, missed)
        moved, lost = led, missed
        if gbuffer.has_motion:
            motion = _predict_motion(older, gbuffer, count, time, camera)
            history.scratch.page_out()
            predicted = splat_motion(gbuffer, motion).field
            # Points of unknown origin get the predicted place.
            fills = np.isnan(moved[..., 0]) & ~np.isnan(predicted[..., 0])
            moved[fills], lost[fills] = predicted[fills], False
            sources.append((gbuffer, predicted))
        fields.append(moved)
        hidden.append(lost)
        newer = gbuffer
    history.scratch.page_out()
    gbuffer, unknown = _reproject_surfaces(sources)
    return HistorySamples(gbuffer, tuple(fields), tuple(hidden), unknown)


def _predict_motion(
    older: OlderKeyFrame, gbuffer: GBuffer, count: int, time: float, camera: Camera | None
) -> Float32:
    """Return where an older key frame's pixels move to, float32 [H, W, 2].

    What stands still is placed by the camera of the slot. What moves by itself is moved from the
    last older key frame alone: from the one before that (`count` 2), it is unknown.
    """
    if count > 1:
        motion = np.full((*gbuffer.window.shape, 2), np.nan, np.float32)
    else:
        motion = displacement(gbuffer, count + time)
    if camera is not None and older.scene is not None and older.stands is not None:
        place_still(older.scene, camera, older.stands, motion)
    return motion


def _look_back_rendered(
    slot: int, gbuffer: GBuffer, back: SlotField, history: KeyHistory, scene: Scene | None
) -> HistorySamples:
    """Look back from the slot's own G-buffer, also at what the last key frame does not show."""
    newer, moved = history.key, pool.copy(back.field)
    fields, hidden = [], []
    for count, older in enumerate(history.past, start=1):
        history.scratch.page_out()
        if older.frame.gbuffer is None:
            break
        # Its own vectors predict a point so many slots ago badly: with them older frames were up to
        # 1.4 dB further from the truth where things move. Depth shows a hidden point only where
        # something else predicts its motion.
        ids = stencil_of(newer), stencil_of(gbuffer)
        follow_points(older.motion, ids, _UNCOMPARED, EXACT, np.float32(0), _UNFORESEEN, moved)
        placed, there = moved.copy(), older.scene
        if scene and there and there.camera and gbuffer.stencil is not None:
            place_still(scene, there.camera, gbuffer.stencil == 0, placed)
        fields.append(placed)
        hidden.append(find_holes(gbuffer, older.frame.gbuffer, placed, slot + FACTOR * count))
        newer = older.frame.gbuffer
    nothing = np.zeros(gbuffer.window.shape, np.bool_)
    return HistorySamples(gbuffer, tuple(fields), tuple(hidden), unknown=nothing)


def _reproject_surfaces(
    # G-buffers on one window, each with the motion field float32 [H, W, 2] from the slot to it, NaN
    # where it shows nothing of the slot. Each pixel comes from the first that shows it.
    sources: Sequence[tuple[GBuffer, Float32]],
) -> tuple[GBuffer, Bool]:
    """Return a slot's G-buffer, taken from other frames'.

    Returns
    -------
    GBuffer
        Those parts out of NEAREST and SMOOTH that the first source has, and a depth in any case:
        NaN where nothing shows what is there, as all else is 0.
    bool [H, W]
        Where that is so.
    """
    (first, motion), *others = sources
    first = replace(first, depth=depth_of(first))
    parts: dict[str, Any] = {}
    for name in NEAREST:
        if (array := getattr(first, name)) is not None:
            parts[name] = pool.empty(array.shape, array.dtype)
    # Nearly all of it: four times as fast for the whole frame as pixel by pixel.
    for name in SMOOTH:
        if (array := getattr(first, name)) is not None:
            parts[name], _ = sample_bilinear(array, motion)
    unknown = np.ones(first.window.shape, np.bool_)
    _take_over(first.without(*SMOOTH), motion, parts, unknown, blanks=True)
    for gbuffer, motion in others:
        _take_over(replace(gbuffer, depth=depth_of(gbuffer)), motion, parts, unknown)
    return GBuffer(first.window, **parts), unknown


def _take_over(
    gbuffer: GBuffer, field: Float32, parts: dict[str, Float32], unknown: Bool, blanks: bool = False
) -> None:
    """Take over what is known of a frame where a slot's parts are not known yet."""

    def array(name: str, source: Mapping[str, Float32 | None]) -> Float32:
        values = source[name] if name in parts else None
        if values is None:
            return np.zeros((0, 0, 0), np.float32)
        return np.ascontiguousarray(values).reshape(*values.shape[:2], -1)

    own = {name: getattr(gbuffer, name) for name in (*NEAREST, *SMOOTH)}
    point_motion.copy_surface(
        field,
        tuple(array(name, own) for name in NEAREST),
        tuple(array(name, own).reshape(-1) for name in SMOOTH),
        tuple(array(name, parts) for name in NEAREST),
        tuple(array(name, parts).reshape(-1) for name in SMOOTH),
        unknown,
        blanks,
    )


def step_back(
    # Motion fields to the key frame, from the slot and from the slot before.
    back: SlotField,
    there: Float32,  # [H, W, 2]: motion from the key frame to the slot before
    before: SlotField,
) -> SlotField:
    """Return the motion field from a slot to the one before it, from key G-buffers alone.

    A hole is what the slot before shows another point of the key frame at, over SAME_POINT pixels
    away.
    """
    field = back.field + _nearest_at_end(there, back.field)
    to_key = field + _nearest_at_end(before.field, field)
    miss = np.abs(to_key - back.field).max(axis=-1)
    return SlotField(field, back.depth, ~(miss <= SAME_POINT))


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
