"""The page of a comparison between two sequences."""

from __future__ import annotations

from typing import Any

from exwarp_cli.pipeline.evaluation import Comparison
from exwarp_cli.report.comparison import part_rows
from exwarp_cli.report.gallery import Album
from exwarp_cli.report.page import Block, Cell, Number, Page, Section, Table, Text, Viewer
from exwarp_cli.report.page_parts import (
    BY_FIELD,
    facts_of,
    file_name,
    measured_in,
    metric_plots,
    metric_text,
    percent,
    quality_numbers,
    quality_table,
    worst_table,
)
from exwarp_cli.report.plot_style import Labels
from exwarp_cli.report.plots import lines

REFERENCE, TEST = "reference", "test"
"""Names of the two sources in the viewer."""


def compare_page(result: Comparison, document: dict[str, Any], album: Album | None = None) -> Page:
    """Build the page of a comparison.

    Parameters
    ----------
    result
        Its frames are plotted.
    document
        What `exwarp_cli.report.comparison.comparison` made of it: tables and headline.
    album
        Pictures of its frames; None for a page without a viewer.
    """
    if album is not None:
        for frame in result.frames:
            facts = facts_of(frame.score, frame.hole_score)
            if frame.reference != frame.test:
                facts["reference frame"] = str(frame.reference)
            if frame.hole_fraction is not None:
                facts["holes"] = str(percent(frame.hole_fraction))
            album.tell(frame.test, "", facts)
    test, reference = document["test"]["pattern"], document["reference"]["pattern"]
    return Page(
        f"{file_name(test)} against {file_name(reference)}",
        f"{test} against {reference}",
        [
            *_verdict(document["thresholds"]),
            Number("Frames", f"{document['frames']:,}", f"matched by {document['matched_by']}"),
            *quality_numbers(document["quality"]["all"]),
            *_of_generated(document),
        ],
        (
            Section("frames", "Frames", [Viewer(album)] if album and album.frames else []),
            Section("quality", "Quality", _quality(result, document, album)),
            Section("input", "Input", [_input(document)]),
        ),
    )


def _of_generated(document: dict[str, Any]) -> list[Number]:
    """Return what the generated frames have, where others better the means over all.

    That is the first metric, and pulse, which limits on generated frames are set on.
    """
    made, count = document["quality"]["generated"], document["frames"]
    metrics = measured_in(made)
    if not metrics or made["frames"] == count:
        return []
    note = f"of {made['frames']:,} frames alone"
    return [
        Number(f"{metric.name}, generated", metric.with_unit(made[metric.field]), note)
        for metric in metrics
        if metric is metrics[0] or metric.signed
    ]


def _quality(result: Comparison, document: dict[str, Any], album: Album | None) -> list[Block]:
    quality = document["quality"]
    numbers = [frame.test for frame in result.frames]
    scores = [frame.score for frame in result.frames]
    blocks = part_rows(quality)
    holes_only = blocks.pop("holes")
    if holes_only["frames"]:
        blocks["holes only"] = holes_only
    found: list[Block] = [quality_table("Means over the frames", blocks)]
    limits = _limits(document["thresholds"])
    shown = () if album is None else tuple(album.frames)
    worst = worst_table(numbers, scores, shown)
    found += [block for block in (limits, worst) if block is not None]
    found += metric_plots(numbers, scores)
    found += [Text(note) for note in document["notes"]]
    holes = [None if f.hole_fraction is None else 100 * f.hole_fraction for f in result.frames]
    if len(holes) > 1 and any(share is not None for share in holes):
        labels = Labels(
            "Hole share per frame", "frame", "holes, % of pixels", "Share of pixels in the mask."
        )
        found.append(lines(labels, numbers, {"holes": holes}))
    return found


def _verdict(verdicts: list[dict[str, Any]]) -> list[Number]:
    """Say first whether all limits hold, where any was set."""
    if not verdicts:
        return []
    failed = [one["name"] for one in verdicts if not one["passed"]]
    return [Number("Limits", "failed" if failed else "passed", ", ".join(failed) or "all of them")]


def _limits(verdicts: list[dict[str, Any]]) -> Table | None:
    """List the limits that the comparison was held against."""
    if not verdicts:
        return None
    rows: list[list[Cell]] = []
    for one in verdicts:
        metric = BY_FIELD[one["metric"]]
        value = metric_text(metric, one["value"])
        limit = f"fails {one['fails']} {'±' if metric.signed else ''}{one['limit']:g}"
        rows.append([one["name"], value, limit, "passed" if one["passed"] else "failed"])
    return Table("Limits", ("", "value", "limit", ""), rows)


def _input(document: dict[str, Any]) -> Table:
    rows: list[list[Cell]] = []
    for name in ("reference", "test", "masks"):
        sequence = document[name]
        if sequence is not None:
            rows.append([name, sequence["pattern"], f"{sequence['first']}-{sequence['last']}"])
    rows.append(["size", f"{document['width']}x{document['height']}", ""])
    if document["preset"] is not None:
        rows.append(["preset", document["preset"], ""])
    rows.append(["ExWarp", document["version"], ""])
    return Table("", ("", "", "frames"), rows)
