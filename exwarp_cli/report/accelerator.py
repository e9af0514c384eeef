"""What ``exwarp policy`` prints: the schedule as tables and as JSON, decisions, and traces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np
import numpy.typing as npt
from rich import box
from rich.table import Table

from exwarp_cli.accel.fixed_point import MOST_ACTIVATION, from_fixed
from exwarp_cli.accel.mac_array import COMPARE_CYCLES, PAPER_LATENCY_NS, Schedule
from exwarp_cli.domain.decision import CHOICES
from exwarp_cli.io.states import IDENTITY
from exwarp_cli.pipeline.accelerator import Decided, Trace
from exwarp_cli.report.frames_csv import table
from exwarp_cli.report.summary import to_json

SCHEMA = "exwarp.cycles/1"

SHOWN = 8
"""Numbers of each layer that a trace shows."""


def cycles_json(found: Schedule, clock_hz: float) -> str:
    """Write a schedule as JSON text, schema ``exwarp.cycles/1``."""
    document = {
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
    return to_json(document)


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


def decisions_csv(rows: list[Decided]) -> str:
    """Write decisions as CSV text: which row, its outputs, and the choice."""
    names = [name for name in IDENTITY if name in rows[0].row.identity]
    header = ("row", *names, "output_warp", "output_extrapolate", "decision")
    return table(
        header,
        (
            (found.row.row, *found.row.identity.values(), *found.outputs, CHOICES[found.choice])
            for found in rows
        ),
    )


def trace_lines(trace: Trace) -> Iterator[str]:
    """Tell an inference layer by layer."""
    found, plan = trace.inference, trace.schedule
    named = ", ".join(f"{name} {value}" for name, value in trace.row.identity.items() if value)
    yield f"row {trace.row.row}{f' ({named})' if named else ''}"
    yield f"input stage: {found.inputs.size} numbers, {plan.inputs.cycles} cycles"
    yield f"  Q16.16 {_first(trace.row.state)}"
    yield f"  as     {' '.join(f'{value:.4f}' for value in from_fixed(trace.row.state)[:SHOWN])}"
    yield f"  int8   {_first(found.inputs)}"
    layers = zip(plan.layers, found.accumulators, strict=True)
    for k, (layer, sums) in enumerate(layers):
        yield f"layer {k}: {layer.fan_in} to {layer.neurons}, {layer.cycles} cycles"
        yield f"  accumulators {int(sums.min())} to {int(sums.max())}"
        yield f"  int32  {_first(sums)}"
        if k < len(found.activations):
            values = found.activations[k]
            yield f"  int8   {_first(values)}"
            zeros, most = int((values == 0).sum()), int((values == MOST_ACTIVATION).sum())
            yield f"  {zeros} are 0, {most} saturate at {MOST_ACTIVATION}"
    warp, extrapolate = found.outputs.tolist()
    yield f"outputs: warp {warp}, extrapolate {extrapolate}"
    yield f"decision: {CHOICES[int(found.choices)]}, {COMPARE_CYCLES} cycle"
    yield f"in all {plan.cycles} cycles on the paper's machine"


def _first(values: npt.NDArray[np.integer[Any]]) -> str:
    """Write the first numbers."""
    more = " …" if values.size > SHOWN else ""
    return " ".join(str(value) for value in values[:SHOWN].tolist()) + more
