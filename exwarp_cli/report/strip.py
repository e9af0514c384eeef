"""The strip of decisions: a row a slot, a column a key interval, a coloured cell each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import escape

from exwarp_cli.report.plot_style import Figure, Labels, kind_role, opening

COLUMNS = 600
"""Columns at most; more intervals share one."""

LEFT, WIDTH, ROW, LEGEND = 46, 520, 22, 18


@dataclass(frozen=True)
class Cell:
    """What stands in one cell: a kind out of `plots.KINDS`, and the text shown on hover."""

    kind: str
    hint: str


def strip(
    labels: Labels,
    rows: Sequence[str],
    columns: Sequence[Sequence[Cell | None]],
    kinds: Sequence[str],
) -> Figure:
    """Draw coloured cells.

    Parameters
    ----------
    rows
        Names of the rows, from the top.
    columns
        For each column a cell a row; None stays empty. Of more than COLUMNS, neighbours share a
        column: its colour is the most frequent, and its hint counts the others.
    kinds
        The kinds that appear, for the legend.
    """
    merged = _merged(columns, len(rows))
    step = WIDTH / max(len(merged), 1)
    height = ROW * len(rows)
    parts = [opening(f"0 0 {LEFT + WIDTH} {height + LEGEND}", labels), _legend(kinds, height)]
    for r, name in enumerate(rows):
        y = r * ROW
        parts.append(
            f'<text class="name" x="{LEFT - 6}" y="{y + ROW * 0.68:g}">{escape(name)}</text>'
        )
        for c, column in enumerate(merged):
            cell = column[r]
            if cell is not None:
                gap = 0.6 if step > 3 else 0
                parts.append(
                    f'<rect x="{LEFT + c * step:.2f}" y="{y + 1}" width="{step - gap:.2f}" '
                    f'height="{ROW - 2}" class="k-{kind_role(cell.kind)}">'
                    f"<title>{escape(cell.hint)}</title></rect>"
                )
    return Figure(labels, "".join(parts) + "</svg>")


def _legend(kinds: Sequence[str], top: int) -> str:
    """Return a square and a word for each kind, below the cells."""
    parts, x = [], LEFT
    for kind in kinds:
        parts.append(
            f'<rect x="{x}" y="{top + 6}" width="9" height="9" class="k-{kind_role(kind)}"/>'
            f'<text class="word" x="{x + 13}" y="{top + 14}">{escape(kind)}</text>'
        )
        x += 26 + 6 * len(kind)
    return "".join(parts)


def _merged(columns: Sequence[Sequence[Cell | None]], rows: int) -> list[Sequence[Cell | None]]:
    if len(columns) <= COLUMNS:
        return list(columns)
    found: list[Sequence[Cell | None]] = []
    for i in range(COLUMNS):
        some = columns[i * len(columns) // COLUMNS : (i + 1) * len(columns) // COLUMNS]
        found.append([_most([column[r] for column in some]) for r in range(rows)])
    return found


def _most(cells: Sequence[Cell | None]) -> Cell | None:
    known = [cell for cell in cells if cell is not None]
    if not known:
        return None
    counts = Counter(cell.kind for cell in known).most_common()
    kinds = ", ".join(f"{kind} {count}" for kind, count in counts)
    return Cell(counts[0][0], f"{known[0].hint} and {len(known) - 1} more: {kinds}")
