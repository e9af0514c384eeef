"""The figures of a benchmark's page; None where nothing of a figure was measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from exwarp_cli.domain.decision import EXTRAPOLATE, WARP
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.report.plots import Figure, Labels, draw_bars, draw_scatter, draw_stacked_bars
from exwarp_cli.research.bench import bench_document
from exwarp_cli.research.bench.bench_tables import PAPER, SLOT_KINDS, SOURCE, BenchTable
from exwarp_cli.research.bench.benchmark import Benchmark
from exwarp_cli.research.bench.systems import BEST_RETURN, CHOOSERS, FIXED, POLICY, SYSTEMS

# Systems in the figures of the effective rate.
RATED = (POLICY, "s1", "s2", "s3")

# Holes of so many sequences, at most, are drawn as bars beside each other, with these labels.
MAX_BARS = 3
FEW_HOLES = Labels("Holes of warped frames", "share of the frame that is unseen", "% of the frames")


@dataclass(frozen=True)
class BenchFigure:
    """What is drawn of a table: bars for each sequence, or a single bar of stacked parts."""

    labels: Labels
    # Keys of the columns by their names in the figure; "" stands for the names of the systems.
    columns: Mapping[str, str]
    # If each system has a row, the systems that are drawn; all that options add are drawn, too.
    systems: tuple[str, ...] = ()
    is_stacked: bool = False
    kinds: bool = False  # parts are named and coloured by what makes a frame


# By the name of the table that follows.
FIGURES = {
    "comparison": BenchFigure(
        Labels("Causal and look-ahead systems", "", "PSNR dB", "Mean PSNR of slots 1 to 3."),
        {"": "psnr_db"},
        ("exwarp", "s1", "s6", "softsplat", "minterpolate"),
    ),
    "paths_psnr": BenchFigure(
        Labels(
            "PSNR of every decision path", "", "PSNR dB",
            "Mean PSNR of slots 1 to 3; a line across a bar is the paper's figure.",
        ),
        {name: name for name in (*FIXED, POLICY)},
    ),
    "decisions": BenchFigure(
        Labels(
            "Decisions of the policy", "% of the decisions",
            description="Share of warping and of extrapolating among all decisions.",
        ),
        {kind: kind for kind in (WARP, EXTRAPOLATE)}, (POLICY,), is_stacked=True, kinds=True,
    ),
    "fps": BenchFigure(
        Labels(
            "Effective rate", "", "frames per second",
            f"Base rate and new frames; at most {FACTOR} times the base rate.",
        ),
        {name: name for name in RATED},
    ),
    "real_time_fps": BenchFigure(
        Labels(
            "Effective rate in real time", "", "frames per second",
            "Base rate and the new frames that are ready at their slots.",
        ),
        {name: name for name in (*RATED, BEST_RETURN)},
    ),
    # Oracles that know the clock decide otherwise.
    "real_time_decisions": BenchFigure(
        Labels(
            "Share of warping in real time", "", "% of the decisions",
            "Of the policy, and of oracles that know the clock.",
        ),
        {"": "warp"}, CHOOSERS,
    ),
    "real_time_slots": BenchFigure(
        Labels(
            "Slots of the policy in real time", "% of the slots",
            description="New frames by what makes them, and repeats by their reason.",
        ),
        {kind: kind for kind in SLOT_KINDS}, (POLICY,), is_stacked=True,
    ),
    "holes": BenchFigure(
        Labels(
            "Share of the frame that is unseen", "% of the frames",
            description="How many frames have how many holes.",
        ),
        {
            f"{100 * low:g}-{100 * high:g} %": f"from_{low:g}"
            for low, high in pairwise(bench_document.HOLE_EDGES)
        },
        is_stacked=True,
    ),
    "runtime": BenchFigure(
        Labels("Run time of a frame", "ms", description="Milliseconds of each step of the work."),
        {"warping": "warping_ms", "hole marking": "hole_marking_ms", "network": "inference_ms"},
        is_stacked=True,
    ),
}  # fmt: skip


def sequence_labels(document: bench_document.Document) -> list[str]:
    """Name the sequences shortly; size and setting only where they differ."""
    rows = document["sequences"]
    sizes, settings = ({row[key] for row in rows} for key in ("size", "setting"))
    heights = {size: f"{size.split('x')[1]}p" for size in sizes}
    if len(set(heights.values())) < len(sizes):
        heights = {size: size for size in sizes}
    labels = []
    for row in rows:
        words = [row["name"]]
        if len(sizes) > 1:
            words.append(heights[row["size"]])
        if len(settings) > 1:
            words.append(row["setting"])
        labels.append(" ".join(words))
    return labels


def draw_figure(table: BenchTable, names: Sequence[str]) -> Figure | None:
    """Draw the figure that stands before a table, if there is one; `names` are the sequences'."""
    if table.name not in FIGURES:
        return None
    figure = FIGURES[table.name]
    shares = {column.key for column in table.columns if column.style.endswith("%")}
    cells, printed = [], []
    for rows in table.by_sequence():
        values = {}
        for row in rows:
            system, is_paper = row.get("system", ""), row.get(SOURCE.key) == PAPER
            if not is_paper and (system in ("", *figure.systems) or system not in SYSTEMS):
                for name, key in figure.columns.items():
                    is_share = key in shares and row[key] is not None
                    values[name or system] = 100 * row[key] if is_share else row[key]
        cells.append(values)
        printed.append(next((row for row in rows if row.get(SOURCE.key) == PAPER), {}))
    if table.name == "holes":  # some sequences have no known holes
        known = {name: v for name, v in zip(names, cells, strict=True) if None not in v.values()}
        names, cells = list(known), list(known.values())
        if 0 < len(known) <= MAX_BARS:
            labels = replace(FEW_HOLES, description=figure.labels.description)
            bars = {name: list(values.values()) for name, values in known.items()}
            return draw_bars(labels, list(figure.columns), bars)
    if not cells or not all(cells):
        return None
    series = {name: [values.get(name) for values in cells] for name in cells[0]}
    if figure.is_stacked:
        return draw_stacked_bars(figure.labels, names, series, figure.kinds)
    series = {name: bars for name, bars in series.items() if any(bar is not None for bar in bars)}
    if not series:
        return None
    references = None
    if SOURCE in table.columns and "" not in figure.columns:
        references = {name: [row.get(figure.columns[name]) for row in printed] for name in series}
    return draw_bars(figure.labels, names, series, references)


def draw_features(benchmark: Benchmark) -> Figure:
    """Draw Figure 4: every feature against the PSNR of W."""
    points = [point for row in benchmark.measured for point in bench_document.feature_points(row)]
    psnr = [point["warp_psnr_db"] for point in points]
    labels = Labels(
        "Features and the quality of W", y="PSNR of W dB",
        description="Each feature against the PSNR of warped frames, a point a slot.",
    )  # fmt: skip
    panels = {name: [point[name] for point in points] for name in bench_document.VARYING_FEATURES}
    return draw_scatter(labels, panels, psnr)
