"""The contract of a report: report.json, schema ``exwarp.report/1``, and its CSV tables.

frames.csv has a row a frame, and review.csv one for each place that is worth a look.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from fractions import Fraction
from itertools import groupby
from typing import Any

import numpy as np

from exwarp_cli.domain.decision import (
    CHOICES,
    EXTRAPOLATE,
    FEATURES,
    HELD,
    LOOKAHEAD,
    NODES,
    PATHS,
    SOFTSPLAT,
    WARP,
    Trial,
)
from exwarp_cli.domain.metric import GROUND_TRUTH, KEY_FRAMES, METRICS
from exwarp_cli.domain.results import FrameKind, FrameRecord, RunSummary, Score
from exwarp_cli.domain.tiles import MAKER_LETTERS, TILE_PATHS, TileMakers
from exwarp_cli.domain.timeline import ranges
from exwarp_cli.report.review import PLACE_COLUMNS, Place, summarise_review

SCHEMA = "exwarp.report/1"

# Steps of the work that a report always names; a run may time others too.
STEPS = ("read", "features", "decide", "warp", "holes", "extrapolate", "write")

HOLE_BINS = 20  # of the hole histogram: 5 % of the frame each

FIRST_SCORES = ("psnr_db", "ssim", "flip")
# Metrics whose columns came later and so stand behind the others; VMAF is one of whole frames.
LATER_SCORES = ("hdr_flip", "vmaf", "flicker")
LATER_HOLE_SCORES = ("hdr_flip", "flicker")
LATER_COLUMNS = (*LATER_SCORES, *(f"{name}_holes" for name in LATER_HOLE_SCORES))

# Lines of frames.csv are read by position, too: a new column goes to the end. The timed steps stand
# behind these, each as <step>_ms.
COLUMNS = (
    *("frame", "file", "key", "slot", "kind", "method", "sources"),
    *("hole_fraction", "nonfinite_pixels", *FIRST_SCORES),
    *(f"{name}_holes" for name in FIRST_SCORES),
    *("resumed", "made_by", "path", "node", "choice", "output_warp", "output_extrapolate"),
    *FEATURES,
    # What the policy's network saw, in Q16.16, with spaces between.
    "inputs",
    *LATER_COLUMNS,
    *("render_s", "render_source"),
    # Of the features: R is width x height, EMD_Wp is judged by the distance.
    *("rendered_width", "rendered_height", "distance"),
    # True where there was ground truth, whatever was measured.
    *("scored", "scored_holes"),
    "replaced",
    # Against ground truth where `scored` is true, else against the key frames.
    "pulse",
    # RMS of the frame in display levels of 0 to 255, and that of its tiles: see `domain.tiles`.
    *("predicted_error", "risk"),
    # The key frame that the gate predicted, and the PSNR of both predictions.
    "gate",
    # What made each tile, row by row: w for warping, e for the network, r for warping what the
    # network made of the slot before.
    "tiles",
    # Numbers of frames that were rendered after all.
    "rendered_sources",
)

_FORMULA = (*"=+-@'", "\t", "\r", "\n")

# What reading a file of a report raises if it holds something else.
UNREADABLE = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)


def run_document(run: RunSummary) -> dict[str, Any]:
    """Turn a run into the dictionary that report.json holds.

    Keys are a contract: more may come, none is renamed. What was not measured is None, never 0,
    and no number is NaN or infinite.
    """
    between = tuple(frame for frame in run.frames if frame.slot)
    source = run.input
    # Frames by key frame, without groups that lack a slot (the last one without tail).
    intervals = [list(frames) for _, frames in groupby(run.frames, lambda frame: frame.key)]
    least = math.floor(run.factor)  # of 2.5, intervals show two or three
    complete = [frames for frames in intervals if len({f.slot for f in frames}) >= least]
    cuts = [{"frame": cut.number, "source": cut.source} for cut in run.cuts or ()]
    document = {
        "schema": SCHEMA,
        "version": run.version,
        "method": run.method,
        "setting": run.setting,
        "lookahead": run.lookahead,
        "input": {
            "pattern": source.pattern,
            "first": source.first,
            "last": source.last,
            "width": source.width,
            "height": source.height,
            "producer": source.producer,
            "motion": {"source": source.motion_source, "evidence": source.motion_evidence},
            "dynamic": source.dynamic,
            "depth": source.depth,
            "step": source.step,
            "selected": ranges(run.selected) or None,
        },
        **_count_frames(run, complete),
        "holes": _summarise_holes(between),
        "decisions": _summarise_decisions(run, complete),
        **_summarise_quality(run.decides, between),
        "review": summarise_review(run),
        "timing_ms": {
            step: mean(f.timing_ms[step] for f in run.frames if step in f.timing_ms)
            for step in timed_steps(run.frames)
        },
        "extrapolator": run.extrapolator,
        "policy": run.policy,
        "interpolator": run.interpolator,
        "render_time": render_time_saved(run),
        "cuts": None if run.cuts is None else cuts,
        # Key frames that the slots after them repeat: the next one shows the same picture; or none
        # follows in the shot, and the key frame itself repeats the one before.
        "held": sorted({frame.key for frame in run.frames if frame.method == HELD}),
        "views": run.views,
        "layers": run.layers,
        "left_out": run.left_out,
        "files": run.files,
        "verified": run.verified,
        "nonfinite": run.nonfinite,
        "view_transform": run.view_transform,
        "wall_s": run.wall_seconds,
    }
    plain: dict[str, Any] = to_plain(document)
    return plain


def to_plain(value: Any, lossless: bool = False) -> Any:
    """Return dataclasses, dictionaries, sequences, Enums and Fractions as JSON has them.

    NaN and infinities become None, or, if nothing may be lost, their names.
    """
    if is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, dict):
        return {key: to_plain(item, lossless) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_plain(item, lossless) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Fraction):
        return str(value)
    if isinstance(value, float) and not math.isfinite(value):
        return str(value) if lossless else None
    return value


def to_json(document: dict[str, Any], compact: bool = False, lossless: bool = False) -> str:
    """Write a document as JSON text; floats keep all their digits, and `to_plain` is applied."""
    indent, separators = (None, (",", ":")) if compact else (2, None)
    plain = to_plain(document, lossless)
    return json.dumps(plain, indent=indent, separators=separators, allow_nan=False) + "\n"


def mean(values: Iterable[float]) -> float | None:
    """Return the mean, or None without values."""
    numbers = [float(value) for value in values]
    return sum(numbers) / len(numbers) if numbers else None


def score_values(score: Score | None) -> dict[str, float | None]:
    """Return a score's values by their names in every report; None if not measured."""
    return {m.field: None if score is None else getattr(score, m.field) for m in METRICS}


def mean_scores(scores: Iterable[Score | None]) -> dict[str, float | int | None]:
    """Average the scores that are there, by metric; None where no frame has a value.

    ``frames`` counts the frames that were scored.
    """
    rows = [score_values(score) for score in scores if score is not None]
    means = {
        m.field: mean(value for row in rows if (value := row[m.field]) is not None) for m in METRICS
    }
    return {**means, "frames": len(rows)}


def timed_steps(frames: tuple[FrameRecord, ...]) -> list[str]:
    """Return the steps that a report names: `STEPS`, then others that were timed."""
    others = {step for frame in frames for step in frame.timing_ms} - set(STEPS)
    return [*STEPS, *sorted(others)]


def _count_frames(run: RunSummary, complete: Sequence[Sequence[FrameRecord]]) -> dict[str, Any]:
    """Return the blocks ``frames`` and ``fps``; `complete` are key intervals with all slots."""
    resumed, replaced = sum(f.resumed for f in run.frames), sum(f.replaced for f in run.frames)
    kinds = [frame.kind for frame in run.frames]
    # A repeated frame is not new. At the paper's factor this is base x (1 + mean number of
    # generated frames per key interval).
    new = mean(f.kind is not FrameKind.DROPPED for interval in complete for f in interval)
    fresh = len(kinds) - resumed
    return {
        "frames": {
            "key": kinds.count(FrameKind.KEY),
            "written": len(kinds),  # of an earlier run too
            "generated": kinds.count(FrameKind.GENERATED),
            "dropped": kinds.count(FrameKind.DROPPED),
            "rendered": kinds.count(FrameKind.RENDERED),
            # These three add up to "written".
            "resumed": resumed,
            "made": fresh - replaced,
            "replaced": replaced,
        },
        "fps": {
            "base": run.base_fps,
            "effective": None if new is None else run.output_fps * new,
            "output": run.output_fps,
            # Of joined runs, per second of all their machines.
            "throughput": fresh / run.wall_seconds if fresh and run.wall_seconds > 0 else None,
            "source": run.fps_source,
            "factor": run.factor,  # a fraction such as 5/2, which loses no digits
        },
    }


def _summarise_holes(between: tuple[FrameRecord, ...]) -> dict[str, Any]:
    fractions = [f.hole_fraction for f in between if f.has_holes and f.hole_fraction is not None]
    fractions = [fraction for fraction in fractions if math.isfinite(fraction)]
    if not fractions:
        return {"mean_fraction": None, "p95_fraction": None, "histogram": None}
    edges = [i / HOLE_BINS for i in range(HOLE_BINS + 1)]
    counts, _ = np.histogram(fractions, bins=edges)
    return {
        "mean_fraction": mean(fractions),
        "p95_fraction": float(np.percentile(fractions, 95)),
        "histogram": {"edges": edges, "counts": counts.tolist()},
    }


def _summarise_decisions(
    run: RunSummary, complete: Sequence[Sequence[FrameRecord]]
) -> dict[str, Any]:
    """Count decisions, and state what the gate decided and what the network computed.

    ``gate``: each trial with the key intervals that it decided for; ``look_ahead``: the frames that
    softsplat and the network made, in parts where tiles were chosen; ``cost``: the networks' share
    of the new frames' area.
    """
    # Makers of the frames whose tiles the decision tree chose. Frames that are made of the key
    # frames on both sides are not among them.
    two_sided = MAKER_LETTERS[SOFTSPLAT], MAKER_LETTERS[LOOKAHEAD]
    makers = ((f.number, f.tiles) for f in run.frames if f.tiles is not None)
    tiles = {number: made for number, made in makers if made.letters[0] not in two_sided}
    decides = run.decides or bool(tiles)
    block = count_decisions(_paths_taken(complete, tiles) if decides else None)
    keys: dict[tuple[Trial, bool], dict[int, None]] = {}
    shares: dict[int, float] = {}  # of each frame that something chose the maker of, the network's
    for frame in run.frames:
        if frame.trial is not None:
            # After the last key frame look-ahead methods go by the decision tree, tile by tile.
            looks_ahead = run.lookahead and frame.number not in tiles
            keys.setdefault((frame.trial, looks_ahead), {})[frame.key] = None
        if frame.tiles is not None:
            shares[frame.number] = sum(map(frame.tiles.share, (EXTRAPOLATE, LOOKAHEAD)))
        elif run.lookahead and frame.kind is FrameKind.GENERATED:
            shares[frame.number] = float(frame.made_by == LOOKAHEAD)
    trials = []
    for (trial, looks_ahead), intervals in keys.items():
        cheap, dear = (SOFTSPLAT, LOOKAHEAD) if looks_ahead else CHOICES
        trials.append(
            {
                "frame": trial.frame,
                f"{cheap}_db": trial.cheap_db,
                f"{dear}_db": trial.dear_db,
                "used": dear if trial.pays else cheap,
                "keys": list(intervals),
            }
        )
    chooses = bool(trials) or any(frame.tiles is not None for frame in run.frames)
    ahead = {frame.number for frame in run.frames if frame.made_by in (SOFTSPLAT, LOOKAHEAD)}
    made = [share for number, share in shares.items() if number in ahead]
    dear_frames = round(sum(made), 3)
    counts = {"cheap": round(len(made) - dear_frames, 3), "dear": dear_frames}
    cost = mean(shares.values()) if chooses or decides else None
    block |= {"gate": trials or None, "look_ahead": counts if chooses and run.lookahead else None}
    block["cost"] = cost
    if cost is not None:
        block["warp_share"] = 1 - cost
    return block


def _paths_taken(
    complete: Sequence[Sequence[FrameRecord]], tiles: Mapping[int, TileMakers]
) -> list[str]:
    """Return the path of each interval that has one, or of each of its tiles."""
    # A tile's path shows in the makers of slots 2 and 3.
    path_of = {letters[1:]: name for name, letters in TILE_PATHS.items()}
    paths: list[str] = []
    for interval in complete:
        taken = [frame.path for frame in interval if frame.path]
        by_slot = {f.slot: tiles[f.number] for f in interval if f.number in tiles}
        if taken:
            paths.append(taken[-1])
        elif 2 in by_slot and 3 in by_slot:
            pairs = zip(by_slot[2].letters, by_slot[3].letters, strict=True)
            paths += [path_of[second + third] for second, third in pairs]
    return paths


def count_decisions(paths: Iterable[str] | None) -> dict[str, Any]:
    """Count the decisions of a run.

    `paths` are S1 to S6 of each key interval with all its slots, or of each of its tiles; None for
    a method outside the paper's decision tree, whose counts are all None.
    """
    if paths is None:
        return {
            "nodes": {node: dict.fromkeys(CHOICES) for node in NODES},
            "paths": dict.fromkeys(PATHS),
            "warp_share": None,
        }
    taken = Counter(paths)
    steps = Counter[tuple[str, str]]()
    for name, count in taken.items():
        for step in PATHS[name].choices.items():
            steps[step] += count
    warped = sum(count for (_, choice), count in steps.items() if choice == WARP)
    return {
        "nodes": {node: {choice: steps[node, choice] for choice in CHOICES} for node in NODES},
        "paths": {name: taken[name] for name in PATHS},
        "warp_share": warped / steps.total() if steps else None,
    }


def _summarise_quality(decides: bool, between: Sequence[FrameRecord]) -> dict[str, Any]:
    """Return the blocks ``quality`` and ``pulse``, of the frames that were not rendered.

    Quality is the mean of the scores, repeats included. Pulse is that of the generated frames, in
    per cent; None where none was measured. Softer and sharper frames cancel out in its ``mean``;
    ``worst`` has the largest magnitude.
    """
    frames = [frame for frame in between if frame.kind is not FrameKind.RENDERED]
    generated = [frame for frame in frames if frame.kind is FrameKind.GENERATED]
    decided = generated if decides else []
    quality = {
        "all": mean_scores(f.score for f in frames),
        "holes": mean_scores(f.hole_score for f in frames),
        "by_decision": {
            choice: mean_scores(f.score for f in decided if f.made_by == choice)
            for choice in CHOICES
        },
        "dropped": mean_scores(f.score for f in frames if f.kind is FrameKind.DROPPED),
    }
    pulse = None
    # Frames without ground truth are left out where others have it.
    scored = [frame for frame in generated if frame.score is not None]
    pulses = [(f, f.pulse) for f in scored or generated if f.pulse is not None]
    if pulses:
        worst, value = max(pulses, key=lambda entry: abs(entry[1]))
        pulse = {
            "mean": mean(pulse for _, pulse in pulses),
            "worst": value,
            "worst_frame": worst.number,
            "frames": len(pulses),
            "against": GROUND_TRUTH if scored else KEY_FRAMES,
        }
    return {"quality": quality, "pulse": pulse}


def render_time_saved(run: RunSummary) -> dict[str, Any] | None:
    """Return what a run saved, from the render times in the headers of its key frames.

    ``key_frame_s``: mean render time of a key frame; ``key_frames``: how many headers state it;
    ``source``: the attribute; ``generated_frame_s``: this run's time for each generated frame,
    reading and writing included, scoring not; ``saved_s``: what rendering the generated frames
    would have taken beyond the key frames, less the run's time; ``saved_share``: that as a share of
    rendering all frames. None where no header says it, or nothing was generated.
    """
    render_times = [frame.render for frame in run.frames if frame.render is not None]
    # This run spent no time on resumed frames, nor on key frames of intervals that it kept.
    fresh = [frame for frame in run.frames if not frame.resumed]
    generated = sum(frame.kind is FrameKind.GENERATED for frame in fresh)
    key_frame_s = mean(seconds for seconds, _ in render_times)
    if key_frame_s is None or not generated:
        return None
    worked = {frame.key for frame in fresh}
    rendered = sum(
        frame.kind in (FrameKind.KEY, FrameKind.RENDERED) and frame.key in worked
        for frame in run.frames
    )
    # Frames are scored one after the other, which a run without ground truth does not need.
    scoring_s = sum(frame.timing_ms.get("score", 0.0) for frame in run.frames) / 1e3
    spent = max(run.wall_seconds - scoring_s, 0.0)
    # Key frames that fall on no output instant were rendered too.
    shown = {frame.key for frame in run.frames if frame.kind is FrameKind.KEY}
    saved = (generated - len(worked - shown)) * key_frame_s - spent
    return {
        "key_frame_s": key_frame_s,
        "key_frames": len(render_times),
        "source": render_times[0][1],
        "generated_frame_s": spent / generated,
        "saved_s": saved,
        "saved_share": saved / ((generated + rendered) * key_frame_s),
    }


def format_frames_csv(frames: tuple[FrameRecord, ...]) -> str:
    """Write the records as CSV text: a header line, then a row a frame in the given order.

    An empty cell is what was not measured or decided; `sources` are frame numbers with spaces
    between.
    """
    steps = timed_steps(frames)
    rows: list[list[Any]] = []
    for frame in frames:
        decision, score, holes = frame.decision, frame.score, frame.hole_score
        features = None if decision is None else decision.features
        rows.append(
            [
                *(frame.number, escape_formula(frame.file), frame.key, frame.slot),
                *(frame.kind, frame.method, " ".join(map(str, frame.sources))),
                *(frame.hole_fraction, frame.nonfinite_pixels),
                *score_cells(score, FIRST_SCORES),
                *score_cells(holes, FIRST_SCORES),
                *(frame.resumed, frame.made_by, frame.path),
                *((decision.node, decision.choice) if decision else (None, None)),
                *((decision.outputs if decision else None) or (None, None)),
                *(features.values if features else (None,) * len(FEATURES)),
                (" ".join(map(str, decision.inputs)) or None) if decision else None,
                *score_cells(score, LATER_SCORES),
                *score_cells(holes, LATER_HOLE_SCORES),
                *(frame.render or (None, None)),
                *((features.width, features.height, features.distance) if features else [None] * 3),
                *(score is not None, holes is not None, frame.replaced, frame.pulse),
                *((frame.risk.error, frame.risk.text) if frame.risk else (None, None)),
                frame.trial.text if frame.trial else None,
                frame.tiles.text if frame.tiles else None,
                " ".join(map(str, frame.rendered_sources)) or None,
                *map(frame.timing_ms.get, steps),
            ]
        )
    return format_csv([*COLUMNS, *(f"{step}_ms" for step in steps)], rows)


def format_review_csv(places: Sequence[Place]) -> str:
    """Write places as CSV, a row each; the error with one decimal."""
    rows = ((p.frame, round(p.error, 1), p.x, p.y, p.width, p.height, p.reason) for p in places)
    return format_csv(PLACE_COLUMNS, rows)


def format_csv(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Write a header and rows as CSV text with ``\\n`` line ends; floats keep all their digits."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([format_cell(value) for value in row] for row in rows)
    # A file name need not be valid Unicode; what cannot be encoded is spelled out. So is a carriage
    # return, which older versions of the writer do not quote and every reader ends a row at.
    plain = text.getvalue().replace("\r", "\\r")
    return plain.encode("utf-8", "backslashreplace").decode("utf-8")


def format_cell(value: Any) -> str:
    """Write a cell: empty for None, NaN and infinities; ``true`` and ``false`` in words."""
    value = to_plain(value)
    if value is None:
        return ""
    return str(value).lower() if isinstance(value, bool) else str(value)


def escape_formula(name: str | None) -> str | None:
    """Put an apostrophe before a name that a spreadsheet would run as a formula."""
    return f"'{name}" if name is not None and name.startswith(_FORMULA) else name


def score_cells(score: Score | None, names: Sequence[str]) -> list[float | None]:
    """Return the cells of some metrics, by their names in `Score`."""
    return [None if score is None else getattr(score, name) for name in names]
