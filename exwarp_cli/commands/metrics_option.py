"""``--metrics``, which several commands have."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

from exwarp_cli.domain.metric import ALL, BY_OPTION, parse_metrics

Command = TypeVar("Command", bound=Callable[..., Any])


def metrics_option(command: Command) -> Command:
    """Give a command the option; its value is a tuple of names in `Score`, or None."""
    return click.option(
        "--metrics",
        metavar="LIST",
        callback=_read,
        help=f"What is measured, with commas between, out of {', '.join(BY_OPTION)}; or {ALL}. "
        "Default: psnr,ssim,flip,pulse.",
    )(command)


def _read(
    _context: click.Context, _parameter: click.Parameter, text: str | None
) -> tuple[str, ...] | None:
    return None if text is None else parse_metrics(text)
