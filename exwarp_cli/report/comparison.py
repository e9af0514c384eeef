"""What ``exwarp compare`` reports: document (``exwarp.compare/1``), table, limits and page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exwarp_cli import __version__
from exwarp_cli.domain.decision import CHOICES
from exwarp_cli.domain.metric import GENERATED
from exwarp_cli.domain.results import FrameKind, Score
from exwarp_cli.domain.settings import SRGB_VIEW
from exwarp_cli.errors import QualityError, UsageError
from exwarp_cli.io.footage import close_sequences
from exwarp_cli.io.sequences import Sequence
from exwarp_cli.io.view_transform import find_display_look, find_view_transform
from exwarp_cli.pipeline.evaluation import ComparedFrame, Comparison
from exwarp_cli.pipeline.ground_truth import read_display
from exwarp_cli.report import html, schema
from exwarp_cli.report.gallery import Album
from exwarp_cli.report.plots import Labels, draw_lines
from exwarp_cli.report.sentences import format_percent

SCHEMA = "exwarp.compare/1"

# Names of the two sources in the viewer.
REFERENCE, TEST = "reference", "test"

# Of a further sequence, whose scores stand beside those of the test.
BASELINE = "baseline"

# Of frames.csv; `frame` is the test's number, `kind` and `made_by` are from its header.
COLUMNS = (
    *("frame", "reference_frame", "file", "hole_fraction", *schema.FIRST_SCORES),
    *(f"{name}_holes" for name in schema.FIRST_SCORES),
    *schema.LATER_COLUMNS,
    *("kind", "made_by", "pulse"),
)


def comparison_document(result: Comparison, baseline: Comparison | None = None) -> dict[str, Any]:
    """Turn a comparison into the dictionary of report.json; None is what was not measured.

    ``baseline`` is there only if there is one, compared with the same reference.
    """
    worst, frames = result.worst, result.frames
    quality = _summarise_quality(frames)
    document: dict[str, Any] = schema.to_plain(
        {
            "schema": SCHEMA,
            "version": __version__,
            "reference": _describe_sequence(result.reference),
            "test": _describe_sequence(result.test),
            "masks": None if result.holes is None else _describe_sequence(result.holes),
            "matched_by": result.matched_by,
            "width": result.width,
            "height": result.height,
            "frames": len(frames),
            "quality": quality,
            "worst": {
                "frame": worst.test,
                "reference_frame": worst.reference,
                "file": worst.file,
                **schema.score_values(worst.score),
            },
            "metrics": list(result.measuring.measured),
            "preset": result.measuring.preset,
            "view_transform": result.measuring.view_transform,
            "thresholds": _judge_limits(result, quality),
            "notes": list(result.notes),
        }
    )
    if baseline is not None:
        document[BASELINE] = _describe_sequence(baseline.test) | {
            "quality": schema.to_plain(_summarise_quality(baseline.frames))
        }
    return document


def _summarise_quality(frames: tuple[ComparedFrame, ...]) -> dict[str, Any]:
    generated = [f for f in frames if f.origin.generated]
    decided = [f for f in generated if f.origin.path is not None]
    dropped = [f for f in frames if f.origin.kind == FrameKind.DROPPED.value]
    return {
        "all": schema.mean_scores(frame.score for frame in frames),
        GENERATED: schema.mean_scores(f.score for f in generated),
        "dropped": schema.mean_scores(f.score for f in dropped),
        "by_decision": {
            choice: schema.mean_scores(f.score for f in decided if f.origin.made_by == choice)
            for choice in CHOICES
        },
        "holes": schema.mean_scores(frame.hole_score for frame in frames),
    }


def _describe_sequence(sequence: Sequence) -> dict[str, Any]:
    numbers = sorted(sequence.files)
    return {"pattern": sequence.pattern, "first": numbers[0], "last": numbers[-1]}


def format_comparison_csv(result: Comparison) -> str:
    """Write a row for every compared frame as CSV text."""
    rows = (
        (
            *(frame.test, frame.reference, schema.escape_formula(frame.file), frame.hole_fraction),
            *schema.score_cells(frame.score, schema.FIRST_SCORES),
            *schema.score_cells(frame.hole_score, schema.FIRST_SCORES),
            *schema.score_cells(frame.score, schema.LATER_SCORES),
            *schema.score_cells(frame.hole_score, schema.LATER_HOLE_SCORES),
            *map(schema.escape_formula, (frame.origin.kind, frame.origin.made_by)),
            frame.score.pulse,
        )
        for frame in result.frames
    )
    return schema.format_csv(COLUMNS, rows)


def quality_rows(document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Name the blocks of a comparison's quality in the order of a table's rows.

    Parts that no header names are left out; "all pixels" and "holes" are always there. The
    baseline's rows stand before the test's, with the names of both; without one there are no names.
    """
    quality = document["quality"]
    parts = {"generated": quality["generated"], "repeated": quality["dropped"]}
    parts |= {f"made by {name}": block for name, block in quality["by_decision"].items()}
    parts = {name: block for name, block in parts.items() if block["frames"]}
    rows = {"all pixels": quality["all"], **parts, "holes": quality["holes"]}
    if BASELINE not in document:
        return rows
    quality = document[BASELINE]["quality"]
    added = {"all pixels": quality["all"], "generated": quality["generated"]}
    return {f"{BASELINE}, {name}": block for name, block in added.items() if block["frames"]} | {
        f"{TEST}, {name}": block for name, block in rows.items()
    }


def _judge_limits(result: Comparison, quality: dict[str, Any]) -> list[dict[str, Any]]:
    """Judge every limit by a comparison's quality; ``value`` is None where it was not measured."""
    verdicts = []
    for limit in result.measuring.thresholds:
        name = limit.metric.field
        if limit.scope == "worst":
            values = (getattr(frame.score, name) for frame in result.frames)
            measured = (value for value in values if value is not None)
            value = max(measured, key=limit.metric.badness, default=None)
        else:
            value = quality[limit.scope][name]
        allowed = limit.metric.badness(limit.limit)
        verdicts.append(
            {
                "name": limit.name,
                "metric": name,
                "scope": limit.scope,
                "limit": limit.limit,
                "fails": limit.option.removeprefix("--fail-"),
                "value": value,
                "passed": value is not None and limit.metric.badness(value) <= allowed,
            }
        )
    return verdicts


def require_quality(result: Comparison) -> None:
    """Raise what a comparison fails by.

    UsageError: a limit is on something that was not measured: nothing passes unseen. QualityError:
    a value is worse than its limit.
    """
    verdicts = _judge_limits(result, _summarise_quality(result.frames))
    failed = [
        (limit, verdict["value"])
        for limit, verdict in zip(result.measuring.thresholds, verdicts, strict=True)
        if not verdict["passed"]
    ]
    unmeasured = [limit.name for limit, value in failed if value is None]
    if unmeasured:
        why = f" ({'; '.join(result.notes)})" if result.notes else ""
        raise UsageError(
            f"the limit on {unmeasured[0]} cannot be judged, as it was not measured{why}; leave "
            "that limit out"
        )
    if failed:
        failures = [
            f"{limit.name} {value:+.6g} is farther from 0 than {limit.limit:g}"
            if limit.metric.signed
            else f"{limit.name} {value:.6g} is {limit.option.removeprefix('--fail-')} "
            f"{limit.limit:g}"
            for limit, value in failed
        ]
        raise QualityError(
            f"{result.test.pattern} is not good enough: {', '.join(failures)}; look at the worst "
            f"frame, {result.worst.test}, or set other limits"
        )


def add_baseline(album: Album, result: Comparison, baseline: Comparison) -> None:
    """Show the baseline's frames in the album of a comparison, left of the test's."""
    view = result.measuring.view
    transform = find_view_transform(result.measuring.view_transform)
    sequences = baseline.reference, baseline.test
    looks = [find_display_look(sequence, transform) for sequence in sequences]
    frame_of = {frame.reference: frame for frame in baseline.frames}
    album.names, album.before, album.after = (BASELINE, TEST, REFERENCE), BASELINE, TEST
    try:
        for frame in result.frames:
            same = frame_of.get(frame.reference)
            if same is not None and frame.test in album.frames:
                truth, pixels = (
                    look.apply(read_display(sequence, number, view))
                    for look, sequence, number in zip(
                        *(looks, sequences, (same.reference, same.test)), strict=True
                    )
                )
                album.add_source(frame.test, BASELINE, pixels, truth)
    finally:
        close_sequences(*sequences)


def compare_page(
    result: Comparison, document: dict[str, Any], album: Album, baseline: Comparison | None = None
) -> html.Page:
    """Build the page of a comparison.

    `document` is what `comparison_document` returned: tables and headline. `album` has pictures of
    its frames, and gets facts and the frame rate.
    """
    base_scores = {f.reference: f.score for f in baseline.frames} if baseline else {}
    album.fps = result.fps
    for frame in result.frames:
        facts = html.score_facts(frame.score, frame.hole_score)
        base = html.score_facts(base_scores.get(frame.reference), None)
        facts |= {f"{name} of the {BASELINE}": text for name, text in base.items()}
        if frame.reference != frame.test:
            facts["reference frame"] = str(frame.reference)
        if frame.hole_fraction is not None:
            facts["holes"] = format_percent(frame.hole_fraction)
        album.set_facts(frame.test, "", facts)
    test, reference = document["test"]["pattern"], document["reference"]["pattern"]
    numbers = [
        html.Number("Frames", f"{document['frames']:,}", f"matched by {document['matched_by']}"),
        *html.quality_numbers(document["quality"]["all"]),
    ]
    if document["thresholds"]:
        failed = [limit["name"] for limit in document["thresholds"] if not limit["passed"]]
        note = ", ".join(failed) or "all of them"
        numbers.insert(0, html.Number("Limits", "failed" if failed else "passed", note))
    generated = document["quality"]["generated"]
    if generated["frames"] != document["frames"]:
        # The mean over all frames flatters: the first metric, and pulse, which limits on generated
        # frames are set on.
        note = f"of {generated['frames']:,} frames alone"
        numbers += [
            html.Number(
                f"{metric.name}, generated", metric.with_unit(generated[metric.field]), note
            )
            for i, metric in enumerate(html.measured_metrics(generated))
            if i == 0 or metric.signed
        ]
    subtitle = f"{test} against {reference}"
    if baseline is not None:
        subtitle += f", with {baseline.test.pattern} as the {BASELINE}"
    return html.Page(
        f"{html.file_name(test)} against {html.file_name(reference)}",
        subtitle,
        numbers,
        (
            html.Section("frames", "Frames", [album] if album.frames else []),
            html.Section("quality", "Quality", _quality(result, document, album, base_scores)),
            html.Section("input", "Input", [_input(document)]),
        ),
    )


def _quality(
    result: Comparison, document: dict[str, Any], album: Album, base_scores: Mapping[int, Score]
) -> list[html.Block]:
    """Write tables and plots; `base_scores` are the baseline's by the reference's number."""
    numbers = [frame.test for frame in result.frames]
    scores = [frame.score for frame in result.frames]
    parts = {
        f"{name} only" if name.endswith("holes") else name: block
        for name, block in quality_rows(document).items()
        if block["frames"] or not name.endswith("holes")
    }
    blocks: list[html.Block] = [html.quality_table("Means over the frames", parts)]
    rows: list[list[html.Cell]] = []
    for limit in document["thresholds"]:
        metric = html.BY_FIELD[limit["metric"]]
        fails = f"fails {limit['fails']} {'±' if metric.signed else ''}{limit['limit']:g}"
        verdict = "passed" if limit["passed"] else "failed"
        rows.append([limit["name"], html.metric_text(metric, limit["value"]), fails, verdict])
    if rows:
        blocks.append(html.Table("Limits", ("", "value", "limit", ""), rows))
    blocks += html.worst_tables(numbers, scores, album)
    beside = [base_scores.get(frame.reference) for frame in result.frames] if base_scores else []
    blocks += html.metric_plots(numbers, scores, names=(TEST, BASELINE), beside=beside)
    blocks += document["notes"]
    holes = [None if f.hole_fraction is None else 100 * f.hole_fraction for f in result.frames]
    if len(holes) > 1 and any(share is not None for share in holes):
        labels = Labels(
            "Hole share per frame", "frame", "holes, % of pixels", "Share of pixels in the mask."
        )
        blocks.append(draw_lines(labels, numbers, {"holes": holes}))
    return blocks


def _input(document: dict[str, Any]) -> html.Table:
    rows: list[list[html.Cell]] = [
        [name, sequence["pattern"], f"{sequence['first']}-{sequence['last']}"]
        for name in ("reference", BASELINE, "test", "masks")
        if (sequence := document.get(name)) is not None
    ]
    view = document["view_transform"]
    settings = {
        "size": f"{document['width']}x{document['height']}",
        "preset": document["preset"],
        "pictures shown by": None if view == SRGB_VIEW else view,
        "ExWarp": document["version"],
    }
    rows += [[name, text, ""] for name, text in settings.items() if text is not None]
    return html.Table("", ("", "", "frames"), rows)
