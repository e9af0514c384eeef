"""The files of a benchmark, each written whole or not at all."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from exwarp_cli.accelerator.mac_array import MacArray, schedule
from exwarp_cli.accelerator.mlp import PAPER_SIZES
from exwarp_cli.io.files import atomic_write_text, make_folder, remove_leftovers
from exwarp_cli.pipeline.progress import Progress
from exwarp_cli.report.folder import PAGE_FILE
from exwarp_cli.report.html import render
from exwarp_cli.report.schema import escape_formula, format_csv, to_json
from exwarp_cli.research.bench.bench_document import (
    Document,
    bench_document,
    describe_benchmark,
    feature_points,
    identify,
)
from exwarp_cli.research.bench.bench_page import bench_page, make_albums
from exwarp_cli.research.bench.bench_tables import Row, make_tables
from exwarp_cli.research.bench.benchmark import Benchmark

JSON_FILE, MARKDOWN_FILE = "bench.json", "bench.md"


def write_benchmark(
    folder: Path, benchmark: Benchmark, clock_hz: float, progress: Progress
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
    document = bench_document(benchmark, schedule(MacArray(), PAPER_SIZES), clock_hz)
    for table in make_tables(document):
        text = _format_rows([column.key for column in table.columns], table.rows)
        atomic_write_text(folder / f"{table.name}.csv", text)
    # What Figure 4 draws: a row a slot.
    points = [
        {"scene": row.subject.name, "size": identify(row)["size"], "setting": row.subject.setting}
        | point
        for row in benchmark.measured
        for point in feature_points(row)
    ]
    atomic_write_text(folder / "features.csv", _format_rows(list(points[0]), points))
    atomic_write_text(folder / MARKDOWN_FILE, format_markdown(document))
    progress.message("making frames for the page")
    page = bench_page(benchmark, document, make_albums(benchmark))
    atomic_write_text(folder / PAGE_FILE, render(page))
    # The document last, as it marks a complete benchmark.
    atomic_write_text(folder / JSON_FILE, to_json(document))
    return document


def describe_files(folder: Path) -> list[str]:
    """Say in lines what lies in a benchmark's folder."""
    return [
        f"tables in {folder / MARKDOWN_FILE}, {folder / JSON_FILE} and CSV files beside them",
        f"page to look at: {folder / PAGE_FILE}",
    ]


def _format_rows(header: Sequence[str], rows: Sequence[Row]) -> str:
    cells = ([row.get(key) for key in header] for row in rows)
    escaped = ([escape_formula(c) if isinstance(c, str) else c for c in row] for row in cells)
    return format_csv(header, escaped)


def format_markdown(document: Document) -> str:
    """Write all tables for a wiki page; columns in which nothing was measured are left out."""
    parts = [f"# ExWarp benchmark\n\n{_escape(describe_benchmark(document))}\n"]
    for table in make_tables(document):
        if not table.rows:
            continue
        columns = table.measured_columns()
        lines = [
            "| " + " | ".join(_escape(column.title) for column in columns) + " |",
            "|" + "|".join("---:" if column.style else "---" for column in columns) + "|",
        ]
        for row in table.rows:
            lines.append("| " + " | ".join(_escape(column.text(row)) for column in columns) + " |")
        parts.append(f"## {table.title}\n\n{table.note}\n\n" + "\n".join(lines) + "\n")
    return "\n".join(parts)


def _escape(text: str) -> str:
    """Keep names of files from being taken for marks."""
    for mark in "\\`*_|<>[]&":
        text = text.replace(mark, f"\\{mark}")
    return " ".join(text.split())
