"""``exwarp merge-reports``: the reports of chunks joined into one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from exwarp_cli.commands.json_option import json_option, print_json
from exwarp_cli.commands.summary_lines import summary_lines
from exwarp_cli.pipeline.progress import KINDS

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
@click.option(
    "--progress",
    type=click.Choice(KINDS),
    default=KINDS[0],
    show_default=True,
    help="How programs are told why it fails: openjd for farms, json for others.",
)
def command(
    folders: tuple[Path, ...], output: Path | None, overwrite: bool, as_json: bool, progress: str
) -> None:
    """Join the reports of chunks into the report of the whole run.

    FOLDER is what upsample --report FOLDER --as-chunk reported to: chunks/*/ in it are joined into
    FOLDER itself. With -o any reports are joined, in any order, if no frame is in two of them.

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
        _print(merged, output or folders[0])


def _print(merged: Merged, output: Path) -> None:
    """Say in a few lines what was joined."""
    from exwarp_cli.report.page_parts import time_text

    document = merged.document
    if document["frames"]["written"]:
        for line in summary_lines(document):
            click.echo(line)
    many = "" if merged.reports == 1 else "s"
    click.echo(f"{merged.reports} report{many} joined, {time_text(document['wall_s'])} of work")
    if merged.missing is not None:
        click.echo(f"key frames of the sequence that are in no report: {merged.missing}")
    if merged.unseen:
        named = ", ".join(map(str, merged.unseen[:NAMED]))
        more = f" and {len(merged.unseen) - NAMED} more" if len(merged.unseen) > NAMED else ""
        click.echo(
            f"without pictures, as report.html is not there or cannot be read: {named}{more}"
        )
    click.echo(f"report in {output}")
