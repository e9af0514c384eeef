"""``exwarp doctor``: under construction."""

import click


@click.command("doctor")
def command() -> None:
    """Under construction."""
