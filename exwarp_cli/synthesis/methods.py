"""The methods by name: what makes the frame of a slot."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial

import numpy as np

from exwarp_cli.domain import decision
from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.network_api import HISTORY_FRAMES, LookAheadNetwork
from exwarp_cli.domain.results import FrameKind
from exwarp_cli.domain.tiles import REWARP, Risk, TileMakers, TilePlan
from exwarp_cli.runtime.frame_pool import pool
from exwarp_cli.synthesis import predicted_error
from exwarp_cli.synthesis.camera import F64
from exwarp_cli.synthesis.history import OlderKeyFrame
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.mosaic import lay_over
from exwarp_cli.synthesis.source_bounds import hold_between
from exwarp_cli.synthesis.warp import Mover, cross_fade, fill_nonfinite

# The default, which looks ahead, and the paper's way, which uses past key frames alone.
EXWARP, CAUSAL = "exwarp", "causal"


@dataclass(frozen=True)
class Predicted:
    """The frame of a slot."""

    pixels: Float32  # [H, W, C], scene-linear, premultiplied alpha, on the interval's window
    kind: FrameKind  # GENERATED, or DROPPED for a repeat
    method: str  # that made it: after the last key frame another one than requested
    sources: tuple[int, ...]  # numbers of the key frames that colour came from, ascending
    made_by: str  # WARP, EXTRAPOLATE, SOFTSPLAT, LOOKAHEAD, BLEND, INTERPOLATE or HOLD
    risk: Risk | None = None  # how wrong it is expected to be
    tiles: TileMakers | None = None  # between key frames, where tiles were chosen


class DecisionSource(Enum):
    """What decides the path of a key interval, where it is not fixed."""

    POLICY = "policy"  # the paper's learned policy, one path for whole frames
    TILES = "tiles"  # a learned policy, a path for each tile
    PSNR = "psnr"  # ground truth: the path whose slots 1 to 3 have the best mean PSNR
    RETURN = "return"  # ground truth: the path with the best sum of the paper's rewards


@dataclass(frozen=True)
class Method:
    """A way to make the frames of slots."""

    name: str  # as on the command line
    # Called with an interval and a slot, 1 or more; None where each interval's path makes it.
    predict: Callable[[Interval, int], Predicted] | None
    lookahead: bool = False  # whether it uses the next key frame
    needs_motion: bool = True  # whether it cannot do without motion vectors
    path: str | None = None  # the paper's decision path that it is, if any
    # What decides the path of each interval; None where nothing is decided.
    judge: DecisionSource | None = None
    # Whether it runs a network on the colour of the key frames on both sides.
    interpolates: bool = False
    weighs: bool = False  # whether a network weighs the key frames on both sides, moved to the slot
    gated: bool = False  # whether its network makes frames only where the gate finds that this pays
    tail: Method | None = None  # makes what has no next key frame; None: warping makes it

    @property
    def runs_network(self) -> bool:
        """Whether it may run any network."""
        return self.extrapolates or self.interpolates or self.weighs

    @property
    def decides(self) -> bool:
        """Whether its frames are made by paths of the paper's decision tree."""
        return self.path is not None or self.judge is not None

    @property
    def finds_flow(self) -> bool:
        """Whether it searches for motion of light, beside the rendered motion of surfaces."""
        return self.lookahead and self.needs_motion

    @property
    def carries_light(self) -> bool:
        """Whether it may warp from one key frame, and carry on how light moved before that."""
        return self.lookahead or self.needs_motion

    @property
    def last(self) -> Method:
        """What makes an interval that has no next key frame."""
        return self.tail or self

    def older_keys(self, looks_ahead: bool) -> int:
        """Return how many key frames before an interval's own its slots may depend on.

        `looks_ahead` says whether the interval has a next key frame that is used.
        """
        if (self if looks_ahead else self.last).extrapolates:
            return HISTORY_FRAMES - 1
        return int(self.carries_light and not looks_ahead)

    @property
    def needs_truth(self) -> bool:
        """Whether ground truth decides."""
        return self.judge in (DecisionSource.PSNR, DecisionSource.RETURN)

    @property
    def extrapolates(self) -> bool:
        """Whether it may need a network, and the key frames before the last one."""
        if self.path is None:
            return self.judge is not None
        return decision.PATHS[self.path].extrapolates


def _hold(interval: Interval, slot: int) -> Predicted:
    pixels = fill_nonfinite(interval.key.image.pixels)
    return Predicted(pixels, FrameKind.DROPPED, "hold", (interval.key.number,), decision.HOLD)


def repeat_held(interval: Interval) -> Predicted:
    """Repeat the key frame of a held interval, whatever the method: its picture does not change."""
    return replace(_hold(interval, 1), method=decision.HELD)


def predict_path(path: str, interval: Interval, slot: int) -> Predicted:
    """Make the frame of a slot by one of the paper's paths.

    What is warped is sampled once, through the whole motion from the last frame that was rendered
    or extrapolated.
    """
    made_by, name = decision.PATHS[path].made_by, path.lower()
    maker = made_by[slot - 1]
    if maker == decision.HOLD:
        shown = _hold(interval, slot) if slot == 1 else predict_path(path, interval, slot - 1)
        return replace(shown, kind=FrameKind.DROPPED, method=name, made_by=decision.HOLD)
    if maker == decision.EXTRAPOLATE:
        pixels = interval.extrapolated(slot)
    elif slot == 3 and made_by[1] == decision.EXTRAPOLATE:
        pixels = Mover(interval.step_back(3), interval.linear).warp_alone(interval.extrapolated(2))
    else:
        return replace(_warp(interval, slot), method=name)
    return _without_next(interval, slot, pixels, name, maker, interval.past)


def predict_tiles(plan: TilePlan, interval: Interval, slot: int) -> Predicted:
    """Make the frame of a slot tile by tile, as each tile's path has it.

    Where all tiles take one path, the frame is that of `predict_path`.
    """
    makers = plan.makers(slot)
    if not (makers.made_by(decision.EXTRAPOLATE) | makers.made_by(REWARP)).any():
        return replace(_warp(interval, slot), method=CAUSAL)
    pixels = _compose_tiles(plan, interval, slot)
    made_by = decision.EXTRAPOLATE if makers.share(decision.EXTRAPOLATE) else decision.WARP
    return _without_next(interval, slot, pixels, CAUSAL, made_by, interval.past)


def _compose_tiles(plan: TilePlan, interval: Interval, slot: int) -> Float32:
    """Return a slot of what warping and the network make in their tiles; made once."""
    if slot in interval.composed:
        return interval.composed[slot]
    makers = plan.makers(slot)
    if interval.linear:
        pixels = interval.warp(slot).make(interval.key.image.pixels)
    else:  # what the network sees of it as well
        pixels = interval.warped(slot)
    rewarped, extrapolated = makers.made_by(REWARP), makers.made_by(decision.EXTRAPOLATE)
    if rewarped.any():
        before = _compose_tiles(plan, interval, slot - 1)
        moved = Mover(interval.step_back(slot), interval.linear).warp_alone(before)
        pixels = lay_over(pixels, moved, interval.mosaic.weight(rewarped))
    if extrapolated.any():
        answer = interval.extrapolated(slot, extrapolated)
        pixels = lay_over(pixels, answer, interval.mosaic.weight(extrapolated))
    interval.composed[slot] = interval.scratch.store(pixels)
    return interval.composed[slot]


def _warp(interval: Interval, slot: int) -> Predicted:
    """Warp the key frame, the paper's path S6, and let light move on as it did before."""
    if interval.estimated and not interval.has_motion:
        return _hold(interval, slot)  # no key frame before it, so no motion could be estimated
    pixels = interval.warp(slot).make(interval.key.image.pixels)
    return _without_next(interval, slot, pixels, "s6", decision.WARP)


def terms_of_warp(interval: Interval, slot: int, pixels: Float32) -> F64:
    """Return the `terms_of` a frame that is made of what came before its slot."""
    tiles, back = interval.tiles, interval.back(slot)
    (unseen,) = tiles.means([tiles.sample(back.hole | back.ghosts)])
    none = np.zeros_like(unseen)
    evidence = predicted_error.TileEvidence(none, none, unseen)
    return predicted_error.terms_of(tiles, evidence, interval.residual, pixels)


def _without_next(
    interval: Interval,
    slot: int,
    pixels: Float32,
    method: str,
    made_by: str,
    past: Sequence[OlderKeyFrame] = (),  # that colour comes from, too: those a network has seen
) -> Predicted:
    """Return a frame that is made of what came before its slot."""
    numbers = interval.key.number, *(older.frame.number for older in past)
    terms = terms_of_warp(interval, slot, pixels)
    formula = predicted_error.WARPED if interval.past else predicted_error.FIRST_WARPED
    risk = predicted_error.predict_risk(terms, formula, interval.time(slot))
    sources = tuple(sorted(numbers))
    return Predicted(pixels, FrameKind.GENERATED, method, sources, made_by, risk)


def _causal(interval: Interval, slot: int) -> Predicted:
    """Make a slot without a next key frame."""
    return _warp(interval, slot) if interval.has_motion else _hold(interval, slot)


def _blend(interval: Interval, slot: int) -> Predicted:
    key, following = interval.key, interval.following
    if following is None:
        return _causal(interval, slot)
    pixels = cross_fade(key.image.pixels, following.image.pixels, interval.time(slot))
    sources = key.number, following.number
    return Predicted(pixels, FrameKind.GENERATED, decision.BLEND, sources, decision.BLEND)


def _look_ahead(name: str, weighs: bool, interval: Interval, slot: int) -> Predicted:
    """Warp both key frames to the slot and mix them; by the interval's network if it `weighs`."""
    key, following = interval.key, interval.following
    if following is None:
        return _causal(interval, slot)
    mixer = interval.look_ahead(slot, weighs)
    pixels = mixer.make(key.image.pixels, following.image.pixels)
    made_by = decision.SOFTSPLAT if mixer.network is None else decision.LOOKAHEAD
    risk, tiles = None, None
    if mixer.chosen is not None:
        tiles = TileMakers.chosen(mixer.chosen)
        made_by = decision.LOOKAHEAD if mixer.chosen.any() else decision.SOFTSPLAT
    if mixer.evidence is not None:
        terms = predicted_error.terms_of(interval.tiles, mixer.evidence, interval.residual, pixels)
        risk = predicted_error.predict_risk(terms, predicted_error.MIXED, interval.time(slot))
    sources = key.number, following.number
    return Predicted(pixels, FrameKind.GENERATED, name, sources, made_by, risk, tiles)


def _onnx(interval: Interval, slot: int) -> Predicted:
    """Have a network interpolate the key frames."""
    key, following = interval.key, interval.following
    if following is None:
        return _causal(interval, slot)
    assert interval.interpolator is not None
    assert not isinstance(interval.interpolator, LookAheadNetwork)
    frames = fill_nonfinite(key.image.pixels), fill_nonfinite(following.image.pixels)
    pixels = pool.copy(interval.interpolator(*frames, interval.time(slot)))
    leads = interval.leads_both_ways
    hold_between(pixels, frames, (interval.back(slot), interval.forward(slot)) if leads else None)
    sources = key.number, following.number
    return Predicted(pixels, FrameKind.GENERATED, "onnx", sources, decision.INTERPOLATE)


def predict_both_ways(interval: Interval, slot: int, lookahead: bool) -> tuple[Float32, Float32]:
    """Predict a slot by warping and by a network, as the gate compares them.

    Returns scene-linear float32 [H, W, C]: of `softsplat` and `lookahead`, or else of W and E.
    """
    if not lookahead:
        return _warp(interval, slot).pixels, interval.extrapolated(slot)
    splatted = _look_ahead(decision.LOOKAHEAD, False, interval, slot).pixels
    return splatted, _look_ahead(decision.LOOKAHEAD, True, interval, slot).pixels


# `causal` as the paper has it: a policy chooses one path for whole frames.
FRAMEWISE = Method(CAUSAL, None, judge=DecisionSource.POLICY, gated=True)

# The default without its networks, at an effort of 0.
EFFORTLESS = Method(EXWARP, partial(_look_ahead, EXWARP, False), lookahead=True)

METHODS: Mapping[str, Method] = {
    method.name: method
    for method in (
        Method(EXWARP, partial(_look_ahead, EXWARP, True), lookahead=True, weighs=True, gated=True),
        Method(CAUSAL, None, judge=DecisionSource.TILES, gated=True),
        *(
            Method(path.lower(), _warp if path == "S6" else partial(predict_path, path), path=path)
            for path in decision.PATHS
        ),
        Method("oracle", None, judge=DecisionSource.PSNR),
        Method("oracle-return", None, judge=DecisionSource.RETURN),
        Method(decision.SOFTSPLAT, partial(_look_ahead, decision.SOFTSPLAT, False), lookahead=True),
        Method(
            decision.LOOKAHEAD,
            partial(_look_ahead, decision.LOOKAHEAD, True),
            lookahead=True,
            weighs=True,
        ),
        Method("onnx", _onnx, lookahead=True, needs_motion=False, interpolates=True),
        Method(decision.BLEND, _blend, lookahead=True, needs_motion=False),
        Method("hold", _hold, needs_motion=False),
    )
}
