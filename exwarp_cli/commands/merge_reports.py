"""``exwarp merge-reports``: under construction."""

import click


@click.command("merge-reports")
def command() -> None:
    """Under construction."""
