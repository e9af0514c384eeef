"""The list of real things: shapes and textures that people made, taken from Debian's packages.

`things.py` writes the list; the generator of training shots and the survey read it. This module
does without Blender.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

NAME = "things.json"
CREDITS = "CREDITS.md"
SCHEMA = "exwarp.things/1"
SHAPE, FIGURE, TEXTURE = "shape", "figure", "texture"
"""Kinds: a still shape (OBJ), a running character (npz), a picture that tiles."""

FREE = ("CC0", "CC-BY")
"""Beginnings of the licences under which things may be seen in committed pictures."""


@dataclass(frozen=True)
class Thing:
    """One shape, character or texture.

    Attributes
    ----------
    name : str
        Unique in the list.
    title : str
        What it is, in words; for a texture "floor", "wall" or "trim".
    kind : str
        `SHAPE`, `FIGURE` or `TEXTURE`.
    path : str
        Relative to the list's folder.
    author, licence : str
        Who made it, and the short name of the licence as in the package's debian/copyright.
    package : str
        Debian's name of the package.
    """

    name: str
    title: str
    kind: str
    path: str
    author: str
    licence: str
    package: str

    @property
    def credit(self) -> dict[str, str]:
        """What a manifest says about it."""
        return {key: value for key, value in asdict(self).items() if key not in ("path", "kind")}


@dataclass(frozen=True)
class ThingList:
    """All real things of a folder.

    Attributes
    ----------
    folder : Path
        Where they lie.
    packages : dict of str to str
        Debian's packages and their versions.
    things : tuple of Thing
        In the order of their names.
    """

    folder: Path
    packages: Mapping[str, str] = field(default_factory=dict)
    things: tuple[Thing, ...] = ()

    def of_kind(self, kind: str) -> list[Thing]:
        """Return all things of a kind."""
        return [thing for thing in self.things if thing.kind == kind]


def default_folder() -> Path:
    """Return where real things go: the user's cache folder."""
    cache = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(cache).expanduser() / "exwarp" / "things"


def read(folder: Path) -> ThingList:
    """Read a folder's list; it is empty where there is none.

    Raises
    ------
    SystemExit
        With one sentence, when the list is damaged.
    """
    path = folder / NAME
    if not path.is_file():
        return ThingList(folder)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        things = tuple(Thing(**row) for row in content["things"])
        return ThingList(folder, dict(content["packages"]), things)
    except (ValueError, KeyError, TypeError) as error:
        raise SystemExit(f"{path} is no list of things; write it again with things.py.") from error


def write(listed: ThingList) -> None:
    """Write the list, and the same for a reader as `CREDITS`; each whole or not at all."""
    content = {
        "schema": SCHEMA,
        "packages": dict(listed.packages),
        "things": [asdict(thing) for thing in listed.things],
    }
    for name, text in (
        (NAME, json.dumps(content, indent=1, ensure_ascii=False) + "\n"),
        (CREDITS, "\n".join(credit_lines(listed)) + "\n"),
    ):
        part = listed.folder / f".{name}.part"
        part.write_text(text, encoding="utf-8")
        part.replace(listed.folder / name)


def credit_lines(listed: ThingList) -> list[str]:
    """Write the list down as Markdown: a table of packages, then each thing."""
    lines = ["# Real things for training shots", "", "Written by `things.py`.", ""]
    lines += ["| package | version | licence | shapes | figures | textures | authors |"]
    lines += ["|---|---|---|---|---|---|---|"]
    for package, licence in sorted({(thing.package, thing.licence) for thing in listed.things}):
        mine = [t for t in listed.things if (t.package, t.licence) == (package, licence)]
        counts = [sum(t.kind == kind for t in mine) for kind in (SHAPE, FIGURE, TEXTURE)]
        cells = [package, listed.packages[package], licence, *map(str, counts)]
        lines.append(f"| {' | '.join(cells)} | {len({t.author for t in mine})} |")
    lines += ["", "| name | what | author | licence |", "|---|---|---|---|"]
    lines += [f"| {t.name} | {t.title} | {t.author} | {t.licence} |" for t in listed.things]
    return lines


def may_be_committed(credits: Iterable[Mapping[str, str]]) -> bool:
    """Return True if pictures of these things may be committed: all are CC0 or CC-BY."""
    return all(is_free(credit["licence"]) for credit in credits)


def is_free(licence: str) -> bool:
    """Return True for CC0 and for CC-BY without further conditions, such as share-alike."""
    return licence.startswith(FREE) and not licence.startswith(("CC-BY-SA", "CC-BY-N"))


def licences(copyright_text: str) -> dict[str, tuple[str, str]]:
    """Read a debian/copyright file: the licence and the holders of each pattern of files."""
    found: dict[str, tuple[str, str]] = {}
    for paragraph in copyright_text.split("\n\n"):
        fields: dict[str, list[str]] = {}
        key = ""
        for line in paragraph.splitlines():
            if line[:1].isspace():
                fields.get(key, []).append(line.strip())
                continue
            key, _, rest = line.partition(":")
            fields[key] = [rest.strip()] if rest.strip() else []
        if "Files" in fields and "License" in fields:
            holders = "; ".join(fields.get("Copyright", []))
            for pattern in " ".join(fields["Files"]).split():
                found[pattern] = (fields["License"][0], holders)
    return found
