"""``exwarp merge-reports``: the reports of chunks joined into one."""

from __future__ import annotations

from pathlib import Path

import click

from exwarp_cli.commands import options
from exwarp_cli.domain.wording import pluralise

# Folders that a line names at most.
MOST_NAMED = 3


@click.command("merge-reports")
@click.argument("folders", nargs=-1, required=True, metavar="FOLDER…", type=options.FILE)
@click.option(
    "-o",
    "--output",
    metavar="DIR",
    type=options.FILE,
    help="Folder of the joined report. Default: FOLDER, whose chunks/ are joined.",
)
@click.option("--overwrite", is_flag=True, help="Replace a report that is there.")
@options.json_option
@options.progress_option("How programs learn why it fails: openjd for farms, json for others.")
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
    from exwarp_cli.report.sentences import format_time

    with reporting(progress, results_on_stdout=as_json):
        document = merge_reports(folders, output, overwrite)
    if as_json:
        options.print_json(document)
        return
    merged, wall_s = document["merged"], document["wall_s"]
    with options.summary_of_files():
        if document["frames"]["written"]:
            for line in options.summary_lines(document):
                options.show(line)
        # NaN or infinite in a run.json is None here.
        work = "time of the work not known" if wall_s is None else f"{format_time(wall_s)} of work"
        click.echo(f"{pluralise(merged['reports'], 'report')} joined, {work}")
        if merged["missing"] is not None:
            click.echo(f"key frames of the sequence that are in no report: {merged['missing']}")
        for subject, places in (
            ("older reports, of key frames that newer ones tell of", merged["superseded"]),
            (
                "without pictures, as album.json is not there or cannot be read",
                merged["without_pictures"],
            ),
        ):
            if places:
                others = len(places) - MOST_NAMED
                more = f" and {others} more" if others > 0 else ""
                options.show(f"{subject}: {', '.join(places[:MOST_NAMED])}{more}")
        options.show(f"report in {output or folders[0]}")
