"""Tables of what frames cost: Table III, the synthesis table, and what a farm saves."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from exwarp_cli.domain.bench import SYSTEMS
from exwarp_cli.report.bench.columns import (
    NOTHING,
    OURS,
    SOURCE,
    SYSTEM,
    WHAT,
    Column,
    Row,
    Table,
    paper_row,
    what,
)
from exwarp_cli.report.bench.naming import Document

LISTED = ("exwarp", "s6", "softsplat")
"""Systems whose savings are listed, with all that options add."""


def render_time(document: Document) -> Table:
    """What a farm saves."""
    rows: list[Row] = []
    for row in document["render_time"]:
        for name, made in row["generated_frame_s"].items():
            if name in SYSTEMS and name not in LISTED:
                continue
            cells = {"system": name, "key": row["key_frame_s"], "made": made}
            for key, source in (("saved", "saved_share"), ("faster", "times_faster")):
                cells[key] = (row[source] or {}).get(name)
            rows.append(what(row) | cells)
    return Table(
        "render_time",
        "Rendering a frame against making one",
        "Seconds that the renderer left in the headers of the key frames, beside those of a "
        "generated frame on the processor named above, files apart. Saved: of the time that "
        "rendering all frames would take; repeated frames save nothing.",
        (
            *WHAT,
            SYSTEM,
            Column("key", "rendered s", ",.2f"),
            Column("made", "generated s", ",.3f"),
            Column("saved", "saved", ".1%"),
            Column("faster", "times faster", ",.1f"),
        ),
        tuple(rows),
    )


def runtime(document: Document) -> Table:
    """Table III."""
    keys = ("gbuffer_ms", "warping_ms", "hole_marking_ms", "inference_ms")
    printed = ("gbuffer", "warping", "hole_marking", "inference")
    rows: list[Row] = []
    for row in document["runtime"]:
        others = {f"{name}_ms": value for name, value in row["others_ms"].items()}
        rows.append(what(row) | {"source": OURS} | {k: row[k] for k in keys} | others)
        if row["paper"] is not None:
            values = {key: row["paper"][name] for key, name in zip(keys, printed, strict=True)}
            rows.append(paper_row(row) | values)
    titles = ("G-buffer generation", "warping", "hole marking", "network")
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


def predictor(document: Document) -> Table:
    """Overheads of the hardware predictor."""
    found, printed = document["predictor"], document["predictor"]["paper"]
    clock = f"{found['clock_hz'] / 1e9:g} GHz"

    rows = (
        _row("cycles of an inference", f"{found['cycles']:,}"),
        _row("of them multiplications", f"{found['mac_cycles']:,}"),
        _row("use of the MAC units", f"{found['utilisation']:.1%}"),
        _row(
            f"latency at {clock}", f"{found['latency_ns']:,.0f} ns", f"{printed['latency_ns']} ns"
        ),
        _row("weights and activations", f"{found['memory_bytes']:,} bytes"),
        _row(
            "fullest core, of its cache",
            f"{found['fullest_core_bytes']:,} of {found['cache_bytes']:,} bytes",
            "16 KB",
        ),
        _row("fetched again an inference", f"{found['refill_bytes']:,} bytes"),
        *_synthesised_rows(found["synthesis"]),
        _row("area", _area(found["synthesis"]), f"{printed['area_mm2']} mm² (28 nm)"),
        _row("power", NOTHING, f"{printed['power_mw']} mW (28 nm)"),
    )
    columns = (
        Column("parameter", ""),
        Column("ours", "counted, or measured"),
        Column("paper", "paper"),
    )
    return Table(
        "predictor",
        "Cost of the predictor (synthesis table)",
        "Counted on the paper's machine: 4 cores with ten 8-bit MACs. What is marked as measured "
        "is the Verilog of 'exwarp policy export --verilog', with 20 KB a core, in other "
        "technologies; power is the paper's alone.",
        columns,
        rows,
    )


def _row(what: str, ours: str, paper: str = NOTHING) -> Row:
    return {"parameter": what, "ours": ours, "paper": paper}


def _synthesised_rows(found: dict[str, Any]) -> Iterator[Row]:
    """Yield what synthesis for an FPGA measured."""
    fpga, simulated = found["ecp5"], found["simulated"]
    states, cycles = simulated["vectors"], simulated["cycles"]
    yield _row("simulated bit for bit", f"{states:,} states in {cycles:,} cycles each, measured")
    logic = f"{fpga['luts']:,} LUTs, {fpga['flip_flops']:,} flip-flops"
    yield _row("logic", f"{logic} (ECP5, measured)")
    parts = f"{fpga['multipliers']} of 18x18 bits, {fpga['block_rams']} of 18 Kbit"
    yield _row("multipliers and memories", f"{parts} (ECP5, measured)")
    rate = fpga["fmax_mhz"]
    if rate is not None:
        times = f"{rate:.1f} MHz, {cycles / rate:,.0f} µs"
        yield _row("clock rate, an inference", f"{times} (ECP5, measured)")


def _area(found: dict[str, Any]) -> str:
    cells = found["osu018"]
    if cells is None:
        return NOTHING
    return f"{cells['area_mm2']:.2f} mm² without memories (180 nm, measured)"
