"""A rendered scene as a source of key intervals, in any variant and look."""

from __future__ import annotations

import zlib
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np

from exwarp_cli.domain.frame import Float32, GBuffer, Image, KeyFrame
from exwarp_cli.domain.motion import MotionConvention
from exwarp_cli.domain.network_api import HISTORY_FRAMES
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.errors import InputError
from exwarp_cli.io.channels import Role
from exwarp_cli.io.dataset import RenderedScene
from exwarp_cli.io.frames import GEOMETRY, SURFACE, read_raw
from exwarp_cli.io.shot import Shot
from exwarp_cli.pipeline.key_frames import over_interval
from exwarp_cli.pipeline.motion_convention import motion_names, parse_motion
from exwarp_cli.research.training.augmentation import (
    PLAIN,
    Look,
    Variant,
    deliver,
    reverse_time,
    with_tones,
)
from exwarp_cli.synthesis.history import older_key_frames
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.motion_fields import settle_motion
from exwarp_cli.synthesis.trajectory import span_motion

# Instants that are kept in memory: enough for one interval and its history.
KEPT = 24


class SceneClip:
    """Key frames, slots and ground truth of one scene as a variant plays and a look delivers it.

    Frames are read when they are asked for, the latest ones are kept.
    """

    def __init__(
        self, scene: RenderedScene, variant: Variant | None = None, look: Look = PLAIN
    ) -> None:
        self.scene = scene
        self.variant = variant or Variant()
        self.look = look
        count = scene.manifest.instants.count
        self._order = self.variant.order(count)
        self._load = lru_cache(KEPT)(partial(_read_instant, scene))
        if not self.intervals:
            raise InputError(
                f"{scene.folder} has {count} instants, too few for {variant}; leave it out"
            )

    def seen_as(self, variant: Variant, look: Look = PLAIN) -> SceneClip:
        """Return the same scene in another variant and look, sharing what was read."""
        clip = SceneClip(self.scene, variant, look)
        clip._load = self._load
        return clip

    @property
    def intervals(self) -> range:
        """Indices k of the key frames that are followed by another one."""
        return range((len(self._order) - 1) // FACTOR)

    def key(self, k: int, setting: str = "key") -> KeyFrame:
        """Return key frame k, with settled motion to the neighbouring key frames.

        Motion to a key frame that lies outside the render is None, unless the render has it. In the
        setting "slot" motion is made of the slots' G-buffers, as in a run.
        """
        if setting == "slot":
            frame = self.slot(k, 0)
            assert frame.gbuffer is not None
            return replace(frame, gbuffer=over_interval(frame.gbuffer, FACTOR))
        index, manifest = self._order[FACTOR * k], self.scene.manifest
        if self.variant.speed == 1 and manifest.has_key(index):
            number = manifest.keys.first + index // manifest.keys.step
            raw = read_raw(self.scene.keys, number, GEOMETRY)
            gbuffer = settle_motion(raw.settle(_convention(self.scene, self.scene.keys)))
            return self._play(index, gbuffer.to_previous, gbuffer.to_next, gbuffer.bend)
        span = FACTOR * self.variant.speed
        return self._play(index, self._spanned(index, span, -1), self._spanned(index, span, 1))

    def slot(self, k: int, i: int) -> KeyFrame:
        """Return slot i of key frame k: ground truth, and settled motion to neighbouring slots."""
        index, span = self._order[FACTOR * k + i], self.variant.speed
        return self._play(index, self._spanned(index, span, -1), self._spanned(index, span, 1))

    def truth(self, k: int, i: int) -> Image:
        """Return what slot i of key frame k is to show."""
        frame, _ = self._load(self._order[FACTOR * k + i])
        return with_tones(frame.image, self.look)

    def interval(self, k: int, setting: str) -> Interval:
        """Return key interval k for synthesis; in the setting "slot" slots have G-buffers, too."""
        key, following = (self.key(index, setting) for index in (k, k + 1))
        return Interval(key, following, self._slots(k, setting))

    def causal(self, k: int, setting: str) -> Interval:
        """Return key interval k for causal synthesis: with its past, without the next key frame."""
        keys = []
        for index in range(k, max(k - HISTORY_FRAMES, -1), -1):
            if setting == "key":
                keys.append(self.key(index))
                continue
            # Motion to the key frame before leads through the slots between.
            instant, direction = self._order[FACTOR * index], 1 if self.variant.backwards else -1
            motion = self._spanned(instant, FACTOR * self.variant.speed, direction)
            both = (None, motion) if self.variant.backwards else (motion, None)
            keys.append(self._play(instant, *both))
        key = keys[0] if setting == "key" else self.key(k, setting)
        return Interval(key, None, self._slots(k, setting), older_key_frames(keys))

    def _slots(self, k: int, setting: str) -> tuple[GBuffer, ...]:
        if setting == "key":
            return ()
        gbuffers = (self.slot(k, i).gbuffer for i in range(1, FACTOR))
        return tuple(gbuffer for gbuffer in gbuffers if gbuffer is not None)

    def _play(
        self,
        index: int,
        to_previous: Float32 | None,
        to_next: Float32 | None,
        bend: Float32 | None = None,
    ) -> KeyFrame:
        """Return an instant in the variant and look, with motion in rendered order."""
        frame, gbuffer = self._load(index)
        gbuffer = replace(gbuffer, to_previous=to_previous, to_next=to_next, bend=bend)
        if self.variant.backwards:
            gbuffer = reverse_time(gbuffer)
        frame = replace(frame, gbuffer=gbuffer)
        if self.look == PLAIN:
            return frame
        noise = np.random.default_rng((zlib.crc32(self.scene.name.encode()), index))
        return deliver(frame, self.look, noise)

    def _spanned(self, index: int, span: int, direction: int) -> Float32 | None:
        """Return the motion over `span` instants in one direction; None beyond the render."""
        if span == 1:
            _, gbuffer = self._load(index)
            return gbuffer.to_next if direction > 0 else gbuffer.to_previous
        end = index + direction * span
        if not 0 <= end < self.scene.manifest.instants.count:
            return None
        gbuffers = [self._load(i)[1] for i in range(index, end + direction, direction)]
        return span_motion(gbuffers, direction)


def _read_instant(scene: RenderedScene, index: int) -> tuple[KeyFrame, GBuffer]:
    """Return an instant as rendered, and its G-buffer, motion settled; index from 0."""
    number = scene.manifest.instants.first + index
    raw = read_raw(scene.instants, number, (Role.COLOUR, *GEOMETRY, *SURFACE))
    frame = raw.key(_convention(scene, scene.instants))
    assert frame.gbuffer is not None
    return replace(frame, gbuffer=None), settle_motion(frame.gbuffer)


def _convention(scene: RenderedScene, shot: Shot) -> MotionConvention:
    size = (shot.display.width, shot.display.height)
    return parse_motion(scene.manifest.motion, motion_names(shot), size)
