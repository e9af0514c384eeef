"""Options that several commands have, and how commands print."""

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
from exwarp_cli.domain.metric import ALL, BY_OPTION, parse_metrics
from exwarp_cli.domain.settings import MOST_PIXELS, SCANS, SRGB_VIEW, SourceSettings
from exwarp_cli.domain.wording import printable
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


class HelpfulGroup(click.Group):
    """A group that shows its help, as no mistake, when it is called without a command."""

    def __init__(self, *args: object, **settings: object) -> None:
        settings["invoke_without_command"] = True
        super().__init__(*args, **settings)  # type: ignore[arg-type]

    def invoke(self, ctx: click.Context) -> object:
        """Run the command that was named, or show the help."""
        result = super().invoke(ctx)
        if ctx.invoked_subcommand is None:
            click.echo(ctx.get_help())
        return result


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
    from exwarp_cli.report.schema import replace_nonfinite, to_json

    click.echo(to_json(replace_nonfinite(document)), nl=False)


# The command takes `as_json`, and prints one document on stdout, and no more.
json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON document on stdout instead."
)

# Its value is for `exwarp_cli.io.threads.use_threads`.
threads_option = click.option(
    "--threads",
    type=click.IntRange(1),
    help="Cores to use, for reading, computing and writing together. Default: all.",
)


def _read_metrics(
    _context: click.Context, _parameter: click.Parameter, text: str | None
) -> tuple[str, ...] | None:
    return None if text is None else parse_metrics(text)


# Its value is a tuple of names in `Score`, or None.
metrics_option = click.option(
    "--metrics",
    metavar="LIST",
    callback=_read_metrics,
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


def source_options(command: Command) -> Command:
    """Add --view, --aov, --channel-map, --dynamic and --max-pixels.

    The command takes `view`, `aovs`, `channel_map`, `dynamic` and `max_pixels`.
    """
    for option in (
        max_pixels_option,
        click.option(
            "--dynamic",
            metavar="GLOB[,GLOB…]",
            help="What moves, by names in the Cryptomatte's manifest, for example 'car*,ball'; "
            "its ids tell objects apart then. 'exwarp inspect' lists names.",
        ),
        click.option(
            "--channel-map",
            metavar="FILE",
            help="TOML file that says which channels hold what; 'exwarp inspect SEQ "
            "--write-channel-map FILE' writes one.",
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
            "--view",
            metavar="NAME",
            help="Of a stereo or multi-view shot, read this view; else the channel map's, or "
            "the first; upsample takes 'all' for every view at once. Of a sequence for each "
            "view: with %V for its name in the pattern, %v for its first letter.",
        ),
    ):
        command = option(command)
    return command
