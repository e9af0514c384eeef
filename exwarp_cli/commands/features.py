"""``exwarp features``: what the policy sees."""

from __future__ import annotations

from typing import Any

import click

from exwarp_cli import __version__
from exwarp_cli.commands import options
from exwarp_cli.domain.timeline import AUTO_CUTS


@click.command("features")
@click.argument("sequence")
@click.option("--gbuffers", metavar="SEQ", help="G-buffers rendered at the output rate.")
@click.option("--motion", metavar="CONVENTION", help="Read vectors so, whatever is measured.")
@options.source_options
@click.option(
    "--cuts",
    default=AUTO_CUTS,
    show_default=True,
    metavar="auto|none|LIST",
    help="Where shots begin, by their first key frames: nothing is compared across cuts.",
)
@click.option("--frames", metavar="RANGE", help="Key frames, by number: 1001-1100x2, 1-10:2.")
@options.threads_option
@options.json_option
@options.progress_option()
def command(
    frames: str | None, threads: int | None, as_json: bool, progress: str, **source: Any
) -> None:
    """Print the features of SEQUENCE as CSV, a row for every decision of every key interval.

    N_d counts moving objects; EMD_Wn and EMD_Wp are distances of normals and positions from the
    instant before, Var_x and Var_y variances of motion (square pixels), all per slot; R is pixels.
    `inputs` is what the network is given: 44 numbers in Q16.16 (see exwarp policy run). With
    --json the same as a list of rows.
    """
    from exwarp_cli.domain.settings import SourceSettings
    from exwarp_cli.pipeline.decide import features
    from exwarp_cli.pipeline.progress import reporting
    from exwarp_cli.pipeline.scheduling import use_threads
    from exwarp_cli.report.command_text import FEATURES_SCHEMA, feature_row
    from exwarp_cli.report.schema import format_cell, format_csv

    use_threads(threads)
    with reporting(progress, results_on_stdout=True) as reporter:
        rows = map(feature_row, features(SourceSettings(**source), frames, reporter))
        if as_json:
            options.print_json(
                {"schema": FEATURES_SCHEMA, "version": __version__, "rows": list(rows)}
            )
            return
        for index, row in enumerate(rows):
            if index == 0:  # not before: a sequence that cannot be used gives no table
                click.echo(format_csv(list(row), ()), nl=False)
            row["inputs"] = " ".join(map(str, row["inputs"]))
            click.echo(format_csv(list(map(format_cell, row.values())), ()), nl=False)
