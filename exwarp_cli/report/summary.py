"""The contract of report.json, schema ``exwarp.report/1``."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from typing import Any

import numpy as np

from exwarp_cli.domain.metric import GROUND_TRUTH, KEY_FRAMES
from exwarp_cli.domain.results import FrameKind, FrameRecord, RunSummary
from exwarp_cli.domain.timeline import ranges
from exwarp_cli.report.decisions import (
    decisions,
    gate,
    paths_of_tiles,
    quality_by_decision,
    tile_shares,
)
from exwarp_cli.report.quality import mean, quality
from exwarp_cli.report.render_time import render_time
from exwarp_cli.report.review import review

SCHEMA = "exwarp.report/1"

STEPS = ("read", "features", "decide", "warp", "holes", "extrapolate", "write")
"""Steps of the work that a report always names; a run may time others too."""

HOLE_BINS = 20
"""Bins of the hole histogram, 5 % of the frame each."""


def report(run: RunSummary) -> dict[str, Any]:
    """Turn a run into the dictionary that report.json holds.

    Keys are a contract: more may come, none is renamed. What was not measured is None, never 0,
    and no number is NaN or infinite.
    """
    shown = tuple(frame for frame in run.frames if frame.slot)
    found = {
        "schema": SCHEMA,
        "version": run.version,
        "method": run.method,
        "setting": run.setting,
        "lookahead": run.lookahead,
        "input": _input(run),
        "frames": _frames(run.frames),
        "fps": _fps(run),
        "holes": _holes(shown),
        "decisions": decisions(_paths(run)) | gate(run) | tile_shares(run),
        "quality": _quality(run.decides, shown),
        "pulse": _pulse(shown),
        "review": review(run),
        "timing_ms": _timing(run.frames),
        "extrapolator": None if run.extrapolator is None else asdict(run.extrapolator),
        "policy": None if run.policy is None else asdict(run.policy),
        "interpolator": None if run.interpolator is None else asdict(run.interpolator),
        "render_time": render_time(run),
        "cuts": None
        if run.cuts is None
        else [{"frame": cut.number, "source": cut.source} for cut in run.cuts],
        "held": list(run.held),
        "views": list(run.views),
        "layers": list(run.layers),
        "left_out": [asdict(one) for one in run.left_out],
        "files": [asdict(one) for one in run.files],
        "verified": run.verified,
        "nonfinite": [asdict(one) for one in run.nonfinite],
        "wall_s": run.wall_seconds,
    }
    plain: dict[str, Any] = finite(found)
    return plain


def complete_intervals(run: RunSummary) -> list[list[FrameRecord]]:
    """Group frames by key frame; leave out groups that lack a slot (the last one without tail)."""
    groups: dict[int, list[FrameRecord]] = {}
    for frame in run.frames:
        groups.setdefault(frame.key, []).append(frame)
    least = math.floor(run.factor)  # of 2.5, intervals show two or three
    return [group for group in groups.values() if len({f.slot for f in group}) >= least]


def steps_of(frames: tuple[FrameRecord, ...]) -> list[str]:
    """Return the steps that a report names: the fixed ones, then others that were timed."""
    others = {step for frame in frames for step in frame.timing_ms} - set(STEPS)
    return [*STEPS, *sorted(others)]


def finite(value: Any) -> Any:
    """Return nested dictionaries and lists with plain numbers; NaN and infinities become None."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, np.generic):
        return finite(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def to_json(document: dict[str, Any]) -> str:
    """Write a report as JSON text; floats keep all their digits."""
    return json.dumps(document, indent=2, allow_nan=False) + "\n"


def _input(run: RunSummary) -> dict[str, Any]:
    """Name the input, and as ``selected`` the range of key frames that the run was for."""
    source = run.input
    return {
        "pattern": source.pattern,
        "first": source.first,
        "last": source.last,
        "width": source.width,
        "height": source.height,
        "producer": source.producer,
        "motion": {"source": source.motion_source, "evidence": source.motion_evidence},
        "dynamic": None if source.dynamic is None else list(source.dynamic),
        "depth": source.depth,
        "step": source.step,
        "selected": ranges(run.selected) or None,
    }


def _frames(frames: tuple[FrameRecord, ...]) -> dict[str, int]:
    """Count the output frames; `written` counts those of an earlier run (`resumed`) too.

    `rendered` are those that were rendered after all, in the place of generated ones.

    `resumed`, `made` and `replaced` add up to `written`: replaced are those that took the place of
    a file.
    """
    resumed, replaced = sum(f.resumed for f in frames), sum(f.replaced for f in frames)
    kinds = [frame.kind for frame in frames]
    return {
        "key": kinds.count(FrameKind.KEY),
        "written": len(frames),
        "generated": kinds.count(FrameKind.GENERATED),
        "dropped": kinds.count(FrameKind.DROPPED),
        "rendered": kinds.count(FrameKind.RENDERED),
        "resumed": resumed,
        "made": len(frames) - resumed - replaced,
        "replaced": replaced,
    }


def _fps(run: RunSummary) -> dict[str, Any]:
    """Base, effective and working speed.

    Effective FPS is the output's times the share of rendered and generated frames, over intervals
    with all their slots: a repeated frame is none for the eye. At the paper's factor that is base
    x (1 + mean number of generated frames per key interval). Throughput is frames that this very
    run wrote, per second of its wall time; of joined runs, per second of all their machines.
    ``factor`` is a fraction as text, such as 4 or 5/2, so that nothing of it is lost.
    """
    new = mean(
        frame.kind is not FrameKind.DROPPED
        for interval in complete_intervals(run)
        for frame in interval
    )
    fresh = sum(not frame.resumed for frame in run.frames)
    timed = fresh > 0 and run.wall_seconds > 0
    return {
        "base": run.base_fps,
        "effective": None if new is None else run.output_fps * new,
        "output": run.output_fps,
        "throughput": fresh / run.wall_seconds if timed else None,
        "source": run.fps_source,
        "factor": str(run.factor),
    }


def _holes(shown: tuple[FrameRecord, ...]) -> dict[str, Any]:
    """Distribution of the hole fraction over the frames that have holes."""
    known = [f.hole_fraction for f in shown if f.has_holes and f.hole_fraction is not None]
    known = [fraction for fraction in known if math.isfinite(fraction)]
    if not known:
        return {"mean_fraction": None, "p95_fraction": None, "histogram": None}
    edges = [i / HOLE_BINS for i in range(HOLE_BINS + 1)]
    counts, _ = np.histogram(known, bins=edges)
    return {
        "mean_fraction": mean(known),
        "p95_fraction": float(np.percentile(known, 95)),
        "histogram": {"edges": edges, "counts": counts.tolist()},
    }


def _paths(run: RunSummary) -> list[str] | None:
    """Return the path of each complete interval whose path is known; None outside the tree.

    Where tiles are decided, that of each tile.
    """
    if not run.decides:
        return None
    paths: list[str] = []
    for group in complete_intervals(run):
        taken = [frame.path for frame in group if frame.path]
        paths += taken[-1:] or paths_of_tiles(group)
    return paths


def _quality(decides: bool, shown: tuple[FrameRecord, ...]) -> dict[str, Any]:
    """Mean scores over the frames between key frames that were not rendered, repeats included."""
    shown = tuple(frame for frame in shown if frame.kind is not FrameKind.RENDERED)
    return {
        "all": quality(f.score for f in shown),
        "holes": quality(f.hole_score for f in shown),
        "by_decision": quality_by_decision(decides, shown),
        "dropped": quality(f.score for f in shown if f.kind is FrameKind.DROPPED),
    }


def _pulse(shown: tuple[FrameRecord, ...]) -> dict[str, Any] | None:
    """Return the pulse of the generated frames, in per cent; None where none was measured.

    ``mean`` is that of the frames' values, so that softer and sharper frames cancel out; ``worst``
    and ``worst_frame`` are those of the largest magnitude. ``against`` is "ground truth", and then
    frames without it are left out; or "key frames", where no frame has ground truth.
    """
    generated = [frame for frame in shown if frame.kind is FrameKind.GENERATED]
    scored = [frame for frame in generated if frame.score is not None]
    known = [(f, f.pulse) for f in scored or generated if f.pulse is not None]
    if not known:
        return None
    worst, value = max(known, key=lambda entry: abs(entry[1]))
    return {
        "mean": mean(value for _, value in known),
        "worst": value,
        "worst_frame": worst.number,
        "frames": len(known),
        "against": GROUND_TRUTH if scored else KEY_FRAMES,
    }


def _timing(frames: tuple[FrameRecord, ...]) -> dict[str, float | None]:
    """Mean milliseconds of each step, over the frames that had it."""
    return {
        step: mean(f.timing_ms[step] for f in frames if step in f.timing_ms)
        for step in steps_of(frames)
    }
