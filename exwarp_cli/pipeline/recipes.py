"""What a slot's frame depends on, digested: who resumes a run keeps frames of the same recipe."""

from __future__ import annotations

import hashlib
import json
from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from exwarp_cli import __version__
from exwarp_cli.domain.results import InterpolatorSummary, NetworkSummary
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.io.frames import Shot
from exwarp_cli.io.output import file_digest
from exwarp_cli.io.sequence import Sequence
from exwarp_cli.pipeline.source import FrameOf, Source
from exwarp_cli.synthesis.methods import Method

DIGESTS = 32
"""Files' digests that are kept: more than the frames that one interval depends on."""


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
    """

    source: Source
    method: Method
    compression: str | None
    truth: tuple[Sequence, FrameOf] | None
    network: NetworkSummary | None = None
    interpolator: InterpolatorSummary | None = None
    policy: str | None = None
    _digests: OrderedDict[tuple[int, int], str] = field(default_factory=OrderedDict, init=False)

    def of(self, key: int, keys: Iterable[int], instants: Iterable[Slot]) -> dict[int, str]:
        """Digest what each slot's frame depends on: sources, settings, version and networks.

        Parameters
        ----------
        key
            Index of the key frame.
        keys
            Indices of the key frames whose colour is used.
        instants
            Whose G-buffers are used beside those of `keys`; in the key setting key frames all.
        """
        source = self.source
        keys = tuple(keys)
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
            "fps": str(source.fps),
            "files": files,
        }
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
        token = (id(shot), number)
        if token not in self._digests:
            digests = {aov: file_digest(path) for aov, path in shot.files(number).items()}
            self._digests[token] = json.dumps(digests, sort_keys=True)
            while len(self._digests) > DIGESTS:
                self._digests.popitem(last=False)
        return self._digests[token]
