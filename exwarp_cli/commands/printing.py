"""Lines that a command prints, which hold names of files, layers and views."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import click

from exwarp_cli.domain.wording import printable
from exwarp_cli.errors import ReaderGoneError


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
