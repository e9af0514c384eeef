"""What decides the path of each key interval: a fixed path, the learned policy, or the truth.

A policy sees features around each key interval, each of which is computed once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from exwarp_cli.accelerator.mlp import to_fixed
from exwarp_cli.accelerator.mlp_kernel import MlpKernel
from exwarp_cli.domain.decision import (
    CHOICES,
    EXTRAPOLATE,
    NODE_SLOTS,
    NODES,
    ONLY_WARPS,
    PATHS,
    WARP,
    Decision,
    Features,
    Plan,
)
from exwarp_cli.domain.frame import Float32, GBuffer, Window, place_on_canvas
from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.domain.tiles import TILE_ROWS, TilePlan
from exwarp_cli.domain.timeline import FACTOR, Slot
from exwarp_cli.io.generated_frames import quantise_picture
from exwarp_cli.pipeline.interval_inputs import IntervalInputs, IntervalReader, PolicyObservation
from exwarp_cli.pipeline.progress import Progress
from exwarp_cli.pipeline.scheduling import record_time
from exwarp_cli.pipeline.source import Source, open_source
from exwarp_cli.policy import state
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.synthesis.interval import Interval, TileChooser, tile_features
from exwarp_cli.synthesis.methods import CAUSAL, FRAMEWISE, DecisionSource, Method, predict_path
from exwarp_cli.synthesis.motion_fields import find_moving, moving_ids, select_ids, settle_motion

if TYPE_CHECKING:
    from exwarp_cli.models.policy_files import PolicyFile

# Id of all that moves, where only motion tells it: connected areas are the objects then.
MOVING = 1

# Choices that show the same frame as one of an earlier node: W(P2) after E(F), and E(P1).
SAME = {("d4", WARP): ("d3", WARP), ("d5", EXTRAPOLATE): ("d4", EXTRAPOLATE)}


# Decides the path of key intervals, one after the other: a path, or one for each tile. It adds the
# milliseconds of its steps to the last argument, and raises nothing that a user can cause.
PathSelector = Callable[[IntervalInputs, Interval, dict[str, float]], Plan | TilePlan]


def ask_policy(
    policy: MlpKernel,
    observer: Observer,
    inputs: IntervalInputs,
    interval: Interval,
    timing_ms: dict[str, float],
) -> Plan:
    """Ask the paper's learned policy, which decides for whole frames, by an interval's features."""
    with record_time(timing_ms, "features"):
        surroundings = observer.of(inputs, interval)
    with record_time(timing_ms, "decide"):
        return state.plan_slots(policy, surroundings)


def ask_tile_policy(
    policy: MlpKernel,
    fixed_path: str | None,  # at an effort of 0 or 1, where no policy is asked
    _inputs: IntervalInputs,
    interval: Interval,
    timing_ms: dict[str, float],
) -> TilePlan:
    """Ask a policy of tiles, by the features of an interval's tiles."""
    tiles = interval.tiles
    if fixed_path is not None or not interval.has_motion:
        return TilePlan.fixed(tiles.columns, TILE_ROWS, fixed_path or ONLY_WARPS)
    with record_time(timing_ms, "features"):
        features = [tile_features(interval, slot) for slot in range(1, FACTOR)]
    with record_time(timing_ms, "decide"):
        return state.plan_tiles(policy, features, tiles.display.width)


def ask_truth(
    judge: DecisionSource,  # by the mean PSNR, or by the sum of rewards
    display: Window,
    inputs: IntervalInputs,
    interval: Interval,
    timing_ms: dict[str, float],
) -> Plan:
    """Make the frames of all six paths of an interval, and take the best path.

    Where a slot has no ground truth no path can be judged, and the interval is warped.
    """
    from exwarp_cli.policy import outcomes

    if set(inputs.truth.frames) != set(range(1, FACTOR)):
        return Plan.fixed("S6")
    by_psnr = judge is DecisionSource.PSNR
    with record_time(timing_ms, "decide"):
        truth = {slot: image.on(display).pixels for slot, image in inputs.truth.frames.items()}
        as_written = partial(quantise_picture, template=inputs.template)
        scores = outcomes_of(interval, truth, display, as_written)
        best = outcomes.best_psnr(scores) if by_psnr else outcomes.best_return(scores)
        path = tuple(PATHS)[int(best)]
        values = scores[..., 0] if by_psnr else outcomes.choice_rewards(scores)
        decisions = []
        for node, choice in PATHS[path].choices.items():
            warp, extrapolate = (
                float(values[NODES.index(node), CHOICES.index(each)])
                for each in (WARP, EXTRAPOLATE)
            )
            decisions.append(Decision(node, choice, outputs=(warp, extrapolate)))
    return Plan(path, tuple(decisions))


def make_chooser(policy: PolicyFile | None, effort: float) -> TileChooser | None:
    """Return what chooses the tiles between key frames that a network makes; None for all."""
    if policy is None:
        return None
    priced = state.apply_price(policy.network, policy.price(effort))
    return partial(state.choose_tiles, MlpKernel(priced))


def make_selector(
    method: Method, source: Source, policy: PolicyFile | None, effort: float
) -> PathSelector | None:
    """Return what decides the path of each key interval; None outside the decision tree.

    `effort` is the share of the area that is extrapolated on the scenes that a policy of tiles
    learned from.
    """
    display = source.keys.display
    if method.path is not None:
        plan = Plan.fixed(method.path)
        return (lambda *_: plan) if source.allows_decisions else None
    if method.judge is None:
        return None
    if policy is None:
        return partial(ask_truth, method.judge, display)
    if policy.of_tiles:
        fixed_path = {0.0: "S6", 1.0: "S3"}.get(effort)
        priced = state.apply_price(policy.network, policy.price(effort))
        return partial(ask_tile_policy, MlpKernel(priced), fixed_path)
    observer = Observer(display, source.setting)
    return partial(ask_policy, MlpKernel(policy.network), observer)


def only_warps(plan: Plan | TilePlan) -> Plan | TilePlan:
    """Return a plan of the same kind that runs no network."""
    if isinstance(plan, TilePlan):
        return TilePlan.fixed(plan.columns, plan.rows, ONLY_WARPS)
    return Plan.fixed(ONLY_WARPS)


def outcomes_of(
    interval: Interval,
    truth: Mapping[int, Float32],
    display: Window | None = None,
    as_written: Callable[[Float32], Float32] | None = None,
) -> npt.NDArray[np.float64]:
    """Make the frames of all choices of a key interval, with its network, and measure them.

    `truth` is of slots 1 to 3, float32 [H, W, 3] or more, scene-linear, on the window `display`;
    None for the interval's own. `as_written` rounds pixels to what a file keeps of them; None to
    measure them as they are made. Returns float64 [5, 2, 2], as `exwarp_cli.policy.outcomes` has
    it.
    """
    from exwarp_cli.domain.colour import encode_display
    from exwarp_cli.metrics.registry import METRICS  # numba: only an oracle measures in decisions
    from exwarp_cli.policy.outcomes import METRICS as JUDGED

    canvas = interval.key.image.data_window
    encoded = {slot: encode_display(pixels) for slot, pixels in truth.items()}
    scores: dict[tuple[str, str], list[float]] = {}
    for node in NODES:
        for choice in CHOICES:
            if (node, choice) in SAME:
                scores[node, choice] = scores[SAME[node, choice]]
                continue
            slot = NODE_SLOTS[node]
            path = next(name for name, p in PATHS.items() if p.choices.get(node) == choice)
            pixels = predict_path(path, interval, slot).pixels
            if as_written is not None:
                pixels = as_written(pixels)
            test = encode_display(place_on_canvas(pixels, canvas, display or canvas))
            scores[node, choice] = [METRICS[name](encoded[slot], test).value() for name in JUDGED]
    return np.array([[scores[node, choice] for choice in CHOICES] for node in NODES])


@dataclass
class Observer:
    """Computes features interval by interval, all on the display window."""

    display: Window
    setting: str  # "key" or "slot"
    _at_keys: dict[int, Features] = field(default_factory=dict)
    _shot_begin: int = 0

    def of(self, inputs: IntervalInputs, interval: Interval) -> state.StateHistory:
        """Return what the states of an interval are made of that was read and built."""
        # Motion settled on another window than the display's differs in its last digits, as other
        # points are looked at; so it is settled again then. It is, too, where the interval took
        # what moves in it for ids: features are of an instant, whichever interval they are first
        # seen in.
        frame = None if inputs.frame is None else inputs.frame.gbuffer
        has_objects = any(g is not None and g.objects is not None for g in (frame, *inputs.slots))
        is_same = interval.key.image.data_window == self.display and not has_objects
        covers = inputs.frame is not None and inputs.frame.image.data_window == self.display
        settled = interval.key.gbuffer if self.setting == "key" and covers and is_same else None
        slots = interval.slots
        if not is_same:
            slots = tuple(settle_motion(slot.on(self.display)) for slot in inputs.slots)
        return self.surroundings(inputs.key, inputs.observed, slots, settled, inputs.slots)

    def surroundings(
        self,
        key: int,
        observed: Sequence[PolicyObservation],
        slots: Sequence[GBuffer],
        settled: GBuffer | None = None,
        read: Sequence[GBuffer] = (),
    ) -> state.StateHistory:
        """Return what the states of an interval are made of, by the index of its key frame.

        `observed` are its instant, and those that were not seen before, ascending; one that nothing
        comes before begins a shot, and what was seen of older ones is of no use. `slots` are the
        G-buffers of slots 1 to 3 on the display window with settled motion; empty where there are
        none. `settled` is the same of the key frame, where it is in memory. `read` are those of the
        slots as read; empty where they are not in memory.
        """
        for instant in observed:
            before = None if instant.before is None else instant.before.on(self.display)
            if before is None:
                self._shot_begin = instant.key
            now, raw = settled if instant.key == key else None, instant.now.on(self.display)
            if now is None:
                now = settle_motion(raw)
            now = with_ids(now, before, raw)
            span = FACTOR if self.setting == "key" else 1
            self._at_keys[instant.key] = state.observe(now, before, span)
        at_key = self._at_keys[key]
        now_on = (at_key, at_key, at_key)
        if slots:
            instants = [observed[-1].now.on(self.display), *slots[:2]]
            raw_slots = [slot.on(self.display) for slot in read[:2]]
            first, second = (
                with_ids(instants[i + 1], instants[i], raw_slots[i] if raw_slots else None)
                for i in (0, 1)
            )
            now_on = at_key, state.observe(first, instants[0], 1), state.observe(second, first, 1)
        older = range(key - 1, max(key - state.OLDER_KEYS, self._shot_begin) - 1, -1)
        before_it = tuple(self._at_keys[i] for i in older)
        self._at_keys = {i: at for i, at in self._at_keys.items() if i > key - state.OLDER_KEYS}
        return state.StateHistory(now_on, before_it)


def with_ids(
    gbuffer: GBuffer, before: GBuffer | None = None, raw: GBuffer | None = None
) -> GBuffer:
    """Return a G-buffer with ids of what moves: its own, else of what keeps no place in the world.

    Its motion is settled. Without ids, positions or depth it stays as it is. `before` and `raw` are
    as :func:`exwarp_cli.synthesis.motion_fields.find_moving` takes them.
    """
    if gbuffer.stencil is not None:
        return gbuffer
    moves = find_moving(gbuffer, before, raw)
    if moves is None:
        return gbuffer
    if gbuffer.objects is not None:
        stencil = select_ids(gbuffer.objects, moving_ids(gbuffer.objects, moves))
        return replace(gbuffer, stencil=stencil, objects=None)
    return replace(gbuffer, stencil=np.where(moves, MOVING, 0).astype(np.int32))


@dataclass(frozen=True)
class NodeFeatures:
    """What is seen at one node of a key interval."""

    frame: int  # output number of the slot that the node decides
    key: int  # input number of the key frame
    node: str  # d1 to d5
    features: Features  # of the instant at which it is decided
    inputs: tuple[int, ...]  # of the policy's network, 44 numbers in Q16.16


def features(
    settings: SourceSettings, frames: str | None = None, progress: Progress | None = None
) -> Iterator[NodeFeatures]:
    """Yield the features at every node of every key interval.

    `frames` is a range of key frames by input number; None for all. `progress` receives every key
    frame. Raises InputError when the sequence cannot be used, MotionError when the convention of
    its motion vectors cannot be settled.
    """
    source = open_source(settings)
    progress = progress or Progress()
    keys = source.timeline.select(frames)
    reader = IntervalReader(source, FRAMEWISE, UpsampleSettings(settings, "", CAUSAL))
    observer = Observer(source.keys.display, source.setting)
    progress.start(len(keys))
    try:
        for key in keys:
            observed = reader.observe(key)
            slots = tuple(map(reader.store.get_slot, reader.store.slots_after(key)))
            reader.release(key)
            settled = [settle_motion(slot.on(observer.display)) for slot in slots]
            surroundings = observer.surroundings(key, observed, settled, read=slots)
            number = source.timeline.numbers[key]
            for node in NODES:
                yield NodeFeatures(
                    source.timeline.number(Slot(key, NODE_SLOTS[node])),
                    number,
                    node,
                    surroundings.now[NODE_SLOTS[node] - 1],
                    tuple(int(x) for x in to_fixed(surroundings.inputs(node))),
                )
            progress.advance(number)
            check_stop()
    finally:
        progress.finish()
