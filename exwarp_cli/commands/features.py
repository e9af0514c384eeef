"""``exwarp features``: what the policy sees."""

from __future__ import annotations

import click

from exwarp_cli.commands.json_option import json_option, print_json
from exwarp_cli.commands.progress_option import progress_option
from exwarp_cli.commands.source_options import source_options
from exwarp_cli.commands.threads_option import threads_option
from exwarp_cli.domain.timeline import AUTO_CUTS


@click.command("features")
@click.argument("sequence")
@click.option("--gbuffers", metavar="SEQ", help="G-buffers rendered at the output rate.")
@click.option("--motion", metavar="CONVENTION", help="Read vectors so, whatever is measured.")
@source_options
@click.option(
    "--cuts",
    default=AUTO_CUTS,
    show_default=True,
    metavar="auto|none|LIST",
    help="Where shots begin, by their first key frames: nothing is compared across cuts.",
)
@click.option("--frames", metavar="RANGE", help="Key frames, by number: 1001-1100x2, 1-10:2.")
@threads_option
@json_option
@progress_option()
def command(
    sequence: str,
    gbuffers: str | None,
    motion: str | None,
    view: str | None,
    aovs: tuple[str, ...],
    channel_map: str | None,
    dynamic: str | None,
    max_pixels: int,
    cuts: str,
    frames: str | None,
    threads: int | None,
    as_json: bool,
    progress: str,
) -> None:
    """Print the features of SEQUENCE as CSV, a row for every decision of every key interval.

    N_d counts moving objects; EMD_Wn and EMD_Wp are distances of normals and positions from the
    instant before, Var_x and Var_y variances of motion (square pixels), all per slot; R is pixels.
    `inputs` is what the network is given: 44 numbers in Q16.16 (see exwarp policy run). With
    --json the same as a list of rows.
    """
    from exwarp_cli.domain.settings import SourceSettings
    from exwarp_cli.io.threads import use_threads
    from exwarp_cli.pipeline.observing import features
    from exwarp_cli.pipeline.progress import reporting
    from exwarp_cli.report.features_table import HEADER, document, row
    from exwarp_cli.report.frames_csv import table

    use_threads(threads)
    with reporting(progress, results_on_stdout=True) as reporter:
        settings = SourceSettings(
            sequence, gbuffers, motion, view=view, aovs=aovs, channel_map=channel_map, cuts=cuts,
            dynamic=dynamic, max_pixels=max_pixels,
        )  # fmt: skip
        rows = features(settings, frames, reporter)
        if as_json:
            print_json(document(rows))
            return
        for number, found in enumerate(rows):
            if not number:  # not before: a sequence that cannot be used gives no table
                click.echo(table(HEADER, ()), nl=False)
            click.echo(table(row(found), ()), nl=False)
