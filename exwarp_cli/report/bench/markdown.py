"""A benchmark as Markdown, for a wiki page or a pull request."""

from __future__ import annotations

from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.report.bench.naming import Document
from exwarp_cli.report.bench.tables import Table, known_columns, tables_of

SETTINGS = {"slot": "every slot", "key": "the key frames"}
"""Who has G-buffers, by setting."""


def markdown(document: Document) -> str:
    """Write all tables of a benchmark; columns in which nothing was measured are left out."""
    parts = [f"# ExWarp benchmark\n\n{_escaped(about(document))}\n"]
    parts += [_section(table) for table in tables_of(document) if table.rows]
    return "\n".join(parts)


def about(document: Document) -> str:
    """Say in a few sentences what was measured, and on what."""
    sequences = document["sequences"]
    sizes, rates = ({row[key]: None for row in sequences} for key in ("size", "fps"))
    settings = " and ".join(
        text for key, text in SETTINGS.items() if any(row["setting"] == key for row in sequences)
    )
    intervals = sum(row["intervals"] for row in sequences)
    processors = dict.fromkeys(
        f"{row['machine']['processor']}, {row['machine']['cores']} cores" for row in sequences
    )
    unseen = [row for row in sequences if row["policy"]["trained_without_it"]]
    sentences = (
        f"{_counted(len(sequences), 'sequence')} of {', '.join(sizes)} pixels, "
        f"{_counted(intervals, 'key interval')}, "
        + " and ".join(f"{rate:g} to {FACTOR * rate:g}" for rate in rates)
        + f" frames per second, G-buffers for {settings}, ExWarp {document['version']}. "
        f"Run times on {'; '.join(processors)}."
    )
    if unseen:
        names = ", ".join(dict.fromkeys(row["name"] for row in unseen))
        sentences += f" The policy of each scene was trained without it ({names})."
    return sentences


def _counted(count: int, what: str) -> str:
    return f"{count:,} {what}{'' if count == 1 else 's'}"


def _section(table: Table) -> str:
    columns = list(known_columns(table))
    lines = [
        "| " + " | ".join(_escaped(column.title) for column in columns) + " |",
        "|" + "|".join("---:" if column.style else "---" for column in columns) + "|",
    ]
    for row in table.rows:
        lines.append("| " + " | ".join(_escaped(column.text(row)) for column in columns) + " |")
    return f"## {table.title}\n\n{table.note}\n\n" + "\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    """Keep names of files from being taken for marks."""
    for mark in "\\`*_|<>[]&":
        text = text.replace(mark, f"\\{mark}")
    return " ".join(text.split())
