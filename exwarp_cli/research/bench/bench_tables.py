"""All tables of a benchmark: a registry, from which Markdown, CSV and HTML are made."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

from exwarp_cli.domain.decision import EXTRAPOLATE, NODES, WARP
from exwarp_cli.domain.metric import METRICS
from exwarp_cli.research.bench import paper, systems
from exwarp_cli.research.bench.bench_document import HOLE_EDGES, VARYING_FEATURES, Document
from exwarp_cli.research.bench.real_time import BUSY, BY_PATH, CLOCKED_SYSTEMS, LATE

OURS, PAPER = "measured", "paper"

# Shown for what was not measured.
NOTHING = "-"

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    key: str  # of its values in the rows, and its name in CSV files
    title: str  # its name for people
    style: str = ""  # format specification of its numbers; empty for text
    path: tuple[str, ...] = ()  # keys to its values in rows of bench.json, where not `key` alone
    optional: bool = False  # left out of the table where no row has a value

    def text(self, row: Row) -> str | None:
        """Return a row's cell as people read it; None for what was not measured."""
        value = row[self.key]
        return None if value is None else format(value, self.style)


@dataclass(frozen=True)
class BenchTable:
    """A table, which `make_tables` fills: title and note may have fields of it until then."""

    name: str  # of its CSV file, without the ending
    title: str
    note: str  # what the numbers mean
    columns: tuple[Column, ...]
    find_rows: Callable[[Document], Iterable[Document]]  # those that columns find their values in
    rows: tuple[Row, ...] = ()  # cells by the keys of the columns

    @property
    def measured_columns(self) -> list[Column]:
        """The columns in which anything was measured."""
        return [c for c in self.columns if any(row[c.key] is not None for row in self.rows)]

    def by_sequence(self) -> list[list[Row]]:
        """Return the rows of each sequence; the paper's follow those that they stand beside."""
        groups: list[list[Row]] = []
        before = None
        for row in self.rows:
            # No two sequences of a benchmark have one name, size and setting.
            sequence = tuple(row[column.key] for column in SEQUENCE)
            if row.get(SOURCE.key) != PAPER and sequence != before:
                groups.append([])
                before = sequence
            groups[-1].append(row)
        return groups


SEQUENCE = (
    Column("scene", "scene", path=("name",)),
    Column("size", "size"),
    Column("setting", "G-buffers"),
)
SOURCE = Column("source", "")
SYSTEM = Column("system", "system")

# Systems whose savings are listed, with all that options add.
SAVING = ("exwarp", "s6", "softsplat")

CHOICE_COLUMNS = (
    Column("warp", "warp", ".1%", ("warp_share",)),
    Column("extrapolate", "extrapolate", ".1%"),
    *(Column(node, f"{node} warp", ".0%") for node in NODES),
    *(Column(path, path.upper(), "d", ("paths", path.upper())) for path in systems.FIXED),
)

# Steps of a frame in bench.json and in the paper, and their titles.
STEP_COLUMNS = (
    ("gbuffer", "G-buffer generation"),
    ("warping", "warping"),
    ("hole_marking", "hole marking"),
    ("inference", "network"),
)
OTHER_STEPS = (
    *(("read", "reading"), ("geometry", "geometry"), ("features", "features")),
    *(("decide", "decision"), ("inputs", "network's inputs")),
)

PATH_COLUMNS = (
    *((path, path.upper()) for path in systems.FIXED),
    *(("exwarp", "ExWarp"), ("oracle", "oracle"), ("oracle-return", "oracle (return)")),
)

PATHS_NOTE = (
    "Means over all frames shown at slots 1 to 3, repeats included. S1 is ExtraNet's way, S6 "
    "warping alone; the oracles choose by ground truth. Paper: other scenes of the same "
    "themes; 240p stands beside its 480p."
)

CLOCK_NOTE = (
    "A display of 120 Hz shows 30 key frames a second, and a slot every 8.33 ms. A frame is "
    "requested when its node decides, one slot ahead; E(F) after d1 = E is requested with the key "
    "frame, two slots ahead. One engine runs E and is busy until that frame is ready. W needs no "
    "engine. A frame that is not ready at its slot is dropped, and the slot repeats the frame "
    "before. "
)

FROM_TABLE = (
    "Latencies are means over the applications of the paper's Table III: W is G-buffer generation "
    "and warping, E all four steps. "
)

LATENCY_NOTES = {
    clock: f"{FROM_TABLE}All frames count as {size}." for clock, size in systems.TABLE_AS.items()
} | {
    systems.TABLE: f"{FROM_TABLE}Between 480p, 720p and 1080p they are interpolated by pixels. "
    "Smaller frames count as 480p, larger ones in proportion to 1080p.",
    systems.MEASURED: "Latencies are this machine's, from the table of run times: W is geometry, "
    "warping and hole marking; E is these, the network's inputs and the network. Reading, features "
    "and the decision do not count.",
}

# What a slot shows under the clock.
SLOT_KINDS = {
    WARP: "W",
    EXTRAPOLATE: "E",
    BY_PATH: "repeat, by path",
    LATE: "repeat, late",
    BUSY: "repeat, engine busy",
}


# What rows of the paper have in common.
PAPER_ROW = {"size": None, "setting": "slot", "source": PAPER}


def _saving_rows(document: Document) -> Iterator[Document]:
    for row in document["render_time"]:
        for name, seconds in row["generated_frame_s"].items():
            if name in SAVING or name not in systems.SYSTEMS:
                saved = {key: (row[key] or {}).get(name) for key in ("saved_share", "times_faster")}
                yield row | {"system": name, "generated_frame_s": seconds} | saved


def _runtime_rows(document: Document) -> Iterator[Document]:
    for row in document["runtime"]:
        yield row | {"source": OURS}
        if row["paper"] is not None:
            steps = {f"{step}_ms": ms for step, ms in row["paper"].items()}
            yield PAPER_ROW | {"name": row["app"]} | steps


def _hole_rows(document: Document) -> Iterator[Document]:
    for row in document["holes"]:
        counts = row["histogram"]["counts"] if row["histogram"] else []
        pairs = zip(HOLE_EDGES, counts, strict=False)
        yield row | {f"from_{low:g}": count / sum(counts) for low, count in pairs}


def _path_rows(metric: str, document: Document) -> Iterator[Document]:
    for row in document["quality"]:
        yield row | {"source": OURS}
        if row["paper"] is not None:
            printed = {name: values[metric] for name, values in row["paper"].items()}
            best = max(systems.FIXED, key=lambda path: printed[path])
            cells = {name: {"all": values} for name, values in row["paper"].items()}
            yield PAPER_ROW | {"name": row["app"], "best_path": best, "systems": cells}


def _comparison_rows(document: Document) -> Iterator[Document]:
    for row, quality in zip(document["comparison"], document["quality"], strict=True):
        for name, values in row["systems"].items():
            kind = "look-ahead" if values["lookahead"] else "causal"
            holes = quality["systems"][name]["holes"]
            identity = {"source": OURS, "system": name, "kind": kind, "holes": holes}
            yield row | identity | values
        for name, values in (row["paper"] or {}).items():
            yield PAPER_ROW | {"name": row["app"], "system": name, "kind": "look-ahead"} | values
        if quality["paper"]:
            for name, label in (("s1", "ExtraNet (S1)"), ("exwarp", "ExWarp")):
                identity = {"name": row["app"], "system": label, "kind": "causal"}
                yield PAPER_ROW | identity | quality["paper"][name]


def _choice_rows(rows: Iterable[Document]) -> Iterator[Document]:
    """Yield what `CHOICE_COLUMNS` show; rows have what systems decided by their names."""
    for row in rows:
        for system in systems.CHOOSERS:
            if system in row:
                decisions = row[system]
                warp = decisions["warp_share"]
                shares = {"extrapolate": None if warp is None else 1 - warp}
                for node, counts in decisions["nodes"].items():
                    total = counts[WARP] + counts[EXTRAPOLATE]
                    shares[node] = counts[WARP] / total if total else None
                yield row | {"system": system} | decisions | shares


def _predictor_rows(document: Document) -> Iterator[Document]:
    cost = document["predictor"]
    printed, synthesis = cost["paper"], cost["synthesis"]
    fpga, simulated, cells = synthesis["ecp5"], synthesis["simulated"], synthesis["osu018"]
    cycles, fmax_mhz = simulated["cycles"], fpga["fmax_mhz"]
    ours = {
        "cycles of an inference": f"{cost['cycles']:,}",
        "of them multiplications": f"{cost['mac_cycles']:,}",
        "use of the MAC units": f"{cost['utilisation']:.1%}",
        f"latency at {cost['clock_hz'] / 1e9:g} GHz": f"{cost['latency_ns']:,.0f} ns",
        "weights and activations": f"{cost['memory_bytes']:,} bytes",
        "fullest core, of its cache": f"{cost['fullest_core_bytes']:,} of "
        f"{cost['cache_bytes']:,} bytes",
        "fetched again an inference": f"{cost['refill_bytes']:,} bytes",
        "simulated bit for bit": f"{simulated['vectors']:,} states in {cycles:,} cycles each, "
        "measured",
        "logic": f"{fpga['luts']:,} LUTs, {fpga['flip_flops']:,} flip-flops (ECP5, measured)",
        "multipliers and memories": f"{fpga['multipliers']} of 18x18 bits, "
        f"{fpga['block_rams']} of 18 Kbit (ECP5, measured)",
    }
    if fmax_mhz is not None:
        ours["clock rate, an inference"] = (
            f"{fmax_mhz:.1f} MHz, {cycles / fmax_mhz:,.0f} µs (ECP5, measured)"
        )
    ours["area"] = NOTHING
    if cells is not None:
        ours["area"] = f"{cells['area_mm2']:.2f} mm² without memories (180 nm, measured)"
    ours["power"] = NOTHING
    papers = {
        f"latency at {cost['clock_hz'] / 1e9:g} GHz": f"{printed['latency_ns']} ns",
        "fullest core, of its cache": "16 KB",
        "area": f"{printed['area_mm2']} mm² (28 nm)",
        "power": f"{printed['power_mw']} mW (28 nm)",
    }
    for name, text in ours.items():
        yield {"parameter": name, "ours": text, "paper": papers.get(name, NOTHING)}


def _clocked_path_rows(document: Document) -> Iterable[Document]:
    rows: dict[str, Document] = {}
    for row in document["real_time"]["rows"]:
        for path, played in row["paths"].items():
            pairs = zip(systems.SLOTS, played["made_by"], played["dropped"], strict=True)
            slots = {f"slot_{slot}": SLOT_KINDS[reason or maker] for slot, maker, reason in pairs}
            fps = document["real_time"]["base"] * (1 + played["new"])
            cells = {"size": row["size"], "path": path, **slots, "new": played["new"], "fps": fps}
            rows.setdefault(str(cells), cells)
    return rows.values()


def _clocked_slot_rows(document: Document) -> Iterator[Document]:
    rows = zip(document["real_time"]["rows"], document["fps"], document["quality"], strict=True)
    for row, offline, quality in rows:
        for name, system in row["systems"].items():
            total = sum(system["slots"].values())
            shares = {kind: count / total for kind, count in system["slots"].items()}
            others = {
                "offline_fps": offline["effective"][name],
                "offline_psnr_db": quality["systems"][name]["all"]["psnr_db"],
            }
            yield row | {"system": name} | system | shares | others


# In the order in which they are shown: that of the paper.
TABLES = (
    BenchTable(
        "render_time",
        "Rendering a frame against making one",
        "Seconds that the renderer left in the headers of the key frames, beside those of a "
        "generated frame on the processor named above, files apart. Saved: of the time that "
        "rendering all frames would take; repeated frames save nothing.",
        (
            *SEQUENCE,
            SYSTEM,
            Column("key", "rendered s", ",.2f", ("key_frame_s",)),
            Column("made", "generated s", ",.3f", ("generated_frame_s",)),
            Column("saved", "saved", ".1%", ("saved_share",)),
            Column("faster", "times faster", ",.1f", ("times_faster",)),
        ),
        _saving_rows,
    ),
    BenchTable(
        "runtime",
        "Run time of each step, ms a generated frame (Table III)",
        "Medians of three key intervals, on the processor named above; the paper's are those of an "
        "RTX A4000. G-buffers: from the renderer's headers, where slots were rendered without "
        "colour; else unknown. Warping has the motion field, sampling and filling in it; with "
        "G-buffers of the key frames only, holes come out of it as well.",
        (
            *SEQUENCE,
            SOURCE,
            *(Column(f"{step}_ms", title, ",.2f") for step, title in STEP_COLUMNS),
            *(Column(f"{k}_ms", title, ",.2f", ("others_ms", k)) for k, title in OTHER_STEPS),
        ),
        _runtime_rows,
    ),
    BenchTable(
        "holes",
        "Share of holes in warped frames (Figure 2)",
        "How many of the frames at slots 1 to 3 have that share of their pixels unseen in the key "
        "frame.{papers_holes}",
        (
            *SEQUENCE,
            Column("mean", "mean", ".1%"),
            Column("p95", "95th percentile", ".1%"),
            *(
                Column(f"from_{low:g}", f"{100 * low:g}-{100 * high:g} %", ".0%", optional=True)
                for low, high in pairwise(HOLE_EDGES)
            ),
            Column("below_10", "below 10 %", ".0%"),
            Column("above_20", "above 20 %", ".0%"),
        ),
        _hole_rows,
    ),
    BenchTable(
        "correlation",
        "Features against the PSNR of W (Figure 4)",
        "Correlation of ranks (Spearman) and of values (Pearson), slot by slot; the paper: "
        f"{paper.CORRELATION}.",
        (
            *SEQUENCE,
            *(
                Column(name, name, "+.2f", ("correlation", name, "spearman"))
                for name in VARYING_FEATURES
            ),
            *(
                Column(
                    f"{name}_pearson", f"{name} (Pearson)", "+.2f", ("correlation", name, "pearson")
                )
                for name in VARYING_FEATURES
            ),
            Column("points", "points", "d"),
        ),
        lambda document: document["features"],
    ),
    *(
        BenchTable(
            f"paths_{name}",
            title,
            PATHS_NOTE,
            (
                *SEQUENCE,
                SOURCE,
                *(
                    Column(k, label, style, ("systems", k, "all", metric))
                    for k, label in PATH_COLUMNS
                ),
                Column("best", "best path", path=("best_path",)),
            ),
            partial(_path_rows, metric),
        )
        for name, title, metric, style in (
            ("psnr", "Quality of every decision path, PSNR dB (Table VI)", "psnr_db", ".2f"),
            ("ssim", "The same, SSIM (Table VI)", "ssim", ".3f"),
        )
    ),
    BenchTable(
        "comparison",
        "Comparison with interpolation (Table VII)",
        "Look-ahead systems wait for the next key frame, so that a live viewer sees "
        "everything a key interval late. Time is that of one generated frame, files apart. s1 to "
        "s5 and exwarp run our E; s1 is what ExtraNet does. PSNR, SSIM and VMAF: more is better; "
        "FLIP, HDR-FLIP and flicker: less; pulse: 0. (holes): the pixels that W cannot see.",
        (
            *SEQUENCE,
            SOURCE,
            SYSTEM,
            Column("kind", "kind"),
            Column("waits_ms", "waits ms", ".1f"),
            Column("frame_ms", "time ms", ".1f"),
            *(Column(m.field, m.title, m.style) for m in METRICS),
            *(
                Column(f"{m.field}_holes", f"{m.title} (holes)", m.style, ("holes", m.field))
                for m in METRICS
                if m.in_holes
            ),
        ),
        _comparison_rows,
    ),
    BenchTable(
        "fps",
        "Effective frames per second (Figure 8)",
        "Base rate x (1 + new frames a key interval); repeats are no new frames. The paper: "
        f"{paper.EFFECTIVE_FPS}.",
        (
            *SEQUENCE,
            Column("base", "base", "g"),
            *(
                Column(name, name, ".1f", ("effective", name), optional=True)
                for name in CLOCKED_SYSTEMS
            ),
        ),
        lambda document: document["fps"],
    ),
    BenchTable(
        "decisions",
        "Breakdown of the decisions (Figure 9)",
        "Shares of warping among all decisions and at each node, and key intervals by path. The "
        f"paper's mean share of warps is {paper.WARP_SHARE:.2%}.",
        (*SEQUENCE, SYSTEM, *CHOICE_COLUMNS),
        lambda document: _choice_rows(document["decisions"]),
    ),
    BenchTable(
        "predictor",
        "Cost of the predictor (synthesis table)",
        "Counted on the paper's machine: 4 cores with ten 8-bit MACs. What is marked as measured "
        "is the Verilog of 'exwarp policy export --verilog', with 20 KB a core, in other "
        "technologies; power is the paper's alone.",
        (Column("parameter", ""), Column("ours", "counted, or measured"), Column("paper", "paper")),
        _predictor_rows,
    ),
    BenchTable(
        "extranet",
        "By ExtraNet's procedure: one frame midway between two rendered ones",
        "8-bit sRGB, rounded; SSIM with a uniform 7x7 window. What a system shows at slot 2.",
        (
            *SEQUENCE,
            SYSTEM,
            Column("psnr_db", "PSNR dB", ".2f"),
            Column("ssim", "SSIM", ".4f"),
            Column("frames", "frames", "d"),
        ),
        lambda document: (
            row | {"system": name} | values
            for row in document["extranet_procedure"]
            for name, values in row["systems"].items()
        ),
    ),
)

# Those of a benchmark with a clock come last.
CLOCKED_TABLES = (
    BenchTable(
        "real_time_fps",
        "Effective frames per second in real time (Figure 8, clock {clock})",
        CLOCK_NOTE + "{latencies}",
        (
            *SEQUENCE,
            Column("warp_ms", "W ms", ".2f", ("latency_ms", WARP)),
            Column("extrapolate_ms", "E ms", ".2f", ("latency_ms", EXTRAPOLATE)),
            Column("extrapolate_slots", "E slots", "d"),
            Column("base", "base", "g"),
            *(
                Column(name, name, ".1f", ("systems", name, "effective"))
                for name in CLOCKED_SYSTEMS
            ),
        ),
        lambda document: (
            row | {"base": document["real_time"]["base"]} for row in document["real_time"]["rows"]
        ),
    ),
    BenchTable(
        "real_time_paths",
        "What every decision path shows in real time",
        "In a key interval that begins with a free engine, by the size of the frames. By path: the "
        "path itself repeats the frame before. Late: the frame is not ready at its slot. Engine "
        "busy: an earlier E still runs when this one is requested. A W after a late E warps the "
        "key frame.",
        (
            Column("size", "size"),
            Column("path", "path"),
            *(Column(f"slot_{slot}", f"slot {slot}") for slot in systems.SLOTS),
            Column("new", "new frames", "d"),
            Column("fps", "effective fps", "g"),
        ),
        _clocked_path_rows,
    ),
    BenchTable(
        "real_time_decisions",
        "Breakdown of the decisions in real time (Figure 9, clock {clock})",
        "As in the table of all decisions. The policy does not know the clock: it decides as it "
        "does offline. The oracles take the path that is best in PSNR or return of what the clock "
        "lets them show.",
        (*SEQUENCE, SYSTEM, *CHOICE_COLUMNS),
        lambda document: _choice_rows(
            row | {name: system["decisions"] for name, system in row["systems"].items()}
            for row in document["real_time"]["rows"]
        ),
    ),
    BenchTable(
        "real_time_slots",
        "Slots and quality of every system in real time",
        "Shares of slots 1 to 3 by what they show, and why they repeat the frame before: by path, "
        "late, or engine busy. PSNR and SSIM are means over these slots, repeats included. Return "
        "is the mean sum of the paper's rewards in a key interval; alpha counts for every repeat, "
        "late ones too. Offline every frame comes in time, and the oracles know of no clock.",
        (
            *SEQUENCE,
            SYSTEM,
            *(Column(kind, title, ".1%") for kind, title in SLOT_KINDS.items()),
            Column("effective", "fps", ".1f"),
            Column("offline_fps", "offline fps", ".1f"),
            Column("psnr_db", "PSNR dB", ".2f"),
            Column("offline_psnr_db", "offline PSNR dB", ".2f"),
            Column("ssim", "SSIM", ".3f"),
            Column("return", "return", "+.2f"),
        ),
        _clocked_slot_rows,
    ),
)


def make_tables(document: Document) -> tuple[BenchTable, ...]:
    """Return every table of a benchmark, in the paper's order; then those of a clock."""
    clock = document["real_time"]["clock"] if "real_time" in document else None
    printed = {row["app"]: row["paper"] for row in document["holes"] if row.get("paper")}
    facts = {
        "clock": clock,
        "latencies": "" if clock is None else LATENCY_NOTES[clock],
        "papers_holes": "".join(f" The paper, {app}: {text}." for app, text in printed.items()),
    }
    tables = []
    for table in TABLES if clock is None else (*TABLES, *CLOCKED_TABLES):
        rows: list[Row] = []
        for row in table.find_rows(document):
            cells: dict[str, Any] = {}
            for column in table.columns:
                value: Any = row
                for key in column.path or (column.key,):
                    value = None if value is None else value.get(key)
                cells[column.key] = value
            rows.append(cells)
        title, note = (text.format(**facts) for text in (table.title, table.note))
        filled = replace(table, title=title, note=note, rows=tuple(rows))
        measured = filled.measured_columns
        columns = tuple(c for c in table.columns if not c.optional or c in measured)
        tables.append(replace(filled, columns=columns))
    return tuple(tables)
