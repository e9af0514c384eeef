"""``--progress``, which commands have that take long."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

from exwarp_cli.pipeline.progress import KINDS

Command = TypeVar("Command", bound=Callable[..., Any])

HELP = (
    "How to tell how far it is: for people a bar or plain lines, for programs JSON lines on "
    "stderr, or openjd, the lines that Open Job Description's farms read."
)


def progress_option(command: Command) -> Command:
    """Give a command the option; it takes `progress`, for `pipeline.progress.reporting`."""
    return click.option(
        "--progress", type=click.Choice(KINDS), default=KINDS[0], show_default=True, help=HELP
    )(command)
