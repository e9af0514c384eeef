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


def progress_option(
    text: str = HELP, default: str | None = KINDS[0]
) -> Callable[[Command], Command]:
    """Give a command the option; it takes `progress`, for `pipeline.progress.reporting`.

    Parameters
    ----------
    text
        What its help says.
    default
        One of `KINDS`; None for a command that chooses itself.
    """
    return click.option(
        "--progress", type=click.Choice(KINDS), default=default, show_default=True, help=text
    )
