"""The one HTML file of a report: what it is made of, and how it becomes text.

A page is a headline of numbers and sections of blocks; nothing in it asks for anything outside the
file. Text is escaped by the template, whatever it holds.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from exwarp_cli import __version__
from exwarp_cli.report.gallery import Album
from exwarp_cli.report.plot_style import ROLES, SERIES, Figure, quiet

if TYPE_CHECKING:
    from jinja2 import Environment

HEAT_STEPS = 24
"""Colours that the error map is interpolated from."""


@dataclass(frozen=True)
class Number:
    """One figure of the headline: what it is, its value with unit, and a word beside it."""

    label: str
    value: str
    note: str = ""


@dataclass(frozen=True)
class Link:
    """Text of a cell that leads to a place in the page, such as ``#viewer:12``."""

    text: str
    target: str


Cell = str | Link | None
"""Of a table; None was not measured. Columns that mostly read as numbers stand to the right."""


@dataclass(frozen=True)
class Table:
    """Rows under a heading; the first cell of each is the row's name.

    Attributes
    ----------
    title
        Heading; empty for none.
    columns
        Names; the first may be empty.
    rows
        As many cells each.
    note
        A line below; empty for none.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    note: str = ""


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str


@dataclass(frozen=True)
class Viewer:
    """An album to look at; `name` is unique in the page: letters, digits and hyphens."""

    album: Album
    name: str = "viewer"


Block = Table | Text | Viewer | Figure


@dataclass(frozen=True)
class Section:
    """A part of the page with a heading; `name` is unique: letters, digits and hyphens."""

    name: str
    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Page:
    """A whole page.

    Attributes
    ----------
    title
        Of the window and the page.
    subtitle
        A line below it.
    numbers
        The headline.
    sections
        In their order; those without blocks are left out.
    """

    title: str
    subtitle: str
    numbers: Sequence[Number]
    sections: Sequence[Section]


def render(page: Page) -> str:
    """Write a page as HTML; the same page gives the same text.

    Returns
    -------
    str
        Valid Unicode: bytes of a file name that are none are spelled out as ``\\udcff``.
    """
    sections = [section for section in page.sections if section.blocks]
    text = (
        _environment()
        .get_template("page.html")
        .render(
            page=page, sections=sections, version=__version__, roles=ROLES, series=range(SERIES)
        )
    )
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def script_json(value: Any) -> Markup:
    """Write a value as JSON that can stand inside a script element: no ``<``, only ASCII."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


def viewer_data(album: Album) -> Markup:
    """Return what the viewer's script reads; see `exwarp_cli.report.gallery`."""
    return script_json(album.plain() | {"heat": heat_colours()})


@cache
def heat_colours() -> list[list[int]]:
    """Colours of the error map, dark for none: matplotlib's magma, even to the eye."""
    with quiet():
        from matplotlib import colormaps

    steps = [i / (HEAT_STEPS - 1) for i in range(HEAT_STEPS)]
    return [[round(255 * part) for part in colormaps["magma"](s)[:3]] for s in steps]


_NUMBER = re.compile(r"[-+]?[0-9][0-9,]*([.][0-9]+)?( ?(%|dB|ms|s|fps|min|h|MB|KB))?")


def is_number(cell: Cell) -> bool:
    """Whether a cell of a table reads as a number; None may stand for one."""
    return cell is None or (isinstance(cell, str) and _NUMBER.fullmatch(cell) is not None)


def kind_of(block: Block) -> str:
    """Name a block's class, by which the template chooses how to write it."""
    return type(block).__name__.lower()


@cache
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=PackageLoader("exwarp_cli.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.tests["number_cell"] = is_number
    made.filters |= {"kind_of": kind_of, "viewer_data": viewer_data}
    return made
