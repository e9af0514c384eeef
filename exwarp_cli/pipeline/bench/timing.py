"""How long the steps of the work take, and how long each system takes for a frame."""

from __future__ import annotations

import os
import platform
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

from exwarp_cli.domain.bench import POLICY, TIMED
from exwarp_cli.pipeline.bench.opened import Opened
from exwarp_cli.pipeline.bench.pictures import FIXED_PATHS, Pictures, names_of
from exwarp_cli.pipeline.interval_inputs import IntervalInputs
from exwarp_cli.pipeline.scoring import SLOTS
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import METHODS
from exwarp_cli.synthesis.motion_fields import find_holes
from exwarp_cli.synthesis.warp import Mover

EXTRAPOLATED = (2, 3)
"""Slots that E is there for."""

MOVING = tuple(name for name, method in METHODS.items() if method.needs_motion)
"""Systems outside the decision tree among these need geometry, too."""

Milliseconds = dict[str, list[float]]


def time_subject(opened: Opened) -> dict[str, Any]:
    """Measure run times on a few key intervals, alone on the machine, with all threads.

    Returns
    -------
    dict
        ``steps_ms`` and ``systems_ms``: medians, milliseconds a generated frame; ``machine``.
    """
    steps: Milliseconds = defaultdict(list)
    systems: Milliseconds = defaultdict(list)
    opened.restart()
    chosen = _chosen(opened.keys)
    for count, key in enumerate(chosen):
        check_stop()
        if count and key == chosen[count - 1]:  # a lone interval is read again, with its features
            opened.restart()
        inputs = opened.load(key, lambda recipes: True)
        found = _interval(opened, inputs)
        if count == 0:  # compiled the kernels, and read what the next intervals share with it
            continue
        for name, value in found[0].items():
            steps[name].append(value)
        for name, value in found[1].items():
            systems[name].append(value)
    return {
        "steps_ms": {name: median(values) for name, values in steps.items()},
        "systems_ms": {name: median(values) for name, values in systems.items()},
        "machine": {"processor": processor(), "cores": os.cpu_count()},
    }


def processor() -> str:
    """Name of the processor, as far as the system tells it."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _chosen(keys: tuple[int, ...]) -> tuple[int, ...]:
    """Return a few neighbours from the middle: the first is for warming up."""
    start = max(len(keys) // 2 - 1, 0)
    chosen = keys[start : start + TIMED + 1]
    return chosen if len(chosen) > 1 else chosen * 2


def _interval(
    opened: Opened, inputs: IntervalInputs
) -> tuple[Mapping[str, float], Mapping[str, float]]:
    """Time the steps of one interval, and its systems; milliseconds a frame."""
    count = len(SLOTS)
    geometry, interval = timed(lambda: opened.interval(inputs))
    features, surroundings = timed(lambda: opened.look(inputs, interval))
    decide, path = timed(lambda: opened.decide(surroundings))
    found = {"read": inputs.read_ms / (count + 1), "geometry": geometry / count}
    found |= {"features": features / count, "decide": decide / count}
    found |= _steps(interval)
    paths = FIXED_PATHS | {POLICY: path}
    systems = {}
    for name in (*opened.settings.systems, *opened.networks.systems):
        path = paths.get(name)
        if path is None and name.startswith("oracle"):
            continue
        # A copy has none of the motion fields that were found before.
        pictures = opened.pictures(inputs, replace(interval))
        names = dict.fromkeys(names_of(name, path))
        spent, _ = timed(partial(_make, pictures, names))
        systems[name] = spent / count
        if name == POLICY:
            systems[name] += found["features"] + found["decide"]
        if path is not None or name in MOVING:
            systems[name] += found["geometry"]
    return found, systems


def _make(pictures: Pictures, names: Iterable[str]) -> None:
    for name in names:
        pictures[name]


def _steps(interval: Interval) -> dict[str, float]:
    """Time what a warped and an extrapolated frame are made of."""
    fresh, count, key = replace(interval), len(SLOTS), interval.key.gbuffer
    fields, backs = timed(lambda: {slot: fresh.back(slot) for slot in SLOTS})
    holes = None
    if fresh.slots and key is not None:
        holes, _ = timed(
            lambda: [find_holes(fresh.slots[s - 1], key, backs[s].field, s) for s in SLOTS]
        )
    moved, _ = timed(lambda: [Mover(backs[s]).warp_alone(interval.key.image.pixels) for s in SLOTS])
    found = {"warp": (fields + moved - (holes or 0.0)) / count}
    if holes is not None:
        found["holes"] = holes / count
    network = fresh.extrapolator
    if network is not None:
        inputs, prepared = timed(lambda: [fresh.prepared(slot) for slot in EXTRAPOLATED])
        spent, _ = timed(lambda: [network(p.inputs) for p in prepared])
        found |= {"inputs": inputs / len(EXTRAPOLATED), "network": spent / len(EXTRAPOLATED)}
    return found


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    """Return how many milliseconds some work took, and what came out."""
    begin = time.perf_counter()
    result = work()
    return 1e3 * (time.perf_counter() - begin), result
