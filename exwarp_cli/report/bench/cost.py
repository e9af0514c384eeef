"""What frames cost: run times of the steps, the predictor, and what a farm saves."""

from __future__ import annotations

import json
from dataclasses import asdict
from importlib import resources

from exwarp_cli.accelerator import verilog
from exwarp_cli.accelerator.mac_array import Schedule
from exwarp_cli.domain.decision import HOLD
from exwarp_cli.pipeline.bench.work import Measured
from exwarp_cli.pipeline.scoring import SLOTS
from exwarp_cli.report.bench import paper
from exwarp_cli.report.bench.naming import Document, identify
from exwarp_cli.report.bench.quality import shown


def runtime_row(one: Measured) -> Document:
    """Return a row of Table III: milliseconds a generated frame."""
    steps, row = one.timing["steps_ms"], identify(one)
    gbuffer = one.about["render_s"]["gbuffer"]
    printed = paper.RUNTIME.get(row["app"])
    return row | {
        "gbuffer_ms": None if gbuffer is None else 1e3 * gbuffer,
        "warping_ms": steps["warp"],
        "hole_marking_ms": steps.get("holes"),
        "inference_ms": steps.get("network"),
        "others_ms": {
            name: value for name, value in steps.items() if name not in ("warp", "holes", "network")
        },
        "paper": None if printed is None else asdict(printed),
    }


def predictor_cost(plan: Schedule, clock_hz: float) -> Document:
    """Return the synthesis table: ours, counted or measured by `make hardware`, and the paper's."""
    return {
        "clock_hz": clock_hz,
        "cycles": plan.cycles,
        "mac_cycles": plan.mac_cycles,
        "utilisation": plan.utilisation,
        "latency_ns": plan.latency_ns(clock_hz),
        "memory_bytes": sum(plan.core_bytes),
        "fullest_core_bytes": max(plan.core_bytes),
        "cache_bytes": plan.array.cache_bytes,
        "refill_bytes": plan.refill_bytes,
        "synthesis": synthesised(),
        "paper": {
            "area_mm2": paper.AREA_MM2,
            "power_mw": paper.POWER_MW,
            "latency_ns": paper.LATENCY_NS,
        },
    }


def synthesised() -> Document:
    """Return what `make hardware` measured of the design."""
    text = resources.files(verilog).joinpath("measured.json").read_text(encoding="utf-8")
    found: Document = json.loads(text)
    return found


def render_time_row(one: Measured) -> Document:
    """Return what rendering a frame took beside making one, in seconds, and what that saves."""
    rendered, spent = one.about["render_s"]["key"], one.timing["systems_ms"]
    made = {name: ms / 1e3 for name, ms in spent.items()}
    row = identify(one) | {"key_frame_s": rendered, "generated_frame_s": made}
    if rendered is None:
        return row | {"times_faster": None, "saved_share": None}
    return row | {
        "times_faster": {name: rendered / each for name, each in made.items() if each > 0},
        "saved_share": {name: saved_share(one, name, rendered, made[name]) for name in made},
    }


def saved_share(one: Measured, system: str, rendered: float, made: float) -> float:
    """Return the share of the render time that a system saves, files apart; below 0 for a loss.

    Parameters
    ----------
    rendered, made
        Seconds of a key frame, and of a slot of the system. Repeats cost time and save none, as
        they would not have been rendered.
    """
    new: float = sum(frame["made_by"] != HOLD for frame in shown(one, system)) / len(one.parts)
    return (new * rendered - len(SLOTS) * made) / ((1 + new) * rendered)
