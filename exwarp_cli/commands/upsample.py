"""``exwarp upsample``: the main job."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from exwarp_cli.commands.metrics_option import metrics_option
from exwarp_cli.commands.source_options import source_options
from exwarp_cli.domain.metric import METRICS
from exwarp_cli.domain.settings import DEVICES, SourceSettings, UpsampleSettings
from exwarp_cli.domain.timeline import MOST
from exwarp_cli.pipeline.progress import KINDS

if TYPE_CHECKING:
    from exwarp_cli.domain.results import RunSummary


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
    help="Default: exwarp, or softsplat where motion is estimated. exwarp: the learned policy "
    "chooses between warping and the network; s1 to s6: the paper's paths, s6 warps only; oracle, "
    "oracle-return: the best path by --ground-truth; softsplat: warp both neighbours and blend by "
    "depth; onnx: the network of --interpolator, from colour alone; blend: cross-fade; hold: "
    "repeat.",
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
@click.option("--frames", metavar="RANGE", help="Key frames to do, by number: 1001-1100x2, 1-10:2.")
@click.option("--gbuffers", metavar="SEQ", help="G-buffers rendered at the output rate.")
@click.option(
    "--motion",
    metavar="CONVENTION",
    help="Read vectors so, and measure nothing: a preset (blender, unreal, unreal-mrq, arnold, "
    "vray, redshift, renderman, karma, moonray, nuke, reelsmart, twixtor, forward, backward, "
    "forward+backward) or e.g. 'previous=X,-Y next=-Z,W'.",
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
    ".json, says what it takes.",
)
@click.option(
    "--policy", metavar="FILE", help="Policy that decides; else the one that comes with ExWarp."
)
@click.option(
    "--device",
    type=click.Choice(DEVICES),
    default=UpsampleSettings.device,
    show_default=True,
    help="What the network runs on.",
)
@click.option("--fps", type=FrameRate(), help="Rate of the input; else its own, else 30.")
@click.option(
    "--factor",
    type=click.IntRange(2, MOST),
    help="Output frames per key frame; else 4. The paper's methods are for 4, all others for any.",
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
@click.option("--compression", metavar="NAME", help="Of generated frames: zip, piz, dwaa, none …")
@click.option("--skip-existing", is_flag=True, help="Keep good frames of an earlier run.")
@click.option("--overwrite", is_flag=True, help="Replace frames that exist.")
@click.option("--threads", type=click.IntRange(1), help="Default: all cores.")
@click.option(
    "--progress",
    type=click.Choice(KINDS),
    default=KINDS[0],
    show_default=True,
)
def command(
    report_folder: Path | None,
    progress: str,
    sequence: str,
    gbuffers: str | None,
    motion: str | None,
    fps: Fraction | None,
    start_frame: int | None,
    tail: bool,
    factor: int | None,
    to_fps: Fraction | None,
    view: str | None,
    aovs: tuple[str, ...],
    channel_map: str | None,
    cuts: str,
    dynamic: str | None,
    **options: object,
) -> None:
    """Write SEQUENCE at four times its frame rate, or another.

    SEQUENCE is a folder, a pattern such as shot.####.exr, or any one frame. Rendered frames pass
    through unchanged; those between them are made from their motion vectors.

    It may also be a video, or PNG, JPEG, TIFF, DPX and other stills, or EXR without vectors: motion
    is then estimated from colour, which needs the extra 'video' and is far less exact.
    """
    from exwarp_cli.pipeline.progress import make_progress
    from exwarp_cli.pipeline.upsample import upsample
    from exwarp_cli.report.folder import prepare_report, write_report
    from exwarp_cli.report.gallery import Gallery

    rate = (fps, start_frame, tail, factor, to_fps)
    source = SourceSettings(
        sequence, gbuffers, motion, *rate, view, aovs, channel_map, cuts, dynamic
    )
    settings = UpsampleSettings(source, **options)  # type: ignore[arg-type]
    if report_folder is not None:
        prepare_report(report_folder, replace=settings.overwrite or settings.skip_existing)
    gallery = None if report_folder is None else Gallery(settings.ground_truth is not None)
    summary = upsample(settings, make_progress(progress), gallery)
    if report_folder is not None and gallery is not None:
        write_report(report_folder, summary, gallery.album)
    _print(summary, settings, report_folder)


def _print(summary: RunSummary, settings: UpsampleSettings, report_folder: Path | None) -> None:
    """Say in a few lines what was done."""
    from exwarp_cli.io.clip import is_clip
    from exwarp_cli.report.page_parts import cuts_line
    from exwarp_cli.report.summary import report

    document = report(summary)
    frames, fps = document["frames"], document["fps"]
    if not frames["written"]:
        kept = f"{settings.output} is there already, as this run would write it"
        # A video without frames is an error, so it was kept.
        click.echo(kept if is_clip(settings.output) else f"no frame falls to {settings.output}")
        return
    many = "" if frames["written"] == 1 else "s"
    click.echo(
        f"{frames['written']} frame{many} in {settings.output}: {frames['key']} rendered, "
        f"{frames['generated']} generated, {frames['dropped']} repeated"
    )
    effective = "" if fps["effective"] is None else f", effective {fps['effective']:g}"
    click.echo(f"{fps['base']:g} fps in, {fps['output']:g} out{effective}")
    if document["cuts"]:
        click.echo(cuts_line(document["cuts"]))
    taken = {name: count for name, count in document["decisions"]["paths"].items() if count}
    if taken:
        listed = ", ".join(f"{name} {count}" for name, count in taken.items())
        share = document["decisions"]["warp_share"]
        click.echo(f"paths of the key intervals: {listed}; {share:.0%} of the decisions are warps")
    if document["holes"]["mean_fraction"] is not None:
        click.echo(f"holes {document['holes']['mean_fraction']:.1%} of the pixels on average")
    if settings.ground_truth is not None and frames["written"] > frames["key"]:
        click.echo(f"against ground truth{_scores(document['quality']['all'])}")
    if document["render_time"] is not None:
        click.echo(_saved(document["render_time"]))
    if report_folder is not None:
        click.echo(f"report in {report_folder}")


def _scores(quality: dict[str, Any]) -> str:
    """Say how good the frames between the rendered ones are."""
    if not quality["frames"]:
        return ": it has none of the frames between the rendered ones"
    values = (
        f"{metric.name} {metric.with_unit(quality[metric.field])}"
        for metric in METRICS
        if quality[metric.field] is not None
    )
    return f" ({quality['frames']} frames): {', '.join(values)}"


def _saved(found: dict[str, Any]) -> str:
    """Say what rendering would have taken, by the renderer's own times."""
    from exwarp_cli.report.page_parts import time_text

    return (
        f"render time saved: {time_text(found['saved_s'])} ({found['saved_share']:.0%}); a key "
        f"frame took {time_text(found['key_frame_s'])} to render, a new one takes "
        f"{time_text(found['generated_frame_s'])}"
    )
