"""What is measured of one key interval, as a dictionary that JSON holds: a part."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from exwarp_cli import __version__
from exwarp_cli.domain.bench import BEST_PSNR, BEST_RETURN, CHOOSERS, POLICY
from exwarp_cli.domain.decision import CHOICES, NODES, PATHS
from exwarp_cli.domain.decision import NODE_SLOTS as SLOT_OF
from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.domain.results import Score
from exwarp_cli.metrics import extranet_scores
from exwarp_cli.metrics.registry import score_frame
from exwarp_cli.metrics.temporal import display_error
from exwarp_cli.pipeline.bench.opened import Opened
from exwarp_cli.pipeline.bench.pictures import (
    FIRST_SLOTS,
    FIXED_PATHS,
    Pictures,
    makers_of,
    name_on,
    names_of,
)
from exwarp_cli.pipeline.interval_inputs import IntervalInputs
from exwarp_cli.pipeline.scoring import SLOTS, Steps, flicker_of, steps_of, vmaf_of
from exwarp_cli.policy.outcomes import METRICS as JUDGED
from exwarp_cli.policy.outcomes import best_psnr, best_return, path_returns

Scored = tuple[Score, Score | None]

MIDDLE = 2
"""The slot that ExtraNet makes: it doubles the frame rate."""


@dataclass
class Scores:
    """Scores of pictures at the slots where they are shown; each is found once.

    Attributes
    ----------
    pictures
        Of the interval, on the display window.
    truth
        Ground truth of slots 0 to 3, and 4 where there is one: float32 [H, W, 3 or more],
        scene-linear, on the display window.
    masks
        bool [H, W], holes of W at slots 1 to 3, on the display window.
    steps
        How surfaces move through the interval; None where flicker is not measured.
    metrics
        Names as in `Score`.
    """

    pictures: Pictures
    truth: Mapping[int, Float32]
    masks: Mapping[int, Bool]
    steps: Steps | None
    metrics: frozenset[str]
    _scored: dict[tuple[str, int], Scored] = field(default_factory=dict, init=False)
    _errors: dict[tuple[str, int], Float32] = field(default_factory=dict, init=False)

    def of(self, name: str, slot: int) -> Scored:
        """Score a picture shown at a slot, over all pixels and in holes; one by one frame."""
        if (name, slot) not in self._scored:
            self._scored[name, slot] = score_frame(
                self.truth[slot], self.pictures[name], self.masks.get(slot), self.metrics
            )
        return self._scored[name, slot]

    def add_vmaf(self, shown: Sequence[tuple[str, ...]]) -> None:
        """Add VMAF to the pictures of some systems, all in one go.

        VMAF looks at a frame and at how the ground truth changes around it, so every picture is
        scored once, in whatever order pictures are strung together.
        """
        if "vmaf" not in self.metrics:
            return
        columns = [sorted({names[slot - 1] for names in shown}) for slot in SLOTS]
        most = max(map(len, columns))
        filled = [column + column[-1:] * (most - len(column)) for column in columns]
        rows = list(zip(*filled, strict=True))
        found = vmaf_of(self.truth, [[self.pictures[name] for name in row] for row in rows])
        for row, values in zip(rows, found, strict=True):
            for slot, name, value in zip(SLOTS, row, values, strict=True):
                everywhere, holes = self.of(name, slot)
                self._scored[name, slot] = replace(everywhere, vmaf=value), holes

    def system(self, names: tuple[str, ...]) -> list[Scored]:
        """Return the scores of slots 1 to 3 of a system that shows these pictures."""
        found = [self.of(name, slot) for slot, name in zip(SLOTS, names, strict=True)]
        if self.steps is None:
            return found
        errors = {slot: self._error(name, slot) for slot, name in zip(SLOTS, names, strict=True)}
        flickers = flicker_of(errors, self.masks, self.steps)
        return [
            (replace(everywhere, flicker=over), holes and replace(holes, flicker=inside))
            for (everywhere, holes), (over, inside) in zip(found, flickers, strict=True)
        ]

    def _error(self, name: str, slot: int) -> Float32:
        if (name, slot) not in self._errors:
            self._errors[name, slot] = display_error(self.truth[slot], self.pictures[name])
        return self._errors[name, slot]

    def outcomes(self) -> npt.NDArray[np.float64]:
        """Return what each choice of the decision tree leads to: see `policy.outcomes`."""
        return np.array(
            [[self._quality(node, choice) for choice in CHOICES] for node in NODES], np.float64
        )

    def as_extranet(self, name: str) -> Score:
        """Score a picture shown midway between key frames as ExtraNet's authors do."""
        return extranet_scores.score_like_extranet(self.truth[MIDDLE], self.pictures[name])

    def _quality(self, node: str, choice: str) -> list[float]:
        path = next(path for path in PATHS.values() if path.choices.get(node) == choice)
        everywhere, _ = self.of(name_on(path.made_by, SLOT_OF[node]), SLOT_OF[node])
        return [getattr(everywhere, name) for name in JUDGED]


SLOT_SCORES = "slot_scores"
"""What a part has besides where a clock is asked for: see `_slot_scores`."""

PART_VERSION = 1
"""Raised whenever the same input would give other numbers."""


def identity(opened: Opened, key: int, recipes: Mapping[int, str]) -> str:
    """Return what a part depends on, digested: files, networks, systems and metrics."""
    settings = opened.settings
    dependencies = {
        "version": [PART_VERSION, __version__],
        "recipes": sorted(recipes.items()),
        "truth": opened.truth_digests(key),
        "networks": sorted(opened.networks.checksums.items()),
        "policy": opened.policy.checksum,
        "systems": [*settings.systems, *opened.networks.systems],
        "metrics": sorted(settings.metrics),
        "device": settings.device,
    }
    return hashlib.sha256(json.dumps(dependencies).encode()).hexdigest()


def measure(opened: Opened, inputs: IntervalInputs) -> dict[str, Any]:
    """Make and score the frames of slots 1 to 3 by every system.

    Returns
    -------
    dict
        ``key``, the key frame's number; ``holes``, the share of slots 1 to 3 that W cannot see;
        ``features`` of the three instants of decision; ``paths`` of the choosing systems;
        ``returns`` of S1 to S6; ``warp_psnr_db`` of W at slots 1 to 3; ``systems``, for each the
        scores of its three frames; ``extranet``, scores of pictures by ExtraNet's procedure. With
        a clock ``slot_scores`` as well.
    """
    interval = opened.interval(inputs)
    surroundings = opened.look(inputs, interval)
    wanted = frozenset((*opened.settings.metrics, *JUDGED))
    masks, display = opened.masks(interval), opened.source.keys.display
    scores = Scores(
        opened.pictures(inputs, interval),
        opened.truth(inputs.key),
        masks,
        steps_of(interval, display, inputs.followed) if "flicker" in wanted else None,
        wanted,
    )
    paths, gains = _paths(opened, scores, opened.decide(surroundings))
    shown = {name: names_of(name, paths.get(name)) for name in _systems(opened)}
    scores.add_vmaf(list(shown.values()))
    part = {
        "key": opened.number(inputs.key),
        "holes": [float(masks[slot].mean()) if slot in masks else None for slot in SLOTS],
        "features": [[float(v) for v in astuple(seen)] for seen in surroundings.now],
        "paths": {name: paths[name] for name in CHOOSERS if name in paths},
        "returns": gains,
        "warp_psnr_db": [scores.of(f"W{slot}", slot)[0].psnr_db for slot in SLOTS],
        "systems": {
            name: _frames(scores.system(names), makers_of(name, paths.get(name)))
            for name, names in shown.items()
        },
        "extranet": _by_extranet(scores, shown),
    }
    if opened.settings.clock is not None:
        part[SLOT_SCORES] = _slot_scores(opened, scores.pictures, scores.truth)
    return part


def measure_slots(opened: Opened, inputs: IntervalInputs) -> dict[str, Any]:
    """Return what a part lacks for the real-time clock if it was measured without one."""
    pictures = opened.pictures(inputs, opened.interval(inputs))
    return {SLOT_SCORES: _slot_scores(opened, pictures, opened.truth(inputs.key))}


def _slot_scores(
    opened: Opened, pictures: Pictures, truth: Mapping[int, Float32]
) -> dict[str, list[list[float] | None]]:
    """Return PSNR and SSIM of each picture of the tree at slots 1 to 3, as if repeated there.

    None stands before a picture's first slot. Without our network nothing is extrapolated.
    """
    return {
        name: [_judged(truth[slot], pictures[name]) if slot >= first else None for slot in SLOTS]
        for name, first in FIRST_SLOTS.items()
        if opened.networks.own is not None or "E" not in name
    }


def _judged(truth: Float32, picture: Float32) -> list[float]:
    over, _ = score_frame(truth, picture, None, frozenset(JUDGED))
    return [getattr(over, metric) for metric in JUDGED]


def _systems(opened: Opened) -> tuple[str, ...]:
    return (*opened.settings.systems, *opened.networks.systems)


def _paths(
    opened: Opened, scores: Scores, decided: str
) -> tuple[dict[str, str], list[float] | None]:
    """Return the path of every system that takes one, and the returns of all six."""
    paths = {name: path for name, path in FIXED_PATHS.items() if name in _systems(opened)}
    paths[POLICY] = decided
    if opened.networks.own is None:
        return paths, None
    outcomes = scores.outcomes()
    names = tuple(PATHS)
    paths[BEST_PSNR] = names[int(best_psnr(outcomes))]
    paths[BEST_RETURN] = names[int(best_return(outcomes))]
    return paths, [float(value) for value in path_returns(outcomes)]


def _frames(scored: list[Scored], makers: tuple[str, ...]) -> list[dict[str, Any]]:
    """Return what is known of the three frames of a system."""
    return [
        {"made_by": maker, "all": asdict(over), "holes": inside and asdict(inside)}
        for (over, inside), maker in zip(scored, makers, strict=True)
    ]


def _by_extranet(scores: Scores, shown: Mapping[str, tuple[str, ...]]) -> dict[str, Any]:
    """Score what each system shows midway between key frames, as ExtraNet's authors do.

    Their network doubles the frame rate; a path that has E's frame at slot 2 stands for it.
    """
    found: dict[str, Score] = {}
    for names in shown.values():
        name = names[MIDDLE - 1]
        if name not in found:
            found[name] = scores.as_extranet(name)
    return {
        system: {"psnr_db": found[names[MIDDLE - 1]].psnr_db, "ssim": found[names[MIDDLE - 1]].ssim}
        for system, names in shown.items()
    }
