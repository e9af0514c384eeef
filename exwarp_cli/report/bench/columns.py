"""What a table is, once for Markdown, CSV and HTML, and the columns that many have."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from exwarp_cli.report.bench.naming import Document

OURS, PAPER = "measured", "paper"

NOTHING = "-"
"""Shown for what was not measured."""

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes
    ----------
    key
        Of its values in the rows, and its name in CSV files.
    title
        Its name for people.
    style
        Format specification of its numbers; empty for text.
    """

    key: str
    title: str
    style: str = ""

    def text(self, row: Row) -> str:
        """Return a row's cell as people read it; a dash for what was not measured."""
        value = row.get(self.key)
        if value is None:
            return NOTHING
        return format(value, self.style) if self.style else str(value)


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes
    ----------
    name
        Of its CSV file, without the ending.
    title, note
        For people; the note tells what the numbers mean.
    columns, rows
        What it holds.
    """

    name: str
    title: str
    note: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]


WHAT = (Column("scene", "scene"), Column("size", "size"), Column("setting", "G-buffers"))
SOURCE = Column("source", "")
SYSTEM = Column("system", "system")


def what(row: Document) -> dict[str, Any]:
    """Return the cells that name a sequence."""
    return {"scene": row["name"], "size": row["size"], "setting": row["setting"]}


def paper_row(row: Document) -> dict[str, Any]:
    """Return the cells that name an application of the paper."""
    return {"scene": row["app"], "size": None, "setting": "slot", "source": PAPER}


def known_columns(table: Table) -> Iterable[Column]:
    """Return the columns of a table in which anything was measured."""
    return [c for c in table.columns if any(row.get(c.key) is not None for row in table.rows)]
