"""``exwarp inspect``: what a sequence holds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from exwarp_cli.commands import options
from exwarp_cli.domain.wording import pluralise, printable

if TYPE_CHECKING:
    from exwarp_cli.pipeline.inspect import Inspection

_ESTIMATED = (
    "no motion vectors: 'exwarp upsample' estimates motion from colour, with the extra 'video'"
)


@click.command("inspect")
@click.argument("sequence")
@click.option("--motion", metavar="CONVENTION", help="Read vectors so, whatever is measured.")
@options.source_options
@options.scan_option
@click.option(
    "--write-channel-map",
    "write_map",
    metavar="FILE",
    type=options.FILE,
    help="Write what is found as a TOML file for --channel-map, to correct and to keep.",
)
@click.option("--overwrite", is_flag=True, help="Replace the channel map if it exists.")
@options.json_option
def command(write_map: Path | None, overwrite: bool, as_json: bool, **source: Any) -> None:
    """Show what SEQUENCE holds and how its motion vectors are read.

    The motion convention is measured on the first, middle and last pair of frames; what the channel
    names say is only a first guess.
    """
    from exwarp_cli.api import SourceSettings, inspect
    from exwarp_cli.pipeline.inspect import save_channel_map

    inspection = inspect(SourceSettings(**source))
    if write_map is not None:
        save_channel_map(inspection, write_map, overwrite)
    if as_json:
        options.print_json(inspection.as_dict())
    else:
        _print_inspection(inspection)


def _print_inspection(inspection: Inspection) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    from exwarp_cli.io.channels import Role
    from exwarp_cli.io.cryptomatte import cryptomatte_refs
    from exwarp_cli.io.layers import is_colour_alone, no_vectors_message
    from exwarp_cli.io.shot import alpha_note

    shot = inspection.shot
    console = Console(highlight=False, soft_wrap=True, markup=False, emoji=False)
    data = inspection.as_dict()
    producer = f", written by {data['producer']}" if data["pictures"] is None else ""
    head = [
        data["pattern"],
        f"{data['count']} frames ({data['frames']}), {data['width']}x{data['height']}, "
        f"{data['fps']['base']:g} fps ({data['fps']['source']}){producer}",
    ]
    head += [note for note in (data["naming_note"], data["fps"]["note"]) if note is not None]
    for line in (*head, *_structure_lines(data)):
        console.print(printable(line))
    if data["pictures"] is not None:
        return
    table = Table("role", "channels", "type", box=box.SIMPLE)
    hashed = cryptomatte_refs(shot.cryptomattes)
    unused: dict[tuple[str, str], list[str]] = {}  # by what they are, and their layer
    for ref in shot.unused:
        name, meaning = ref.label, "Cryptomatte" if ref in hashed else "no role"
        unused.setdefault((meaning, name.rpartition(".")[0]), []).append(name)
    rows = [*data["roles"].items(), *((meaning, names) for (meaning, _), names in unused.items())]
    for meaning, names in rows:
        kinds = sorted({inspection.types.get(name, "") for name in names})
        table.add_row(meaning, printable(", ".join(names)), ", ".join(kinds))
    console.print(table)
    # What is left out or absent, and how motion and depth are read.
    lines = [] if (alpha := alpha_note(shot.layout)) is None else [alpha]
    if missing := [role for role in Role if role not in shot.layout]:
        incomplete = shot.layout.incomplete
        names = (
            f"{role.value} ({incomplete[role]})" if role in incomplete else role.value
            for role in missing
        )
        lines.append(f"not found: {', '.join(names)}")
    motion = data["motion"]
    if motion is not None:
        state = motion["source"] or "unsettled"
        lines.append(f"motion {state}: {motion['evidence'] or motion['problem']}")
    else:
        lines.append(_ESTIMATED if is_colour_alone(shot) else no_vectors_message(shot))
    if data["depth_evidence"] is not None:
        lines.append(f"depth {data['depth_evidence']}")
    for line in lines:
        console.print(printable(line))


def _structure_lines(data: dict[str, Any]) -> list[str]:
    """Say what else there is: pictures, views, AOVs' files, tiles, deep parts, Cryptomattes."""
    from exwarp_cli.io.cryptomatte import MAX_NAMES, quote_name

    lines = []
    if (pictures := data["pictures"]) is not None:
        line = f"{pictures['kind']} of {pictures['bits']} bits, {pictures['colour']}"
        if pictures["pixel_aspect"] != 1:
            line += f", pixel aspect {pictures['pixel_aspect']:g}"
        if pictures["alpha"] is not None:
            line += f", alpha {pictures['alpha']}"
        if pictures["kind"] == "video":
            line += f", sound {', '.join(pictures['sound'])}" if pictures["sound"] else ", no sound"
        lines += [line, _ESTIMATED]
    if data["views"]:
        lines.append(f"views {', '.join(data['views'])}; shown is {data['view']}")
    lines += [f"AOV {aov} in {pattern}" for aov, pattern in data["aovs"].items()]
    parts = data["parts"]
    for kind, meaning in (("tiled", "stored in tiles"), ("deep", "deep and not read")):
        names = [part["name"] for part in parts if part[kind]]
        if names:
            subject = "the file" if len(names) == len(parts) else f"part {', '.join(names)}"
            lines.append(f"{subject} is {meaning}")
    for matte in data["cryptomattes"]:
        name = matte["name"] if matte["aov"] is None else f"{matte['aov']}:{matte['name']}"
        subject = f"Cryptomatte {name} ({matte['kind']})"
        if matte["problem"]:
            lines.append(f"{subject}: {matte['problem']}")
            continue
        names, count = matte["names"], len(matte["names"])
        listed = ", ".join(map(quote_name, names[:MAX_NAMES]))
        more = f" and {count - MAX_NAMES} more" if count > MAX_NAMES else ""
        lines.append(f"{subject}, {pluralise(count, 'name')}: {listed}{more}")
    if data["dynamic"] is not None:
        lines.append(f"moving by name: {', '.join(data['dynamic'])}")
    return lines
