"""``exwarp inspect``: what a sequence holds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from exwarp_cli.commands.json_option import json_option, print_json
from exwarp_cli.commands.source_options import scan_option, source_options
from exwarp_cli.domain.wording import pluralise, printable

if TYPE_CHECKING:
    from rich.text import Text

    from exwarp_cli.pipeline.inspect import Inspection


@click.command("inspect")
@click.argument("sequence")
@click.option("--motion", metavar="CONVENTION", help="Read vectors so, whatever is measured.")
@source_options
@scan_option
@click.option(
    "--write-channel-map",
    "write_map",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Write what is found as a TOML file for --channel-map, to correct and to keep.",
)
@click.option("--overwrite", is_flag=True, help="Replace the channel map if it exists.")
@json_option
def command(
    sequence: str,
    motion: str | None,
    view: str | None,
    aovs: tuple[str, ...],
    channel_map: str | None,
    dynamic: str | None,
    max_pixels: int,
    scan: str,
    write_map: Path | None,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Show what SEQUENCE holds and how its motion vectors are read.

    The motion convention is measured on the first, middle and last pair of frames; what the channel
    names say is only a first guess.
    """
    from exwarp_cli.domain.settings import SourceSettings
    from exwarp_cli.pipeline.inspect import inspect, save_channel_map

    found = inspect(
        SourceSettings(
            sequence,
            motion=motion,
            view=view,
            aovs=aovs,
            channel_map=channel_map,
            dynamic=dynamic,
            max_pixels=max_pixels,
            scan=scan,
        )
    )
    if write_map is not None:
        save_channel_map(found, write_map, overwrite)
    if as_json:
        print_json(found.as_dict())
    else:
        _print(found)


def _print(found: Inspection) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console = Console(highlight=False, soft_wrap=True)
    data = found.as_dict()
    console.print(_text(data["pattern"]))
    console.print(
        _text(
            f"{data['count']} frames ({data['frames']}), {data['width']}x"
            f"{data['height']}, {data['fps']['base']:g} fps ({data['fps']['source']})"
            + (f", written by {data['producer']}" if data["pictures"] is None else "")
        )
    )
    for note in (data["naming_note"], data["fps"]["note"]):
        if note is not None:
            console.print(_text(note))
    for line in _structure(data):
        console.print(_text(line))
    if data["pictures"] is not None:
        return
    table = Table("role", "channels", "type", box=box.SIMPLE)
    for role, names in data["roles"].items():
        kinds = sorted({found.types.get(name, "") for name in names})
        table.add_row(role, _text(", ".join(names)), ", ".join(kinds))
    for meaning, names in _unused(found):
        kinds = sorted({found.types.get(name, "") for name in names})
        table.add_row(meaning, _text(", ".join(names)), ", ".join(kinds))
    console.print(table)
    for line in _findings(found, data):
        console.print(_text(line))


def _findings(found: Inspection, data: Mapping[str, Any]) -> Iterator[str]:
    """Yield what is left out or absent, and how motion and depth are read."""
    from exwarp_cli.io.shot import alpha_left_out
    from exwarp_cli.pipeline.inspect import missing_roles

    layout = found.shot.layout
    if (left_out := alpha_left_out(layout)) is not None:
        yield left_out
    missing = missing_roles(layout)
    if missing:
        halves = layout.incomplete
        named = (
            f"{role.value} ({halves[role]})" if role in halves else role.value for role in missing
        )
        yield f"not found: {', '.join(named)}"
    motion = data["motion"]
    if motion is None:
        yield _without_vectors(found)
    else:
        state = motion["source"] or "unsettled"
        yield f"motion {state}: {motion['evidence'] or motion['problem']}"
    if data["depth_evidence"] is not None:
        yield f"depth {data['depth_evidence']}"


def _unused(found: Inspection) -> list[tuple[str, list[str]]]:
    """Return what channels without a role are and their names, layer by layer."""
    from exwarp_cli.io.shot import spelled
    from exwarp_cli.pipeline.inspect import unused_channels

    hashed = {ref for one in found.shot.cryptomattes for ref in one.refs}
    layers: dict[tuple[str, str], list[str]] = {}
    for ref in unused_channels(found.shot):
        name, meaning = spelled(ref), "Cryptomatte" if ref in hashed else "no role"
        layers.setdefault((meaning, name.rpartition(".")[0]), []).append(name)
    return [(meaning, names) for (meaning, _), names in layers.items()]


def _text(text: str) -> Text:
    """Return text that neither a terminal nor rich takes for more than text."""
    from rich.text import Text

    return Text(printable(text))


def _without_vectors(found: Inspection) -> str:
    """Say what `upsample` does where no vectors are recognised, and why."""
    from exwarp_cli.io.unrecognised import is_colour_alone, no_vectors

    return _ESTIMATED if is_colour_alone(found.shot) else no_vectors(found.shot)


_ESTIMATED = (
    "no motion vectors: 'exwarp upsample' estimates motion from colour, with the extra 'video'"
)


def _pictures(pictures: dict[str, Any]) -> str:
    """Say in a line what a video or stills are like."""
    line = f"{pictures['kind']} of {pictures['bits']} bits, {pictures['colour']}"
    if pictures["pixel_aspect"] != 1:
        line += f", pixel aspect {pictures['pixel_aspect']:g}"
    if pictures["alpha"] is not None:
        line += f", alpha {pictures['alpha']}"
    if pictures["kind"] == "video":
        line += f", sound {', '.join(pictures['sound'])}" if pictures["sound"] else ", no sound"
    return line


def _structure(data: dict[str, Any]) -> list[str]:
    """Say in lines what else there is: views, AOVs' files, tiles, deep parts, Cryptomattes."""
    lines = []
    if data["pictures"] is not None:
        lines += [_pictures(data["pictures"]), _ESTIMATED]
    if data["views"]:
        lines.append(f"views {', '.join(data['views'])}; shown is {data['view']}")
    lines += [f"AOV {aov} in {pattern}" for aov, pattern in data["aovs"].items()]
    parts = data["parts"]
    for kind, meaning in (("tiled", "stored in tiles"), ("deep", "deep and not read")):
        of = [part["name"] for part in parts if part[kind]]
        if of:
            named = "the file" if len(of) == len(parts) else f"part {', '.join(of)}"
            lines.append(f"{named} is {meaning}")
    lines += [_matte(one) for one in data["cryptomattes"]]
    if data["dynamic"] is not None:
        lines.append(f"moving by name: {', '.join(data['dynamic'])}")
    return lines


def _matte(one: dict[str, Any]) -> str:
    """Say in a line what a Cryptomatte has."""
    from exwarp_cli.io.cryptomatte_manifest import SHOWN, shown

    name = one["name"] if one["aov"] is None else f"{one['aov']}:{one['name']}"
    if one["problem"]:
        return f"Cryptomatte {name} ({one['kind']}): {one['problem']}"
    names, count = one["names"], len(one["names"])
    listed = ", ".join(shown(each) for each in names[:SHOWN])
    more = f" and {count - SHOWN} more" if count > SHOWN else ""
    return f"Cryptomatte {name} ({one['kind']}), {pluralise(count, 'name')}: {listed}{more}"
