"""What one key interval needs from disk, read ahead of the computation."""

from __future__ import annotations

import hashlib
import json
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace

from exwarp_cli import __version__
from exwarp_cli.domain.frame import GBuffer, Image, KeyFrame
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.timeline import FACTOR, Slot
from exwarp_cli.io.channels import Role
from exwarp_cli.io.frames import GEOMETRY, Shot, read_image, read_raw
from exwarp_cli.io.output import Template, file_digest, read_template
from exwarp_cli.io.sequence import Sequence
from exwarp_cli.pipeline.source import FrameOf, Source
from exwarp_cli.synthesis.methods import Method


@dataclass(frozen=True)
class Loaded:
    """One key interval as read: nothing computed yet.

    Attributes
    ----------
    key
        Index of the key frame.
    frame, following
        The key frames on both sides; `following` only for look-ahead methods. None where every
        slot of the interval was found written, and nothing has to be computed.
    slots
        G-buffers of slots 1 to 3, empty in the key setting.
    truth
        Ground truth by slot, where there is some.
    template
        What generated frames take over from the key frame's file.
    recipes
        For each slot, what its frame depends on, digested.
    read_ms
        Milliseconds that reading took.
    """

    key: int
    frame: KeyFrame | None
    following: KeyFrame | None
    slots: tuple[GBuffer, ...]
    truth: dict[int, Image]
    template: Template
    recipes: dict[int, str]
    read_ms: float


class IntervalLoader:
    """Reads intervals in order; the frame that two intervals share is read once."""

    def __init__(
        self,
        source: Source,
        method: Method,
        settings: UpsampleSettings,
        truth: tuple[Sequence, FrameOf] | None,
    ) -> None:
        self._source = source
        self._method = method
        self._settings = settings
        self._truth = truth
        self._frames: OrderedDict[int, KeyFrame] = OrderedDict()
        self._digests: OrderedDict[tuple[int, int], str] = OrderedDict()

    def load(self, key: int, needed: Callable[[int, dict[int, str]], bool]) -> Loaded:
        """Read an interval.

        Parameters
        ----------
        key
            Index of the key frame.
        needed
            Called with the index and the recipes before anything is decoded; False leaves the
            pixels unread.
        """
        begin = time.perf_counter()
        source = self._source
        number = source.timeline.numbers[key]
        last = key + 1 == len(source.timeline.numbers)
        lookahead = self._method.lookahead and not last
        slots = self._slot_numbers(key)
        recipes = self._recipes(key, lookahead, slots)
        template = read_template(
            source.keys.sequence.files[number], source.keys.layout.roles[Role.COLOUR]
        )
        if not needed(key, recipes):
            elapsed = 1e3 * (time.perf_counter() - begin)
            return Loaded(key, None, None, (), {}, template, recipes, elapsed)
        frame = self._key_frame(key)
        following = self._key_frame(key + 1) if lookahead else None
        gbuffers = tuple(self._slot_gbuffer(n) for n in slots)
        truth = self._read_truth(key)
        elapsed = 1e3 * (time.perf_counter() - begin)
        return Loaded(key, frame, following, gbuffers, truth, template, recipes, elapsed)

    def _slot_numbers(self, key: int) -> tuple[int, ...]:
        """Numbers of the slot G-buffers of an interval; empty when not all are there."""
        numbers = [self._source.slot_number(Slot(key, i)) for i in range(1, FACTOR)]
        return tuple(n for n in numbers if n is not None) if None not in numbers else ()

    def _key_frame(self, key: int) -> KeyFrame:
        """Read a key frame, or take it from the last two read."""
        if key not in self._frames:
            source = self._source
            number = source.timeline.numbers[key]
            convention = None if source.finding is None else source.finding.convention
            if source.slots is None:
                frame = read_raw(source.keys, number, self._key_roles).key(convention)
            else:
                frame = read_raw(source.keys, number, (Role.COLOUR,)).key(None)
                slot = source.slot_number(Slot(key, 0))
                assert slot is not None
                gbuffer = _stretched(self._slot_gbuffer(slot))
                frame = replace(frame, gbuffer=gbuffer.on(frame.image.data_window))
            self._frames[key] = frame
            while len(self._frames) > 2:
                self._frames.popitem(last=False)
        return self._frames[key]

    @property
    def _key_roles(self) -> tuple[Role, ...]:
        """What is read of a key frame in the key setting.

        Methods without motion still report holes by the geometry. Normals tell nothing there but
        Unreal's background, in sets of one file per AOV.
        """
        if self._source.finding is None:
            return (Role.COLOUR,)
        if self._source.keys.aovs:
            return (Role.COLOUR, *GEOMETRY)
        return (Role.COLOUR, *(role for role in GEOMETRY if role is not Role.NORMAL))

    def _slot_gbuffer(self, number: int) -> GBuffer:
        source = self._source
        assert source.slots is not None
        convention = None if source.finding is None else source.finding.convention
        return read_raw(source.slots, number, GEOMETRY).settle(convention)

    def _read_truth(self, key: int) -> dict[int, Image]:
        if self._truth is None:
            return {}
        sequence, frame_of = self._truth
        found = {}
        for slot in self._source.timeline.slots_of(key)[1:]:
            number = frame_of(slot)
            if number is not None:
                found[slot.index] = read_image(sequence.files[number])
        return found

    def _recipes(self, key: int, lookahead: bool, slots: tuple[int, ...]) -> dict[int, str]:
        """Digest what each slot's frame depends on: sources, settings and version."""
        source, settings = self._source, self._settings
        numbers = source.timeline.numbers
        files = [self._digest(source.keys, numbers[key])]
        if lookahead:
            files.append(self._digest(source.keys, numbers[key + 1]))
        if source.slots is not None:
            keys = [source.slot_number(Slot(key, 0))]
            if lookahead:
                keys.append(source.slot_number(Slot(key + 1, 0)))
            files += [self._digest(source.slots, n) for n in (*keys, *slots) if n is not None]
        common = {
            "version": __version__,
            "method": self._method.name,
            "setting": source.setting,
            "motion": repr(None if source.finding is None else source.finding.convention),
            "compression": settings.compression,
            "fps": str(source.fps),
            "files": files,
        }
        return {
            slot.index: hashlib.sha256(
                json.dumps(common | {"slot": slot.index}, sort_keys=True).encode()
            ).hexdigest()
            for slot in source.timeline.slots_of(key)[1:]
        }

    def _digest(self, shot: Shot, number: int) -> str:
        """Digest all files of one frame; kept for the interval that shares it."""
        token = (id(shot), number)
        if token not in self._digests:
            digests = {aov: file_digest(path) for aov, path in shot.files(number).items()}
            self._digests[token] = json.dumps(digests, sort_keys=True)
            while len(self._digests) > 16:
                self._digests.popitem(last=False)
        return self._digests[token]


def _stretched(gbuffer: GBuffer) -> GBuffer:
    """Turn motion per slot into motion per key interval, at constant velocity.

    A key frame's vectors span a key interval in either setting. With slot G-buffers they are only
    used where the slots' own do not lead: after the last key frame, and to the next one where the
    renderer writes none that way.
    """
    if gbuffer.to_next is not None:
        return replace(gbuffer, to_next=FACTOR * gbuffer.to_next, to_previous=None)
    assert gbuffer.to_previous is not None
    return replace(gbuffer, to_previous=FACTOR * gbuffer.to_previous)
