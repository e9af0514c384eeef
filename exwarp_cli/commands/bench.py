"""``exwarp bench``: every table and figure of the paper, on the user's own frames."""

from __future__ import annotations

from pathlib import Path

import click

from exwarp_cli.commands import options
from exwarp_cli.commands.options import FILE, FrameRate
from exwarp_cli.domain.settings import DEVICES
from exwarp_cli.research.bench.systems import CLOCKS, SETTINGS, SYSTEMS, BenchSettings


@click.command("bench", context_settings={"show_default": True})
@click.argument("inputs", nargs=-1, required=True, metavar="DATA…|SEQUENCE")
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder for tables, page and parts.",
)
@click.option("--ground-truth", metavar="SEQ", help="Of one SEQUENCE, at the output rate.")
@click.option("--gbuffers", metavar="SEQ", help="Of one SEQUENCE, at the output rate.")
@click.option("--motion", metavar="CONVENTION", help="Of one SEQUENCE; as for upsample.")
@click.option("--fps", type=FrameRate(), help="Of one SEQUENCE; else the header's, else 30.")
@click.option("--scenes", metavar="LIST", help="Of DATA, with commas; default: its benchmarks.")
@click.option(
    "--setting",
    type=click.Choice((*SETTINGS, "both")),
    default=SETTINGS[0],
    help="Of DATA: G-buffers of every slot, as in the paper, or of the key frames only.",
)
@click.option("--frames", metavar="RANGE", help="Key frames to do, by number: a chunk.")
@click.option("--every", type=click.IntRange(1), default=1, help="Only every Nth key interval.")
@click.option("--systems", metavar="LIST", help=f"Out of {','.join(SYSTEMS)}.  [default: all]")
@click.option(
    "--interpolator",
    "interpolators",
    type=FILE,
    multiple=True,
    metavar="FILE",
    help="ONNX network that interpolates, with its card; several times for several.",
)
@click.option("--extrapolator", type=FILE, metavar="FILE", help="E; default: the one shipped.")
@click.option("--extranet", type=FILE, metavar="FILE", help="ONNX file of the imported ExtraNet.")
@click.option("--policy", type=FILE, metavar="FILE", help="Default: one that never saw the scene.")
@click.option("--metrics", default="all", metavar="LIST", help="As for upsample.")
@click.option(
    "--clock",
    type=click.Choice(CLOCKS),
    help="Add what a 120 Hz display shows in real time, with late frames dropped. Run times are "
    "the paper's, by the size of the frames or as if they had another one, or this machine's.",
)
@click.option(
    "--predictor-clock", default="1GHz", metavar="RATE", help="Of the predictor's hardware."
)
@click.option("--jobs", type=click.IntRange(1), help="Key intervals at a time; default: all cores.")
@click.option("--device", type=click.Choice(DEVICES), default=DEVICES[0])
@options.json_option
@options.progress_option()
def command(
    scenes: str | None,
    setting: str,
    systems: str | None,
    metrics: str,
    predictor_clock: str,
    as_json: bool,
    progress: str,
    **values: object,
) -> None:
    """Measure every method on DATA, or on SEQUENCE with its ground truth.

    DATA is a folder of rendered scenes (several for several resolutions). The output folder gets
    bench.json (which --json prints too), bench.md, report.html and a CSV a table. Stopped at any
    time, the same command goes on; chunks by --frames into one folder are put together by the same
    command without it.
    """
    from exwarp_cli.domain.metric import parse_metrics
    from exwarp_cli.pipeline.predictor import clock_of
    from exwarp_cli.pipeline.progress import reporting
    from exwarp_cli.report.folder import PAGE_FILE
    from exwarp_cli.research.bench.bench_report import JSON_FILE, MARKDOWN_FILE, write_benchmark
    from exwarp_cli.research.bench.benchmark import run_benchmark
    from exwarp_cli.research.bench.systems import parse_names, parse_systems

    with reporting(progress, results_on_stdout=as_json) as reporter:
        hertz = clock_of(predictor_clock, "--predictor-clock")
        settings = BenchSettings(
            scenes=parse_names(scenes),
            settings=SETTINGS if setting == "both" else (setting,),
            systems=parse_systems(systems),
            metrics=parse_metrics(metrics),
            **values,  # type: ignore[arg-type]
        )
        with run_benchmark(settings, reporter) as benchmark:
            written = write_benchmark(settings.output, benchmark, hertz, reporter)
    if as_json:
        options.print_json(written)
        return
    out = settings.output
    with options.summary_of_files():
        options.show(
            f"tables in {out / MARKDOWN_FILE}, {out / JSON_FILE} and CSV files beside them"
        )
        options.show(f"page to look at: {out / PAGE_FILE}")
