"""What is chosen and why: holes, features, decisions, effective rate (Figures 2, 4, 8, 9)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from exwarp_cli.domain.bench import CHOOSERS
from exwarp_cli.domain.decision import FEATURES, HOLD
from exwarp_cli.pipeline.bench.work import Measured
from exwarp_cli.report.bench import paper
from exwarp_cli.report.bench.naming import Document, identify
from exwarp_cli.report.bench.quality import shown
from exwarp_cli.report.bench.statistics import pearson, share, spearman
from exwarp_cli.report.decisions import decisions
from exwarp_cli.report.quality import mean

HOLE_EDGES = (0.0, 0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 1.0)
"""Bins of the histogram of hole shares (Figure 2); the last one holds 1, too."""

EFFECTIVE = FEATURES[:-1]
"""Features that vary within a sequence: R, the resolution, does not."""


def holes_row(one: Measured) -> Document:
    """Return what Figure 2 draws: how many frames have how many holes."""
    row = identify(one)
    known = [hole for part in one.parts for hole in part["holes"] if hole is not None]
    if not known:
        return row | {"mean": None, "below_10": None, "above_20": None, "histogram": None}
    counts, _ = np.histogram(known, bins=HOLE_EDGES)
    return row | {
        "mean": mean(known),
        "p95": float(np.percentile(known, 95)),
        "below_10": share(hole < 0.1 for hole in known),
        "above_20": share(hole > 0.2 for hole in known),
        "histogram": {"edges": list(HOLE_EDGES), "counts": counts.tolist()},
        "paper": paper.HOLES.get(row["app"]),
    }


def feature_points(one: Measured) -> list[Document]:
    """Return the features of every slot's decision beside the PSNR of W at that slot (Figure 4)."""
    return [
        {
            "key": part["key"],
            "slot": slot,
            **dict(zip(FEATURES, values, strict=False)),
            "R": values[5] * values[6],
            "distance": values[7],
            "warp_psnr_db": part["warp_psnr_db"][slot - 1],
            "hole_fraction": part["holes"][slot - 1],
        }
        for part in one.parts
        for slot, values in enumerate(part["features"], start=1)
    ]


def features_row(rows: Iterable[Measured], row: Document) -> Document:
    """Return how the features go together with the quality of W."""
    points = [point for one in rows for point in feature_points(one)]
    psnr = [point["warp_psnr_db"] for point in points]
    return row | {
        "points": len(points),
        "correlation": {
            name: {
                "pearson": pearson([point[name] for point in points], psnr),
                "spearman": spearman([point[name] for point in points], psnr),
            }
            for name in EFFECTIVE
        },
        "paper": paper.CORRELATION,
    }


def fps_row(one: Measured) -> Document:
    """Return what Figure 8 draws: base x (1 + mean number of new frames a key interval)."""
    base = one.about["fps"]
    effective = {}
    for name in one.parts[0]["systems"]:
        new = sum(frame["made_by"] != HOLD for frame in shown(one, name))
        effective[name] = base * (1 + new / len(one.parts))
    return identify(one) | {"base": base, "effective": effective, "paper": paper.EFFECTIVE_FPS}


def decisions_row(one: Measured) -> Document:
    """Return what Figure 9 draws: decisions, nodes and paths of the systems that choose."""
    found = {
        chooser: decisions(part["paths"][chooser] for part in one.parts)
        for chooser in CHOOSERS
        if chooser in one.parts[0]["paths"]
    }
    return identify(one) | found | {"paper_warp_share": paper.WARP_SHARE}
