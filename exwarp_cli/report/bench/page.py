"""The page of a benchmark: the paper's tables and figures, and frames to look at."""

from __future__ import annotations

from collections.abc import Sequence

from exwarp_cli.domain.bench import CHOOSERS
from exwarp_cli.pipeline.bench.work import Benchmark
from exwarp_cli.report.bench import figures
from exwarp_cli.report.bench.columns import PAPER, SOURCE, WHAT, Column, Row
from exwarp_cli.report.bench.figures import labels_of
from exwarp_cli.report.bench.markdown import about
from exwarp_cli.report.bench.naming import Document
from exwarp_cli.report.bench.tables import Table as Rows
from exwarp_cli.report.bench.tables import known_columns, tables_of
from exwarp_cli.report.gallery import Album
from exwarp_cli.report.page import Block, Number, Page, Section, Table, Text, Viewer
from exwarp_cli.report.page_parts import percent, time_text
from exwarp_cli.report.quality import mean

SECTIONS = {
    "Saved": ("render_time",),
    "Quality": ("comparison",),
    "Paths": ("paths_psnr", "paths_ssim"),
    "Decisions": ("decisions",),
    "Rate": ("fps",),
    "Real time": (
        "real_time_fps",
        "real_time_paths",
        "real_time_decisions",
        "real_time_slots",
    ),
    "Holes": ("holes",),
    "Features": ("correlation",),
    "Run time": ("runtime",),
    "Predictor": ("predictor",),
    "ExtraNet": ("extranet",),
}
"""Tables by section, what a farm asks first before what the paper shows. Without a clock there is
none of "Real time"."""

FIGURES = {
    "comparison": figures.compared,
    "paths_psnr": figures.paths,
    "decisions": figures.decisions,
    "fps": figures.fps,
    "real_time_fps": figures.clocked_fps,
    "real_time_decisions": figures.clocked_decisions,
    "real_time_slots": figures.clocked_slots,
    "holes": figures.holes,
    "runtime": figures.runtime,
}

HEADLINE = (("exwarp", "ExWarp"), ("s6", "warping alone"), ("softsplat", "look-ahead"))
"""Systems of the headline; the first that was timed stands for what is saved."""


def bench_page(found: Benchmark, document: Document, albums: Sequence[Album]) -> Page:
    """Lay a benchmark out as a page."""
    tables = {table.name: table for table in tables_of(document)}
    sections = []
    for title, names in SECTIONS.items():
        shown = [tables[name] for name in names if name in tables]
        if not shown:
            continue
        blocks = [block for table in shown for block in _blocks(found, document, table)]
        sections.append(Section(title.lower().replace(" ", "-"), title, blocks))
    return Page(
        "ExWarp benchmark",
        about(document),
        _numbers(document),
        [sections[0], _frames(document, albums), *sections[1:]],
    )


def _frames(document: Document, albums: Sequence[Album]) -> Section:
    """Show an album of each sequence, with its name above where there are several."""
    blocks: list[Block] = []
    for i, (label, album) in enumerate(zip(labels_of(document), albums, strict=True)):
        if album.frames:
            blocks += [Text(label)] if len(albums) > 1 else []
            blocks.append(Viewer(album, f"viewer-{i}"))
    return Section("frames", "Frames", blocks)


def _blocks(found: Benchmark, document: Document, table: Rows) -> list[Block]:
    """Return a table as the page takes it, with its figure before."""
    if not table.rows:
        return []
    blocks: list[Block] = []
    if table.name in FIGURES and (figure := FIGURES[table.name](document)) is not None:
        blocks.append(figure)
    if table.name == "correlation":
        blocks.append(figures.scattered(found))
    names = labels_of(document)
    if table.name not in LONG or len(names) == 1:
        return [*blocks, _table(table.title, table, table.rows, table.note)]
    groups = _groups(table)
    blocks.append(Text(f"{table.title}. {table.note}"))
    return blocks + [_table(n, table, rows) for n, rows in zip(names, groups, strict=True)]


LONG = ("comparison", "extranet", "real_time_slots")
"""Tables with a row for each sequence and system: one a sequence."""


def _groups(table: Rows) -> list[list[Row]]:
    """Return the rows of each sequence; the paper's follow those that they stand beside."""
    groups: list[list[Row]] = []
    before = None
    for row in table.rows:
        what = tuple(row[column.key] for column in WHAT)
        if row.get(SOURCE.key) != PAPER and what != before:
            groups.append([])
            before = what
        groups[-1].append(row)
    return groups


def _table(title: str, table: Rows, rows: Sequence[Row], note: str = "") -> Table:
    columns = _shown_columns(table, rows)
    cells = [[None if row.get(c.key) is None else c.text(row) for c in columns] for row in rows]
    return Table(title, [column.title for column in columns], cells, note)


def _shown_columns(table: Rows, rows: Sequence[Row]) -> list[Column]:
    """Leave out columns that say the same of all rows: the subtitle has it, or the title.

    Rows still begin with a name: that of the sequence, or where it is left out, of the system.
    """
    by_system = any(column.key == "system" for column in table.columns)
    spare = {column.key for column in (*WHAT, SOURCE)} - (set() if by_system else {WHAT[0].key})
    return [
        column
        for column in known_columns(table)
        if column.key not in spare or len({row.get(column.key) for row in rows} - {None}) > 1
    ]


def _numbers(document: Document) -> list[Number]:
    """Return the headline: what is saved first, then means over the sequences."""
    rows = document["comparison"]
    found = _saved(document)
    for name, label in HEADLINE:
        known = [row["systems"][name] for row in rows if name in row["systems"]]
        psnr, ssim = (mean(values[key] for values in known) for key in ("psnr_db", "ssim"))
        if psnr is not None and ssim is not None:
            found.append(Number(f"PSNR, {label}", f"{psnr:.2f} dB", f"SSIM {ssim:.3f}"))
    known = [row for row in document["fps"] if CHOOSERS[0] in row["effective"]]
    rate = mean(row["effective"][CHOOSERS[0]] for row in known)
    if rate is not None:
        base = mean(row["base"] for row in known)
        found.append(Number("Effective rate", f"{rate:.1f} fps", f"ExWarp, from {base:g}"))
    count = sum(row["intervals"] for row in document["sequences"])
    return [*found, Number("Sequences", str(len(rows)), f"{count:,} key intervals")]


def _saved(document: Document) -> list[Number]:
    """Return what was saved against rendering, where headers state how long that took."""
    rows = [row for row in document["render_time"] if row["saved_share"] is not None]
    for name, label in HEADLINE:
        known = [row for row in rows if name in row["saved_share"]]
        if not known:
            continue
        share = mean(row["saved_share"][name] for row in known)
        rendered = mean(row["key_frame_s"] for row in known)
        made = mean(row["generated_frame_s"][name] for row in known)
        return [
            Number("Render time saved", str(percent(share)), f"{label}, of rendering all frames"),
            Number("Rendered frame", str(time_text(rendered)), "by the headers, on average"),
            Number("Generated frame", str(time_text(made)), f"{label}, files apart"),
        ]
    return []
