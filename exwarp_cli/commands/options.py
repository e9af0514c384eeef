"""Options that several commands have, and what several print."""

from __future__ import annotations

import copy
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeVar

import click

from exwarp_cli.config import configured_command
from exwarp_cli.domain.metric import ALL, BY_OPTION, KEY_FRAMES, METRICS, parse_metrics
from exwarp_cli.domain.settings import MOST_PIXELS, SCANS, SRGB_VIEW, SourceSettings
from exwarp_cli.domain.wording import pluralise, printable
from exwarp_cli.errors import ReaderGoneError
from exwarp_cli.pipeline.progress import KINDS

Command = TypeVar("Command", bound=Callable[..., Any])
Decorator = Callable[[Command], Command]

FILE = click.Path(path_type=Path)


def with_settings(
    command: click.Command, path: tuple[str, ...], *, completing: bool = False
) -> click.Command:
    """Return a copy of a command or group whose options files and the environment set too.

    `path` has the names of its groups, and its own. With `completing`, for a shell that asks for
    completions, its parameters have some to offer.
    """
    if isinstance(command, click.Group):
        group = copy.copy(command)
        group.commands = {
            name: with_settings(below, (*path, name), completing=completing)
            for name, below in command.commands.items()
        }
        return group
    if completing:
        # Imported here: it takes 8 ms, which other calls need not pay.
        from exwarp_cli.commands.completion import with_suggestions

        command = with_suggestions(command)
    return configured_command(command, path)


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


def show(line: str, *, err: bool = False) -> None:
    """Print a line, of which a terminal shows all and obeys nothing; `err` for stderr."""
    click.echo(printable(line), err=err)


@contextmanager
def summary_of_files() -> Iterator[None]:
    """Print, in this block, a summary of files that are written already.

    A reader that ends early, as ``| head`` does, is no failure of the command then.
    """
    with suppress(ReaderGoneError):
        yield
        sys.stdout.flush()


def print_json(document: dict[str, Any]) -> None:
    """Print a document; numbers that are none become null, as JSON has no word for them."""
    from exwarp_cli.report.schema import to_json

    click.echo(to_json(document), nl=False)


# The command takes `as_json`, and prints one document on stdout, and no more.
json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON document on stdout instead."
)

# Its value is for `exwarp_cli.pipeline.scheduling.use_threads`.
threads_option = click.option(
    "--threads",
    type=click.IntRange(1),
    help="Cores to use, for reading, computing and writing together. Default: all.",
)


# Its value is a tuple of names in `Score`, or None.
metrics_option = click.option(
    "--metrics",
    metavar="LIST",
    callback=lambda _ctx, _parameter, text: None if text is None else parse_metrics(text),
    help=f"What is measured, with commas between, out of {', '.join(BY_OPTION)}; or {ALL}. "
    "Default: psnr,ssim,flip,pulse.",
)

PROGRESS_HELP = (
    "How to tell how far it is: for people a bar or plain lines, for programs JSON lines on "
    "stderr, or openjd, the lines that Open Job Description's farms read."
)


def progress_option(text: str = PROGRESS_HELP, default: str | None = KINDS[0]) -> Decorator[Any]:
    """Return ``--progress``, for `pipeline.progress.reporting`; None for no default."""
    return click.option(
        "--progress", type=click.Choice(KINDS), default=default, show_default=True, help=text
    )


def view_transform_option(shown: str) -> Decorator[Any]:
    """Return the option ``--view-transform``; its help says how what `shown` names show colour."""
    return click.option(
        "--view-transform",
        default=SRGB_VIEW,
        show_default=True,
        metavar="NAME|CONFIG:DISPLAY:VIEW",
        help=f"How {shown} scene-linear colour: srgb, the curve alone; aces1 or aces2, the tone "
        "scale of ACES 1 or 2; or a view of an OpenColorIO configuration.",
    )


max_pixels_option = click.option(
    "--max-pixels",
    type=click.IntRange(1),
    default=MOST_PIXELS,
    show_default="2^28",
    metavar="N",
    help="Refuse frames that say they have more pixels.",
)

scan_option = click.option(
    "--scan",
    type=click.Choice(SCANS),
    default=SourceSettings.scan,
    show_default=True,
    help="How video is read that says it is interlaced: auto refuses it, progressive takes its "
    "frames as they are (PsF), deinterlace makes a frame of each two fields.",
)


def combined(*options: Decorator[Any]) -> Decorator[Any]:
    """Return a decorator that adds options to a command, in the order of its help."""

    def add(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return add


# The command takes `view`, `aovs`, `channel_map`, `dynamic` and `max_pixels`.
source_options = combined(
    click.option(
        "--view",
        metavar="NAME",
        help="Of a stereo or multi-view shot, read this view; else the channel map's, or "
        "the first; upsample takes 'all' for every view at once. Of a sequence for each "
        "view: with %V for its name in the pattern, %v for its first letter.",
    ),
    click.option(
        "--aov",
        "aovs",
        multiple=True,
        metavar="ROLE=PATTERN[:CHANNELS]",
        help="Take a role's channels from a sequence of its own, for example "
        "motion=vec/shot.####.exr:R,G; may be repeated. Roles: colour, depth, motion, "
        "normal, position, stencil …",
    ),
    click.option(
        "--channel-map",
        metavar="FILE",
        help="TOML file that says which channels hold what; 'exwarp inspect SEQ "
        "--write-channel-map FILE' writes one.",
    ),
    click.option(
        "--dynamic",
        metavar="GLOB[,GLOB…]",
        help="What moves, by names in the Cryptomatte's manifest, for example 'car*,ball'; "
        "its ids tell objects apart then. 'exwarp inspect' lists names.",
    ),
    max_pixels_option,
)


def summary_lines(
    document: dict[str, Any],  # what report.json holds; at least one frame was written
    place: str = "",  # where the frames are; empty where that is not known
    is_scored: bool | None = None,  # ground truth was given; None to tell by the scores
) -> list[str]:
    """Say in a few lines what a run of `upsample` did."""
    from exwarp_cli.report import sentences

    frames, fps, decisions = document["frames"], document["fps"], document["decisions"]
    effective = "" if fps["effective"] is None else f", effective {fps['effective']:g}"
    lines = [
        f"{pluralise(frames['written'], 'frame')}{place and f' in {place}'}: "
        f"{sentences.format_rendered(frames)}, {frames['generated']} generated, "
        f"{frames['dropped']} repeated",
        f"{fps['base']:g} fps in, {fps['output']:g} out{effective}",
    ]
    if frames["resumed"] or frames["replaced"]:
        lines.append(
            f"{frames['resumed']} kept of an earlier run, {frames['made']} made, "
            f"{frames['replaced']} replaced"
        )
    if document["cuts"]:
        lines.append(sentences.describe_cuts(document["cuts"]))
    if document["held"]:
        lines.append(sentences.describe_holds(document["held"]))
    # A method outside the paper's decision tree has no paths.
    paths = {name: count for name, count in decisions["paths"].items() if count}
    if paths and decisions["cost"] is None:
        listed = ", ".join(f"{name} {count}" for name, count in paths.items())
        share = f"{decisions['warp_share']:.0%} of the decisions are warps"
        lines.append(f"paths of the key intervals: {listed}; {share}")
    elif paths:
        total = sum(paths.values())
        listed = ", ".join(f"{name} {count / total:.0%}" for name, count in paths.items())
        share = f"the network made {decisions['cost']:.0%} of the new frames' area"
        lines.append(f"paths of the tiles: {listed}; {share}")
    if decisions["gate"]:
        lines.append(sentences.describe_gate(decisions["gate"]))
    lines += _quality_lines(document, is_scored)
    remarks = (
        (document["review"], sentences.describe_review),
        (document["left_out"], sentences.describe_left_out),
        (document["nonfinite"], sentences.describe_nonfinite),
    )
    lines += [describe(value) for value, describe in remarks if value]
    if document["verified"] is not None:
        lines.append(f"{pluralise(document['verified'], 'file')} read back, all as written")
    if (times := document["render_time"]) is not None:  # by the renderer's own times
        lines.append(
            f"render time saved: {sentences.format_time(times['saved_s'])} "
            f"({times['saved_share']:.0%}); a key frame took "
            f"{sentences.format_time(times['key_frame_s'])} to render, a new one takes "
            f"{sentences.format_time(times['generated_frame_s'])}"
        )
    return lines


def _quality_lines(document: dict[str, Any], is_scored: bool | None) -> list[str]:
    """Say how much was hidden, and how good the frames are."""
    frames, quality = document["frames"], document["quality"]["all"]
    holes, pulse = document["holes"], document["pulse"]
    lines = []
    if holes["mean_fraction"] is not None:
        count = sum(holes["histogram"]["counts"])
        # Where not all frames between key frames are warped, it is said how many are.
        is_all = count == frames["generated"] + frames["dropped"]
        warped = "" if is_all else f", of {pluralise(count, 'warped frame')}"
        lines.append(f"holes {holes['mean_fraction']:.1%} of the pixels on average{warped}")
    if is_scored is None:
        is_scored = bool(quality["frames"])
    if is_scored and frames["written"] > frames["key"]:
        values = [
            f"{metric.name} {metric.with_unit(quality[metric.field])}"
            for metric in METRICS
            if quality[metric.field] is not None
        ]
        scores = f"against ground truth ({quality['frames']} frames): {', '.join(values)}"
        nothing = "against ground truth: it has none of the frames between the rendered ones"
        lines.append(scores if quality["frames"] else nothing)
    if pulse is not None and pulse["against"] == KEY_FRAMES:
        mean, worst = (BY_OPTION["pulse"].with_unit(pulse[name]) for name in ("mean", "worst"))
        count = pluralise(pulse["frames"], "frame")
        lines.append(f"pulse against {pulse['against']} ({count}): {mean}, at worst {worst}")
    return lines
