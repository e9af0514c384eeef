"""The reports of chunks, merged into the one that a single run would have written.

Chunks' reports may overlap: jobs that are submitted again with chunks of another size, and engines
that change the size on the way, leave such reports. Of each key frame the newest counts. None is
deleted.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

from exwarp_cli import __version__
from exwarp_cli.domain.results import RunSummary, join_cuts
from exwarp_cli.domain.timeline import list_numbers, ranges
from exwarp_cli.errors import DamagedFileError, InputError, UsageError
from exwarp_cli.report.comparison import SCHEMA as COMPARISON
from exwarp_cli.report.folder import (
    ALBUM_FILE,
    CHUNKS,
    REPORT_FILE,
    RUN_FILE,
    chunk_reports,
    parse_run,
    prepare_report,
    write_report,
)
from exwarp_cli.report.gallery import merge_albums
from exwarp_cli.report.schema import SCHEMA, UNREADABLE, run_document

# Characters of a value in a message.
MAX_VALUE = 120

_AGAIN = "do its key frames again with --report, or leave it out"


def merge_reports(
    folders: Sequence[Path], output: Path | None = None, replace: bool = False
) -> dict[str, Any]:
    """Merge reports into one, and write it.

    `folders` are those of reports, or what chunks reported to: a folder without a report of its own
    stands for those in its ``chunks``, of which the newest count. `output` is the folder to write
    to; None for the only one of `folders`, whose ``chunks`` are merged. `replace` is True if a
    report in it may be replaced.

    Return what its report.json holds, and as ``merged``: ``reports``, how many there are;
    ``missing``, the range of key frames that are in none, or None; ``without_pictures``, folders of
    which the page has no pictures; ``superseded``, folders with key frames that newer ones have.

    UsageError: nothing says where to write. InputError: a report cannot be read, or they do not
    belong together. OutputError: the report cannot be written; OutputExistsError: there is one.
    """
    if output is None and len(folders) > 1:
        raise UsageError("several reports are named; say with -o where the joined one goes")
    selected: Selection = {}
    superseded: list[Path] = []
    for folder in {folder.resolve(): folder for folder in folders}.values():
        # Without -o, a report of the folder's own is the one to write.
        if output is not None and (folder / REPORT_FILE).exists():
            selected[folder] = None
            continue
        chunks = chunk_reports(folder)
        if not chunks and output is None:
            raise InputError(
                f"{folder} holds no {CHUNKS}/*/{REPORT_FILE}, as upsample --report {folder} "
                "--as-chunk writes it; name the folders of the reports themselves, and with -o "
                "where to write"
            )
        if not chunks:
            raise InputError(
                f"{folder} holds no {REPORT_FILE}; name folders that upsample --report wrote"
            )
        newest, older = _select_newest(chunks)
        selected |= newest
        superseded += older
    unique = {folder.resolve(): folder for folder in selected}
    if output is not None and output.resolve() in unique:
        raise UsageError(f"-o {output} is one of the reports that are joined; name another folder")
    runs: dict[Path, RunSummary] = {}
    for folder in unique.values():
        run, keys = _read_run(folder), selected[folder]
        runs[folder] = run if keys is None else part_of_run(run, keys)
    run = merge_runs({str(folder): run for folder, run in runs.items()})
    target = output or folders[0]
    prepare_report(target, replace, "-o")
    numbers = [{frame.number for frame in part.frames} for part in runs.values()]
    album, unreadable = merge_albums([folder / ALBUM_FILE for folder in runs], numbers, run)
    write_report(target, run, album)
    merged = {
        "reports": len(runs),
        "missing": ranges(sorted(set(run.input.numbers) - set(run.selected))) or None,
        "without_pictures": [str(path.parent) for path in unreadable],
        "superseded": [str(folder) for folder in superseded],
    }
    return run_document(run) | {"merged": merged}


# Of each report, the key frames that are taken from it; None for all.
Selection = dict[Path, frozenset[int] | None]


def _select_newest(folders: Sequence[Path]) -> tuple[Selection, list[Path]]:
    """Assign each key frame to the newest report that has it.

    Return what counts, in the order of `folders`, and the reports with key frames of which newer
    ones count.
    """
    finished_ns: dict[Path, int] = {}
    keys: dict[Path, frozenset[int]] = {}
    for folder in folders:
        _, document = _read_report(folder)
        finished_ns[folder] = (folder / REPORT_FILE).stat().st_mtime_ns
        try:
            numbers = list_numbers(document["input"]["selected"] or "")
            keys[folder] = frozenset(map(int, numbers))
        except UNREADABLE as error:
            raise _unusable(folder, document) from error

    covered: frozenset[int] = frozenset()
    remaining: dict[Path, frozenset[int]] = {}
    newest_first = sorted(folders, key=finished_ns.__getitem__, reverse=True)
    for _, group in groupby(newest_first, key=finished_ns.__getitem__):
        # Of the same moment none is newer: merging refuses frames that are in two of them.
        same_moment = list(group)
        remaining |= {folder: keys[folder] - covered for folder in same_moment}
        covered = covered.union(*(keys[folder] for folder in same_moment))
    selected = {
        folder: None if remaining[folder] == keys[folder] else remaining[folder]
        for folder in folders
        if remaining[folder] or not keys[folder]
    }
    return selected, [folder for folder in folders if remaining[folder] != keys[folder]]


def _read_run(folder: Path) -> RunSummary:
    """Read what `write_report` wrote; InputError or DamagedFileError if it is something else."""
    report, document = _read_report(folder)
    if not (folder / RUN_FILE).exists():
        raise InputError(
            f"{folder} holds no {RUN_FILE}, which earlier versions of ExWarp did not write; merge "
            f"reports with the version that wrote them, or {_AGAIN}"
        )
    text = _read_text(folder / RUN_FILE)
    try:
        return parse_run(text, report)
    except UNREADABLE as error:
        raise _unusable(folder, document) from error


def _read_report(folder: Path) -> tuple[str, dict[str, Any]]:
    """Return the text and the document of report.json, if it is one of `upsample`."""
    path = folder / REPORT_FILE
    text = _read_text(path)
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise DamagedFileError(f"{path} is damaged; {_AGAIN}") from error
    schema = document.get("schema") if isinstance(document, dict) else None
    if schema == COMPARISON:
        raise InputError(
            f"{path} is the report of a comparison, which has no parts; name reports of upsample"
        )
    if schema != SCHEMA:
        raise InputError(
            f"{path} is no report of schema {SCHEMA}; name folders that upsample --report wrote"
        )
    return text, document


def _unusable(folder: Path, document: dict[str, Any]) -> DamagedFileError:
    version = document.get("version")
    if version != __version__:
        return DamagedFileError(
            f"the report in {folder} was written by ExWarp {version}, and {__version__} cannot "
            "read all of it; merge reports with the version that wrote them"
        )
    return DamagedFileError(
        f"{REPORT_FILE} and {RUN_FILE} in {folder} do not go together, as if one was damaged or "
        f"changed; {_AGAIN}"
    )


def _read_text(path: Path) -> str:
    try:
        return path.read_bytes().decode("utf-8")
    except UnicodeDecodeError as error:
        raise DamagedFileError(f"{path} is damaged; {_AGAIN}") from error
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}; {_AGAIN}") from error


def part_of_run(run: RunSummary, keys: Collection[int]) -> RunSummary:
    """Return what a run says of some of its key frames.

    Cuts are those that the key frames meet, before or behind them; the wall time is the share of
    their frames.
    """
    frames = tuple(frame for frame in run.frames if frame.key in keys)
    met = {number + step for number in keys for step in (0, run.input.step)}
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
        left_out=tuple(interval for interval in run.left_out if interval.key in keys),
        files=files,
        verified=None if run.verified is None else len(files),
        nonfinite=tuple(pixels for pixels in run.nonfinite if pixels.key in keys),
    )


def merge_runs(runs: Mapping[str, RunSummary]) -> RunSummary:
    """Merge what chunks of one run found out into what the run that does all their frames would.

    `runs` are at least one, in any order, by what messages call them, such as the folders of their
    reports. The `wall_seconds` are the sum: the time that machines spent, not the time that passed.
    Where machines may differ, as in paths, the value is that of the part with the first frames.

    InputError: they are no parts of one run, or two have the same frame.
    """
    parts = sorted(runs.items(), key=lambda part: (part[1].selected, part[1].input.pattern))
    ordered = [run for _, run in parts]
    first_name, first = parts[0]
    common = _common_facts(first)
    for name, run in parts[1:]:
        for fact, value in _common_facts(run).items():
            if value != common[fact]:
                raise InputError(
                    f"{first_name} and {name} are no parts of one run: the {fact} is "
                    f"{_format_value(common[fact])} in the one and {_format_value(value)} in the "
                    "other; join only what one command did in chunks"
                )
    frames = [(frame, name) for name, run in parts for frame in run.frames]
    frames.sort(key=lambda entry: entry[0].number)
    for (frame, name), (later, later_name) in pairwise(frames):
        if frame.number == later.number:
            raise InputError(
                f"frame {frame.number} is in {name} and again in {later_name}; leave one of them "
                "out"
            )
    files = dict.fromkeys(file for run in ordered for file in run.files)
    left_out = [interval for run in ordered for interval in run.left_out]
    verified = [run.verified for run in ordered]
    return replace(
        first,
        frames=tuple(frame for frame, _ in frames),
        keys=tuple(sorted({key for run in ordered for key in run.selected})),
        cuts=join_cuts(run.cuts for run in ordered),
        wall_seconds=sum(run.wall_seconds for run in ordered),
        left_out=tuple(sorted(left_out, key=lambda interval: interval.key)),
        # Frame by frame, a video last.
        files=tuple(sorted(files, key=lambda f: (f.frame is None, f.frame or 0, f.kind))),
        verified=None if None in verified else sum(count or 0 for count in verified),
        nonfinite=tuple(pixels for run in ordered for pixels in run.nonfinite),
    )


def _format_value(value: str | tuple[str, ...] | None) -> str:
    text = (", ".join(value) if isinstance(value, tuple) else value) or "none"
    return text if len(text) <= MAX_VALUE else f"{text[: MAX_VALUE - 1]}…"


def _common_facts(run: RunSummary) -> dict[str, Any]:
    """Return what all parts of a run have in common, by its name in messages."""
    # Paths are left out where a checksum says the same, and so are folders: they are mounted
    # elsewhere on other machines.
    source = run.input
    facts: dict[str, Any] = {
        "version of ExWarp": run.version,
        "input": re.split(r"[/\\]", source.pattern)[-1],
        "range of its key frames": f"{source.first}-{source.last}",
        "size of its frames": f"{source.width}x{source.height}",
        "program that wrote it": source.producer,
        "source of motion": source.motion_source,
        "reading of its vectors": source.motion_evidence,
        "choice of what moves": source.dynamic,
        "method": run.method,
        "setting of G-buffers": run.setting,
        "rate of the input": f"{run.base_fps} fps ({run.fps_source})",
        "factor": str(run.factor),
        "network that extrapolates": None,
        "network that interpolates": None,
        "policy": None,
        "search for cuts": "no" if run.cuts is None else "yes",
        "choice of views": run.views,
        "choice of layers": run.layers,
        "view transform": run.view_transform,
    }
    if source.step > 1:
        facts["range of its key frames"] += f"x{source.step}"
    if source.motion_evidence is not None:
        # What was measured: other processors differ in its last digits.
        facts["reading of its vectors"] = re.sub(r"\d+\.\d+", "…", source.motion_evidence)
    if network := run.extrapolator:
        colour = "shading alone" if network.demodulated else "whole colour"
        facts["network that extrapolates"] = (
            f"sha256 {network.sha256} on {network.device}, given {colour}"
        )
    if model := run.interpolator:
        facts["network that interpolates"] = (
            f"{model.name} on {model.device}, sha256 {model.sha256}, card {model.card_sha256}, "
            f"policy {model.policy_sha256}, effort {model.effort}"
        )
    if policy := run.policy:
        missing = " and ".join(policy.missing) or "nothing"
        facts["policy"] = (
            f"sha256 {policy.sha256} with objects from {policy.objects_from} and {missing} missing"
        )
    return facts
