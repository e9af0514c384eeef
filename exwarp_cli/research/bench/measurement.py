"""What is measured of one key interval: scores as a part, which JSON holds, and run times."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, astuple, dataclass, field, replace
from functools import partial
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from exwarp_cli import __version__
from exwarp_cli.domain.decision import CHOICES, NODE_SLOTS, NODES, PATHS
from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.domain.results import Score
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.io.footage import digest_frame
from exwarp_cli.metrics import temporal
from exwarp_cli.metrics.registry import score_frame, score_like_extranet
from exwarp_cli.pipeline.interval_inputs import IntervalInputs
from exwarp_cli.pipeline.scoring import Steps, flicker_of, steps_of, vmaf_of
from exwarp_cli.policy.outcomes import METRICS as JUDGED
from exwarp_cli.policy.outcomes import best_psnr, best_return, path_returns
from exwarp_cli.policy.state import plan_slots
from exwarp_cli.research.bench import systems
from exwarp_cli.research.bench.subjects import OpenedSubject, SystemFrames
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.synthesis.methods import METHODS
from exwarp_cli.synthesis.motion_fields import find_holes
from exwarp_cli.synthesis.warp import Mover

FrameScores = tuple[Score, Score | None]

# Raised whenever the same input would give other numbers.
PART_VERSION = 3

# The slot that ExtraNet makes: it doubles the frame rate.
MIDDLE = 2

# Key intervals of a sequence on which run times are measured; the medians count.
TIMED_INTERVALS = 3

# Slots that E is there for.
EXTRAPOLATED = (2, 3)

# Systems outside the decision tree among these need geometry, too.
MOVING = tuple(name for name, method in METHODS.items() if method.needs_motion)

Result = TypeVar("Result")


@dataclass
class IntervalScores:
    """Scores of pictures at the slots where they are shown; each is computed once."""

    frames: SystemFrames  # on the display window
    # Of slots 0 to 3, and 4 where there is one: float32 [H, W, 3 or more], scene-linear.
    truth: Mapping[int, Float32]
    masks: Mapping[int, Bool]  # bool [H, W], holes of W at slots 1 to 3
    steps: Steps | None  # how surfaces move; None where flicker is not measured
    metrics: frozenset[str]  # names as in `Score`
    _scores: dict[tuple[str, int], FrameScores] = field(default_factory=dict, init=False)
    _errors: dict[tuple[str, int], Float32] = field(default_factory=dict, init=False)

    def score(self, name: str, slot: int) -> FrameScores:
        """Score a picture shown at a slot, over all pixels and in holes; one by one frame."""
        if (name, slot) not in self._scores:
            self._scores[name, slot] = score_frame(
                self.truth[slot], self.frames[name], self.masks.get(slot), self.metrics
            )
        return self._scores[name, slot]

    def score_repeats(self, extrapolates: bool) -> dict[str, list[list[float] | None]]:
        """Return PSNR and SSIM of each picture of the tree at slots 1 to 3, as if repeated there.

        None stands before a picture's first slot. No other metric is computed.
        """
        by_picture: dict[str, list[list[float] | None]] = {}
        for name, first in systems.FIRST_SLOTS.items():
            if not extrapolates and "E" in name:
                continue
            by_picture[name] = [None] * (first - 1)
            for slot in range(first, FACTOR):
                frame, _ = self._scores.get((name, slot)) or score_frame(
                    self.truth[slot], self.frames[name], None, frozenset(JUDGED)
                )
                by_picture[name].append([getattr(frame, metric) for metric in JUDGED])
        return by_picture

    def add_vmaf(self, shown: Sequence[tuple[str, ...]]) -> None:
        """Add VMAF to the pictures that systems show, all in one run.

        VMAF looks at a frame and at how the ground truth changes around it, so every picture is
        scored once, in whatever order pictures are strung together.
        """
        columns = [sorted({names[slot - 1] for names in shown}) for slot in systems.SLOTS]
        most = max(map(len, columns))
        filled = [column + column[-1:] * (most - len(column)) for column in columns]
        rows = list(zip(*filled, strict=True))
        values = vmaf_of(self.truth, [[self.frames[name] for name in row] for row in rows])
        for row, row_values in zip(rows, values, strict=True):
            for slot, name, vmaf in zip(systems.SLOTS, row, row_values, strict=True):
                frame, holes = self.score(name, slot)
                self._scores[name, slot] = replace(frame, vmaf=vmaf), holes

    def score_system(self, names: tuple[str, ...]) -> list[FrameScores]:
        """Return the scores of slots 1 to 3 of a system that shows these pictures."""
        scores = [self.score(name, slot) for slot, name in zip(systems.SLOTS, names, strict=True)]
        if self.steps is None:
            return scores
        errors = {}
        for slot, name in zip(systems.SLOTS, names, strict=True):
            if (name, slot) not in self._errors:
                self._errors[name, slot] = temporal.display_error(
                    self.truth[slot], self.frames[name]
                )
            errors[slot] = self._errors[name, slot]
        flickers = flicker_of(errors, self.masks, self.steps)
        return [
            (replace(frame, flicker=over), holes and replace(holes, flicker=inside))
            for (frame, holes), (over, inside) in zip(scores, flickers, strict=True)
        ]

    def outcomes(self) -> npt.NDArray[np.float64]:
        """Return what each choice of the decision tree leads to: see `policy.outcomes`."""
        rows = []
        for node, choice in product(NODES, CHOICES):
            slot = NODE_SLOTS[node]
            path = next(path for path in PATHS.values() if path.choices.get(node) == choice)
            frame, _ = self.score(systems.picture_at(path.made_by, slot), slot)
            rows.append([getattr(frame, name) for name in JUDGED])
        return np.array(rows, np.float64).reshape(len(NODES), len(CHOICES), len(JUDGED))


def part_identity(opened: OpenedSubject, key: int, recipes: Mapping[int, str]) -> str:
    """Return what a part depends on, digested: files, networks, systems and metrics."""
    settings = opened.settings
    dependencies = {
        "version": [PART_VERSION, __version__],
        "recipes": sorted(recipes.items()),
        "truth": [
            digest_frame(opened.truth_sequence, n) for n in opened.truth_numbers(key).values()
        ],
        "networks": sorted(opened.networks.checksums.items()),
        "policy": opened.policy.checksum,
        "systems": opened.systems,
        "metrics": sorted(settings.metrics),
        "device": settings.device,
    }
    return hashlib.sha256(json.dumps(dependencies).encode()).hexdigest()


def measure(opened: OpenedSubject, inputs: IntervalInputs) -> dict[str, Any]:
    """Make and score the frames of slots 1 to 3 by every system.

    Return ``key``, the key frame's number; ``holes``, the share of slots 1 to 3 that W cannot see;
    ``features`` of the three instants of decision; ``paths`` of the choosing systems; ``returns``
    of S1 to S6; ``warp_psnr_db`` of W at slots 1 to 3; ``systems``, for each the scores of its
    three frames; ``extranet``, scores of pictures by ExtraNet's procedure; ``slot_scores``, which a
    clock needs: see `IntervalScores.score_repeats`.
    """
    interval = opened.builder.build(inputs)
    surroundings = opened.observer.of(inputs, interval)
    metrics = frozenset((*opened.settings.metrics, *JUDGED))
    masks, display = opened.masks(interval), opened.display
    frames, truth = SystemFrames(opened, inputs, interval), opened.truth(inputs.key)
    steps = steps_of(interval, display, inputs.followed) if "flicker" in metrics else None
    scores = IntervalScores(frames, truth, masks, steps, metrics)

    paths = {name: path for name, path in systems.FIXED_PATHS.items() if name in opened.systems}
    paths[systems.POLICY] = plan_slots(opened.chooser, surroundings).path
    gains = None
    if opened.networks.own is not None:
        outcomes = scores.outcomes()
        names = tuple(PATHS)
        paths[systems.BEST_PSNR] = names[int(best_psnr(outcomes))]
        paths[systems.BEST_RETURN] = names[int(best_return(outcomes))]
        gains = [float(value) for value in path_returns(outcomes)]

    shown = {name: systems.pictures_of(name, paths.get(name)) for name in opened.systems}
    if "vmaf" in metrics:
        scores.add_vmaf(list(shown.values()))
    # A path that has E's frame at slot 2 stands for ExtraNet.
    middles = {names[MIDDLE - 1] for names in shown.values()}
    by_extranet = {name: score_like_extranet(truth[MIDDLE], frames[name]) for name in middles}
    return {
        "key": opened.numbers[inputs.key],
        "holes": [float(masks[slot].mean()) if slot in masks else None for slot in systems.SLOTS],
        "features": [[float(v) for v in astuple(features)] for features in surroundings.now],
        "paths": {name: paths[name] for name in systems.CHOOSERS if name in paths},
        "returns": gains,
        "warp_psnr_db": [scores.score(f"W{slot}", slot)[0].psnr_db for slot in systems.SLOTS],
        "systems": {
            system: [
                {"made_by": maker, "all": asdict(frame), "holes": holes and asdict(holes)}
                for (frame, holes), maker in zip(
                    scores.score_system(names),
                    systems.makers_of(system, paths.get(system)),
                    strict=True,
                )
            ]
            for system, names in shown.items()
        },
        "extranet": {
            system: {name: getattr(by_extranet[names[MIDDLE - 1]], name) for name in JUDGED}
            for system, names in shown.items()
        },
        "slot_scores": scores.score_repeats(extrapolates=gains is not None),
    }


def timed_keys(opened: OpenedSubject) -> tuple[int, ...]:
    """Return the key intervals that run times are measured on: a few neighbours of the middle.

    The first of them is not counted; a lone interval comes twice.
    """
    start = max(len(opened.keys) // 2 - 1, 0)
    keys = tuple(opened.keys[start : start + TIMED_INTERVALS + 1])
    return keys * 2 if len(keys) == 1 else keys


def time_subject(opened: OpenedSubject, report: Callable[[int], None]) -> dict[str, Any]:
    """Measure run times on `timed_keys`, alone on the machine, with all threads.

    `report` is called with each of these intervals when it is done. Return ``steps_ms`` and
    ``systems_ms``, medians, milliseconds a generated frame; and ``machine``.
    """
    steps: dict[str, list[float]] = defaultdict(list)
    systems_ms: dict[str, list[float]] = defaultdict(list)
    keys = timed_keys(opened)
    for count, key in enumerate(keys):
        check_stop()
        if count and key == keys[count - 1]:  # a lone interval is read again, with its features
            opened.restart()
        measured = _time_interval(opened, opened.reader.read(key))
        report(key)
        if count == 0:  # compiled the kernels, and read what the next intervals share with it
            continue
        for values, times in zip((steps, systems_ms), measured, strict=True):
            for name, ms in times.items():
                values[name].append(ms)
    opened.restart()
    processor = platform.processor() or platform.machine()
    with suppress(OSError):  # the name, as far as the system has it
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        models = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
        processor = next(models, processor)
    return {
        "steps_ms": {name: median(values) for name, values in steps.items()},
        "systems_ms": {name: median(values) for name, values in systems_ms.items()},
        "machine": {"processor": processor, "cores": os.cpu_count()},
    }


def _time_interval(
    opened: OpenedSubject, inputs: IntervalInputs
) -> tuple[dict[str, float], dict[str, float]]:
    """Time the steps of one interval, and its systems; milliseconds a frame."""
    count = len(systems.SLOTS)
    geometry_ms, interval = _timed(lambda: opened.builder.build(inputs))
    features_ms, surroundings = _timed(lambda: opened.observer.of(inputs, interval))
    decide_ms, decided = _timed(lambda: plan_slots(opened.chooser, surroundings).path)
    steps = {
        "read": inputs.read_ms / (count + 1),
        "geometry": geometry_ms / count,
        "features": features_ms / count,
        "decide": decide_ms / count,
    }
    # What a warped and an extrapolated frame are made of.
    fresh, gbuffer, pixels = replace(interval), interval.key.gbuffer, interval.key.image.pixels
    fields_ms, backs = _timed(lambda: {slot: fresh.back(slot) for slot in systems.SLOTS})
    warp_ms, _ = _timed(lambda: [Mover(back).warp_alone(pixels) for back in backs.values()])
    steps["warp"] = (fields_ms + warp_ms) / count
    if fresh.slots and gbuffer is not None:
        holes_ms, _ = _timed(
            lambda: [
                find_holes(fresh.slots[s - 1], gbuffer, back.field, s) for s, back in backs.items()
            ]
        )
        # Holes come with the motion fields, and are stated by themselves.
        steps["holes"] = holes_ms / count
        steps["warp"] -= steps["holes"]
    network = fresh.extrapolator
    if network is not None:
        inputs_ms, prepared = _timed(lambda: [fresh.prepared(slot) for slot in EXTRAPOLATED])
        network_ms, _ = _timed(lambda: [network(p.inputs) for p in prepared])
        steps["inputs"] = inputs_ms / len(EXTRAPOLATED)
        steps["network"] = network_ms / len(EXTRAPOLATED)
    paths = systems.FIXED_PATHS | {systems.POLICY: decided}
    systems_ms = {}
    for name in opened.systems:
        path = paths.get(name)
        if path is None and name in systems.CHOOSERS:
            continue
        # A copy has none of the motion fields that were computed before.
        frames = SystemFrames(opened, inputs, replace(interval))
        pictures = dict.fromkeys(systems.pictures_of(name, path))
        spent_ms, _ = _timed(partial(list, map(frames.__getitem__, pictures)))
        systems_ms[name] = spent_ms / count
        if name == systems.POLICY:
            systems_ms[name] += steps["features"] + steps["decide"]
        if path is not None or name in MOVING:
            systems_ms[name] += steps["geometry"]
    return steps, systems_ms


def _timed(work: Callable[[], Result]) -> tuple[float, Result]:
    """Return how many milliseconds some work took, and its result."""
    begin = time.perf_counter()
    result = work()
    return 1e3 * (time.perf_counter() - begin), result
