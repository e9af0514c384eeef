"""The files of a benchmark, each written whole or not at all: tables, and a page with figures.

The page has the paper's tables and figures, and frames of each sequence.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from exwarp_cli.accelerator.mac_array import MacArray, schedule
from exwarp_cli.accelerator.mlp import PAPER_SIZES
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.io.files import atomic_write_text, make_folder, remove_leftovers
from exwarp_cli.pipeline.progress import Progress
from exwarp_cli.report.folder import PAGE_FILE
from exwarp_cli.report.gallery import BUDGET, PICTURE_BYTES, TRUTH, Album
from exwarp_cli.report.html import Block, Number, Page, Section, Table, render
from exwarp_cli.report.schema import escape_formula, format_csv, mean, to_json
from exwarp_cli.report.sentences import format_percent, format_time
from exwarp_cli.research.bench import bench_tables
from exwarp_cli.research.bench.bench_document import (
    Document,
    bench_document,
    describe_benchmark,
    feature_points,
    identify,
)
from exwarp_cli.research.bench.bench_figures import draw_features, draw_figure, sequence_labels
from exwarp_cli.research.bench.benchmark import Benchmark, Measured
from exwarp_cli.research.bench.subjects import OpenedSubject, SystemFrames
from exwarp_cli.research.bench.systems import CHOOSERS, FIXED_PATHS, POLICY, SLOTS, pictures_of

JSON_FILE, MARKDOWN_FILE = "bench.json", "bench.md"

# Tables by section: what a farm asks first before what the paper shows.
SECTIONS = {
    "Saved": ("render_time",),
    "Quality": ("comparison",),
    "Paths": ("paths_psnr", "paths_ssim"),
    "Decisions": ("decisions",),
    "Rate": ("fps",),
    "Real time": (  # only with a clock
        *("real_time_fps", "real_time_paths", "real_time_decisions", "real_time_slots"),
    ),
    "Holes": ("holes",),
    "Features": ("correlation",),
    "Run time": ("runtime",),
    "Predictor": ("predictor",),
    "ExtraNet": ("extranet",),
}

# Tables with a row for each sequence and system: one a sequence.
LONG = ("comparison", "extranet", "real_time_slots")

# Systems of the headline; the first that was timed stands for what is saved.
HEADLINE = ((POLICY, "ExWarp"), ("s6", "warping alone"), ("softsplat", "look-ahead"))

# Systems whose frames are shown, with all that options add.
PICTURED = (POLICY, "s6", "softsplat", "minterpolate", "hold")


def write_benchmark(
    folder: Path, benchmark: Benchmark, clock_hz: float, progress: Progress
) -> Document:
    """Write bench.json, bench.md, a CSV file a table, and the page; return what bench.json holds.

    OutputError: a file cannot be written.
    """
    make_folder(folder)
    remove_leftovers(folder)
    document = bench_document(benchmark, schedule(MacArray(), PAPER_SIZES), clock_hz)
    # What Figure 4 draws: a row a slot.
    points = [
        {"scene": row.subject.name, "size": identify(row)["size"], "setting": row.subject.setting}
        | point
        for row in benchmark.measured
        for point in feature_points(row)
    ]
    files = {
        table.name: ([column.key for column in table.columns], table.rows)
        for table in bench_tables.make_tables(document)
    }
    files["features"] = (list(points[0]), tuple(points))
    for name, (header, rows) in files.items():
        cells = ([row.get(key) for key in header] for row in rows)
        escaped = ([escape_formula(c) if isinstance(c, str) else c for c in row] for row in cells)
        atomic_write_text(folder / f"{name}.csv", format_csv(header, escaped))
    atomic_write_text(folder / MARKDOWN_FILE, format_markdown(document))
    progress.message("making frames for the page")
    page = bench_page(benchmark, document, _make_albums(benchmark))
    atomic_write_text(folder / PAGE_FILE, render(page))
    # The document last, as it marks a complete benchmark.
    atomic_write_text(folder / JSON_FILE, to_json(document))
    return document


def format_markdown(document: Document) -> str:
    """Write all tables for a wiki page; columns in which nothing was measured are left out."""
    parts = [f"# ExWarp benchmark\n\n{_escape(describe_benchmark(document))}\n"]
    for table in bench_tables.make_tables(document):
        if not table.rows:
            continue
        columns = table.measured_columns
        lines = [
            "| " + " | ".join(_escape(column.title) for column in columns) + " |",
            "|" + "|".join("---:" if column.style else "---" for column in columns) + "|",
        ]
        for row in table.rows:
            cells = (_escape(column.text(row) or bench_tables.NOTHING) for column in columns)
            lines.append("| " + " | ".join(cells) + " |")
        parts.append(f"## {table.title}\n\n{table.note}\n\n" + "\n".join(lines) + "\n")
    return "\n".join(parts)


def _escape(text: str) -> str:
    """Keep names of files from being taken for marks."""
    for mark in "\\`*_|<>[]&":
        text = text.replace(mark, f"\\{mark}")
    return " ".join(text.split())


def bench_page(benchmark: Benchmark, document: Document, albums: Sequence[Album]) -> Page:
    """Lay a benchmark out as a page; `albums` are those of its sequences."""
    tables = {table.name: table for table in bench_tables.make_tables(document)}
    sections = []
    for title, names in SECTIONS.items():
        shown = (tables[name] for name in names if name in tables)
        blocks = [block for table in shown for block in _blocks(benchmark, document, table)]
        sections.append(Section(title.lower().replace(" ", "-"), title, blocks))
    viewers: list[Block] = []
    for i, (label, album) in enumerate(zip(sequence_labels(document), albums, strict=True)):
        if album.frames:
            album.viewer = f"viewer-{i}"
            viewers += [label, album] if len(albums) > 1 else [album]
    return Page(
        "ExWarp benchmark",
        describe_benchmark(document),
        _numbers(document),
        [sections[0], Section("frames", "Frames", viewers), *sections[1:]],
    )


def _blocks(
    benchmark: Benchmark, document: Document, table: bench_tables.BenchTable
) -> list[Block]:
    """Return a table as the page takes it, with its figure before."""
    if not table.rows:
        return []
    blocks: list[Block] = []
    labels = sequence_labels(document)
    if (figure := draw_figure(table, labels)) is not None:
        blocks.append(figure)
    if table.name == "correlation":
        blocks.append(draw_features(benchmark))
    parts = [(table.title, table.rows, table.note)]
    if table.name in LONG and len(labels) > 1:
        blocks.append(f"{table.title}. {table.note}")
        groups = zip(labels, table.by_sequence(), strict=True)
        parts = [(name, tuple(rows), "") for name, rows in groups]
    # Columns that are equal in all rows are left out, as titles have these. Rows still begin with a
    # name: that of the sequence, or where it is left out, of the system.
    spare = {column.key for column in (*bench_tables.SEQUENCE, bench_tables.SOURCE)}
    if not any(column.key == "system" for column in table.columns):
        spare.remove(bench_tables.SEQUENCE[0].key)
    for title, rows, note in parts:
        columns = [
            column
            for column in table.measured_columns
            if column.key not in spare or len({row.get(column.key) for row in rows} - {None}) > 1
        ]
        cells = [[column.text(row) for column in columns] for row in rows]
        blocks.append(Table(title, [column.title for column in columns], cells, note))
    return blocks


def _numbers(document: Document) -> list[Number]:
    """Return the headline: what is saved first, then means over the sequences.

    What is saved against rendering is there where headers state how long that took.
    """
    rows, numbers = document["comparison"], []
    for name, label in HEADLINE:
        timed = [row for row in document["render_time"] if name in (row["saved_share"] or {})]
        if timed:
            share = format_percent(mean(row["saved_share"][name] for row in timed) or 0.0)
            rendered = format_time(mean(row["key_frame_s"] for row in timed))
            generated = format_time(mean(row["generated_frame_s"][name] for row in timed))
            numbers += [
                Number("Render time saved", share, f"{label}, of rendering all frames"),
                Number("Rendered frame", str(rendered), "by the headers, on average"),
                Number("Generated frame", str(generated), f"{label}, files apart"),
            ]
            break
    for name, label in HEADLINE:
        systems = [row["systems"][name] for row in rows if name in row["systems"]]
        psnr, ssim = (mean(system[key] for system in systems) for key in ("psnr_db", "ssim"))
        if psnr is not None and ssim is not None:
            numbers.append(Number(f"PSNR, {label}", f"{psnr:.2f} dB", f"SSIM {ssim:.3f}"))
    rated = [row for row in document["fps"] if POLICY in row["effective"]]
    rate = mean(row["effective"][POLICY] for row in rated)
    if rate is not None:
        base = mean(row["base"] for row in rated)
        numbers.append(Number("Effective rate", f"{rate:.1f} fps", f"ExWarp, from {base:g}"))
    count = sum(row["intervals"] for row in document["sequences"])
    return [*numbers, Number("Sequences", str(len(rows)), f"{count:,} key intervals")]


def _make_albums(benchmark: Benchmark) -> list[Album]:
    """Return an album for each subject: a usual and a bad key interval, made once more.

    They have the median and the worst PSNR of the first system that is shown.
    """
    extra = [name for name in benchmark.systems if name not in benchmark.settings.systems]
    systems = [name for name in PICTURED if name in benchmark.systems] + extra
    chosen: list[list[int]] = []
    for row in benchmark.measured:
        numbers: set[int] = set()
        if systems:
            quality = {
                part["key"]: sum(frame["all"]["psnr_db"] for frame in part["systems"][systems[0]])
                for part in row.parts
            }
            ranked = sorted(quality, key=lambda number: quality[number])
            numbers = {ranked[0], ranked[len(ranked) // 2]}
        chosen.append(sorted(numbers))
    # A picture and an error for each system, half as large, and the truth, at three slots.
    pictures = sum(map(len, chosen)) * len(SLOTS) * (1.5 * len(systems) + 1)
    room = min(PICTURE_BYTES, int(BUDGET / max(pictures, 1)))
    subjects = zip(benchmark.measured, benchmark.opened, chosen, strict=True)
    return [_make_album(row, opened, keys, systems, room) for row, opened, keys in subjects]


def _make_album(
    row: Measured, opened: OpenedSubject, keys: Sequence[int], systems: Sequence[str], room: int
) -> Album:
    """Return an album of some key frames, by their numbers; `room` is in bytes a picture."""
    album = Album((*systems, TRUTH), next(iter(systems), TRUTH), TRUTH, room)
    parts = {part["key"]: part for part in row.parts}
    for number in keys:
        key, part = opened.numbers.index(number), parts[number]
        inputs = opened.reader.read(key)
        interval = opened.builder.build(inputs)
        frames, masks = SystemFrames(opened, inputs, interval), opened.masks(interval)
        truth, paths = opened.truth(key), FIXED_PATHS | part["paths"]
        shown = {
            name: pictures_of(name, paths.get(name))
            for name in systems
            if name not in CHOOSERS or name in paths
        }
        for slot in SLOTS:
            sources = {name: frames[pictures[slot - 1]] for name, pictures in shown.items()}
            frame = opened.source.timeline.number(Slot(key, slot))
            album.add(frame, "blend", sources | {TRUTH: truth[slot]}, TRUTH, masks.get(slot))
            # Named after what made the frame of the learned policy, where that was measured.
            chosen = part["systems"].get(POLICY)
            maker = "blend" if chosen is None else str(chosen[slot - 1]["made_by"])
            facts = {"slot": f"{slot} after key frame {number}"}
            if path := part["paths"].get(POLICY):
                facts["path"] = path
            for name in systems:
                psnr = part["systems"][name][slot - 1]["all"]["psnr_db"]
                facts[f"PSNR {name}"] = f"{psnr:.2f} dB"
            if (hole := part["holes"][slot - 1]) is not None:
                facts["holes"] = f"{hole:.1%}"
            album.set_facts(frame, maker, facts)
        opened.restart()
    return album
