"""``exwarp completion``: under construction."""

import click


@click.command("completion")
def command() -> None:
    """Under construction."""
