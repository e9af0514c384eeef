"""Options that say how a sequence is read: its view, its AOVs' files, channel map, what moves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

from exwarp_cli.domain.settings import MOST_PIXELS, SCANS, SourceSettings

Command = TypeVar("Command", bound=Callable[..., Any])

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
    """Add --view, --aov, --channel-map, --dynamic, --max-pixels.

    The command takes `view`, `aovs`, `channel_map`, `dynamic` and `max_pixels`.
    """
    for option in reversed(
        [
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
        ]
    ):
        command = option(command)
    return command
