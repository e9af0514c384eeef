"""The tables of a benchmark, once for Markdown, CSV and HTML."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from exwarp_cli.domain.decision import PATHS
from exwarp_cli.domain.metric import METRICS
from exwarp_cli.report.bench.document import EFFECTIVE, Document

OURS, PAPER = "measured", "paper"

NOTHING = "-"
"""Shown for what was not measured."""

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes
    ----------
    key
        Of its values in the rows, and its name in CSV files.
    title
        Its name for people.
    style
        Format specification of its numbers; empty for text.
    """

    key: str
    title: str
    style: str = ""

    def text(self, row: Row) -> str:
        """Return a row's cell as people read it; a dash for what was not measured."""
        value = row.get(self.key)
        if value is None:
            return NOTHING
        return format(value, self.style) if self.style else str(value)


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes
    ----------
    name
        Of its CSV file, without the ending.
    title, note
        For people; the note tells what the numbers mean.
    columns, rows
        What it holds.
    """

    name: str
    title: str
    note: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]


WHAT = (Column("scene", "scene"), Column("size", "size"), Column("setting", "G-buffers"))
SOURCE = Column("source", "")
SYSTEM = Column("system", "system")
PATH_NAMES = tuple(name.lower() for name in PATHS)


def tables_of(document: Document) -> tuple[Table, ...]:
    """Return every table of a benchmark, in the paper's order."""
    return tuple(make(document) for make in MAKERS)


def _what(row: Document) -> dict[str, Any]:
    """Return the cells that name a sequence."""
    return {"scene": row["name"], "size": row["size"], "setting": row["setting"]}


def runtime(document: Document) -> Table:
    """Table III."""
    keys = ("gbuffer_ms", "warping_ms", "hole_marking_ms", "inference_ms")
    printed = ("gbuffer", "warping", "hole_marking", "inference")
    rows: list[Row] = []
    for row in document["runtime"]:
        others = {f"{name}_ms": value for name, value in row["others_ms"].items()}
        rows.append(_what(row) | {"source": OURS} | {k: row[k] for k in keys} | others)
        if row["paper"] is not None:
            values = {key: row["paper"][name] for key, name in zip(keys, printed, strict=True)}
            rows.append(_paper_row(row) | values)
    titles = ("G-buffers", "warping", "hole marking", "network")
    more = ("read_ms", "geometry_ms", "features_ms", "decide_ms", "inputs_ms")
    names = ("reading", "geometry", "features", "decision", "network's inputs")
    return Table(
        "runtime",
        "Run time of each step, ms a generated frame (Table III)",
        "Medians of three key intervals, on the processor named above; the paper's are those of an "
        "RTX A4000. G-buffers: from the renderer's headers, where slots were rendered without "
        "colour; else unknown. Warping has the motion field, sampling and filling in it; with "
        "G-buffers of the key frames only, holes come out of it as well.",
        (
            *WHAT,
            SOURCE,
            *(Column(k, t, ",.2f") for k, t in zip(keys, titles, strict=True)),
            *(Column(k, t, ",.2f") for k, t in zip(more, names, strict=True)),
        ),
        tuple(rows),
    )


def _paper_row(row: Document) -> dict[str, Any]:
    return {"scene": row["app"], "size": None, "setting": "slot", "source": PAPER}


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
        rows.append(_what(row) | values | bins | {"paper": row.get("paper")})
    edges = next((r["histogram"]["edges"] for r in document["holes"] if r["histogram"]), (0.0,))
    pairs = list(pairwise(edges))
    return Table(
        "holes",
        "Share of holes in warped frames (Figure 2)",
        "How many of the frames at slots 1 to 3 have that share of their pixels unseen in the key "
        "frame.",
        (
            *WHAT,
            Column("mean", "mean", ".1%"),
            Column("p95", "95th percentile", ".1%"),
            *(Column(f"from_{low:g}", f"{low:.0%} to {high:.0%}", ".0%") for low, high in pairs),
            Column("below_10", "below 10 %", ".0%"),
            Column("above_20", "above 20 %", ".0%"),
            Column("paper", "paper"),
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


def _paths(document: Document, metric: str, name: str, title: str, style: str) -> Table:
    """Table VI, for one metric."""
    systems = (*PATH_NAMES, "exwarp", "oracle", "oracle-return")
    rows: list[Row] = []
    for row in document["quality"]:
        found = row["systems"]
        values = {s: found[s]["all"][metric] for s in systems if s in found}
        rows.append(_what(row) | {"source": OURS, "best": row["best_path"]} | values)
        if row["paper"] is not None:
            printed = {system: values[metric] for system, values in row["paper"].items()}
            best = max(PATH_NAMES, key=lambda path: printed[path])
            rows.append(_paper_row(row) | {"best": best} | printed)
    titles = (*(path.upper() for path in PATH_NAMES), "ExWarp", "oracle", "oracle (return)")
    return Table(
        name,
        title,
        "Means over all frames shown at slots 1 to 3, repeats included. S1 is ExtraNet's way, S6 "
        "warping alone; the oracles are told by ground truth. Paper: other scenes of the same "
        "themes; 240p stands beside its 480p.",
        (
            *WHAT,
            SOURCE,
            *(Column(s, t, style) for s, t in zip(systems, titles, strict=True)),
            Column("best", "best path"),
        ),
        tuple(rows),
    )


def psnr(document: Document) -> Table:
    """Table VI, its upper half."""
    title = "Quality of every decision path, PSNR dB (Table VI)"
    return _paths(document, "psnr_db", "paths_psnr", title, ".2f")


def ssim(document: Document) -> Table:
    """Table VI, its lower half."""
    return _paths(document, "ssim", "paths_ssim", "The same, SSIM (Table VI)", ".3f")


def comparison(document: Document) -> Table:
    """Table VII, with every metric."""
    rows: list[Row] = []
    for row, quality in zip(document["comparison"], document["quality"], strict=True):
        for name, values in row["systems"].items():
            inside = quality["systems"][name]["holes"]
            masked = {f"{m.field}_holes": inside[m.field] for m in METRICS if m.in_holes}
            kind = "look-ahead" if values["lookahead"] else "causal"
            rows.append(
                _what(row) | {"source": OURS, "system": name, "kind": kind} | values | masked
            )
        for name, values in (row["paper"] or {}).items():
            rows.append(_paper_row(row) | {"system": name, "kind": "look-ahead"} | values)
        for name in ("s1", "exwarp") if quality["paper"] else ():
            label = "ExtraNet (S1)" if name == "s1" else "ExWarp"
            rows.append(
                _paper_row(row) | {"system": label, "kind": "causal"} | quality["paper"][name]
            )
    return Table(
        "comparison",
        "Comparison with interpolation (Table VII)",
        "Look-ahead systems wait for the next key frame, so that whoever watches live sees "
        "everything a key interval late. Time is that of one generated frame, files apart. s1 to "
        "s5 and exwarp run our E; s1 is what ExtraNet does. PSNR, SSIM and VMAF: more is better; "
        "FLIP, HDR-FLIP and flicker: less. (holes): the pixels that W cannot see.",
        (
            *WHAT,
            SOURCE,
            SYSTEM,
            Column("kind", "kind"),
            Column("waits_ms", "waits ms", ".1f"),
            Column("frame_ms", "time ms", ".1f"),
            *(Column(m.field, m.title, f".{m.digits}f") for m in METRICS),
            *(
                Column(f"{m.field}_holes", f"{m.title} (holes)", f".{m.digits}f")
                for m in METRICS
                if m.in_holes
            ),
        ),
        tuple(rows),
    )


def fps(document: Document) -> Table:
    """Figure 8."""
    rows = [_what(row) | row["effective"] | {"base": row["base"]} for row in document["fps"]]
    names = ("exwarp", *PATH_NAMES, "oracle", "oracle-return")
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
            found = row[system]
            warp = found["warp_share"]
            cells = {
                "system": system,
                "warp": warp,
                "extrapolate": None if warp is None else 1 - warp,
            }
            nodes = {
                node: _share(counts["warp"], counts["extrapolate"])
                for node, counts in found["nodes"].items()
            }
            paths = {name.lower(): count for name, count in found["paths"].items()}
            rows.append(_what(row) | cells | nodes | paths)
    return Table(
        "decisions",
        "Breakdown of the decisions (Figure 9)",
        f"Shares of warping among all decisions and at each node, and key intervals by path. The "
        f"paper's mean share of warps is {document['decisions'][0]['paper_warp_share']:.2%}.",
        (
            *WHAT,
            SYSTEM,
            Column("warp", "warp", ".1%"),
            Column("extrapolate", "extrapolate", ".1%"),
            *(Column(f"d{i}", f"d{i} warp", ".0%") for i in range(1, 6)),
            *(Column(path, path.upper(), "d") for path in PATH_NAMES),
        ),
        tuple(rows),
    )


def _share(part: int, rest: int) -> float | None:
    return part / (part + rest) if part + rest else None


def predictor(document: Document) -> Table:
    """Overheads of the hardware predictor."""
    found, printed = document["predictor"], document["predictor"]["paper"]
    clock = f"{found['clock_hz'] / 1e9:g} GHz"

    def row(what: str, ours: str, paper: str) -> Row:
        return {"parameter": what, "ours": ours, "paper": paper}

    rows = (
        row("cycles of an inference", f"{found['cycles']:,}", NOTHING),
        row("of them multiplications", f"{found['mac_cycles']:,}", NOTHING),
        row("use of the MAC units", f"{found['utilisation']:.1%}", NOTHING),
        row(f"latency at {clock}", f"{found['latency_ns']:,.0f} ns", f"{printed['latency_ns']} ns"),
        row("weights and activations", f"{found['memory_bytes']:,} bytes", NOTHING),
        row(
            "fullest core, of its cache",
            f"{found['fullest_core_bytes']:,} of {found['cache_bytes']:,} bytes",
            "16 KB",
        ),
        row("fetched again an inference", f"{found['refill_bytes']:,} bytes", NOTHING),
        row("area", NOTHING, f"{printed['area_mm2']} mm² (28 nm)"),
        row("power", NOTHING, f"{printed['power_mw']} mW (28 nm)"),
    )
    columns = (Column("parameter", ""), Column("ours", "counted"), Column("paper", "paper"))
    return Table(
        "predictor",
        "Cost of the predictor (synthesis table)",
        "Counted on the paper's machine: 4 cores with ten 8-bit MACs. Area and power are the "
        "paper's alone, from its synthesis.",
        columns,
        rows,
    )


def by_extranet(document: Document) -> Table:
    """What ExtraNet's own procedure gives."""
    rows: list[Row] = []
    for row in document["extranet_procedure"]:
        for name, values in row["systems"].items():
            rows.append(_what(row) | {"system": name} | values | {"frames": row["frames"]})
    return Table(
        "extranet",
        "By ExtraNet's procedure: one frame midway between two rendered ones",
        "8-bit sRGB, rounded; SSIM with a uniform 7x7 window. What a system shows at slot 2.",
        (
            *WHAT,
            SYSTEM,
            Column("psnr_db", "PSNR dB", ".2f"),
            Column("ssim", "SSIM", ".4f"),
            Column("frames", "frames", "d"),
        ),
        tuple(rows),
    )


def render_time(document: Document) -> Table:
    """What a farm saves."""
    rows: list[Row] = []
    for row in document["render_time"]:
        for name in ("exwarp", "s6", "softsplat"):
            made = row["generated_frame_s"].get(name)
            if made is None:
                continue
            faster = None if row["times_faster"] is None else row["times_faster"][name]
            cells = {"system": name, "key": row["key_frame_s"], "made": made, "faster": faster}
            rows.append(_what(row) | cells)
    return Table(
        "render_time",
        "Rendering a frame against making one",
        "Seconds that the renderer left in the headers of the key frames, beside those of a "
        "generated frame on the processor named above, files apart.",
        (
            *WHAT,
            SYSTEM,
            Column("key", "rendered s", ",.2f"),
            Column("made", "generated s", ",.3f"),
            Column("faster", "times faster", ",.1f"),
        ),
        tuple(rows),
    )


MAKERS: Sequence[Callable[[Document], Table]] = (
    *(render_time, runtime, holes, features, psnr, ssim, comparison, fps, choices, predictor),
    by_extranet,
)


def known_columns(table: Table) -> Iterable[Column]:
    """Return the columns of a table in which anything was measured."""
    return [c for c in table.columns if any(row.get(c.key) is not None for row in table.rows)]
