"""A slot's surfaces, and where they were in the key frames before the last one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, GBuffer, KeyFrame
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.kernels import point_motion
from exwarp_cli.kernels.point_motion import fill_predicted, follow_points, follow_visible
from exwarp_cli.runtime.frame_pool import IN_MEMORY, ScratchFrames, pool
from exwarp_cli.synthesis.camera import Camera, Index, Scene, camera_by, place_still, scene_of
from exwarp_cli.synthesis.geometry import SlotField, depth_of, moved_on, stands_still, unmatched
from exwarp_cli.synthesis.rounding import EXACT
from exwarp_cli.synthesis.trajectory import displacement, stencil_of
from exwarp_cli.synthesis.warp import sampled

SAME_POINT = 2.0
"""Pixels of the key frame within which two samples show the same surface point."""

UNFORESEEN = np.zeros((0, 0, 2), np.float32)
"""What is expected where nothing is."""

UNCOMPARED = (np.zeros((0, 0), np.float32),) * 2
"""Depths that are not compared."""


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
    guessed
        True if `motion` is that to the frame after, turned round, as no vectors lead back.
    """

    frame: KeyFrame
    motion: Float32
    guessed: bool = False

    _gone: list[tuple[GBuffer, Bool]] = field(default_factory=list, init=False, compare=False)

    @cached_property
    def scene(self) -> Scene | None:
        """The frame's points."""
        return None if self.frame.gbuffer is None else scene_of(self.frame.gbuffer)

    @cached_property
    def stands(self) -> Bool | None:
        """bool [H, W]: what stands still in the world; None where no camera tells."""
        gbuffer, scene = self.frame.gbuffer, self.scene
        if gbuffer is None or scene is None or scene.camera is None:
            return None
        return stands_still(gbuffer, scene)

    def gone(self, newer: GBuffer) -> Bool:
        """bool [H, W]: what the key frame after it, `newer`, shows, and it does not."""
        for known, found in self._gone:
            if known is newer:
                return found
        assert self.frame.gbuffer is not None
        self._gone[:] = [(newer, unmatched(newer, self.frame.gbuffer, self.motion, FACTOR))]
        return self._gone[0][1]


def past_of(keys: Sequence[KeyFrame]) -> tuple[Past, ...]:
    """Return the past of the first of some key frames, by their own vectors.

    Parameters
    ----------
    keys
        Successive ones, the newest first, on one window, with settled motion between key frames.
    """
    past = []
    for newer, older in pairwise(keys):
        assert newer.gbuffer is not None
        guessed = newer.gbuffer.to_previous is None
        past.append(Past(older, displacement(newer.gbuffer, -1), guessed))
    return tuple(past)


@dataclass(frozen=True)
class BetweenKeys:
    """What lies between successive key frames, whichever slot is looked back from; made lazily.

    Attributes
    ----------
    key
        G-buffer of F_k with settled motion.
    past
        F_k-1 and F_k-2, as far as they are there.
    scratch
        Where large frames lie.
    """

    key: GBuffer
    past: Sequence[Past]
    scratch: ScratchFrames = IN_MEMORY

    @cached_property
    def gone(self) -> tuple[Bool, ...]:
        """For each older key frame, bool [H, W]: what the one after it shows, and it does not.

        As far back as there is geometry.
        """
        found, newer = [], self.key
        for step in self.past:
            if step.frame.gbuffer is None:
                break
            found.append(step.gone(newer))
            newer = step.frame.gbuffer
            self.scratch.page_out()
        return tuple(found)

    def camera_at(self, time: float) -> Camera | None:
        """Return the camera of a slot, as the key frame's motion foretells it, in world space."""
        scene = self._scene
        if scene is None or scene.camera is None:
            return None
        key, before, after = self.key, self.key.to_previous, self.key.to_next

        def motion_at(index: Index) -> Float32:
            some = replace(
                key, to_previous=_at(before, index), to_next=_at(after, index), bend=None
            )
            found: Float32 = displacement(some, time)[0]
            return found

        return camera_by(scene, motion_at, key.stencil)

    @cached_property
    def _scene(self) -> Scene | None:
        return scene_of(self.key)


LIGHT_CHANGE = 2.0
"""Factor by which the light on the same surfaces may differ in an older key frame. Beyond, it was
a fade, a flash or a lamp: the network painted speckles of the other light, up to 120 of 255 after a
black key frame."""


def lit_alike(frame: Float32, other: Float32, both: Bool) -> bool:
    """Return True if the surfaces that two frames show have about the same light in both.

    Parameters
    ----------
    frame, other
        float32 [H, W, 3 or more], scene-linear, moved to one instant.
    both
        bool [H, W]: where both show the surface.
    """
    lights = []
    for pixels in (frame, other):
        # A mean of roots: a mean goes by a few highlights, a median by a background without light.
        roots = (np.sqrt(np.abs(pixels[..., c])) for c in range(3))
        lights.append(sum(float(np.sum(root, where=both, dtype=np.float64)) for root in roots) ** 2)
    return max(lights) <= LIGHT_CHANGE * min(lights)


@dataclass(frozen=True)
class LookBack:
    """What is known of a slot's surfaces.

    Attributes
    ----------
    surface
        The slot's G-buffer; from key G-buffers alone without ids, positions and motion.
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
    slot: int,
    back: SlotField,
    slots: Sequence[GBuffer],
    between: BetweenKeys,
    here: Scene | None = None,
) -> LookBack:
    """Find a slot's surfaces in the older key frames.

    Parameters
    ----------
    slot
        1 to 3.
    back
        Motion field from the slot to the key frame.
    slots
        G-buffers of slots 1 to 3 with settled motion; empty when only key frames have them.
    between
        The key frames.
    here
        The slot's points, where it has a G-buffer that tells them.
    """
    if slots:
        return _rendered(slot, slots[slot - 1], back, between, here)
    return _reprojected(slot, back, between)


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
    return SlotField(field, back.depth, hole)


def _at(vectors: Float32 | None, index: Index) -> Float32 | None:
    """Return vectors, float32 [1, N, 2], at pixels given by flat index."""
    return None if vectors is None else vectors.reshape(-1, 2)[index][None]


def _reprojected(slot: int, back: SlotField, between: BetweenKeys) -> LookBack:
    """Look back from key G-buffers alone.

    The key frame's surfaces are moved to the slot, and followed back from the key frame. What it
    does not show comes from the ones before, moved on to the slot: the only rendered pictures of
    what has just been disoccluded.
    """
    time, newer, moved = slot / FACTOR, between.key, back.field
    camera = between.camera_at(time) if between.past else None
    sources = [(newer, back.field)]
    fields: list[Float32] = []
    hidden: list[Bool] = []
    lost = np.isnan(moved[..., 0])
    for count, (step, gone) in enumerate(zip(between.past, between.gone, strict=False), start=1):
        older = step.frame.gbuffer
        assert older is not None
        between.scratch.page_out()
        led, missed = pool.empty(moved.shape, np.float32), pool.empty(lost.shape, np.bool_)
        follow_visible(step.motion, stencil_of(newer), gone, moved, lost, led, missed)
        moved, lost = led, missed
        if older.has_motion:
            motion = _predicted_motion(step, count + time, camera, count > 1)
            between.scratch.page_out()
            predicted = moved_on(older, motion).field
            fill_predicted(predicted, moved, lost)
            sources.append((older, predicted))
        fields.append(moved)
        hidden.append(lost)
        newer = older
    between.scratch.page_out()
    surface, unknown = reprojected(sources)
    return LookBack(surface, tuple(fields), tuple(hidden), unknown)


def _predicted_motion(past: Past, time: float, camera: Camera | None, still: bool) -> Float32:
    """Return where an older key frame's pixels move to, float32 [H, W, 2].

    Parameters
    ----------
    past
        The older key frame.
    time
        How far, in key intervals.
    camera
        Of the slot; what stands still is placed by it, beside what the key frame shows. Without
        one everything counts as moving by itself.
    still
        Whether what moves by itself is left out (NaN), as too far ago.
    """
    gbuffer = past.frame.gbuffer
    assert gbuffer is not None
    if still:
        motion = np.full((*gbuffer.window.shape, 2), np.nan, np.float32)
    else:
        motion = displacement(gbuffer, time)
    if camera is not None and past.scene is not None and past.stands is not None:
        place_still(past.scene, camera, past.stands, motion)
    return motion


def _rendered(
    slot: int, surface: GBuffer, back: SlotField, between: BetweenKeys, here: Scene | None
) -> LookBack:
    """Look back from the slot's own G-buffer, also at what the last key frame does not show."""
    newer, moved = between.key, pool.copy(back.field)
    fields, hidden = [], []
    for count, step in enumerate(between.past, start=1):
        between.scratch.page_out()
        older = step.frame.gbuffer
        if older is None:
            break
        # Its own vectors foretell a point so many slots ago badly, and mislead: with them older
        # frames were up to 1.4 dB further from the truth where things move.
        # Depth tells a hidden point only where something else foretells its motion.
        ids = stencil_of(newer), stencil_of(surface)
        follow_points(step.motion, ids, UNCOMPARED, EXACT, np.float32(0), UNFORESEEN, moved)
        placed = _placed(moved, here, step, surface)
        fields.append(placed)
        hidden.append(unmatched(surface, older, placed, slot + FACTOR * count))
        newer = older
    nothing = np.zeros(surface.window.shape, np.bool_)
    return LookBack(surface, tuple(fields), tuple(hidden), unknown=nothing)


def _placed(moved: Float32, here: Scene | None, past: Past, surface: GBuffer) -> Float32:
    """Place what stands still by the cameras, where world positions are known."""
    there, placed = past.scene, moved.copy()
    if here is None or there is None or there.camera is None or surface.stencil is None:
        return placed
    place_still(here, there.camera, surface.stencil == 0, placed)
    return placed


SMOOTH = ("albedo", "specular")
"""Sampled bilinearly, as colour is, so that they cancel where colour is divided by them."""

ROWS = 64
"""That are looked up at a time."""

FLAT = ("depth", "roughness", "metallic")
"""Of one number a pixel."""

NEAREST = ("depth", "normal", "roughness", "metallic")
"""Taken from the nearest pixel."""

SHOWN = (*NEAREST, *SMOOTH)
"""What is taken over: what networks receive of a surface, and depth to fill holes by."""


def reprojected(sources: Sequence[tuple[GBuffer, Float32]]) -> tuple[GBuffer, Bool]:
    """Return a slot's G-buffer, taken from other frames'.

    Parameters
    ----------
    sources
        G-buffers on one window, each with the motion field float32 [H, W, 2] from the slot to it,
        NaN where it shows nothing of the slot. Each pixel comes from the first that shows it.

    Returns
    -------
    GBuffer
        Those parts out of SHOWN that the first source has, and a depth in any case: NaN where
        nothing shows what is there, as all else is 0.
    bool [H, W]
        Where that is so.
    """
    (first, motion), *others = sources
    first = replace(first, depth=depth_of(first))
    made: dict[str, Any] = {}
    for name in NEAREST:
        if (array := getattr(first, name)) is not None:
            made[name] = pool.empty(array.shape, array.dtype)
    # Nearly all of it: four times as fast for the whole frame as pixel by pixel.
    for name in SMOOTH:
        if (array := getattr(first, name)) is not None:
            made[name], _ = sampled(array, motion)
    unknown = np.ones(first.window.shape, np.bool_)
    _take_over(first.without(*SMOOTH), motion, made, unknown, blanks=True)
    for gbuffer, moved in others:
        _take_over(replace(gbuffer, depth=depth_of(gbuffer)), moved, made, unknown)
    return GBuffer(first.window, **made), unknown


def _take_over(
    gbuffer: GBuffer, field: Float32, made: dict[str, Float32], unknown: Bool, blanks: bool = False
) -> None:
    """Take over what is known of a frame where a slot's parts are not known yet."""

    def given(name: str, parts: Mapping[str, Float32 | None]) -> Float32:
        array = parts[name] if name in made else None
        if array is None:
            return np.zeros((0, 0) if name in FLAT else (0, 0, 3), np.float32)
        return np.ascontiguousarray(array)

    here = {name: getattr(gbuffer, name) for name in SHOWN}
    point_motion.copy_surface(
        field,
        tuple(given(name, here) for name in NEAREST),
        tuple(given(name, here).reshape(-1) for name in SMOOTH),
        tuple(given(name, made) for name in NEAREST),
        tuple(given(name, made).reshape(-1) for name in SMOOTH),
        unknown,
        blanks,
    )


def lookup(array: np.ndarray, field: Float32, default: object) -> np.ndarray:
    """Return what lies at the end of a motion field, from the nearest pixel.

    Parameters
    ----------
    array
        [H, W, ...].
    field
        float32 [H, W, 2], NaN where unknown.
    default
        For pixels without an end inside the frame.
    """
    out = np.full_like(array, default)
    for pixels, ends in _ends(field, np.ones(array.shape[:2], np.bool_)):
        _flat(out)[pixels] = _flat(array)[ends]
    return out


def _flat(array: np.ndarray) -> np.ndarray:
    """Return [H, W, ...] as [H W, ...]; a view where the array is contiguous."""
    return array.reshape(-1, *array.shape[2:])


def _ends(field: Float32, wanted: Bool) -> Iterator[tuple[Index, Index]]:
    """Yield which wanted pixels a field leads from, and the nearest pixels it leads to, flat.

    Some rows at a time, as the numbers on the way take over ten times the memory of a plane.
    """
    height, width = wanted.shape
    for first in range(0, height, ROWS):
        pixels = np.flatnonzero(wanted[first : first + ROWS]) + first * width
        row, column = np.divmod(pixels, width)
        move = _flat(field)[pixels]
        x, y = column + move[:, 0] + 0.5, row + move[:, 1] + 0.5
        with np.errstate(invalid="ignore"):
            inside = (x >= 0) & (y >= 0) & (x <= width) & (y <= height)
        left = np.minimum(x[inside].astype(np.intp), width - 1)
        top = np.minimum(y[inside].astype(np.intp), height - 1)
        yield pixels[inside], top * width + left
