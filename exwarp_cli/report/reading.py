"""A report read back from its files: report.json and frames.csv hold all that a run found out."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from exwarp_cli import __version__
from exwarp_cli.domain.decision import Decision, Features, Trial, infer_maker
from exwarp_cli.domain.results import (
    BrokenPixels,
    FrameKind,
    FrameRecord,
    InputSummary,
    InterpolatorSummary,
    LeftOut,
    NetworkSummary,
    PolicySummary,
    RunSummary,
    Score,
    WrittenFile,
)
from exwarp_cli.domain.tiles import Risk, TileMakers
from exwarp_cli.domain.timeline import Cut, list_numbers
from exwarp_cli.errors import DamagedFileError, InputError
from exwarp_cli.report.comparison import SCHEMA as COMPARISON
from exwarp_cli.report.folder import FRAMES_FILE, REPORT_FILE
from exwarp_cli.report.frames_csv import (
    ADDED_COLUMNS,
    FIRST_SCORES,
    LATER_HOLE_SCORES,
    LATER_SCORES,
    frames_csv,
    named,
)
from exwarp_cli.report.summary import SCHEMA, report

Model = TypeVar("Model", NetworkSummary, InterpolatorSummary)

HOLES = "_holes"
STEP = "_ms"
"""Endings of columns: scores within holes, and times of steps."""

SETTINGS = ("key", "slot")

ADDED: dict[str, Any] = {
    "left_out": [],
    "files": [],
    "verified": None,
    "nonfinite": [],
    "held": [],
    "pulse": None,
    "review": None,
}
"""What reports of earlier versions do not tell, as it was then."""

ADDED_IN: dict[str, dict[str, Any]] = {
    "decisions": {"gate": None, "look_ahead": None, "cost": None},
    "frames": {"rendered": 0},
}
"""The same of their parts."""

MOST_KEYS = 10_000_000
"""Key frames of a sequence, as many as a range of frames can name."""

CLOSE = 1e-9
"""How near to each other two computers' means of the same numbers are, relatively."""


def read_report(folder: Path) -> RunSummary:
    """Read back what `exwarp_cli.report.folder.write_report` wrote.

    Returns
    -------
    RunSummary
        Of which `report` and `frames_csv` make the same files again. A file name that is no valid
        Unicode is spelled out, as it is in frames.csv.

    Raises
    ------
    InputError
        When a file cannot be read, or the report is one of another kind.
    DamagedFileError
        When a file is damaged or was changed, or is of a version that wrote something else.
    """
    document = _document(folder / REPORT_FILE)
    text = _text(folder / FRAMES_FILE)
    try:
        run = _run(document, frames_of(text))
        written = frames_csv(run.frames, _lacking(text))
        whole = written == text and _alike(report(run), _with_pulse(document))
    except _NONSENSE as error:
        raise _unusable(folder, document) from error
    if not whole:
        raise _unusable(folder, document)
    return run


def reported_keys(folder: Path) -> frozenset[int]:
    """Read of which key frames a report tells, by their input numbers, and nothing else of it.

    Raises
    ------
    InputError
        As `read_report` does.
    """
    document = _document(folder / REPORT_FILE)
    try:
        return frozenset(_selected(document))
    except _NONSENSE as error:
        raise _unusable(folder, document) from error


def frames_of(text: str) -> tuple[FrameRecord, ...]:
    """Read what `frames_csv` wrote.

    Raises
    ------
    KeyError, ValueError, csv.Error
        When it is no such table.
    """
    rows = csv.DictReader(io.StringIO(text, newline=""), strict=True)
    return tuple(_frame(row) for row in rows)


def _document(path: Path) -> dict[str, Any]:
    """Read report.json, as far as to know that it is one of `upsample`."""
    try:
        found = json.loads(_text(path))
    except (ValueError, RecursionError) as error:
        raise DamagedFileError(f"{path} is damaged; {_AGAIN}") from error
    schema = found.get("schema") if isinstance(found, dict) else None
    if schema == COMPARISON:
        raise InputError(
            f"{path} is the report of a comparison, which has no parts; name reports of upsample"
        )
    if schema != SCHEMA:
        raise InputError(
            f"{path} is no report of schema {SCHEMA}; name folders that upsample --report wrote"
        )
    for part, added in ADDED_IN.items():
        if isinstance(found.get(part), dict):
            found[part] = {**added, **found[part]}
    if isinstance(found.get("left_out"), list):
        found["left_out"] = [{"rendered": [], **one} for one in found["left_out"]]
    return {**ADDED, **found}


_NONSENSE = (
    *(ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError),
    csv.Error,
)
"""What is raised on the way by files that hold something else."""

_AGAIN = "do its key frames again with --report, or leave it out"


def _text(path: Path) -> str:
    """Return a file's text, line ends as they are."""
    try:
        return path.read_bytes().decode("utf-8")
    except UnicodeDecodeError as error:
        raise DamagedFileError(f"{path} is damaged; {_AGAIN}") from error
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}; {_AGAIN}") from error


def _unusable(folder: Path, document: Mapping[str, Any]) -> DamagedFileError:
    """Say why a report cannot be read: its version, else damage."""
    version = document.get("version")
    if version != __version__:
        return DamagedFileError(
            f"the report in {folder} was written by ExWarp {version}, and {__version__} cannot "
            "read all of it; merge reports with the version that wrote them"
        )
    return DamagedFileError(
        f"{REPORT_FILE} and {FRAMES_FILE} in {folder} do not go together, as if one was damaged or "
        f"changed; {_AGAIN}"
    )


def _alike(one: Any, other: Any) -> bool:
    """Whether two documents are equal, but for the last digits of what was averaged."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_alike(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_alike, one, other))
    if isinstance(one, float) and isinstance(other, int | float):
        return math.isclose(one, other, rel_tol=CLOSE, abs_tol=CLOSE)
    return bool(one == other)


def _lacking(text: str) -> list[str]:
    """Return the columns that a table of an earlier version does not have."""
    header = text.partition("\n")[0].split(",")
    return [name for name in ADDED_COLUMNS if name not in header]


def _with_pulse(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return a report with "pulse" in all parts of its quality; earlier versions had none."""

    def completed(part: Mapping[str, Any]) -> dict[str, Any]:
        return {"pulse": None, **part}

    quality = document["quality"]
    by_decision = {name: completed(part) for name, part in quality["by_decision"].items()}
    parts = {name: completed(part) for name, part in quality.items() if name != "by_decision"}
    return {**document, "quality": {**parts, "by_decision": by_decision}}


def _run(document: Mapping[str, Any], frames: tuple[FrameRecord, ...]) -> RunSummary:
    """Put a run together from its document and its frames."""
    fps, cuts, wall = document["fps"], document["cuts"], document["wall_s"]
    made = RunSummary(
        method=document["method"],
        setting=document["setting"],
        lookahead=document["lookahead"],
        input=_input(document["input"]),
        base_fps=fps["base"],
        fps_source=fps["source"],
        wall_seconds=math.nan if wall is None else wall,
        frames=frames,
        # A count, even of none, is one of a run that decides.
        decides=None not in document["decisions"]["paths"].values(),
        extrapolator=_model(NetworkSummary, document["extrapolator"]),
        policy=_policy(document["policy"]),
        interpolator=_model(InterpolatorSummary, document["interpolator"]),
        factor=Fraction(fps["factor"]),
        cuts=None if cuts is None else tuple(Cut(int(cut["frame"]), cut["source"]) for cut in cuts),
        views=tuple(document["views"]),
        layers=tuple(document["layers"]),
        keys=_selected(document),
        version=document["version"],
        left_out=tuple(
            LeftOut(
                *(one["key"], tuple(one["frames"]), one["reason"]),
                *(tuple(one["scores"]), tuple(one["rendered"])),
            )
            for one in document["left_out"]
        ),
        files=tuple(WrittenFile(**one) for one in document["files"]),
        verified=document["verified"],
        nonfinite=tuple(BrokenPixels(**one) for one in document["nonfinite"]),
    )
    if made.setting not in SETTINGS:
        raise ValueError(f"the setting {made.setting}")
    models = (made.extrapolator, made.policy, made.interpolator)
    for part in (made, made.input, *models, *made.left_out, *made.files, *made.nonfinite):
        _require_types(part)
    return made


def _selected(document: Mapping[str, Any]) -> tuple[int, ...]:
    """Return the input numbers of the key frames that the run was for."""
    return tuple(map(int, list_numbers(document["input"]["selected"] or "")))


def _require_types(part: Any) -> None:
    """Refuse a part of a run whose fields hold something else than they may.

    Equality with the document does not tell: what is copied is equal, whatever it is.
    """
    if part is None:
        return
    kinds = get_type_hints(type(part))
    wrong = [name for name, kind in kinds.items() if not _fits(getattr(part, name), kind)]
    if wrong:
        raise TypeError(f"{wrong[0]} of {type(part).__name__}")


def _fits(value: Any, kind: Any) -> bool:
    """Whether a value is of an annotated type: a class, a union, or a tuple of any length."""
    if isinstance(kind, UnionType):
        return any(_fits(value, one) for one in get_args(kind))
    if get_origin(kind) is tuple:
        return isinstance(value, tuple) and all(_fits(one, get_args(kind)[0]) for one in value)
    if kind is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    return type(value) is kind


def _input(block: Mapping[str, Any]) -> InputSummary:
    motion, dynamic = block["motion"], block["dynamic"]
    numbers = {name: int(block[name]) for name in ("first", "last", "width", "height", "step")}
    if numbers["step"] < 1:
        raise ValueError(f"key frames in steps of {numbers['step']}")
    if (numbers["last"] - numbers["first"]) // numbers["step"] >= MOST_KEYS:
        raise ValueError(f"key frames up to {numbers['last']}")
    return InputSummary(
        pattern=block["pattern"],
        producer=block["producer"],
        **numbers,
        motion_source=motion["source"],
        motion_evidence=motion["evidence"],
        dynamic=None if dynamic is None else tuple(dynamic),
        depth=block.get("depth"),
    )


def _model(kind: Callable[..., Model], block: Mapping[str, Any] | None) -> Model | None:
    return None if block is None else kind(**block)


def _policy(block: Mapping[str, Any] | None) -> PolicySummary | None:
    if block is None:
        return None
    lists = {"missing": block["missing"], "trained_for": block.get("trained_for", ())}
    return PolicySummary(**{**block, **{name: tuple(values) for name, values in lists.items()}})


def _frame(row: Mapping[str, str]) -> FrameRecord:
    """Read a row; its cells are as `frames_csv` writes them."""
    pixels = _number(row["nonfinite_pixels"])
    pulse = _number(row.get("pulse", ""))
    score = _score(row, "scored", (*FIRST_SCORES, *LATER_SCORES))
    return FrameRecord(
        number=int(row["frame"]),
        file=named(row["file"]),
        key=int(row["key"]),
        slot=int(row["slot"]),
        kind=FrameKind(row["kind"]),
        method=row["method"],
        sources=_integers(row["sources"]),
        hole_fraction=_number(row["hole_fraction"]),
        nonfinite_pixels=None if pixels is None else int(pixels),
        score=None if score is None else replace(score, pulse=pulse),
        hole_score=_score(row, f"scored{HOLES}", _HOLE_SCORES, HOLES),
        resumed=_truth(row["resumed"]),
        timing_ms=_timing(row),
        made_by=infer_maker(row["made_by"] or None, row["method"]),
        path=row["path"] or None,
        decision=_decision(row),
        render=_render(row),
        replaced=_truth(row["replaced"]),
        key_pulse=pulse if score is None else None,
        risk=_risk(row),
        trial=Trial.parsed(row["gate"]) if row.get("gate") else None,
        tiles=TileMakers.parsed(row["tiles"]) if row.get("tiles") else None,
        rendered_sources=_integers(row.get("rendered_sources", "")),
    )


_HOLE_SCORES = (*FIRST_SCORES, *(name.removesuffix(HOLES) for name in LATER_HOLE_SCORES))


def _score(
    row: Mapping[str, str], scored: str, names: tuple[str, ...], ending: str = ""
) -> Score | None:
    if not _truth(row[scored]):
        return None
    return Score(**{name: _number(row[f"{name}{ending}"]) for name in names})


def _timing(row: Mapping[str, str]) -> dict[str, float]:
    steps = {name.removesuffix(STEP): text for name, text in row.items() if name.endswith(STEP)}
    return {step: _value(text) for step, text in steps.items() if text}


def _decision(row: Mapping[str, str]) -> Decision | None:
    if not row["node"]:
        return None
    warp, extrapolate = _number(row["output_warp"]), _number(row["output_extrapolate"])
    return Decision(
        row["node"],
        row["choice"],
        _features(row),
        _integers(row["inputs"]),
        None if warp is None or extrapolate is None else (warp, extrapolate),
    )


def _features(row: Mapping[str, str]) -> Features | None:
    if not row["N_d"]:
        return None
    return Features(
        objects=int(row["N_d"]),
        emd_normal=_value(row["EMD_Wn"]),
        emd_position=_value(row["EMD_Wp"]),
        var_x=_value(row["Var_x"]),
        var_y=_value(row["Var_y"]),
        width=int(row["rendered_width"]),
        height=int(row["rendered_height"]),
        distance=_value(row["distance"]),
    )


def _render(row: Mapping[str, str]) -> tuple[float, str] | None:
    seconds = _number(row["render_s"])
    return None if seconds is None else (seconds, row["render_source"])


def _risk(row: Mapping[str, str]) -> Risk | None:
    text = row.get("predicted_error")
    return Risk.parsed(_value(text), row["risk"]) if text else None


def _truth(text: str) -> bool:
    return {"true": True, "false": False}[text]


def _integers(text: str) -> tuple[int, ...]:
    return tuple(map(int, text.split()))


def _number(text: str) -> float | None:
    """Read a cell; nothing is what was not measured."""
    return _value(text) if text else None


def _value(text: str) -> float:
    """Read a number: integers stay integers, so that the same text is written again."""
    return int(text) if re.fullmatch("-?[0-9]+", text) else float(text)
