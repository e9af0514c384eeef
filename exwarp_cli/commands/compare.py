"""``exwarp compare``: score a sequence against ground truth."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from exwarp_cli.pipeline.evaluate import Comparison


@click.command("compare")
@click.argument("reference", metavar="A")
@click.argument("test", metavar="B")
@click.option("--frames", metavar="RANGE", help="Compare these frames only, by A's numbers.")
@click.option(
    "--holes",
    metavar="SEQ",
    help="Masks: EXR with a channel 'holes', above 0.5 where the score in holes is taken.",
)
@click.option(
    "--report",
    "folder",
    metavar="DIR",
    type=click.Path(path_type=Path, file_okay=False),
    help="Write report.json and frames.csv into this folder.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
def command(
    reference: str,
    test: str,
    frames: str | None,
    holes: str | None,
    folder: Path | None,
    as_json: bool,
) -> None:
    """Score sequence B against A, the ground truth: PSNR, SSIM and FLIP.

    A and B are folders, patterns such as shot.####.exr, or any one frame of a sequence. Frames are
    matched by number where one sequence has all numbers of the other, else by order. Compared is
    the display window, sRGB-encoded and clipped to [0, 1].
    """
    from exwarp_cli.io.atomic import make_folder
    from exwarp_cli.pipeline.evaluate import evaluate
    from exwarp_cli.pipeline.progress import make_progress
    from exwarp_cli.report.comparison import comparison
    from exwarp_cli.report.folder import write_comparison
    from exwarp_cli.report.summary import to_json

    if folder is not None:
        make_folder(folder)  # before the work, which would be lost
    progress = make_progress("bar" if sys.stderr.isatty() else "none")
    result = evaluate(reference, test, frames, holes, progress)
    if folder is not None:
        write_comparison(folder, result)
    if as_json:
        click.echo(to_json(comparison(result)), nl=False)
    else:
        _print(result)


def _print(result: Comparison) -> None:
    from rich.console import Console
    from rich.table import Table

    from exwarp_cli.report.comparison import comparison

    document = comparison(result)
    table = Table("", "PSNR dB", "SSIM", "FLIP", "frames")
    worst = document["worst"]
    rows = (
        ("all pixels", document["quality"]["all"]),
        ("holes", document["quality"]["holes"]),
        (f"worst: {worst['frame']}", worst | {"frames": 1}),
    )
    for name, values in rows:
        table.add_row(name, *_cells(values))
    click.echo(f"reference {result.reference.pattern}")
    click.echo(f"test      {result.test.pattern}")
    click.echo(f"{len(result.frames)} frames, matched by {result.matched_by}")
    Console().print(table)


def _cells(values: dict[str, float | int | None]) -> tuple[str, ...]:
    formats = {"psnr_db": ".2f", "ssim": ".4f", "flip": ".4f", "frames": "d"}
    return tuple(
        "-" if values[key] is None else format(values[key], how) for key, how in formats.items()
    )
