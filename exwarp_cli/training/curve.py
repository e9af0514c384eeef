"""The validation curve of a training, a CSV file with a row a checkpoint."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

from exwarp_cli.io.atomic import atomic_path

CURVE = "curve.csv"
COLUMNS = ("step", "seconds", "loss", "rate", "gain_db", "gain_holes_db")


def add_row(path: Path, step: int, values: Sequence[float]) -> None:
    """Add a row for a step; rows from that step on are of a broken run, and removed.

    Parameters
    ----------
    path
        Of the file; made where there is none.
    step
        First of `COLUMNS`.
    values
        Of the others; integers as they are, else with five digits.
    """
    rows = [row for row in _rows(path) if int(row["step"]) < step]
    formatted = (str(v) if isinstance(v, int) else f"{v:.5g}" for v in (step, *values))
    rows.append(dict(zip(COLUMNS, formatted, strict=True)))
    with atomic_path(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def last_row(path: Path) -> dict[str, float]:
    """Return the numbers of the last row by their columns; `step` and `seconds` are whole."""
    row = _rows(path)[-1]
    return {name: _number(row[name]) for name in COLUMNS}


def _rows(path: Path) -> list[dict[str, str]]:
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _number(text: str) -> float:
    return int(text) if text.isdigit() else float(text)
