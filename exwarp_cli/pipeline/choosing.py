"""What decides the path of each key interval: nothing, the learned policy, or the truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.decision import (
    CHOICES,
    EXTRAPOLATE,
    NODE_SLOTS,
    NODES,
    ONLY_WARPS,
    PATHS,
    WARP,
    Decision,
    Plan,
)
from exwarp_cli.domain.frame import Float32, Window, place_on_canvas
from exwarp_cli.domain.tiles import TILE_ROWS, TilePlan
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.io.output import quantised
from exwarp_cli.pipeline.interval_inputs import IntervalInputs
from exwarp_cli.pipeline.scheduling import record_time
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import Judge, take
from exwarp_cli.synthesis.tile_features import tile_features

if TYPE_CHECKING:
    from exwarp_cli.io.policy_files import PolicyFile
    from exwarp_cli.pipeline.observing import Observer
    from exwarp_cli.policy.state import LearnedPolicy


@dataclass(frozen=True)
class Chosen:
    """A plan, and how long it took.

    Attributes
    ----------
    plan
        For one key interval: a path, or one for each tile.
    timing_ms
        Milliseconds by step of the work.
    """

    plan: Plan | TilePlan
    timing_ms: Mapping[str, float] = field(default_factory=dict)


Chooser = Callable[[IntervalInputs, Interval], Chosen]


def always(path: str) -> Chooser:
    """Return who takes one path whatever is seen."""
    chosen = Chosen(Plan.fixed(path))
    return lambda inputs, interval: chosen


def by_policy(policy: LearnedPolicy, observer: Observer) -> Chooser:
    """Return who asks the learned policy."""

    def choose(inputs: IntervalInputs, interval: Interval) -> Chosen:
        timing_ms: dict[str, float] = {}
        with record_time(timing_ms, "features"):
            surroundings = observer.of(inputs, interval)
        with record_time(timing_ms, "decide"):
            plan = policy.plan(surroundings)
        return Chosen(plan, timing_ms)

    return choose


def by_tiles(policy: PolicyFile, effort: float) -> Chooser:
    """Return a chooser that asks a policy of tiles, or at an effort of 0 or 1 none.

    `effort` is the share of the area that is extrapolated on the scenes that it learned from.
    """
    from exwarp_cli.policy.state import TilePolicy, interpolate_price

    settled = {0.0: "S6", 1.0: "S3"}.get(effort)
    learned = TilePolicy(policy.network, interpolate_price(policy.efforts, effort))

    def choose(inputs: IntervalInputs, interval: Interval) -> Chosen:
        tiles = interval.tiles
        if settled is not None or not interval.has_motion:
            return Chosen(TilePlan.fixed(tiles.columns, TILE_ROWS, settled or ONLY_WARPS))
        timing_ms: dict[str, float] = {}
        with record_time(timing_ms, "features"):
            seen = [tile_features(interval, slot) for slot in range(1, FACTOR)]
        with record_time(timing_ms, "decide"):
            plan = learned.plan(seen, tiles.display.width)
        return Chosen(plan, timing_ms)

    return choose


def by_truth(judge: Judge, display: Window) -> Chooser:
    """Return who looks at the ground truth: exact over the six paths of each interval.

    Where a slot has no ground truth no path can be judged, and the interval is warped.
    """
    from exwarp_cli.policy import outcomes

    by_psnr = judge is Judge.PSNR
    best = outcomes.best_psnr if by_psnr else outcomes.best_return

    def choose(inputs: IntervalInputs, interval: Interval) -> Chosen:
        if set(inputs.truth.frames) != set(range(1, FACTOR)):
            return Chosen(Plan.fixed("S6"))
        timing_ms: dict[str, float] = {}
        with record_time(timing_ms, "decide"):
            truth = {slot: image.on(display).pixels for slot, image in inputs.truth.frames.items()}
            as_written = partial(quantised, template=inputs.metadata.template)
            scores = outcomes_of(interval, truth, display, as_written)
            path = tuple(PATHS)[int(best(scores))]
            outputs = scores[..., 0] if by_psnr else outcomes.choice_rewards(scores)
            decisions = tuple(
                Decision(node, choice, outputs=_pair(outputs[NODES.index(node)]))
                for node, choice in PATHS[path].choices.items()
            )
        return Chosen(Plan(path, decisions), timing_ms)

    return choose


def _pair(outputs: np.ndarray) -> tuple[float, float]:
    """Return the outputs for the two choices."""
    warp, extrapolate = (float(outputs[CHOICES.index(choice)]) for choice in CHOICES)
    return warp, extrapolate


SAME = {("d4", WARP): ("d3", WARP), ("d5", EXTRAPOLATE): ("d4", EXTRAPOLATE)}
"""Choices that show the same frame as one of an earlier node: W(P2) after E(F), and E(P1)."""


def outcomes_of(
    interval: Interval,
    truth: Mapping[int, Float32],
    display: Window | None = None,
    as_written: Callable[[Float32], Float32] | None = None,
) -> npt.NDArray[np.float64]:
    """Make the frames of all choices of a key interval and measure them.

    Parameters
    ----------
    interval
        With its network.
    truth
        Ground truth of slots 1 to 3, float32 [H, W, 3] or more, scene-linear.
    display
        The window of the truth; None for the interval's own.
    as_written
        Rounds pixels to what a file keeps of them; None to measure them as they are made.

    Returns
    -------
    float64 [5, 2, 2]
        As `exwarp_cli.policy.outcomes` has it.
    """
    from exwarp_cli.metrics.display import (
        encode_display,  # numba: only an oracle measures while it decides
    )
    from exwarp_cli.metrics.registry import METRICS
    from exwarp_cli.policy.outcomes import METRICS as JUDGED

    canvas = interval.key.image.data_window
    encoded = {slot: encode_display(pixels) for slot, pixels in truth.items()}
    found: dict[tuple[str, str], list[float]] = {}
    for node in NODES:
        for choice in CHOICES:
            if (node, choice) in SAME:
                found[node, choice] = found[SAME[node, choice]]
                continue
            slot = NODE_SLOTS[node]
            pixels = take(_path_through(node, choice), interval, slot).pixels
            if as_written is not None:
                pixels = as_written(pixels)
            made = encode_display(place_on_canvas(pixels, canvas, display or canvas))
            found[node, choice] = [METRICS[name](encoded[slot], made).overall() for name in JUDGED]
    return np.array([[found[node, choice] for choice in CHOICES] for node in NODES])


def _path_through(node: str, choice: str) -> str:
    """Return a path that takes this choice at this node."""
    return next(name for name, path in PATHS.items() if path.choices.get(node) == choice)
