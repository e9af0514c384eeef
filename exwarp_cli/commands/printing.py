"""Lines that a command prints, which hold names of files, layers and views."""

from __future__ import annotations

import click

from exwarp_cli.domain.line import printable


def show(line: str, *, err: bool = False) -> None:
    """Print a line, of which a terminal shows all and obeys nothing; `err` for stderr."""
    click.echo(printable(line), err=err)
