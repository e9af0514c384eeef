"""``exwarp merge-reports``: the reports of chunks joined into one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from exwarp_cli.commands.options import (
    FILE,
    json_option,
    print_json,
    progress_option,
    show,
    summary_lines,
    summary_of_files,
)
from exwarp_cli.domain.wording import pluralise

# Folders that a line names at most.
MOST_NAMED = 3


@click.command("merge-reports")
@click.argument("folders", nargs=-1, required=True, metavar="FOLDER…", type=FILE)
@click.option(
    "-o",
    "--output",
    metavar="DIR",
    type=FILE,
    help="Folder of the joined report. Default: FOLDER, whose chunks/ are joined.",
)
@click.option("--overwrite", is_flag=True, help="Replace a report that is there.")
@json_option
@progress_option("How programs learn why it fails: openjd for farms, json for others.")
def command(
    folders: tuple[Path, ...], output: Path | None, overwrite: bool, as_json: bool, progress: str
) -> None:
    """Join the reports of chunks into the report of the whole run.

    FOLDER is what upsample --report FOLDER --as-chunk reported to: chunks/*/ in it are joined into
    FOLDER itself; of a key frame that is in two of them, as after a job with chunks of another
    size, the newer tells. With -o any reports are joined, in any order, if no frame is in two.

    The joined report.json, frames.csv and report.html are those of a single run, but for measured
    times: the wall time is the sum of the chunks', so that frames per second are those of one
    machine.
    """
    from exwarp_cli.pipeline.progress import reporting
    from exwarp_cli.report.merge import merge_reports

    with reporting(progress, results_on_stdout=as_json):
        document = merge_reports(folders, output, overwrite)
    if as_json:
        print_json(document)
    else:
        with summary_of_files():
            _print_summary(document, output or folders[0])


def _print_summary(document: dict[str, Any], output: Path) -> None:
    from exwarp_cli.report.sentences import format_time

    merged, wall_s = document["merged"], document["wall_s"]
    if document["frames"]["written"]:
        for line in summary_lines(document):
            show(line)
    # NaN or infinite in a run.json is None here.
    work = "time of the work not known" if wall_s is None else f"{format_time(wall_s)} of work"
    click.echo(f"{pluralise(merged['reports'], 'report')} joined, {work}")
    if merged["missing"] is not None:
        click.echo(f"key frames of the sequence that are in no report: {merged['missing']}")
    if merged["superseded"]:
        names = _list_folders(merged["superseded"])
        show(f"older reports, of key frames that newer ones tell of: {names}")
    if merged["without_pictures"]:
        names = _list_folders(merged["without_pictures"])
        show(f"without pictures, as album.json is not there or cannot be read: {names}")
    show(f"report in {output}")


def _list_folders(folders: Sequence[str]) -> str:
    more = f" and {len(folders) - MOST_NAMED} more" if len(folders) > MOST_NAMED else ""
    return f"{', '.join(folders[:MOST_NAMED])}{more}"
