"""``exwarp inspect``: what a sequence holds."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from exwarp_cli.pipeline.inspect import Inspection


@click.command("inspect")
@click.argument("sequence")
@click.option("--motion", metavar="CONVENTION", help="Read vectors so, and measure nothing.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of tables.")
def command(sequence: str, motion: str | None, as_json: bool) -> None:
    """Show what SEQUENCE holds and how its motion vectors are read.

    The motion convention is measured on the first, middle and last pair of frames; what the channel
    names say is only a first guess.
    """
    from exwarp_cli.domain.settings import SourceSettings
    from exwarp_cli.pipeline.inspect import inspect

    found = inspect(SourceSettings(sequence, motion=motion))
    if as_json:
        click.echo(json.dumps(found.as_dict(), indent=2))
    else:
        _print(found)


def _print(found: Inspection) -> None:
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from exwarp_cli.pipeline.inspect import missing_roles

    console = Console(highlight=False, soft_wrap=True)
    data = found.as_dict()
    console.print(
        escape(
            f"{data['pattern']}\n{data['count']} frames ({data['frames']}), {data['width']}x"
            f"{data['height']}, {data['fps']['base']:g} fps ({data['fps']['source']}), written by "
            f"{data['producer']}"
        )
    )
    table = Table("role", "channels", "type", box=box.SIMPLE)
    types = {c.name: c.pixel_type for part in found.parts for c in part.channels}
    for role, names in data["roles"].items():
        kinds = sorted({types.get(name, "") for name in names})
        table.add_row(role, escape(", ".join(names)), ", ".join(kinds))
    console.print(table)
    missing = missing_roles(found.shot.layout)
    if missing:
        console.print(f"not found: {', '.join(role.value for role in missing)}")
    motion = data["motion"]
    if motion is not None:
        state = motion["source"] or "unsettled"
        console.print(escape(f"motion {state}: {motion['evidence'] or motion['problem']}"))
