"""Tables of what is chosen and why: Figures 2, 4, 8 and 9."""

from __future__ import annotations

from itertools import pairwise

from exwarp_cli.domain.bench import FIXED
from exwarp_cli.report.bench.choices import EFFECTIVE
from exwarp_cli.report.bench.columns import (
    SYSTEM,
    WHAT,
    Column,
    Row,
    Table,
    what,
)
from exwarp_cli.report.bench.naming import Document


def holes(document: Document) -> Table:
    """Figure 2."""
    rows = []
    for row in document["holes"]:
        bins = {}
        if row["histogram"] is not None:
            edges, counts = row["histogram"]["edges"], row["histogram"]["counts"]
            total = sum(counts)
            for low, count in zip(edges, counts, strict=False):
                bins[f"from_{low:g}"] = count / total if total else None
        values = {key: row.get(key) for key in ("mean", "p95", "below_10", "above_20")}
        rows.append(what(row) | values | bins)
    edges = next((r["histogram"]["edges"] for r in document["holes"] if r["histogram"]), (0.0,))
    printed = {row["app"]: row["paper"] for row in document["holes"] if row.get("paper")}
    paper = "".join(f" The paper, {app}: {text}." for app, text in printed.items())
    return Table(
        "holes",
        "Share of holes in warped frames (Figure 2)",
        "How many of the frames at slots 1 to 3 have that share of their pixels unseen in the key "
        "frame." + paper,
        (
            *WHAT,
            Column("mean", "mean", ".1%"),
            Column("p95", "95th percentile", ".1%"),
            *(
                Column(f"from_{low:g}", f"{100 * low:g}-{100 * high:g} %", ".0%")
                for low, high in pairwise(edges)
            ),
            Column("below_10", "below 10 %", ".0%"),
            Column("above_20", "above 20 %", ".0%"),
        ),
        tuple(rows),
    )


def features(document: Document) -> Table:
    """Figure 4."""
    rows = []
    for row in document["features"]:
        values = {"scene": row["name"], "size": row["size"], "setting": row["setting"]}
        for name in EFFECTIVE:
            values[name] = row["correlation"][name]["spearman"]
            values[f"{name}_pearson"] = row["correlation"][name]["pearson"]
        rows.append(values | {"points": row["points"]})
    return Table(
        "correlation",
        "Features against the PSNR of W (Figure 4)",
        "Correlation of ranks (Spearman) and of values (Pearson), slot by slot; the paper: "
        + document["features"][0]["paper"]
        + ".",
        (
            *WHAT,
            *(Column(name, name, "+.2f") for name in EFFECTIVE),
            *(Column(f"{name}_pearson", f"{name} (Pearson)", "+.2f") for name in EFFECTIVE),
            Column("points", "points", "d"),
        ),
        tuple(rows),
    )


def fps(document: Document) -> Table:
    """Figure 8."""
    rows = [what(row) | row["effective"] | {"base": row["base"]} for row in document["fps"]]
    names = ("exwarp", *FIXED, "oracle", "oracle-return")
    known = [name for name in names if any(name in row for row in rows)]
    return Table(
        "fps",
        "Effective frames per second (Figure 8)",
        "Base rate x (1 + new frames a key interval); repeats are no new frames. The paper: "
        + document["fps"][0]["paper"]
        + ".",
        (*WHAT, Column("base", "base", "g"), *(Column(n, n, ".1f") for n in known)),
        tuple(rows),
    )


def choices(document: Document) -> Table:
    """Figure 9."""
    rows: list[Row] = []
    for row in document["decisions"]:
        for system in ("exwarp", "oracle", "oracle-return"):
            if system not in row:
                continue
            rows.append(what(row) | {"system": system} | choice_cells(row[system]))
    return Table(
        "decisions",
        "Breakdown of the decisions (Figure 9)",
        f"Shares of warping among all decisions and at each node, and key intervals by path. The "
        f"paper's mean share of warps is {document['decisions'][0]['paper_warp_share']:.2%}.",
        (*WHAT, SYSTEM, *CHOICE_COLUMNS),
        tuple(rows),
    )


CHOICE_COLUMNS = (
    Column("warp", "warp", ".1%"),
    Column("extrapolate", "extrapolate", ".1%"),
    *(Column(f"d{i}", f"d{i} warp", ".0%") for i in range(1, 6)),
    *(Column(path, path.upper(), "d") for path in FIXED),
)


def choice_cells(found: Document) -> Document:
    """Return the cells of `CHOICE_COLUMNS` for what `report.decisions.decisions` counted."""
    warp = found["warp_share"]
    return {
        "warp": warp,
        "extrapolate": None if warp is None else 1 - warp,
        **{
            node: _share(counts["warp"], counts["extrapolate"])
            for node, counts in found["nodes"].items()
        },
        **{name.lower(): count for name, count in found["paths"].items()},
    }


def _share(part: int, rest: int) -> float | None:
    return part / (part + rest) if part + rest else None
