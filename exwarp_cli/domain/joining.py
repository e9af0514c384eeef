"""Several runs over parts of one sequence, joined into the run that would have done them all."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

from exwarp_cli.domain.results import (
    BrokenPixels,
    FrameRecord,
    InputSummary,
    InterpolatorSummary,
    LeftOut,
    NetworkSummary,
    PolicySummary,
    RunSummary,
    WrittenFile,
)
from exwarp_cli.domain.timeline import Cut, ranges
from exwarp_cli.errors import InputError

SHOWN = 120
"""Characters of a value in a message."""


@dataclass(frozen=True)
class _Trait:
    """What all parts of a run have in common: its name in messages, and how it is found."""

    name: str
    of: Callable[[RunSummary], Any]


def _file_name(pattern: str) -> str:
    """Return the last part of a pattern; its folder is mounted elsewhere on another machine."""
    return re.split(r"[/\\]", pattern)[-1]


def _range(source: InputSummary) -> str:
    step = f"x{source.step}" if source.step > 1 else ""
    return f"{source.first}-{source.last}{step}"


def _measured(evidence: str | None) -> str | None:
    """Mask what was measured in an evidence: other processors differ in its last digits."""
    return None if evidence is None else re.sub(r"\d+\.\d+", "…", evidence)


def _extrapolator(model: NetworkSummary | None) -> str | None:
    if model is None:
        return None
    given = "shading alone" if model.demodulated else "whole colour"
    return f"sha256 {model.sha256} on {model.device}, given {given}"


def _interpolator(model: InterpolatorSummary | None) -> str | None:
    if model is None:
        return None
    return f"{model.name} on {model.device}, sha256 {model.sha256}, card {model.card_sha256}"


def _policy(model: PolicySummary | None) -> str | None:
    if model is None:
        return None
    missing = " and ".join(model.missing) or "nothing"
    return f"sha256 {model.sha256} with objects from {model.objects_from} and {missing} missing"


TRAITS = (
    _Trait("version of ExWarp", lambda run: run.version),
    _Trait("input", lambda run: _file_name(run.input.pattern)),
    _Trait("range of its key frames", lambda run: _range(run.input)),
    _Trait("size of its frames", lambda run: f"{run.input.width}x{run.input.height}"),
    _Trait("program that wrote it", lambda run: run.input.producer),
    _Trait("source of motion", lambda run: run.input.motion_source),
    _Trait("reading of its vectors", lambda run: _measured(run.input.motion_evidence)),
    _Trait("choice of what moves", lambda run: run.input.dynamic),
    _Trait("method", lambda run: run.method),
    _Trait("setting of G-buffers", lambda run: run.setting),
    _Trait("rate of the input", lambda run: f"{run.base_fps} fps ({run.fps_source})"),
    _Trait("factor", lambda run: str(run.factor)),
    _Trait("network that extrapolates", lambda run: _extrapolator(run.extrapolator)),
    _Trait("network that interpolates", lambda run: _interpolator(run.interpolator)),
    _Trait("policy", lambda run: _policy(run.policy)),
    _Trait("search for cuts", lambda run: "no" if run.cuts is None else "yes"),
    _Trait("choice of views", lambda run: run.views),
    _Trait("choice of layers", lambda run: run.layers),
)
"""Paths are left out where a checksum tells the same, and so are folders: machines differ there."""


def join(runs: Sequence[RunSummary], names: Sequence[str] = ()) -> RunSummary:
    """Join what chunks of one run found out.

    Parameters
    ----------
    runs
        In any order, at least one. No frame may be in two of them.
    names
        What messages call them, such as the folders of their reports; their key frames where left
        out.

    Returns
    -------
    RunSummary
        That of the run that does all their frames. Its `wall_seconds` is the sum, which is the time
        that machines spent, not the time that passed. Where machines may differ, as in paths, it is
        what the part with the first frames tells.

    Raises
    ------
    InputError
        When they are no parts of one run, or two have the same frame.
    """
    called = [_Part(run, name) for run, name in zip(runs, names or map(_name, runs), strict=True)]
    parts = sorted(called, key=lambda part: (part.run.selected, part.run.input.pattern))
    for other in parts[1:]:
        _require_alike(parts[0], other)
    frames = _frames(parts)
    keys = {key for part in parts for key in part.run.selected}
    return replace(
        parts[0].run,
        frames=frames,
        keys=tuple(sorted(keys)),
        cuts=join_cuts(part.run.cuts for part in parts),
        wall_seconds=sum(part.run.wall_seconds for part in parts),
        left_out=tuple(
            sorted((one for part in parts for one in part.run.left_out), key=lambda one: one.key)
        ),
        files=_files(parts),
        verified=_verified(parts),
        nonfinite=tuple(one for part in parts for one in part.run.nonfinite),
    )


def part_of(run: RunSummary, keys: Collection[int]) -> RunSummary:
    """Return what a run tells of some of its key frames.

    Of cuts these are the ones that the key frames themselves meet, before or behind them; of the
    wall time it is the share of their frames.
    """
    frames = tuple(frame for frame in run.frames if frame.key in keys)
    met = {number + behind for number in keys for behind in (0, run.input.step)}
    cuts = None if run.cuts is None else tuple(cut for cut in run.cuts if cut.number in met)
    share = len(frames) / len(run.frames) if run.frames else 0.0
    numbers = {frame.number for frame in frames}
    files = tuple(file for file in run.files if file.frame is None or file.frame in numbers)
    return replace(
        run,
        frames=frames,
        keys=tuple(key for key in run.selected if key in keys),
        cuts=cuts,
        wall_seconds=run.wall_seconds * share,
        left_out=tuple(one for one in run.left_out if one.key in keys),
        files=files,
        verified=None if run.verified is None else len(files),
        nonfinite=tuple(one for one in run.nonfinite if one.key in keys),
    )


def missing_keys(run: RunSummary) -> list[int]:
    """Return the input numbers of the key frames of its sequence that a run is not for."""
    there = set(run.selected)
    return [number for number in run.input.numbers if number not in there]


def join_cuts(each: Iterable[tuple[Cut, ...] | None]) -> tuple[Cut, ...] | None:
    """Unite the cuts that parts met; neighbours both meet the one between them.

    Parameters
    ----------
    each
        Of every part; None where none were looked for or given, as then in all of them.
    """
    met: set[Cut] = set()
    for cuts in each:
        if cuts is None:
            return None
        met.update(cuts)
    # A cut that was given in one part and found in another is given: that word comes last.
    by_number = {cut.number: cut for cut in sorted(met, key=lambda c: (c.number, c.source))}
    return tuple(by_number.values())


@dataclass(frozen=True)
class _Part:
    """A run, and what messages call it."""

    run: RunSummary
    name: str


def _name(run: RunSummary) -> str:
    return f"the run of key frames {ranges(run.selected) or 'none'}"


def _require_alike(one: _Part, other: _Part) -> None:
    """Refuse two runs that are no parts of one."""
    for trait in TRAITS:
        first, second = trait.of(one.run), trait.of(other.run)
        if first != second:
            raise InputError(
                f"{one.name} and {other.name} are no parts of one run: the {trait.name} is "
                f"{_shown(first)} in the one and {_shown(second)} in the other; join only what "
                "one command did in chunks"
            )


def _files(parts: Sequence[_Part]) -> tuple[WrittenFile, ...]:
    """Return all files, frame by frame, a video last."""
    found = dict.fromkeys(file for part in parts for file in part.run.files)
    return tuple(sorted(found, key=lambda one: (one.frame is None, one.frame or 0, one.kind)))


def _verified(parts: Sequence[_Part]) -> int | None:
    """Return how many files were read back; None where not all parts did so."""
    counts = [part.run.verified for part in parts]
    return None if None in counts else sum(count or 0 for count in counts)


def _shown(value: Any) -> str:
    """Write a trait's value, not too long."""
    if isinstance(value, tuple):
        value = ", ".join(map(str, value))
    text = "none" if value is None or value == "" else str(value)
    return text if len(text) <= SHOWN else f"{text[: SHOWN - 1]}…"


def _frames(parts: Sequence[_Part]) -> tuple[FrameRecord, ...]:
    """Return all frames, ascending; refuse those that are there twice."""
    found = [(frame, part) for part in parts for frame in part.run.frames]
    found.sort(key=lambda entry: entry[0].number)
    for (frame, one), (later, other) in pairwise(found):
        if frame.number == later.number:
            raise InputError(
                f"frame {frame.number} is in {one.name} and again in {other.name}; leave one of "
                "them out"
            )
    return tuple(frame for frame, _ in found)


@dataclass(frozen=True)
class Outcome:
    """What was made; attributes as in `RunSummary`."""

    frames: tuple[FrameRecord, ...] = ()
    cuts: tuple[Cut, ...] | None = None
    left_out: tuple[LeftOut, ...] = ()
    files: tuple[WrittenFile, ...] = ()
    verified: int | None = None
    nonfinite: tuple[BrokenPixels, ...] = ()

    @property
    def shown(self) -> int:
        """How many frames a video of them has."""
        return len(self.frames) + sum(len(one.frames) for one in self.left_out)

    @classmethod
    def joined(cls, parts: Sequence[Outcome]) -> Outcome:
        """Join those of chunks, in their order."""
        counts = [part.verified for part in parts if part.verified is not None]
        return cls(
            tuple(frame for part in parts for frame in part.frames),
            join_cuts(part.cuts for part in parts),
            tuple(one for part in parts for one in part.left_out),
            tuple(file for part in parts for file in part.files),
            sum(counts) if counts else None,
            tuple(one for part in parts for one in part.nonfinite),
        )
