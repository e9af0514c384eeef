"""``--json``, which every command has that tells something: one document on stdout, and no more."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

Command = TypeVar("Command", bound=Callable[..., Any])


def json_option(command: Command) -> Command:
    """Give a command the option; it takes `as_json`."""
    return click.option(
        "--json", "as_json", is_flag=True, help="Print one JSON document on stdout instead."
    )(command)


def print_json(document: dict[str, Any]) -> None:
    """Print a document; numbers that are none become null, as JSON has no word for them."""
    from exwarp_cli.report.schema import replace_nonfinite, to_json

    click.echo(to_json(replace_nonfinite(document)), nl=False)
