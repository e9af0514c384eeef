"""What ``exwarp features``, ``exwarp policy`` and ``exwarp upsample --dry-run`` print."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from exwarp_cli import __version__
from exwarp_cli.accelerator.mac_array import COMPARE_CYCLES, PAPER_LATENCY_NS, Schedule
from exwarp_cli.accelerator.mlp import MAX_ACTIVATION, ONE
from exwarp_cli.domain.decision import CHOICES, FEATURES
from exwarp_cli.domain.results import FrameKind
from exwarp_cli.domain.timeline import ranges
from exwarp_cli.domain.wording import pluralise
from exwarp_cli.report.schema import run_document

# Types alone: each of these brings what its command needs, and the others do without.
if TYPE_CHECKING:
    from rich.table import Table

    from exwarp_cli.pipeline.decide import NodeFeatures
    from exwarp_cli.pipeline.dry_run import DryRun, ForeseenFrame
    from exwarp_cli.pipeline.predictor import Trace

FEATURES_SCHEMA = "exwarp.features/1"
CYCLES_SCHEMA = "exwarp.cycles/1"
TRACE_SCHEMA = "exwarp.policy-trace/1"
DRY_RUN_SCHEMA = "exwarp.dry-run/1"

# Numbers of each layer that a trace shows to people.
MAX_NUMBERS = 8

# Characters of a list of frames in a line; generated ones lie between all others.
MAX_RANGES = 60

# Kinds of frames that a dry run foresees, and what lines call them.
KINDS = {
    FrameKind.KEY: "rendered",
    FrameKind.RENDERED: "rendered after all",
    FrameKind.GENERATED: "generated",
}


def feature_row(observed: NodeFeatures) -> dict[str, Any]:
    """Return a row of the table of features, by column."""
    return {
        "frame": observed.frame,
        "key": observed.key,
        "node": observed.node,
        **dict(zip(FEATURES, observed.features.values, strict=True)),
        "distance": observed.features.distance,
        "inputs": observed.inputs,
    }


def cycles_document(schedule: Schedule, clock_hz: float) -> dict[str, Any]:
    """Turn a schedule into the dictionary that is printed as JSON."""
    return {
        "schema": CYCLES_SCHEMA,
        "machine": asdict(schedule.array),
        "sizes": schedule.sizes,
        "clock_hz": clock_hz,
        "inputs": asdict(schedule.inputs),
        "layers": [asdict(layer) for layer in schedule.layers],
        "decision_cycles": COMPARE_CYCLES,
        "mac_cycles": schedule.mac_cycles,
        "cycles": schedule.cycles,
        "utilisation": schedule.utilisation,
        "latency_ns": schedule.latency_ns(clock_hz),
        "paper_latency_ns": PAPER_LATENCY_NS,
        "buffer_bytes": schedule.buffer_bytes,
        "core_bytes": schedule.core_bytes,
        "core_refill_bytes": schedule.core_refill_bytes,
        "refill_bytes": schedule.refill_bytes,
    }


def cycles_table(schedule: Schedule) -> Table:
    """Lay out a schedule as a table, narrow enough for 80 columns."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE)
    for head in ("stage", "MAC", "fill", "requant.", "cycles", "MACs used", "bytes", "refill"):
        table.add_column(head, justify="left" if head == "stage" else "right", no_wrap=True)
    stage = schedule.inputs
    table.add_row(
        *(f"input {stage.numbers}", "-", str(stage.fill_cycles), str(stage.multiply_cycles)),
        *(str(stage.cycles), "-", f"{stage.parameter_bytes:,}", f"{stage.refill_bytes:,}"),
    )
    for layer in schedule.layers:
        parameter_bytes = layer.weight_bytes + layer.bias_bytes + layer.scale_bytes
        table.add_row(
            *(f"{layer.fan_in} to {layer.neurons}", f"{layer.mac_cycles:,}"),
            *(str(layer.fill_cycles), str(layer.requantise_cycles), f"{layer.cycles:,}"),
            f"{layer.utilisation:.1%}",
            *(f"{parameter_bytes:,}", f"{layer.refill_bytes:,}"),
        )
    table.add_row("decision", "-", "-", "-", str(COMPARE_CYCLES), "-", "-", "-")
    table.add_row("buffers", "-", "-", "-", "-", "-", f"{schedule.buffer_bytes:,}", "-")
    table.add_row(
        *("total", f"{schedule.mac_cycles:,}", "", "", f"{schedule.cycles:,}"),
        f"{schedule.utilisation:.1%}",
        *(f"{schedule.core_bytes[0]:,}", f"{schedule.core_refill_bytes[0]:,}"),
    )
    return table


def cycles_lines(schedule: Schedule, clock_hz: float) -> list[str]:
    """Say what the table's totals come to."""
    array, refill = schedule.array, schedule.refill_bytes
    cache = (
        f"caches: {schedule.core_bytes[0]:,} bytes for the fullest core, which has "
        f"{array.cache_bytes:,}; "
    )
    if refill:
        cache += (
            f"{refill:,} of all {sum(schedule.core_bytes):,} bytes are fetched again for every "
            f"inference, {refill / schedule.cycles:.1f} a cycle"
        )
        if array.port_bytes:
            waits = sum(layer.refill_cycles for layer in schedule.layers)
            cache += (
                f", over a port of {array.port_bytes} for which MAC units wait {waits:,} cycles"
            )
    else:
        cache += "everything fits"
    return [
        f"{array.cores} cores with {array.macs} MACs and {array.pipeline_stages} pipeline stages; "
        "bytes and refill are those of core 0",
        f"latency: {schedule.cycles:,} cycles, {schedule.latency_ns(clock_hz):,.4g} ns at "
        f"{clock_hz / 1e9:,.4g} GHz",
        f"the paper states {PAPER_LATENCY_NS} ns: the {schedule.mac_cycles:,} MAC cycles alone "
        f"would need {schedule.mac_cycles / PAPER_LATENCY_NS:,.0f} GHz for that, so it cannot be a "
        "whole inference on these MACs",
        cache,
    ]


def trace_document(trace: Trace) -> dict[str, Any]:
    """Return an inference with every number on the way.

    ``state`` is in Q16.16, ``inputs`` and ``activations`` are int8, ``accumulators`` int32 with
    biases; the last layer has no activations, as its accumulators are the outputs.
    """
    inference, schedule = trace.inference, trace.schedule
    warp, extrapolate = inference.outputs.tolist()
    activations = [values.tolist() for values in inference.activations] + [None]
    return {
        "schema": TRACE_SCHEMA,
        "version": __version__,
        "row": trace.row.row,
        **trace.row.identity,
        "state": trace.row.state.tolist(),
        "inputs": inference.inputs.tolist(),
        "input_cycles": schedule.inputs.cycles,
        "layers": [
            {
                "fan_in": layer.fan_in,
                "neurons": layer.neurons,
                "cycles": layer.cycles,
                "accumulators": sums.tolist(),
                "activations": values,
            }
            for layer, sums, values in zip(
                schedule.layers, inference.accumulators, activations, strict=True
            )
        ],
        "output_warp": warp,
        "output_extrapolate": extrapolate,
        "decision": CHOICES[int(inference.choices)],
        "decision_cycles": COMPARE_CYCLES,
        "cycles": schedule.cycles,
    }


def trace_lines(trace: Trace) -> Iterator[str]:
    """Describe an inference layer by layer."""
    inference, schedule, state = trace.inference, trace.schedule, trace.row.state
    identity = ", ".join(f"{name} {value}" for name, value in trace.row.identity.items() if value)
    yield f"row {trace.row.row}{f' ({identity})' if identity else ''}"
    yield f"input stage: {inference.inputs.size} numbers, {schedule.inputs.cycles} cycles"
    yield f"  Q16.16 {_first_numbers(state)}"
    yield f"  as     {' '.join(f'{value:.4f}' for value in state[:MAX_NUMBERS] / ONE)}"
    yield f"  int8   {_first_numbers(inference.inputs)}"
    for k, (layer, sums) in enumerate(zip(schedule.layers, inference.accumulators, strict=True)):
        yield f"layer {k}: {layer.fan_in} to {layer.neurons}, {layer.cycles} cycles"
        yield f"  accumulators {int(sums.min())} to {int(sums.max())}"
        yield f"  int32  {_first_numbers(sums)}"
        if k < len(inference.activations):
            values = inference.activations[k]
            yield f"  int8   {_first_numbers(values)}"
            zeros, saturated = int((values == 0).sum()), int((values == MAX_ACTIVATION).sum())
            yield f"  {zeros} are 0, {saturated} saturate at {MAX_ACTIVATION}"
    warp, extrapolate = inference.outputs.tolist()
    yield f"outputs: warp {warp}, extrapolate {extrapolate}"
    yield f"decision: {CHOICES[int(inference.choices)]}, {COMPARE_CYCLES} cycle"
    yield f"in all {schedule.cycles} cycles on the paper's machine"


def _first_numbers(values: npt.NDArray[np.integer[Any]]) -> str:
    more = " …" if values.size > MAX_NUMBERS else ""
    return " ".join(str(value) for value in values[:MAX_NUMBERS].tolist()) + more


def dry_run_document(plan: DryRun) -> dict[str, Any]:
    """Turn what a run would do into the dictionary that is printed as JSON.

    Frames are given as ranges of numbers; the rest has the names that report.json gives it.
    """
    from exwarp_cli.pipeline.dry_run import Fate

    head = run_document(plan.head)
    shared = ("version", "method", "setting", "lookahead", "input", "views", "layers")
    paths = {"output": plan.output, "holes": plan.holes, "video": plan.video}
    paths |= {"report": plan.report}
    groups = {
        **{kind.value: [f.number for f in plan.frames if f.kind is kind] for kind in KINDS},
        **{fate.value: [f.number for f in plan.frames if f.fate is fate] for fate in Fate},
    }
    frames = {n: {"count": len(group), "numbers": ranges(group)} for n, group in groups.items()}
    return {
        "schema": DRY_RUN_SCHEMA,
        **{name: head[name] for name in shared},
        "fps": {name: head["fps"][name] for name in ("base", "output", "source", "factor")},
        "frames": {"count": len(plan.frames), **frames},
        **{name: None if path is None else str(path) for name, path in paths.items()},
        **{name: head[name] for name in ("extrapolator", "policy", "interpolator")},
        "cuts": {
            "detect": plan.cuts_looked_for,
            "known": [{"frame": cut.number, "source": cut.source} for cut in plan.cuts],
        },
        "spread": plan.spread,
        "chunks": [ranges(list(chunk)) for chunk in plan.chunks],
    }


def dry_run_lines(plan: DryRun) -> list[str]:
    """Say in a few lines what a run would do."""
    from exwarp_cli.pipeline.dry_run import Fate

    place = plan.output or plan.video
    count = "no frame"
    if plan.frames:
        count = f"{pluralise(len(plan.frames), 'frame')}, {_short_ranges(plan.frames)},"
    lines = [f"dry run, nothing is written: {count} in {place}"]
    for kind, words in KINDS.items():
        if frames := [f for f in plan.frames if f.kind is kind]:
            lines.append(f"  {len(frames)} {words}: {_short_ranges(frames)}")
    for fate, words in ((Fate.REPLACE, "replaced"), (Fate.KEEP, "there already and kept")):
        if frames := [f for f in plan.frames if f.fate is fate]:
            lines.append(f"  {len(frames)} of them {words}: {_short_ranges(frames)}")
    paths = {"hole masks": plan.holes, "video": plan.video, "report": plan.report}
    lines += [f"{name} in {path}" for name, path in paths.items() if path not in (None, place)]
    head = plan.head
    lines.append(f"method {head.method}; {head.base_fps:g} fps in, {head.output_fps:g} out")
    if plan.cuts or plan.cuts_looked_for:
        cuts = ", ".join(f"{cut.number} ({cut.source})" for cut in plan.cuts)
        search = "looked for on the way" if plan.cuts_looked_for else ""
        lines.append(f"cuts: {'; '.join(text for text in (cuts, search) if text)}")
    else:
        lines.append("cuts: none are looked for")
    if plan.spread is not None:
        sizes = " or ".join(map(str, sorted({len(chunk) for chunk in plan.chunks})))
        chunks = pluralise(len(plan.chunks), "chunk")
        lines.append(f"{plan.spread}: {chunks} of {sizes} key frames")
    return lines


def _short_ranges(frames: Iterable[ForeseenFrame]) -> str:
    text = ranges([frame.number for frame in frames])
    return text if len(text) <= MAX_RANGES else f"{text[:MAX_RANGES].rpartition(',')[0]} …"
