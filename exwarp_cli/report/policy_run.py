"""What ``exwarp policy run`` prints: decisions and traces, for people and as JSON."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from exwarp_cli import __version__
from exwarp_cli.accelerator.fixed_point import MAX_ACTIVATION, from_fixed
from exwarp_cli.accelerator.mac_array import COMPARE_CYCLES
from exwarp_cli.domain.decision import CHOICES
from exwarp_cli.pipeline.accelerator import Decided, Trace
from exwarp_cli.report.frames_csv import table

DECISIONS, TRACE = "exwarp.policy-decisions/1", "exwarp.policy-trace/1"
"""Schemas of the JSON documents."""

SHOWN = 8
"""Numbers of each layer that a trace shows to people."""


def decisions_document(rows: list[Decided]) -> dict[str, Any]:
    """Return all rows under ``rows``, keys and values as in :func:`decisions_csv`."""
    header = _header(rows)
    return {
        "schema": DECISIONS,
        "version": __version__,
        "rows": [dict(zip(header, _values(found), strict=True)) for found in rows],
    }


def trace_document(trace: Trace) -> dict[str, Any]:
    """Return an inference with every number on the way.

    ``state`` is in Q16.16, ``inputs`` and ``activations`` are int8, ``accumulators`` int32 with
    biases; the last layer has no activations, as its accumulators are the outputs.
    """
    found, plan = trace.inference, trace.schedule
    outputs = found.outputs.tolist()
    return {
        "schema": TRACE,
        "version": __version__,
        "row": trace.row.row,
        **trace.row.identity,
        "state": trace.row.state.tolist(),
        "inputs": found.inputs.tolist(),
        "input_cycles": plan.inputs.cycles,
        "layers": [
            {
                "fan_in": layer.fan_in,
                "neurons": layer.neurons,
                "cycles": layer.cycles,
                "accumulators": sums.tolist(),
                "activations": found.activations[k].tolist()
                if k < len(found.activations)
                else None,
            }
            for k, (layer, sums) in enumerate(zip(plan.layers, found.accumulators, strict=True))
        ],
        "output_warp": outputs[0],
        "output_extrapolate": outputs[1],
        "decision": CHOICES[int(found.choices)],
        "decision_cycles": COMPARE_CYCLES,
        "cycles": plan.cycles,
    }


def decisions_csv(rows: list[Decided]) -> str:
    """Write decisions as CSV text: which row, its outputs, and the choice."""
    return table(_header(rows), map(_values, rows))


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
            zeros, most = int((values == 0).sum()), int((values == MAX_ACTIVATION).sum())
            yield f"  {zeros} are 0, {most} saturate at {MAX_ACTIVATION}"
    warp, extrapolate = found.outputs.tolist()
    yield f"outputs: warp {warp}, extrapolate {extrapolate}"
    yield f"decision: {CHOICES[int(found.choices)]}, {COMPARE_CYCLES} cycle"
    yield f"in all {plan.cycles} cycles on the paper's machine"


def _header(rows: list[Decided]) -> tuple[str, ...]:
    """Name the columns; all rows of a table have those of the first."""
    return ("row", *rows[0].row.identity, "output_warp", "output_extrapolate", "decision")


def _values(found: Decided) -> tuple[Any, ...]:
    row = found.row
    return (row.row, *row.identity.values(), *found.outputs, CHOICES[found.choice])


def _first(values: npt.NDArray[np.integer[Any]]) -> str:
    """Write the first numbers."""
    more = " …" if values.size > SHOWN else ""
    return " ".join(str(value) for value in values[:SHOWN].tolist()) + more
