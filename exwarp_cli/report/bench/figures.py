"""The figures of a benchmark's page; None where nothing of a figure was measured."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from exwarp_cli.domain.bench import CHOOSERS, FIXED, POLICY, SYSTEMS
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.pipeline.bench.work import Benchmark
from exwarp_cli.report.bench.choices import EFFECTIVE, feature_points
from exwarp_cli.report.bench.naming import Document
from exwarp_cli.report.plot_style import Figure, Labels
from exwarp_cli.report.plots import Panel, bars, scatter, stacked_bars

COMPARED = ("exwarp", "s1", "s6", "softsplat", "minterpolate")
"""Systems in the figure of Table VII, of those that are always there."""

RATED = (POLICY, "s1", "s2", "s3")
"""Systems in the figures of the effective rate."""

FEW = 3
"""Sequences that bars can stand beside each other for at every share of holes."""


def labels_of(document: Document) -> list[str]:
    """Name the sequences shortly; size and setting only where they differ."""
    rows = document["sequences"]
    sizes, settings = ({row[key] for row in rows} for key in ("size", "setting"))
    high = {size: f"{size.split('x')[1]}p" for size in sizes}
    if len(set(high.values())) < len(sizes):
        high = {size: size for size in sizes}
    return [
        " ".join(
            [row["name"]]
            + ([high[row["size"]]] if len(sizes) > 1 else [])
            + ([row["setting"]] if len(settings) > 1 else [])
        )
        for row in rows
    ]


def runtime(document: Document) -> Figure | None:
    """Draw Table III: the steps of a frame that the paper names."""
    keys = {"warping": "warping_ms", "hole marking": "hole_marking_ms", "network": "inference_ms"}
    labels = Labels(
        "Run time of a frame", "ms", description="Milliseconds of each step of the work."
    )
    parts = {name: [row[key] for row in document["runtime"]] for name, key in keys.items()}
    return stacked_bars(labels, labels_of(document), parts)


def holes(document: Document) -> Figure | None:
    """Draw Figure 2: how many frames have how many holes."""
    rows = [
        (label, row)
        for label, row in zip(labels_of(document), document["holes"], strict=True)
        if row["histogram"]
    ]
    if not rows:
        return None
    edges = rows[0][1]["histogram"]["edges"]
    groups = [f"{100 * low:g}-{100 * high:g} %" for low, high in pairwise(edges)]
    shares = {
        label: [
            100 * count / sum(row["histogram"]["counts"]) for count in row["histogram"]["counts"]
        ]
        for label, row in rows
    }
    if len(rows) > FEW:
        name = "Share of the frame that is unseen"
        labels = Labels(name, "% of the frames", description="How many frames have how many holes.")
        parts = {group: [shares[label][i] for label, _ in rows] for i, group in enumerate(groups)}
        return stacked_bars(labels, [label for label, _ in rows], parts)
    labels = Labels(
        "Holes of warped frames", "share of the frame that is unseen", "% of the frames",
        "How many frames have how many holes.",
    )  # fmt: skip
    return bars(labels, groups, shares)


def scattered(found: Benchmark) -> Figure:
    """Draw Figure 4: every feature against the PSNR of W."""
    points = [point for one in found.measured for point in feature_points(one)]
    psnr = [point["warp_psnr_db"] for point in points]
    labels = Labels(
        "Features and the quality of W", y="PSNR of W dB",
        description="Each feature against the PSNR of warped frames, a point a slot.",
    )  # fmt: skip
    return scatter(
        labels, [Panel(name, [point[name] for point in points], psnr) for name in EFFECTIVE]
    )


def paths(document: Document) -> Figure | None:
    """Draw Table VI: every path's PSNR, with the paper's across the bars."""
    rows = document["quality"]
    systems = [name for name in (*FIXED, "exwarp") if name in rows[0]["systems"]]
    if not systems:
        return None
    labels = Labels(
        "PSNR of every decision path", "", "PSNR dB",
        "Mean PSNR of slots 1 to 3; a line across a bar is the paper's figure.",
    )  # fmt: skip
    return bars(
        labels,
        labels_of(document),
        {s: [_psnr(row["systems"].get(s)) for row in rows] for s in systems},
        {
            s: [row["paper"][s]["psnr_db"] if row["paper"] else None for row in rows]
            for s in systems
        },
    )


def _psnr(system: dict[str, Any] | None) -> float | None:
    return None if system is None else system["all"]["psnr_db"]


def compared(document: Document) -> Figure | None:
    """Draw Table VII: the PSNR of causal and look-ahead systems."""
    rows = document["comparison"]
    known = [name for name in rows[0]["systems"] if name in COMPARED or name not in SYSTEMS]
    if not known:
        return None
    labels = Labels("Causal and look-ahead systems", "", "PSNR dB", "Mean PSNR of slots 1 to 3.")
    values = {n: [row["systems"].get(n, {}).get("psnr_db") for row in rows] for n in known}
    return bars(labels, labels_of(document), values)


def fps(document: Document) -> Figure | None:
    """Draw Figure 8: the effective rate."""
    rows = document["fps"]
    names = [name for name in RATED if name in rows[0]["effective"]]
    if not names:
        return None
    labels = Labels(
        "Effective rate", "", "frames per second",
        f"Base rate and new frames; at most {FACTOR} times the base rate.",
    )  # fmt: skip
    return bars(
        labels, labels_of(document), {n: [row["effective"].get(n) for row in rows] for n in names}
    )


def decisions(document: Document) -> Figure | None:
    """Draw Figure 9: what the policy decides."""
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
    return stacked_bars(labels, labels_of(document), parts, kinds=True)


def clocked_fps(document: Document) -> Figure | None:
    """Draw Figure 8 under the clock."""
    found = document["real_time"]
    rows = [row["systems"] for row in found["rows"]]
    names = [name for name in (*RATED, "oracle-return") if name in rows[0]]
    if not names:
        return None
    labels = Labels(
        "Effective rate in real time", "", "frames per second",
        "Base rate and the new frames that are ready at their slots.",
    )  # fmt: skip
    values = {name: [row[name]["effective"] for row in rows] for name in names}
    return bars(labels, labels_of(document), values)


def clocked_decisions(document: Document) -> Figure | None:
    """Draw Figure 9 under the clock: who knows the clock decides otherwise."""
    rows = [row["systems"] for row in document["real_time"]["rows"]]
    names = [name for name in CHOOSERS if name in rows[0]]
    if not names:
        return None
    labels = Labels(
        "Share of warping in real time", "", "% of the decisions",
        "Of the policy, and of oracles that know the clock.",
    )  # fmt: skip
    shares = {name: [row[name]["decisions"]["warp_share"] for row in rows] for name in names}
    percents = {
        name: [None if share is None else 100 * share for share in values]
        for name, values in shares.items()
    }
    return bars(labels, labels_of(document), percents)


def clocked_slots(document: Document) -> Figure | None:
    """Draw what comes of the policy's decisions under the clock."""
    rows = [row["systems"].get(POLICY) for row in document["real_time"]["rows"]]
    known = [row["slots"] for row in rows if row is not None]
    if len(known) < len(rows):
        return None
    labels = Labels(
        "Slots of the policy in real time", "% of the slots",
        description="New frames by what makes them, and repeats by their reason.",
    )  # fmt: skip
    parts = {kind: [100 * row[kind] / sum(row.values()) for row in known] for kind in known[0]}
    return stacked_bars(labels, labels_of(document), parts)
