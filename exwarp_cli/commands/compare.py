"""``exwarp compare``: score a sequence against ground truth."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from exwarp_cli.commands import options
from exwarp_cli.domain.metric import METRICS, Threshold, parse_threshold
from exwarp_cli.domain.settings import PRESETS, MeasureSettings
from exwarp_cli.domain.wording import pluralise

if TYPE_CHECKING:
    from exwarp_cli.pipeline.evaluation import Comparison


def _parse_limits(
    _context: click.Context, parameter: click.Parameter, texts: tuple[str, ...]
) -> tuple[Threshold, ...]:
    return tuple(parse_threshold(text, parameter.opts[0]) for text in texts)


@click.command("compare")
@click.argument("reference", metavar="A")
@click.argument("test", metavar="B")
@click.option("--view", default="", metavar="NAME", help="Compare this view of stereo frames.")
@click.option(
    "--ground-truth",
    metavar="SEQ",
    help="Score both A and B against this sequence: A is the baseline, and limits are on B.",
)
@click.option(
    "--frames",
    metavar="RANGE",
    help="Compare these frames only, by A's numbers or those of --ground-truth.",
)
@options.max_pixels_option
@options.scan_option
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
    help="Write report.html to look at, report.json and frames.csv into this folder.",
)
@options.view_transform_option("the report's pictures show")
@options.metrics_option
@click.option(
    "--preset",
    type=click.Choice(tuple(PRESETS)),
    help="extranet: PSNR, SSIM and VMAF as ExtraNet's authors took them, of generated frames.",
)
@click.option(
    "--fail-below",
    metavar="NAME=VALUE",
    multiple=True,
    callback=_parse_limits,
    help="Exit with 8 if a metric is worse: psnr=35, generated.psnr=30 for the frames that "
    "ExWarp made, worst.psnr=30 for the worst frame, holes.ssim=0.8. May be given again.",
)
@click.option(
    "--fail-above",
    metavar="NAME=VALUE",
    multiple=True,
    callback=_parse_limits,
    help="The same for flip, hdr-flip and flicker, of which less is better, and for the magnitude "
    "of pulse: generated.pulse=5.",
)
@options.json_option
@options.progress_option(
    f"{options.PROGRESS_HELP} Default: a bar on a terminal, nothing elsewhere.", default=None
)
def command(
    reference: str,
    test: str,
    ground_truth: str | None,
    frames: str | None,
    max_pixels: int,
    holes: str | None,
    folder: Path | None,
    fail_below: tuple[Threshold, ...],
    fail_above: tuple[Threshold, ...],
    as_json: bool,
    progress: str | None,
    **measuring: Any,
) -> None:
    """Score sequence B against A, the ground truth; or both against --ground-truth.

    A and B are folders, patterns such as shot.####.exr, any one frame of a sequence, or videos, of
    EXR or other stills. Frames are matched by number where one sequence has all numbers of the
    other, else by order, and by the instant where their pictures show different rates. Compared is
    the display window, sRGB-encoded and clipped to [0, 1]; for HDR-FLIP as it is. Flicker follows
    A's own motion vectors. Pulse is by how many per cent B's mean gradient is above A's.
    """
    from exwarp_cli.api import compare
    from exwarp_cli.domain.frame import set_max_pixels
    from exwarp_cli.pipeline.progress import reporting
    from exwarp_cli.report.comparison import require_quality

    set_max_pixels(max_pixels)
    kind = progress or ("bar" if sys.stderr.isatty() else "none")
    with reporting(kind, results_on_stdout=as_json) as reporter:
        result = compare(
            reference,
            test,
            ground_truth=ground_truth,
            frames=frames,
            holes=holes,
            report=folder,
            measuring=MeasureSettings(thresholds=(*fail_below, *fail_above), **measuring),
            progress=reporter,
        )
        if as_json:
            options.print_json(result.document)
        else:
            _print_scores(result.comparison, result.document)
        require_quality(result.comparison)


def _print_scores(result: Comparison, document: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    from exwarp_cli.report.comparison import BASELINE, quality_rows

    metrics = [metric for metric in METRICS if metric.field in result.measuring.measured]
    table = Table("", *(metric.title for metric in metrics), "frames")
    worst = document["worst"]
    rows = quality_rows(document)
    rows[f"worst: {worst['frame']}"] = worst | {"frames": 1}
    for name, values in rows.items():
        scores = ((metric, values[metric.field]) for metric in metrics)
        cells = ("-" if value is None else metric.text(value) for metric, value in scores)
        table.add_row(name, *cells, str(values["frames"]))
    options.show(f"reference {result.reference.pattern}")
    if BASELINE in document:
        options.show(f"baseline  {document[BASELINE]['pattern']}")
    options.show(f"test      {result.test.pattern}")
    click.echo(f"{pluralise(len(result.frames), 'frame')}, matched by {result.matched_by}")
    for note in result.notes:
        options.show(note)
    Console().print(table)
