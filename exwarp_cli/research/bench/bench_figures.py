"""The figures of a benchmark's page; None where nothing of a figure was measured."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise

from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.report.plots import (
    Figure,
    Labels,
    draw_bars,
    draw_scatter,
    draw_stacked_bars,
)
from exwarp_cli.research.bench.bench_document import (
    HOLE_EDGES,
    VARYING_FEATURES,
    Document,
    feature_points,
)
from exwarp_cli.research.bench.benchmark import Benchmark
from exwarp_cli.research.bench.systems import BEST_RETURN, CHOOSERS, FIXED, POLICY, SYSTEMS

# Systems in the figure of Table VII, of those that are always measured.
COMPARED = ("exwarp", "s1", "s6", "softsplat", "minterpolate")

# Systems in the figures of the effective rate.
RATED = (POLICY, "s1", "s2", "s3")

# Sequences that bars can stand beside each other for at every share of holes.
MAX_BARS = 3


def sequence_labels(document: Document) -> list[str]:
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


def draw_run_times(document: Document) -> Figure | None:
    """Draw Table III: the steps of a frame that the paper names."""
    keys = {"warping": "warping_ms", "hole marking": "hole_marking_ms", "network": "inference_ms"}
    labels = Labels(
        "Run time of a frame", "ms", description="Milliseconds of each step of the work."
    )
    parts = {name: [row[key] for row in document["runtime"]] for name, key in keys.items()}
    return draw_stacked_bars(labels, sequence_labels(document), parts)


def draw_holes(document: Document) -> Figure | None:
    """Draw Figure 2: how many frames have how many holes."""
    shares = {}
    for label, row in zip(sequence_labels(document), document["holes"], strict=True):
        if row["histogram"]:
            counts = row["histogram"]["counts"]
            shares[label] = [100 * count / sum(counts) for count in counts]
    if not shares:
        return None
    groups = [f"{100 * low:g}-{100 * high:g} %" for low, high in pairwise(HOLE_EDGES)]
    description = "How many frames have how many holes."
    if len(shares) > MAX_BARS:
        title = "Share of the frame that is unseen"
        labels = Labels(title, "% of the frames", description=description)
        parts = {group: [row[i] for row in shares.values()] for i, group in enumerate(groups)}
        return draw_stacked_bars(labels, list(shares), parts)
    x, y = "share of the frame that is unseen", "% of the frames"
    return draw_bars(Labels("Holes of warped frames", x, y, description), groups, shares)


def draw_features(benchmark: Benchmark) -> Figure:
    """Draw Figure 4: every feature against the PSNR of W."""
    points = [point for row in benchmark.measured for point in feature_points(row)]
    psnr = [point["warp_psnr_db"] for point in points]
    labels = Labels(
        "Features and the quality of W", y="PSNR of W dB",
        description="Each feature against the PSNR of warped frames, a point a slot.",
    )  # fmt: skip
    panels = {name: [point[name] for point in points] for name in VARYING_FEATURES}
    return draw_scatter(labels, panels, psnr)


def draw_paths(document: Document) -> Figure | None:
    """Draw Table VI: every path's PSNR, with the paper's across the bars."""
    rows = document["quality"]
    names = [name for name in (*FIXED, POLICY) if name in rows[0]["systems"]]
    if not names:
        return None
    labels = Labels(
        "PSNR of every decision path", "", "PSNR dB",
        "Mean PSNR of slots 1 to 3; a line across a bar is the paper's figure.",
    )  # fmt: skip
    values: dict[str, list[float | None]] = {}
    printed: dict[str, list[float | None]] = {}
    for name in names:
        systems = [row["systems"].get(name) for row in rows]
        values[name] = [system and system["all"]["psnr_db"] for system in systems]
        printed[name] = [row["paper"] and row["paper"][name]["psnr_db"] for row in rows]
    return draw_bars(labels, sequence_labels(document), values, printed)


def _draw_systems(
    document: Document, labels: Labels, names: Iterable[str], rows: Sequence[Document]
) -> Figure | None:
    """Draw a group of bars for each sequence: a bar for each system of the first one in `names`.

    `rows` have what is drawn, by system, for each sequence.
    """
    values = {name: [row.get(name) for row in rows] for name in names if name in rows[0]}
    return draw_bars(labels, sequence_labels(document), values) if values else None


def draw_comparison(document: Document) -> Figure | None:
    """Draw Table VII: the PSNR of causal and look-ahead systems."""
    labels = Labels("Causal and look-ahead systems", "", "PSNR dB", "Mean PSNR of slots 1 to 3.")
    rows = [
        {name: system["psnr_db"] for name, system in row["systems"].items()}
        for row in document["comparison"]
    ]
    names = [name for name in rows[0] if name in COMPARED or name not in SYSTEMS]
    return _draw_systems(document, labels, names, rows)


def draw_decisions(document: Document) -> Figure | None:
    """Draw Figure 9: what the policy decides."""
    shares = [row.get(POLICY, {}).get("warp_share") for row in document["decisions"]]
    labels = Labels(
        "Decisions of the policy", "% of the decisions",
        description="Share of warping and of extrapolating among all decisions.",
    )  # fmt: skip
    parts = {
        "warp": [None if share is None else 100 * share for share in shares],
        "extrapolate": [None if share is None else 100 * (1 - share) for share in shares],
    }
    return draw_stacked_bars(labels, sequence_labels(document), parts, kinds=True)


def draw_clocked_slots(document: Document) -> Figure | None:
    """Draw what comes of the policy's decisions under the clock."""
    rows = [row["systems"].get(POLICY) for row in document["real_time"]["rows"]]
    if None in rows:
        return None
    labels = Labels(
        "Slots of the policy in real time", "% of the slots",
        description="New frames by what makes them, and repeats by their reason.",
    )  # fmt: skip
    slots = [row["slots"] for row in rows]
    parts = {kind: [100 * row[kind] / sum(row.values()) for row in slots] for kind in slots[0]}
    return draw_stacked_bars(labels, sequence_labels(document), parts)


# By the table that each stands before.
FIGURES: dict[str, Callable[[Document], Figure | None]] = {
    "comparison": draw_comparison,
    "paths_psnr": draw_paths,
    "decisions": draw_decisions,
    "fps": lambda document: _draw_systems(
        document,
        Labels(
            "Effective rate", "", "frames per second",
            f"Base rate and new frames; at most {FACTOR} times the base rate.",
        ),
        RATED,
        [row["effective"] for row in document["fps"]],
    ),
    "real_time_fps": lambda document: _draw_systems(
        document,
        Labels(
            "Effective rate in real time", "", "frames per second",
            "Base rate and the new frames that are ready at their slots.",
        ),
        (*RATED, BEST_RETURN),
        [
            {name: system["effective"] for name, system in row["systems"].items()}
            for row in document["real_time"]["rows"]
        ],
    ),
    # Oracles that know the clock decide otherwise.
    "real_time_decisions": lambda document: _draw_systems(
        document,
        Labels(
            "Share of warping in real time", "", "% of the decisions",
            "Of the policy, and of oracles that know the clock.",
        ),
        CHOOSERS,
        [
            {name: 100 * each["decisions"]["warp_share"] for name, each in row["systems"].items()}
            for row in document["real_time"]["rows"]
        ],
    ),
    "real_time_slots": draw_clocked_slots,
    "holes": draw_holes,
    "runtime": draw_run_times,
}  # fmt: skip
