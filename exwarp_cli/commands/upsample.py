"""``exwarp upsample``: the main job."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext, suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from exwarp_cli.commands import options
from exwarp_cli.commands.options import FrameRate
from exwarp_cli.domain.settings import (
    DEVICES,
    USUAL_EFFORT,
    VIDEO_CODECS,
    ClusterSettings,
    SourceSettings,
    UpsampleSettings,
)
from exwarp_cli.domain.timeline import MAX_FACTOR
from exwarp_cli.errors import IncompleteError
from exwarp_cli.runtime.read_registry import enable_restart, is_restarted

if TYPE_CHECKING:
    from exwarp_cli.api import UpsampleResult
    from exwarp_cli.pipeline.job import Job
    from exwarp_cli.pipeline.progress import Progress


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
@options.source_options
@options.scan_option
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
    help="Of exwarp and --causal: share of the area that networks may compute, 0 to 1, on average "
    f"over many shots; else {USUAL_EFFORT:g}. 0 runs no network.",
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
@options.metrics_option
@click.option(
    "--report",
    "report_folder",
    metavar="DIR",
    type=click.Path(path_type=Path),
    help="Write report.html to look at, report.json and frames.csv there.",
)
@click.option("--video", metavar="FILE", help="Also write an MP4 or MOV.")
@click.option(
    "--video-codec",
    type=click.Choice(VIDEO_CODECS),
    default=UpsampleSettings.video_codec,
    show_default=True,
    help="Of the video: h264, 8 bits, plays everywhere; hevc, 10 bits; prores, ProRes 422 HQ, "
    "10 bits, in MOV alone.",
)
@click.option("--exposure", type=float, default=0.0, show_default=True, help="Of the video, stops.")
@options.view_transform_option("the video and the report's pictures show")
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
@options.threads_option
@click.option(
    "--workers",
    type=click.IntRange(1),
    metavar="N",
    help="Spread the work over N processes on this machine, which share --threads "
    "(extra: cluster).",
)
@click.option(
    "--cluster",
    metavar="ADDRESS",
    help="Spread it over the workers of a running Dask scheduler, tcp://host:port or "
    "tls://host:port; --threads is then for each worker (extra: cluster).",
)
@click.option(
    "--chunk-size",
    type=click.IntRange(1),
    metavar="N",
    help="Key frames that a worker is given at a time; else 1 to 10, by the length and "
    "the number of workers.",
)
@click.option(
    "--as-chunk",
    is_flag=True,
    help="This is one chunk of a job: put its report into a folder of its own below "
    "--report, which 'exwarp merge-reports' joins.",
)
@click.option(
    "--dry-run", is_flag=True, help="Open everything and say what would be done; write nothing."
)
@options.json_option
@options.progress_option()
def command(
    report_folder: Path | None,
    as_chunk: bool,
    dry_run: bool,
    as_json: bool,
    progress: str,
    workers: int | None,
    cluster: str | None,
    chunk_size: int | None,
    **values: Any,
) -> None:
    """Write SEQUENCE at four times its frame rate, or another.

    SEQUENCE is a folder, a pattern such as shot.####.exr, or any one frame. Rendered frames pass
    through unchanged, but for a frame rate in their header that is not the output's; those between
    them are made from their motion vectors.

    It may also be a video, or PNG, JPEG, TIFF, DPX and other stills, or EXR with colour alone:
    motion is then estimated from colour, which needs the extra 'video' and is far less exact. A
    render with depth, normals or other passes needs vectors, or --estimate-motion.
    """
    from exwarp_cli.api import find_report_folder, upsample
    from exwarp_cli.pipeline.job import open_job
    from exwarp_cli.pipeline.messages import require_complete
    from exwarp_cli.pipeline.progress import reporting

    settings = settings_of(values)
    if settings.source.keep_going:
        enable_restart()
    if is_restarted():  # what is there was written before
        settings = replace(
            settings, skip_existing=True, overwrite=False, replaces_foreign=settings.overwrite
        )
    distribution = ClusterSettings(workers, cluster, chunk_size)
    # Engines of Open Job Description know success and failure alone. They try one that fails
    # again, and never begin the steps after it, which join the reports and make the video.
    leniency = suppress(IncompleteError) if progress == "openjd" else nullcontext()
    with leniency, reporting(progress, results_on_stdout=as_json) as reporter:
        if dry_run:
            job = replace(open_job(settings), reported=as_json or report_folder is not None)
            folder = find_report_folder(report_folder, as_chunk, job.key_numbers)
            _print_dry_run(job, distribution, folder, reporter, as_json)
            return
        result = upsample(
            settings,
            report=report_folder,
            is_chunk=as_chunk,
            distribution=distribution,
            progress=reporter,
            has_document=as_json,
        )
        _print_summary(result, settings, as_json)
        require_complete(result.summary)


def settings_of(values: Mapping[str, Any]) -> UpsampleSettings:
    """Return the settings that options of `command` make: those that have a field of their name."""
    source = {field.name: values[field.name] for field in fields(SourceSettings)}
    own = {f.name: values[f.name] for f in fields(UpsampleSettings) if f.name in values}
    return UpsampleSettings(SourceSettings(**source), **own)


def _print_dry_run(
    job: Job, distribution: ClusterSettings, folder: Path | None, reporter: Progress, as_json: bool
) -> None:
    from exwarp_cli.pipeline.dry_run import foresee, require_writable
    from exwarp_cli.report.command_text import dry_run_document, dry_run_lines

    if folder is not None:
        from exwarp_cli.report.folder import refuse_report

        refuse_report(folder, replace=job.settings.overwrite or job.settings.skip_existing)
        require_writable((folder,))
    plan = foresee(job)
    if distribution.spread:
        from exwarp_cli.farm.dask_cluster import foresee_on_cluster

        plan = foresee_on_cluster(job, distribution, plan)
    job.announce(reporter)
    plan = replace(plan, report=folder)
    if as_json:
        options.print_json(dry_run_document(plan))
        return
    for line in dry_run_lines(plan):
        options.show(line)


def _print_summary(result: UpsampleResult, settings: UpsampleSettings, as_json: bool) -> None:
    from exwarp_cli.io.video_reader import is_clip

    document = result.document
    if as_json:
        options.print_json(document)
        return
    with options.summary_of_files():
        if document["frames"]["written"]:
            is_scored = settings.ground_truth is not None
            for line in options.summary_lines(document, settings.output, is_scored):
                options.show(line)
            if result.report_folder is not None:
                options.show(f"report in {result.report_folder}")
        elif result.is_complete:
            # A video without frames is an error, so it was kept.
            if is_clip(settings.output):
                options.show(f"{settings.output} is there already, as this run would write it")
            else:
                options.show(f"no frame falls to {settings.output}")
