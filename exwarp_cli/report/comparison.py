"""What ``exwarp compare`` reports, schema ``exwarp.compare/1``."""

from __future__ import annotations

from typing import Any

from exwarp_cli import __version__
from exwarp_cli.domain.decision import CHOICES
from exwarp_cli.io.sequences import Sequence
from exwarp_cli.pipeline.evaluation import ComparedFrame, Comparison
from exwarp_cli.report.frames_csv import (
    LATER_HOLE_SCORES,
    LATER_SCORES,
    later_cells,
    name_cell,
    score_cells,
    table,
)
from exwarp_cli.report.quality import quality, values_of
from exwarp_cli.report.summary import finite
from exwarp_cli.report.thresholds import verdicts

SCHEMA = "exwarp.compare/1"

COLUMNS = (
    *("frame", "reference_frame", "file", "hole_fraction", "psnr_db", "ssim", "flip"),
    *("psnr_db_holes", "ssim_holes", "flip_holes"),
    *LATER_SCORES,
    *LATER_HOLE_SCORES,
    *("kind", "made_by", "pulse"),
)
"""Columns of frames.csv; `frame` is the test's number, `kind` and `made_by` tells its header."""


def comparison(result: Comparison) -> dict[str, Any]:
    """Turn a comparison into the dictionary of report.json; None is what was not measured."""
    worst = result.worst
    document: dict[str, Any] = finite(
        {
            "schema": SCHEMA,
            "version": __version__,
            "reference": _sequence(result.reference),
            "test": _sequence(result.test),
            "masks": None if result.holes is None else _sequence(result.holes),
            "matched_by": result.matched_by,
            "width": result.width,
            "height": result.height,
            "frames": len(result.frames),
            "quality": _quality(result.frames),
            "worst": {
                "frame": worst.test,
                "reference_frame": worst.reference,
                "file": worst.file,
                **values_of(worst.score),
            },
            "metrics": list(result.measuring.measured),
            "preset": result.measuring.preset,
            "thresholds": verdicts(result),
            "notes": list(result.notes),
        }
    )
    return document


def comparison_csv(result: Comparison) -> str:
    """Write a row for every compared frame as CSV text."""
    rows = (
        (
            *(frame.test, frame.reference, name_cell(frame.file), frame.hole_fraction),
            *score_cells(frame.score),
            *score_cells(frame.hole_score),
            *later_cells(frame.score, frame.hole_score),
            *(name_cell(frame.origin.kind), name_cell(frame.origin.made_by), frame.score.pulse),
        )
        for frame in result.frames
    )
    return table(COLUMNS, rows)


def part_rows(quality: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Name the blocks of a comparison's `quality` in the order of a table's rows.

    Parts that no header tells of are left out; "all pixels" and "holes" are always there.
    """
    parts = {"generated": quality["generated"], "repeated": quality["dropped"]}
    parts |= {f"made by {name}": block for name, block in quality["by_decision"].items()}
    there = {name: block for name, block in parts.items() if block["frames"]}
    return {"all pixels": quality["all"], **there, "holes": quality["holes"]}


def _quality(frames: tuple[ComparedFrame, ...]) -> dict[str, Any]:
    """Average the scores of all frames, and of the parts that their headers tell apart."""
    return {
        "all": quality(frame.score for frame in frames),
        "generated": quality(frame.score for frame in frames if frame.origin.generated),
        "dropped": quality(frame.score for frame in frames if frame.origin.dropped),
        "by_decision": {
            choice: quality(frame.score for frame in frames if frame.origin.choice == choice)
            for choice in CHOICES
        },
        "holes": quality(frame.hole_score for frame in frames),
    }


def _sequence(sequence: Sequence) -> dict[str, Any]:
    numbers = sorted(sequence.files)
    return {"pattern": sequence.pattern, "first": numbers[0], "last": numbers[-1]}
