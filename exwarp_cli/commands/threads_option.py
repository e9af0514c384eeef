"""``--threads``: how many cores a command uses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

Command = TypeVar("Command", bound=Callable[..., Any])


def threads_option(command: Command) -> Command:
    """Give a command the option; its value is for `exwarp_cli.io.threads.use_threads`."""
    return click.option(
        "--threads",
        type=click.IntRange(1),
        help="Cores to use, for reading, computing and writing together. Default: all.",
    )(command)
