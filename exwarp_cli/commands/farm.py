"""``exwarp farm``: under construction."""

import click


@click.command("farm")
def command() -> None:
    """Under construction."""
