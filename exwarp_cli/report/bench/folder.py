"""The files of a benchmark, each written whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from exwarp_cli.accelerator.mac_array import MacArray, schedule
from exwarp_cli.accelerator.mlp import PAPER_SIZES
from exwarp_cli.io.atomic import atomic_write_text, make_folder, remove_leftovers
from exwarp_cli.pipeline.bench.work import Benchmark
from exwarp_cli.pipeline.progress import Progress
from exwarp_cli.report.bench.album import albums
from exwarp_cli.report.bench.choices import feature_points
from exwarp_cli.report.bench.document import document
from exwarp_cli.report.bench.markdown import markdown
from exwarp_cli.report.bench.naming import Document, identify
from exwarp_cli.report.bench.page import bench_page
from exwarp_cli.report.bench.tables import tables_of
from exwarp_cli.report.folder import PAGE_FILE
from exwarp_cli.report.frames_csv import name_cell, table
from exwarp_cli.report.page import render
from exwarp_cli.report.summary import to_json

JSON_FILE, MARKDOWN_FILE = "bench.json", "bench.md"


def write_benchmark(
    folder: Path, found: Benchmark, clock_hz: float, progress: Progress
) -> Document:
    """Write bench.json, bench.md, a CSV file a table, and the page.

    Returns
    -------
    dict
        What bench.json holds.

    Raises
    ------
    OutputError
        When a file cannot be written.
    """
    make_folder(folder)
    remove_leftovers(folder)
    plain = document(found, schedule(MacArray(), PAPER_SIZES), clock_hz)
    for one in tables_of(plain):
        header = [column.key for column in one.columns]
        rows = ([_cell(row.get(key)) for key in header] for row in one.rows)
        atomic_write_text(folder / f"{one.name}.csv", table(header, rows))
    atomic_write_text(folder / "features.csv", _points(found))
    atomic_write_text(folder / MARKDOWN_FILE, markdown(plain))
    progress.message("making frames for the page")
    atomic_write_text(folder / PAGE_FILE, render(bench_page(found, plain, albums(found))))
    # The document last: who sees it then finds what belongs to it.
    atomic_write_text(folder / JSON_FILE, to_json(plain))
    return plain


def what_is_where(folder: Path) -> list[str]:
    """Tell the user in lines what lies in a benchmark's folder."""
    return [
        f"tables in {folder / MARKDOWN_FILE}, {folder / JSON_FILE} and CSV files beside them",
        f"page to look at: {folder / PAGE_FILE}",
    ]


def _points(found: Benchmark) -> str:
    """Write what Figure 4 draws as CSV: a row a slot."""
    rows = [
        {"scene": row["name"], "size": row["size"], "setting": row["setting"], **point}
        for one in found.measured
        for row in (identify(one),)
        for point in feature_points(one)
    ]
    header = list(rows[0])
    return table(header, ([_cell(row[key]) for key in header] for row in rows))


def _cell(value: Any) -> Any:
    return name_cell(value) if isinstance(value, str) else value
