"""What a slot's frame depends on, digested: who resumes a run keeps frames of the same recipe."""

from __future__ import annotations

import hashlib
import json
from collections import OrderedDict
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
from exwarp_cli.io.footage import ClipSequence, digest_frame, is_plain
from exwarp_cli.io.frames import Shot
from exwarp_cli.io.generated_frames import file_digest
from exwarp_cli.io.key_file import digests, key_file
from exwarp_cli.io.sequence import Sequence
from exwarp_cli.pipeline.source import FrameOf, Source
from exwarp_cli.synthesis.methods import Method
from exwarp_cli.synthesis.optical_flow import flow_identity

DIGESTS = 32
"""Files' digests that are kept: more than the frames that one interval depends on."""


Token = tuple[int, tuple[tuple[str, Path], ...]]
"""A frame's number, which tells frames of one video apart, and its files by AOV."""


@dataclass
class Recipes:
    """Digests what the frames of intervals depend on, interval after interval.

    Attributes
    ----------
    source, method
        Of the run.
    compression
        Of generated frames; None for the key frame's.
    truth
        Ground truth and its frame for a slot; only oracles depend on it.
    network, interpolator
        That extrapolates, and that interpolates; None for methods that do without.
    policy
        SHA-256 of the policy's file; None where none decides.
    layers
        Names of the layers that are written beside the beauty.
    reading
        In which a slot's frame is read, to note that it is lost where that fails; None where
        nothing may be.
    key_rate
        The frame rate that written key frames get; None where they are copied as they are.
    """

    source: Source
    method: Method
    compression: str | None
    truth: tuple[Sequence, FrameOf] | None
    network: NetworkSummary | None = None
    interpolator: InterpolatorSummary | None = None
    policy: str | None = None
    layers: tuple[str, ...] = ()
    reading: Callable[[Slot], AbstractContextManager[None]] | None = None
    key_rate: Fraction | None = None
    _digests: OrderedDict[Token, str] = field(default_factory=OrderedDict, init=False)
    _rewritten: OrderedDict[Path, str] = field(default_factory=OrderedDict, init=False)

    def share(self, other: Recipes) -> None:
        """Keep files' digests with those of another view, which may be of the same files."""
        self._digests = other._digests

    def digest(self, slot: Slot) -> None:
        """Digest all files of a slot's frame ahead; raises InputError where one cannot be read."""
        if not slot.index:
            self._digest(self.source.keys, self.source.timeline.numbers[slot.key])
        if self.source.slots is not None:
            number = self.source.slot_number(slot)
            if number is not None:
                self._digest(self.source.slots, number)

    def of(
        self,
        key: int,
        keys: Iterable[int],
        instants: Iterable[Slot],
        cuts: Collection[str] = (),
    ) -> dict[int, str]:
        """Digest what each slot's frame depends on: sources, settings, version and networks.

        Parameters
        ----------
        key
            Index of the key frame.
        keys
            Indices of the key frames whose colour is used.
        instants
            Whose G-buffers are used beside those of `keys`; in the key setting key frames all.
        cuts
            What cuts around the interval change.
        """
        source = self.source
        keys, instants = tuple(keys), tuple(instants)
        if self.reading is not None:
            for slot in (*(Slot(index, 0) for index in keys), *instants):
                with self.reading(slot):
                    self.digest(slot)
        files = [self._digest(source.keys, source.timeline.numbers[i]) for i in keys]
        if source.slots is None:
            files += [self._digest(source.keys, source.timeline.numbers[s.key]) for s in instants]
        else:
            numbers = [source.slot_number(s) for s in (*(Slot(i, 0) for i in keys), *instants)]
            files += [self._digest(source.slots, n) for n in numbers if n is not None]
        common: dict[str, Any] = {
            "version": __version__,
            "method": self.method.name,
            "setting": source.setting,
            "motion": repr(None if source.finding is None else source.finding.convention),
            "compression": self.compression,
            "fps": f"{source.fps}{'' if source.written_fps else ' assumed'}",
            "files": files,
        }
        common |= _seen_otherwise(source, self.method)
        if self.layers:
            common["layers"] = list(self.layers)
        if cuts:
            common["cuts"] = list(cuts)
        if self.network is not None:
            common["network"] = [self.network.sha256, self.network.device]
        if self.interpolator is not None:
            common["interpolator"] = self.interpolator.identity
        if self.policy is not None:
            common["policy"] = self.policy
        if self.method.needs_truth:
            common["truth"] = self._truth_digests(key)
        return {
            slot.index: hashlib.sha256(
                json.dumps(common | self._place(slot), sort_keys=True).encode()
            ).hexdigest()
            for slot in source.timeline.made_of(key)
        }

    def key_digests(self, keys: Iterable[int]) -> dict[int, str]:
        """Return the digests of written key frames by input number; none for a video."""
        shot, numbers = self.source.keys, self.source.timeline.numbers
        if isinstance(shot.sequence, ClipSequence):
            return {}
        digests = {numbers[key]: self._digest(shot, numbers[key]) for key in keys}
        if is_plain(shot.sequence):
            return digests
        return {
            number: self._written_digest(shot.sequence.files[number], json.loads(digest)[""])
            for number, digest in digests.items()
        }

    def _written_digest(self, path: Path, digest: str) -> str:
        """Return the digest of a key frame's file as it is written, from that of its source."""
        if path not in self._rewritten:
            file = key_file(path, self.key_rate)
            self._keep_rewritten(path, file.digest() if file.head else digest)
        return self._rewritten[path]

    def _keep_rewritten(self, path: Path, digest: str) -> None:
        self._rewritten[path] = digest
        while len(self._rewritten) > DIGESTS:
            self._rewritten.popitem(last=False)

    def _place(self, slot: Slot) -> dict[str, Any]:
        """Say which slot it is, of how many."""
        timeline = self.source.timeline
        return {
            "slot": slot.index,
            "time": str(timeline.time(slot)),
            "factor": str(timeline.factor),
        }

    def _truth_digests(self, key: int) -> list[str]:
        """Digest the ground truth of an interval."""
        if self.truth is None:
            return []
        sequence, frame_of = self.truth
        numbers = [frame_of(slot) for slot in self.source.timeline.made_of(key)]
        return [file_digest(sequence.files[n]) for n in numbers if n is not None]

    def _digest(self, shot: Shot, number: int) -> str:
        """Digest all files of one frame; kept for the interval that shares it."""
        token = (number, tuple(shot.files(number).items()))
        if token not in self._digests:
            self._digests[token] = self._digest_of(shot, number)
            while len(self._digests) > DIGESTS:
                self._digests.popitem(last=False)
        return self._digests[token]

    def _digest_of(self, shot: Shot, number: int) -> str:
        """Digest all files of one frame, and a key frame's file as it is written."""
        if is_plain(shot.sequence):
            return digest_frame(shot.sequence, number)
        found = {}
        for aov, path in shot.files(number).items():
            is_key = not aov and shot is self.source.keys
            rate = self.key_rate if is_key else None
            found[aov], written = digests(path, rate, None if aov else shot.headers)
            if is_key and written is not None:
                self._keep_rewritten(path, written)
        return json.dumps(found, sort_keys=True)


def key_recipe(keys: Shot, number: int, rate: Fraction | None = None) -> str:
    """Digest what a key frame depends on that is not copied but decoded and encoded.

    The rate is what its header says; None where it says none.
    """
    found = {"version": __version__, "key": digest_frame(keys.sequence, number), "fps": str(rate)}
    return hashlib.sha256(json.dumps(found, sort_keys=True).encode()).hexdigest()


def _seen_otherwise(source: Source, method: Method) -> dict[str, Any]:
    """Return what is known of an input beside what its own channels say."""
    found: dict[str, Any] = {}
    if source.estimated or method.finds_flow or (source.moves and method.carries_light):
        found["flow"] = flow_identity()
    if source.keys.by_hand:
        found["read"] = source.keys.by_hand
    turned = [
        [reading.kind.value, reading.offset, reading.scale, Role.DEPTH in shot.layout]
        for shot in (source.keys, source.slots)
        if shot is not None and (reading := shot.depth).evidence
    ]
    if turned:
        found["depth"] = turned
    ids = (source.slots or source.keys).ids
    if ids is not None:
        found["ids"] = ids.identity
    return found
