"""The page of a benchmark: the paper's tables and figures, and frames to look at."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from exwarp_cli.domain.decision import PATHS
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.pipeline.bench.work import Benchmark
from exwarp_cli.report.bench.document import EFFECTIVE, Document, feature_points
from exwarp_cli.report.bench.markdown import about
from exwarp_cli.report.bench.tables import Table as Rows
from exwarp_cli.report.bench.tables import known_columns, tables_of
from exwarp_cli.report.gallery import Album
from exwarp_cli.report.page import Block, Number, Page, Section, Table, Text, Viewer
from exwarp_cli.report.plot_style import Figure, Labels
from exwarp_cli.report.plots import Panel, bars, scatter, stacked_bars
from exwarp_cli.report.quality import mean

PATH_NAMES = tuple(path.lower() for path in PATHS)

COMPARED = ("exwarp", "s1", "s6", "softsplat", "minterpolate")
"""Systems in the figure of Table VII."""


def bench_page(found: Benchmark, document: Document, albums: Sequence[Album]) -> Page:
    """Lay a benchmark out as a page."""
    tables = {table.name: table for table in tables_of(document)}
    figures = {
        "runtime": _runtime,
        "holes": _holes,
        "paths_psnr": _paths,
        "comparison": _compared,
        "fps": _fps,
        "decisions": _decisions,
    }
    viewers = [
        Section(f"frames-{i}", f"Frames of {label}", [Viewer(album, f"viewer-{i}")])
        for i, (label, album) in enumerate(zip(_labels(document), albums, strict=True))
        if album.frames
    ]
    sections = []
    for name, table in tables.items():
        blocks: list[Block] = [figures[name](document)] if name in figures else []
        if name == "correlation":
            blocks.append(_scattered(found))
        sections.append(Section(name.replace("_", "-"), table.title, [*blocks, *_blocks(table)]))
    return Page("ExWarp benchmark", about(document), _numbers(document), [*sections, *viewers])


def _labels(document: Document) -> list[str]:
    """Name the sequences; size and setting only where they differ."""
    rows = document["sequences"]
    sizes, settings = ({row[key] for row in rows} for key in ("size", "setting"))
    return [
        " ".join(
            [row["name"]]
            + ([row["size"]] if len(sizes) > 1 else [])
            + ([row["setting"]] if len(settings) > 1 else [])
        )
        for row in rows
    ]


def _blocks(table: Rows) -> list[Block]:
    """Return a table as the page takes it, with its note above."""
    columns = list(known_columns(table))
    rows = [
        [None if row.get(c.key) is None else c.text(row) for c in columns] for row in table.rows
    ]
    return [Text(table.note), Table("", [column.title for column in columns], rows)]


def _numbers(document: Document) -> list[Number]:
    """Return the headline: means over the sequences."""
    rows = document["comparison"]
    found = [Number("sequences", str(len(rows)))]
    for name, label in (("exwarp", "ExWarp"), ("s6", "warping alone"), ("softsplat", "look-ahead")):
        known = [row["systems"][name] for row in rows if name in row["systems"]]
        psnr = mean(v["psnr_db"] for v in known)
        if psnr is not None:
            ssim = mean(v["ssim"] for v in known)
            found.append(Number(f"PSNR, {label}", f"{psnr:.2f} dB", f"SSIM {ssim:.3f}"))
    rates = [row["effective"]["exwarp"] for row in document["fps"] if "exwarp" in row["effective"]]
    if rates:
        base = document["fps"][0]["base"]
        found.append(Number("effective rate", f"{mean(rates):.1f} fps", f"from {base:g}"))
    faster = [
        row["times_faster"]["exwarp"]
        for row in document["render_time"]
        if row["times_faster"] and "exwarp" in row["times_faster"]
    ]
    if faster:
        found.append(Number("against rendering", f"{mean(faster):,.0f} x", "faster, files apart"))
    return found


def _runtime(document: Document) -> Figure:
    keys = {"warping": "warping_ms", "hole marking": "hole_marking_ms", "network": "inference_ms"}
    labels = Labels(
        "Run time of a frame", "ms", description="Milliseconds of each step of the work."
    )
    parts = {name: [row[key] for row in document["runtime"]] for name, key in keys.items()}
    return stacked_bars(labels, _labels(document), parts)


def _holes(document: Document) -> Figure:
    rows = [
        (label, row)
        for label, row in zip(_labels(document), document["holes"], strict=True)
        if row["histogram"]
    ]
    edges = rows[0][1]["histogram"]["edges"] if rows else [0.0, 1.0]
    groups = [f"{low:.0%}-{high:.0%}" for low, high in pairwise(edges)]
    shares = {
        label: [
            100 * count / sum(row["histogram"]["counts"]) for count in row["histogram"]["counts"]
        ]
        for label, row in rows
    }
    labels = Labels(
        "Holes of warped frames", "share of the frame that is unseen", "% of the frames",
        "How many frames have how many holes.",
    )  # fmt: skip
    return bars(labels, groups, shares)


def _scattered(found: Benchmark) -> Figure:
    points = [point for one in found.measured for point in feature_points(one)]
    psnr = [point["warp_psnr_db"] for point in points]
    labels = Labels(
        "Features and the quality of W", y="PSNR of W, dB",
        description="Each feature against the PSNR of warped frames, a point a slot.",
    )  # fmt: skip
    return scatter(
        labels, [Panel(name, [point[name] for point in points], psnr) for name in EFFECTIVE]
    )


def _paths(document: Document) -> Figure:
    systems = (*PATH_NAMES, "exwarp")
    rows = document["quality"]
    labels = Labels(
        "PSNR of every decision path", "", "PSNR, dB",
        "Mean PSNR of slots 1 to 3; a line across a bar is the paper's figure.",
    )  # fmt: skip
    return bars(
        labels,
        _labels(document),
        {s: [_psnr(row["systems"].get(s)) for row in rows] for s in systems},
        {
            s: [row["paper"][s]["psnr_db"] if row["paper"] else None for row in rows]
            for s in systems
        },
    )


def _psnr(system: dict[str, Any] | None) -> float | None:
    return None if system is None else system["all"]["psnr_db"]


def _compared(document: Document) -> Figure:
    rows = document["comparison"]
    known = [name for name in rows[0]["systems"] if name in COMPARED or ":" in name]
    labels = Labels("Causal and look-ahead systems", "", "PSNR, dB", "Mean PSNR of slots 1 to 3.")
    values = {n: [row["systems"].get(n, {}).get("psnr_db") for row in rows] for n in known}
    return bars(labels, _labels(document), values)


def _fps(document: Document) -> Figure:
    rows = document["fps"]
    names = [name for name in ("exwarp", "s1", "s2", "s3") if name in rows[0]["effective"]]
    labels = Labels(
        "Effective rate", "", "frames per second",
        f"Base rate and new frames; at most {FACTOR} times the base rate.",
    )  # fmt: skip
    return bars(
        labels, _labels(document), {n: [row["effective"].get(n) for row in rows] for n in names}
    )


def _decisions(document: Document) -> Figure:
    rows = document["decisions"]
    shares = [row.get("exwarp", {}).get("warp_share") for row in rows]
    labels = Labels(
        "Decisions of the policy", "% of the decisions",
        description="Share of warping and of extrapolating among all decisions.",
    )  # fmt: skip
    parts = {
        "warp": [None if share is None else 100 * share for share in shares],
        "extrapolate": [None if share is None else 100 * (1 - share) for share in shares],
    }
    return stacked_bars(labels, _labels(document), parts, kinds=True)
