"""The folder of a report: which files it holds, each written whole or not at all."""

from __future__ import annotations

from pathlib import Path

from exwarp_cli.domain.results import RunSummary
from exwarp_cli.errors import OutputExistsError
from exwarp_cli.io.atomic import atomic_write_text, make_folder, remove_leftovers
from exwarp_cli.pipeline.evaluate import Comparison
from exwarp_cli.report.comparison import comparison, comparison_csv
from exwarp_cli.report.frames_csv import frames_csv
from exwarp_cli.report.summary import report, to_json

REPORT_FILE = "report.json"
FRAMES_FILE = "frames.csv"


def prepare_report(folder: Path, replace: bool) -> None:
    """Make the folder before the work, and refuse to replace a report unless asked.

    Raises
    ------
    OutputExistsError
        When a report is there and `replace` is False.
    OutputError
        When the folder cannot be made.
    """
    if (folder / REPORT_FILE).exists() and not replace:
        raise OutputExistsError(
            f"{folder} holds a report already; give --overwrite to replace it, or another --report"
        )
    make_folder(folder)
    remove_leftovers(folder)


def write_report(folder: Path, run: RunSummary) -> None:
    """Write report.json and frames.csv of an upsampling run.

    Parameters
    ----------
    folder
        Made, with its parents, if it does not exist. Files of these names in it are replaced.

    Raises
    ------
    OutputError
        When the folder cannot be made or a file cannot be written.
    """
    _write(folder, to_json(report(run)), frames_csv(run.frames))


def write_comparison(folder: Path, result: Comparison) -> None:
    """Write report.json and frames.csv of a comparison; as `write_report` does."""
    _write(folder, to_json(comparison(result)), comparison_csv(result))


def _write(folder: Path, document: str, frames: str) -> None:
    make_folder(folder)
    # The table first: who sees a report.json then finds the frames.csv that belongs to it.
    atomic_write_text(folder / FRAMES_FILE, frames)
    atomic_write_text(folder / REPORT_FILE, document)
