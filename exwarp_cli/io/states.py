"""States of the predictor as tables hold them: 44 integers in one cell of a CSV file."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from exwarp_cli.errors import DamagedFileError, InputError, LayoutError

COLUMN = "inputs"
"""Column of the states: Q16.16 integers with spaces between."""

IDENTITY = ("frame", "key", "slot", "node")
"""Columns that tell which decision a row is of, where they are there."""

_INT32 = np.iinfo(np.int32)


@dataclass(frozen=True)
class StateRow:
    """A row with a state.

    Attributes
    ----------
    row
        Number of the row, from 1; the header does not count.
    line
        Of the file, from 1.
    identity
        What the columns of `IDENTITY` hold, by their names.
    state
        int32 [n] in Q16.16.
    """

    row: int
    line: int
    identity: dict[str, str]
    state: npt.NDArray[np.int32]


def read_states(path: Path, size: int) -> tuple[StateRow, ...]:
    """Read the rows of a CSV file that hold a state; rows whose cell is empty are left out.

    Parameters
    ----------
    path
        As ``exwarp upsample --report`` and ``exwarp features`` write it: UTF-8, with a header.
    size
        Numbers in a state.

    Raises
    ------
    InputError
        When the file cannot be read.
    LayoutError
        When there is no column `COLUMN`, no state, or a cell holds something else.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = tuple(_rows(path, csv.DictReader(file), size))
    except OSError as error:
        raise InputError(
            f"cannot read {path}: {error.strerror}; check the path and its rights"
        ) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise DamagedFileError(
            f"{path} is no CSV file in UTF-8 ({error}); give a table with a column '{COLUMN}'"
        ) from error
    if not rows:
        raise LayoutError(
            f"{path} has no row with '{COLUMN}'; give one of a run with a learned policy"
        )
    return rows


def _rows(path: Path, table: csv.DictReader[str], size: int) -> Iterator[StateRow]:
    columns = table.fieldnames or []
    if COLUMN not in columns:
        raise LayoutError(
            f"{path} has no column '{COLUMN}'; give a table of exwarp features, or frames.csv of a "
            "run with a learned policy"
        )
    for number, cells in enumerate(table, 1):
        text: Any = cells[COLUMN]
        if text and text.strip():
            state = _state(f"{path}, line {table.line_num}", text, size)
            identity = {name: cells[name] or "" for name in IDENTITY if name in columns}
            yield StateRow(number, table.line_num, identity, state)


def _state(where: str, text: str, size: int) -> npt.NDArray[np.int32]:
    """Read one cell."""
    words = text.split()
    if len(words) != size:
        raise LayoutError(
            f"{where}: '{COLUMN}' holds {len(words)} numbers, and the policy takes {size}; give "
            "the row as it was written"
        )
    for word in words:
        # Not int() alone, which also takes 1_000 and digits of other scripts, and any length.
        plain = len(word) <= 11 and word.isascii() and word.lstrip("-").isdigit()
        if not plain or word.count("-") > 1 or not _INT32.min <= int(word) <= _INT32.max:
            raise LayoutError(
                f"{where}: {word[:20]!r} in '{COLUMN}' is no 32-bit integer; give Q16.16 numbers, "
                "65536 for 1"
            )
    return np.array([int(word) for word in words], np.int32)
