"""What a frame depends on, digested: a resumed run keeps frames whose fingerprint is the same."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Collection, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

from exwarp_cli import __version__
from exwarp_cli.domain.results import InterpolatorSummary, NetworkSummary
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.io.channels import Role
from exwarp_cli.io.files import compute_checksum
from exwarp_cli.io.footage import ClipSequence, digest_frame, is_plain
from exwarp_cli.io.key_file import digests, file_digest, plan_key_file
from exwarp_cli.io.sequences import Sequence
from exwarp_cli.io.shot import Shot
from exwarp_cli.pipeline.source import FrameOf, Source
from exwarp_cli.synthesis.methods import Method
from exwarp_cli.synthesis.optical_flow import flow_identity

# Files' digests that are kept: more than the frames that one interval depends on.
DIGESTS = 32

# A frame's number, which tells frames of one video apart, and its files by AOV.
FrameFiles = tuple[int, tuple[tuple[str, Path], ...]]


@dataclass
class Fingerprinter:
    """Digests what the frames of intervals depend on, interval after interval."""

    source: Source
    method: Method
    compression: str | None  # of generated frames, as the user names it
    truth: tuple[Sequence, FrameOf] | None  # only oracles depend on it
    network: NetworkSummary | None = None  # that extrapolates
    interpolator: InterpolatorSummary | None = None
    policy: str | None = None  # SHA-256 of the policy's file, maybe with the effort
    layers: tuple[str, ...] = ()  # names of those that are written beside the beauty
    # In which a slot's frame is read, to record it as unreadable where that fails; None where
    # nothing may be unreadable.
    reading: Callable[[Slot], AbstractContextManager[None]] | None = None
    key_rate: Fraction | None = None  # frame rate that written key frames get; None: as they are
    # Of files that were digested; views share them, which may be of the same files. The second is
    # that of the key frame as it is written, where it is known.
    digests: dict[FrameFiles, tuple[str, str | None]] = field(default_factory=dict, init=False)

    def digest(self, slot: Slot) -> None:
        """Digest all files of a slot's frame ahead; raises InputError where one cannot be read."""
        if not slot.index:
            self._digest(self.source.keys, self.source.timeline.numbers[slot.key])
        if self.source.slots is not None:
            number = self.source.slot_number(slot)
            if number is not None:
                self._digest(self.source.slots, number)

    def fingerprints(
        self,
        key: int,
        keys: Iterable[int],
        instants: Iterable[Slot],
        surroundings: Collection[str] = (),
        extrapolates: bool = True,
    ) -> dict[int, str]:
        """Digest what each slot's frame depends on: sources, settings, version and networks.

        `key` is the index of the key frame, `keys` are those of key frames whose colour is used.
        The G-buffers of `instants` are used beside theirs; in the key setting key frames all.
        `surroundings` are what cuts, holds, windows and trials around the interval change. With
        `extrapolates` the network that extrapolates, if there is one, may make the frames.
        """
        source, timeline = self.source, self.source.timeline
        own = [Slot(index, 0) for index in keys]
        sources = [*own, *instants]
        if self.reading is not None:
            for slot in sources:
                with self.reading(slot):
                    self.digest(slot)
        # In the key setting G-buffers are in the key frames' files.
        colours = sources if source.slots is None else own
        files = [self._digest(source.keys, timeline.numbers[slot.key])[0] for slot in colours]
        if source.slots is not None:
            in_slots = map(source.slot_number, sources)
            files += [self._digest(source.slots, n)[0] for n in in_slots if n is not None]
        facts: dict[str, Any] = {
            "version": __version__,
            "method": self.method.name,
            "setting": source.setting,
            "motion": repr(source.convention),
            "compression": self.compression,
            "fps": f"{source.fps}{'' if source.written_fps else ' assumed'}",
            "factor": str(timeline.factor),
            "files": files,
        }
        facts |= _reading_facts(source, self.method)
        if self.layers:
            facts["layers"] = list(self.layers)
        if surroundings:
            facts["cuts"] = list(surroundings)
        if self.network is not None and extrapolates:
            facts["network"] = [self.network.sha256, self.network.device]
        if self.interpolator is not None:
            model = self.interpolator
            tiles = [] if model.policy_sha256 is None else [model.policy_sha256, model.effort]
            facts["interpolator"] = [model.sha256, model.card_sha256, model.device, *tiles]
        if self.policy is not None and extrapolates:
            facts["policy"] = self.policy
        if self.method.needs_truth and self.truth is not None:
            sequence, frame_of = self.truth
            numbers = [frame_of(slot) for slot in timeline.made_of(key)]
            facts["truth"] = [file_digest(sequence.files[n]) for n in numbers if n is not None]
        return {
            slot.index: digest_json(facts | {"slot": slot.index, "time": str(timeline.time(slot))})
            for slot in timeline.made_of(key)
        }

    def key_digests(self, keys: Iterable[int]) -> dict[int, str]:
        """Return the digests of written key frames by input number; none for a video."""
        shot, numbers = self.source.keys, self.source.timeline.numbers
        if isinstance(shot.sequence, ClipSequence):
            return {}
        written = {}
        for number in (numbers[key] for key in keys):
            digest, rewritten = self._digest(shot, number)
            if rewritten is None:
                file = plan_key_file(shot.sequence.files[number], self.key_rate)
                rewritten = compute_checksum(file.pieces()) if file.head else json.loads(digest)[""]
            written[number] = rewritten
        return written

    def _digest(self, shot: Shot, number: int) -> tuple[str, str | None]:
        """Digest all files of one frame; kept for the interval that shares it."""
        files = shot.files(number)
        frame = (number, tuple(files.items()))
        if frame in self.digests:
            return self.digests[frame]
        rewritten: str | None = None
        if is_plain(shot.sequence):
            digest = rewritten = digest_frame(shot.sequence, number)
        else:
            by_aov = {}
            for aov, path in files.items():
                # A key frame's file is digested as it is written, too.
                is_key = not aov and shot is self.source.keys
                rate = self.key_rate if is_key else None
                by_aov[aov], written = digests(path, rate, None if aov else shot.headers)
                rewritten = written if is_key else rewritten
            digest = json.dumps(by_aov, sort_keys=True)
        self.digests[frame] = digest, rewritten
        if len(self.digests) > DIGESTS:
            del self.digests[next(iter(self.digests))]  # the oldest
        return self.digests[frame]


def key_fingerprint(keys: Shot, number: int, rate: Fraction | None = None) -> str:
    """Digest what a key frame depends on that is not copied but decoded and encoded.

    The rate is what its header says; None where it says none.
    """
    facts = {"version": __version__, "key": digest_frame(keys.sequence, number), "fps": str(rate)}
    return digest_json(facts)


def digest_json(facts: dict[str, Any]) -> str:
    """Digest what JSON can hold, whatever the order of its keys."""
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


def _reading_facts(source: Source, method: Method) -> dict[str, Any]:
    """Return how an input is read beside what its own channels say."""
    facts: dict[str, Any] = {}
    moves_light = source.finding is not None and method.carries_light
    if source.estimated or method.finds_flow or moves_light:
        facts["flow"] = flow_identity()
    if source.keys.by_hand:
        facts["read"] = source.keys.by_hand
    depth = [
        [reading.kind.value, reading.offset, reading.scale, Role.DEPTH in shot.layout]
        for shot in (source.keys, source.slots)
        if shot is not None and (reading := shot.depth).evidence
    ]
    if depth:
        facts["depth"] = depth
    ids = source.geometry.ids
    if ids is not None:
        moving = None if ids.dynamic is None else list(ids.dynamic.ids)
        facts["ids"] = [ids.cryptomatte.aov, ids.cryptomatte.name, ids.rounded, moving]
    return facts
