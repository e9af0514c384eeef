"""What ``exwarp policy cycles`` prints: the schedule as a table, in words, and as JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from rich import box
from rich.table import Table

from exwarp_cli.accelerator.mac_array import COMPARE_CYCLES, PAPER_LATENCY_NS, Schedule

SCHEMA = "exwarp.cycles/1"


def cycles_document(found: Schedule, clock_hz: float) -> dict[str, Any]:
    """Turn a schedule into the dictionary that is printed as JSON."""
    return {
        "schema": SCHEMA,
        "machine": asdict(found.array),
        "sizes": found.sizes,
        "clock_hz": clock_hz,
        "inputs": {**asdict(found.inputs), "cycles": found.inputs.cycles},
        "layers": [{**asdict(layer), "cycles": layer.cycles} for layer in found.layers],
        "decision_cycles": COMPARE_CYCLES,
        "mac_cycles": found.mac_cycles,
        "cycles": found.cycles,
        "utilisation": found.utilisation,
        "latency_ns": found.latency_ns(clock_hz),
        "paper_latency_ns": PAPER_LATENCY_NS,
        "buffer_bytes": found.buffer_bytes,
        "core_bytes": found.core_bytes,
        "core_refill_bytes": found.core_refill_bytes,
        "refill_bytes": found.refill_bytes,
    }


def cycles_table(found: Schedule) -> Table:
    """Lay out a schedule as a table, narrow enough for 80 columns."""
    rows = Table(box=box.SIMPLE)
    heads = ("stage", "MAC", "fill", "requant.", "cycles", "MACs used", "bytes", "refill")
    for head in heads:
        rows.add_column(head, justify="left" if head == "stage" else "right", no_wrap=True)
    first = found.inputs
    rows.add_row(
        *(f"input {first.numbers}", "-", str(first.fill_cycles), str(first.multiply_cycles)),
        *(str(first.cycles), "-", f"{first.parameter_bytes:,}", f"{first.refill_bytes:,}"),
    )
    for layer in found.layers:
        rows.add_row(
            *(f"{layer.fan_in} to {layer.neurons}", f"{layer.mac_cycles:,}"),
            *(str(layer.fill_cycles), str(layer.requantise_cycles), f"{layer.cycles:,}"),
            f"{layer.utilisation:.1%}",
            *(f"{layer.parameter_bytes:,}", f"{layer.refill_bytes:,}"),
        )
    rows.add_row("decision", "-", "-", "-", str(COMPARE_CYCLES), "-", "-", "-")
    rows.add_row("buffers", "-", "-", "-", "-", "-", f"{found.buffer_bytes:,}", "-")
    rows.add_row(
        *("total", f"{found.mac_cycles:,}", "", "", f"{found.cycles:,}"),
        *(
            f"{found.utilisation:.1%}",
            f"{found.core_bytes[0]:,}",
            f"{found.core_refill_bytes[0]:,}",
        ),
    )
    return rows


def cycles_lines(found: Schedule, clock_hz: float) -> list[str]:
    """Say what the table's totals come to."""
    array, total = found.array, sum(found.core_bytes)
    needed = found.mac_cycles / PAPER_LATENCY_NS
    cache = (
        f"caches: {found.core_bytes[0]:,} bytes for the fullest core, which has "
        f"{array.cache_bytes:,}; "
    )
    if found.refill_bytes:
        cache += (
            f"{found.refill_bytes:,} of all {total:,} bytes are fetched again for every inference, "
            f"{found.refill_bytes / found.cycles:.1f} a cycle"
        )
        if array.port_bytes:
            waits = sum(layer.refill_cycles for layer in found.layers)
            cache += (
                f", over a port of {array.port_bytes} for which MAC units wait {waits:,} cycles"
            )
    else:
        cache += "everything fits"
    return [
        f"{array.cores} cores with {array.macs} MACs and {array.pipeline_stages} pipeline stages; "
        "bytes and refill are those of core 0",
        f"latency: {found.cycles:,} cycles, {found.latency_ns(clock_hz):,.4g} ns at "
        f"{clock_hz / 1e9:,.4g} GHz",
        f"the paper states {PAPER_LATENCY_NS} ns: the {found.mac_cycles:,} MAC cycles alone would "
        f"need {needed:,.0f} GHz for that, so it cannot be a whole inference on these MACs",
        cache,
    ]
