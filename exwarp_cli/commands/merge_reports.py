"""``exwarp merge-reports``: the reports of chunks joined into one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from exwarp_cli.commands.json_option import json_option, print_json
from exwarp_cli.commands.printing import show, summary_of_files
from exwarp_cli.commands.progress_option import progress_option
from exwarp_cli.commands.summary_lines import summary_lines
from exwarp_cli.domain.wording import pluralise

if TYPE_CHECKING:
    from exwarp_cli.report.merging import Merged

NAMED = 3
"""Folders that a line names at most."""


@click.command("merge-reports")
@click.argument(
    "folders", nargs=-1, required=True, metavar="FOLDER…", type=click.Path(path_type=Path)
)
@click.option(
    "-o",
    "--output",
    metavar="DIR",
    type=click.Path(path_type=Path),
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
    from exwarp_cli.report.merging import merge_reports

    with reporting(progress, results_on_stdout=as_json):
        merged = merge_reports(folders, output, overwrite)
    if as_json:
        print_json(merged.document)
    else:
        with summary_of_files():
            _print(merged, output or folders[0])


def _print(merged: Merged, output: Path) -> None:
    """Say in a few lines what was joined."""
    from exwarp_cli.report.page_parts import time_text

    document = merged.document
    if document["frames"]["written"]:
        for line in summary_lines(document):
            show(line)
    joined = pluralise(merged.reports, "report")
    click.echo(f"{joined} joined, {time_text(document['wall_s'])} of work")
    if merged.missing is not None:
        click.echo(f"key frames of the sequence that are in no report: {merged.missing}")
    if merged.superseded:
        named = _named(merged.superseded)
        show(f"older reports, of key frames that newer ones tell of: {named}")
    if merged.unseen:
        named = _named(merged.unseen)
        show(f"without pictures, as report.html is not there or cannot be read: {named}")
    show(f"report in {output}")


def _named(folders: Sequence[Path]) -> str:
    """Name the first of some folders."""
    more = f" and {len(folders) - NAMED} more" if len(folders) > NAMED else ""
    return f"{', '.join(map(str, folders[:NAMED]))}{more}"
