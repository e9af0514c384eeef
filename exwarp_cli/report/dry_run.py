"""What ``exwarp upsample --dry-run`` tells: as a document, schema ``exwarp.dry-run/1``, and lines.

Frames are given as ranges of numbers. Whatever stands in both has the names that report.json gives
it.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from exwarp_cli.domain.results import FrameKind
from exwarp_cli.domain.timeline import ranges
from exwarp_cli.domain.wording import pluralise
from exwarp_cli.pipeline.dry_run import DryRun, Fate, ForeseenFrame
from exwarp_cli.report.summary import report

SCHEMA = "exwarp.dry-run/1"

LONGEST = 60
"""Characters of a list of frames in a line; generated ones lie between all others."""

KINDS = {
    FrameKind.KEY: "rendered",
    FrameKind.RENDERED: "rendered after all",
    FrameKind.GENERATED: "generated",
}
"""Kinds of frames that are foreseen, and what lines call them."""

_SAME = ("version", "method", "setting", "lookahead", "input", "views", "layers")
_MODELS = ("extrapolator", "policy", "interpolator")


def dry_run_document(found: DryRun) -> dict[str, Any]:
    """Turn what a run would do into the dictionary that is printed as JSON."""
    head = report(found.head)
    paths = {"output": found.output, "holes": found.holes, "video": found.video}
    return {
        "schema": SCHEMA,
        **{name: head[name] for name in _SAME},
        "fps": {name: head["fps"][name] for name in ("base", "output", "source", "factor")},
        "frames": _frames(found.frames),
        **{name: None if path is None else str(path) for name, path in paths.items()},
        "report": None if found.report is None else str(found.report),
        **{name: head[name] for name in _MODELS},
        "cuts": {
            "detect": found.cuts_looked_for,
            "known": [{"frame": cut.number, "source": cut.source} for cut in found.cuts],
        },
        "spread": found.spread,
        "chunks": [ranges(list(chunk)) for chunk in found.chunks],
    }


def dry_run_lines(found: DryRun) -> list[str]:
    """Tell in a few lines what a run would do, beside what it says of its input."""
    fates = {fate: [f for f in found.frames if f.fate is fate] for fate in Fate}
    where = found.output or found.video
    lines = [f"dry run, nothing is written: {_how_many(found.frames)} in {where}"]
    lines += [f"  {line}" for line in _kinds(found.frames)]
    said = {Fate.REPLACE: "replaced", Fate.KEEP: "there already and kept"}
    for fate, words in said.items():
        if fates[fate]:
            lines.append(f"  {len(fates[fate])} of them {words}: {_ranges(fates[fate])}")
    beside = {"hole masks": found.holes, "video": found.video, "report": found.report}
    lines += [
        f"{name} in {path}" for name, path in beside.items() if path is not None and path != where
    ]
    fps = report(found.head)["fps"]
    lines.append(f"method {found.head.method}; {fps['base']:g} fps in, {fps['output']:g} out")
    lines.append(_cuts(found))
    if found.spread is not None:
        many = pluralise(len(found.chunks), "chunk")
        sizes = sorted({len(chunk) for chunk in found.chunks})
        lines.append(f"{found.spread}: {many} of {' or '.join(map(str, sizes))} key frames")
    return lines


def _frames(frames: tuple[ForeseenFrame, ...]) -> dict[str, Any]:
    """Count frames by kind and by fate, and name them."""
    kinds = {
        **{kind.value: [frame for frame in frames if frame.kind is kind] for kind in KINDS},
        **{fate.value: [frame for frame in frames if frame.fate is fate] for fate in Fate},
    }
    numbers = {name: ranges([frame.number for frame in some]) for name, some in kinds.items()}
    return {
        "count": len(frames),
        **{name: {"count": len(some), "numbers": numbers[name]} for name, some in kinds.items()},
    }


def _kinds(frames: tuple[ForeseenFrame, ...]) -> list[str]:
    kinds = {kind: [frame for frame in frames if frame.kind is kind] for kind in KINDS}
    return [f"{len(some)} {KINDS[kind]}: {_ranges(some)}" for kind, some in kinds.items() if some]


def _cuts(found: DryRun) -> str:
    if not found.cuts_looked_for and not found.cuts:
        return "cuts: none are looked for"
    known = ", ".join(f"{cut.number} ({cut.source})" for cut in found.cuts)
    looked = "looked for on the way" if found.cuts_looked_for else ""
    return f"cuts: {'; '.join(text for text in (known, looked) if text)}"


def _ranges(frames: Iterable[ForeseenFrame]) -> str:
    text = ranges([frame.number for frame in frames])
    if len(text) <= LONGEST:
        return text
    return f"{text[:LONGEST].rpartition(',')[0]} …"


def _how_many(frames: tuple[ForeseenFrame, ...]) -> str:
    if not frames:
        return "no frame"
    return f"{pluralise(len(frames), 'frame')}, {_ranges(frames)},"
