"""``exwarp upsample``: the main job."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import fields, replace
from fractions import Fraction
from importlib import import_module
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

import click

from exwarp_cli.commands.json_option import json_option, print_json
from exwarp_cli.commands.metrics_option import metrics_option
from exwarp_cli.commands.printing import show, summary_of_files
from exwarp_cli.commands.progress_option import progress_option
from exwarp_cli.commands.source_options import scan_option, source_options
from exwarp_cli.commands.spread_options import spread_options
from exwarp_cli.commands.threads_option import threads_option
from exwarp_cli.domain.settings import (
    DEVICES,
    USUAL_EFFORT,
    ClusterSettings,
    SourceSettings,
    UpsampleSettings,
)
from exwarp_cli.domain.timeline import MAX_FACTOR
from exwarp_cli.errors import IncompleteError, UsageError
from exwarp_cli.runtime.read_registry import enable_restart, is_restarted

if TYPE_CHECKING:
    from exwarp_cli.domain.results import RunSummary
    from exwarp_cli.pipeline.dry_run import DryRun
    from exwarp_cli.pipeline.job import Job
    from exwarp_cli.pipeline.progress import Progress
    from exwarp_cli.report.gallery import Gallery


class FrameRate(click.ParamType[Fraction]):
    """Frames per second, exactly: 30, 23.976, 24000/1001."""

    name = "fps"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> Fraction:
        """Read a rate; the broadcast rates written with three decimals become exact."""
        try:
            rate = Fraction(str(value))
        except (ValueError, ZeroDivisionError):
            self.fail(f"{value!r} is not a frame rate; write for example 30 or 24000/1001")
        broadcast = Fraction(round(rate) * 1000, 1001)
        if rate.denominator > 1 and abs(rate - broadcast) < Fraction(1, 1000):
            rate = broadcast
        if rate <= 0:
            self.fail(f"{value!r} is not a frame rate; it must be above 0")
        return rate


@click.command("upsample")
@click.argument("sequence")
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="DIR|PATTERN|VIDEO",
    help="Where frames go: a folder, a pattern, or an MP4 or MOV alone.",
)
@click.option(
    "-m",
    "--method",
    metavar="NAME",
    help="Default: exwarp, which moves the key frames on both sides to the new frame's time and "
    "mixes them, by a network where that pays on this shot (lookahead), else by depth (softsplat); "
    "causal: as --causal; s1 to s6: the paper's paths, s6 warps only; oracle, oracle-return: the "
    "best path by --ground-truth; onnx: the network of --interpolator, from colour alone; blend: "
    "cross-fade; hold: repeat.",
)
@click.option(
    "--causal",
    is_flag=True,
    help="Use past key frames alone, as a renderer in real time must: a learned policy "
    "chooses, tile by tile, between warping and a network that extrapolates.",
)
@click.option(
    "--layers",
    default=UpsampleSettings.layers,
    show_default=True,
    metavar="beauty|all|GLOB[,GLOB…]",
    help="Layers that new frames hold beside the beauty, by name: all, or '*Diffuse*,Depth'. Light "
    "moves as the beauty does; ids, depth, normals and the like come from the nearest source.",
)
@source_options
@scan_option
@click.option("--frames", metavar="RANGE", help="Key frames to do, by number: 1001-1100x2, 1-10:2.")
@click.option("--gbuffers", metavar="SEQ", help="G-buffers rendered at the output rate.")
@click.option(
    "--motion",
    metavar="CONVENTION",
    help="Read vectors so, whatever is measured: a preset (blender, unreal, unreal-mrq, arnold, "
    "vray, redshift, renderman, karma, moonray, nuke, reelsmart, twixtor, forward, backward, "
    "forward+backward) or e.g. 'previous=X,-Y next=-Z,W'.",
)
@click.option(
    "--estimate-motion",
    is_flag=True,
    help="Estimate motion from colour where a render with other passes has no usable vectors; far "
    "less exact, and an error else. Plain footage needs no leave.",
)
@click.option(
    "--extrapolator",
    metavar="FILE",
    help="ONNX network that extrapolates; else the one that comes with ExWarp.",
)
@click.option(
    "--interpolator",
    metavar="FILE",
    help="ONNX network for --method onnx, which interpolates two frames; its card, FILE with "
    ".json, says what it takes. For exwarp and lookahead, one that weighs both; else ExWarp's own.",
)
@click.option(
    "--policy",
    metavar="FILE|paper",
    help="Policy that decides with --causal; else ExWarp's own, tile by tile. paper: the paper's, "
    "for whole frames.",
)
@click.option(
    "--effort",
    type=click.FloatRange(0, 1),
    metavar="SHARE",
    help="With --causal: share of the area that the network may compute, 0 to 1, on average over "
    f"many shots; else {USUAL_EFFORT:g}. 0 only warps, 1 computes all.",
)
@click.option(
    "--gate/--no-gate",
    default=UpsampleSettings.gate,
    help="Let a network make frames only where it predicts this shot's own key frames better than "
    "warping does; or wherever the method would.",
)
@click.option(
    "--device",
    type=click.Choice(DEVICES),
    default=UpsampleSettings.device,
    show_default=True,
    help="What the network runs on.",
)
@click.option("--fps", type=FrameRate(), help="Rate of the key frames; else their own, else 30.")
@click.option(
    "--factor",
    type=click.IntRange(2, MAX_FACTOR),
    help="Output frames per key frame; else 4. --causal, s1 to s5 and the oracles are for 4 alone.",
)
@click.option(
    "--to-fps", type=FrameRate(), metavar="FPS", help="Rate of the output, such as 60 from 24."
)
@click.option(
    "--cuts",
    default=SourceSettings.cuts,
    show_default=True,
    metavar="auto|none|LIST",
    help="Where shots begin, as nothing is taken across cuts: auto looks for them, none does not; "
    "LIST names the first key frame of each new shot, as 1045,1101, and with auto in it the others "
    "are looked for too.",
)
@click.option("--start-frame", type=int, help="Number of the first output frame.")
@click.option(
    "--tail/--no-tail", default=True, help="Predict past the last key frame, or stop there."
)
@click.option(
    "--rendered",
    metavar="SEQ",
    help="Frames that were rendered after all, by output number, as review.txt names them: they "
    "take the place of generated frames.",
)
@click.option("--ground-truth", metavar="SEQ", help="Score against this sequence.")
@metrics_option
@click.option(
    "--report",
    "report_folder",
    metavar="DIR",
    type=click.Path(path_type=Path),
    help="Write report.html to look at, report.json and frames.csv there.",
)
@click.option("--video", metavar="FILE", help="Also write an MP4 or MOV.")
@click.option("--exposure", type=float, default=0.0, show_default=True, help="Of the video, stops.")
@click.option("--write-holes", metavar="DIR|PATTERN", help="Also write the hole masks.")
@click.option(
    "--compression",
    metavar="NAME",
    help="Of generated frames: zip, piz, dwaa, none …; zip:4 is slower and mostly smaller.",
)
@click.option(
    "--keep-bytes",
    is_flag=True,
    help="Copy key frames byte for byte; else their headers get the frame rate of the output.",
)
@click.option(
    "--keep-going",
    is_flag=True,
    help="Leave out key intervals whose files are damaged or missing, and exit with 12, or with 0 "
    "under --progress openjd.",
)
@click.option(
    "--skip-existing",
    is_flag=True,
    help="Keep good frames of an earlier run; never replace others' files.",
)
@click.option("--overwrite", is_flag=True, help="Replace frames that exist.")
@click.option(
    "--verify", is_flag=True, help="Read all files back from the disk, and compare checksums."
)
@threads_option
@spread_options
@click.option(
    "--dry-run", is_flag=True, help="Open everything and say what would be done; write nothing."
)
@json_option
@progress_option()
def command(
    report_folder: Path | None,
    as_chunk: bool,
    dry_run: bool,
    as_json: bool,
    progress: str,
    workers: int | None,
    cluster: str | None,
    chunk_size: int | None,
    **options: Any,
) -> None:
    """Write SEQUENCE at four times its frame rate, or another.

    SEQUENCE is a folder, a pattern such as shot.####.exr, or any one frame. Rendered frames pass
    through unchanged, but for a frame rate in their header that is not the output's; those between
    them are made from their motion vectors.

    It may also be a video, or PNG, JPEG, TIFF, DPX and other stills, or EXR with colour alone:
    motion is then estimated from colour, which needs the extra 'video' and is far less exact. A
    render with depth, normals or other passes needs vectors, or --estimate-motion.
    """
    from exwarp_cli.pipeline.job import open_job
    from exwarp_cli.pipeline.progress import reporting

    settings = settings_of(options)
    if settings.source.keep_going:
        enable_restart()
    if is_restarted():  # what is there was written before
        settings = replace(
            settings, skip_existing=True, overwrite=False, replaces_foreign=settings.overwrite
        )
    where = ClusterSettings(workers, cluster, chunk_size)
    runs = not (dry_run or where.spread)
    if runs and settings.threads != 1:
        with suppress(RuntimeError):  # no more threads: what needs one says so
            Thread(target=_import_run, name="exwarp-import").start()
    with _going_on(progress), reporting(progress, results_on_stdout=as_json) as reporter:
        job = replace(open_job(settings), reported=as_json or report_folder is not None)
        place = _report_place(report_folder, as_chunk, job)
        if dry_run:
            _tell(_foreseen(job, where, place, reporter), as_json)
            return
        summary = _run(job, where, place, reporter)
        _print(summary, settings, place, as_json)
        _require_complete(summary)


@contextmanager
def _going_on(progress: str) -> Iterator[None]:
    """Let a task of a farm succeed that left out what its options let it leave out.

    Engines of Open Job Description know success and failure alone. One that fails they try again,
    and the steps after it, which join the reports and make the video, never begin.
    """
    try:
        yield
    except IncompleteError:
        if progress != "openjd":
            raise


def settings_of(options: Mapping[str, Any]) -> UpsampleSettings:
    """Return the settings that options of `command` make: those that have a field of their name."""
    source = {field.name: options[field.name] for field in fields(SourceSettings)}
    own = {f.name: options[f.name] for f in fields(UpsampleSettings) if f.name in options}
    return UpsampleSettings(SourceSettings(**source), **own)


def _import_run() -> None:
    """Import what makes frames, while the main thread waits for the frames that motion is found by.

    What fails here fails again where it is used, and is reported there.
    """
    with suppress(Exception):
        import_module("exwarp_cli.pipeline.run")


def _report_place(folder: Path | None, as_chunk: bool, job: Job) -> Path | None:
    """Return the folder of the report: of a chunk, one of its own."""
    if not as_chunk:
        return folder
    if folder is None:
        raise UsageError(
            "--as-chunk says where the report goes; give --report too, or leave it out"
        )
    from exwarp_cli.report.folder import chunk_folder

    return chunk_folder(folder, job.key_numbers)


def _run(job: Job, where: ClusterSettings, place: Path | None, reporter: Progress) -> RunSummary:
    """Do the job, and write its report."""
    if place is None:
        return _done(job, where, reporter)
    from exwarp_cli.report.folder import prepare_report, write_report
    from exwarp_cli.report.gallery import Gallery

    settings = job.settings
    prepare_report(place, replace=settings.overwrite or settings.skip_existing)
    gallery = Gallery(settings.ground_truth is not None)
    summary = _done(job, where, reporter, gallery)
    write_report(place, summary, gallery.album)
    return summary


def _require_complete(summary: RunSummary) -> None:
    """Fail where something was left out, now that all else is done and said."""
    if summary.left_out:
        from exwarp_cli.pipeline.announcing import require_complete

        require_complete(summary)


def _done(
    job: Job, where: ClusterSettings, reporter: Progress, gallery: Gallery | None = None
) -> RunSummary:
    """Do the job, in this process or others."""
    if where.spread:
        from exwarp_cli.farm.cluster import run_on_cluster

        return run_on_cluster(job, where, reporter, gallery)
    from exwarp_cli.pipeline.run import run_job

    return run_job(job, reporter, gallery)


def _foreseen(job: Job, where: ClusterSettings, place: Path | None, reporter: Progress) -> DryRun:
    """Find out what the job would do."""
    from exwarp_cli.pipeline.dry_run import foresee, require_writable

    if place is not None:
        from exwarp_cli.report.folder import refuse_report

        refuse_report(place, replace=job.settings.overwrite or job.settings.skip_existing)
        require_writable((place,))
    found = foresee(job)
    if where.spread:
        from exwarp_cli.farm.cluster import foresee_on_cluster

        found = foresee_on_cluster(job, where, found)
    job.announce(reporter)
    return replace(found, report=place)


def _tell(found: DryRun, as_json: bool) -> None:
    """Say what would be done."""
    from exwarp_cli.report.dry_run import dry_run_document, dry_run_lines

    if as_json:
        print_json(dry_run_document(found))
        return
    for line in dry_run_lines(found):
        show(line)


def _print(
    summary: RunSummary, settings: UpsampleSettings, place: Path | None, as_json: bool
) -> None:
    """Say in a few lines what was done, or give the report's document."""
    from exwarp_cli.report.summary import report

    document = report(summary)
    if as_json:
        print_json(document)
        return
    with summary_of_files():
        _print_summary(document, summary, settings, place)


def _print_summary(
    document: dict[str, Any], summary: RunSummary, settings: UpsampleSettings, place: Path | None
) -> None:
    from exwarp_cli.commands.summary_lines import summary_lines
    from exwarp_cli.io.clip import is_clip

    if not document["frames"]["written"]:
        if summary.left_out:
            return
        kept = f"{settings.output} is there already, as this run would write it"
        # A video without frames is an error, so it was kept.
        message = kept if is_clip(settings.output) else f"no frame falls to {settings.output}"
        show(message)
        return
    for line in summary_lines(document, settings.output, settings.ground_truth is not None):
        show(line)
    if place is not None:
        show(f"report in {place}")
