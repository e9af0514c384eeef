"""Groups of commands."""

from __future__ import annotations

import click


class HelpfulGroup(click.Group):
    """A group that shows its help, as no mistake, when it is called without a command."""

    def __init__(self, *args: object, **settings: object) -> None:
        settings["invoke_without_command"] = True
        super().__init__(*args, **settings)  # type: ignore[arg-type]

    def invoke(self, ctx: click.Context) -> object:
        """Run the command that was named, or show the help."""
        result = super().invoke(ctx)
        if ctx.invoked_subcommand is None:
            click.echo(ctx.get_help())
        return result
