"""The methods by name: what makes the frame of a slot."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial

from exwarp_cli.domain.decision import BLEND, EXTRAPOLATE, HELD, HOLD, PATHS, SOFTSPLAT, WARP
from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.network_api import HISTORY_FRAMES, INTERPOLATE, LOOKAHEAD, LookAheadNetwork
from exwarp_cli.domain.results import FrameKind
from exwarp_cli.domain.tiles import REWARP, Risk, TilePlan
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.mosaic import lay_over
from exwarp_cli.synthesis.risk import (
    F64,
    FIRST_WARPED,
    MIXED,
    WARPED,
    Evidence,
    evidence_of_warp,
    predict_risk,
    terms_of,
)
from exwarp_cli.synthesis.source_bounds import hold_in_range, hold_within, sources_between
from exwarp_cli.synthesis.warp import Mover, between, cross_fade, repair

EXWARP, CAUSAL = "exwarp", "causal"
"""The default, which looks ahead, and the paper's way, which goes by past key frames alone."""


@dataclass(frozen=True)
class Predicted:
    """What is shown at a slot.

    Attributes
    ----------
    pixels
        float32 [H, W, C], scene-linear, premultiplied alpha, on the interval's window.
    kind
        GENERATED, or DROPPED for a repeat.
    method
        Name of the method that made it, which differs from the one asked for after the last key
        frame.
    sources
        Numbers of the key frames that colour came from, ascending.
    made_by
        WARP, EXTRAPOLATE, SOFTSPLAT, LOOKAHEAD, BLEND, INTERPOLATE or HOLD.
    risk
        How wrong it is expected to be; None where nothing tells.
    """

    pixels: Float32
    kind: FrameKind
    method: str
    sources: tuple[int, ...]
    made_by: str
    risk: Risk | None = None


class Judge(Enum):
    """Who decides the path of a key interval, where it is not fixed."""

    POLICY = "policy"
    """The paper's learned policy, one path for whole frames."""

    TILES = "tiles"
    """A learned policy, a path for each tile."""

    PSNR = "psnr"
    """Ground truth: the path whose slots 1 to 3 have the best mean PSNR."""

    RETURN = "return"
    """Ground truth: the path with the best sum of the paper's rewards."""


@dataclass(frozen=True)
class Method:
    """A way to make the frames of slots.

    Attributes
    ----------
    name
        As on the command line.
    predict
        Called with an interval and a slot, 1 or more; None where each interval's path makes it.
    lookahead
        Whether it uses the next key frame.
    needs_motion
        Whether it cannot do without motion vectors.
    path
        The paper's decision path that it is, if any.
    judge
        Who decides the path of each interval; None where nothing is decided.
    interpolates
        Whether it runs a network on the colour of the key frames on both sides.
    weighs
        Whether a network weighs the key frames on both sides, moved to the slot.
    gated
        Whether its network makes frames only where the gate finds that this pays.
    """

    name: str
    predict: Callable[[Interval, int], Predicted] | None
    lookahead: bool
    needs_motion: bool
    path: str | None = None
    judge: Judge | None = None
    interpolates: bool = False
    weighs: bool = False
    gated: bool = False

    @property
    def any_factor(self) -> bool:
        """Whether it makes slots at any time; the paper's decisions are for those of 4x alone."""
        return self.judge is None and not self.extrapolates

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

    def older_keys(self, looks_ahead: bool) -> int:
        """Return how many key frames before an interval's own its slots may depend on.

        `looks_ahead` says whether the interval has a next key frame that is used.
        """
        if self.extrapolates:
            return HISTORY_FRAMES - 1
        return int(self.carries_light and not looks_ahead)

    @property
    def needs_truth(self) -> bool:
        """Whether ground truth decides."""
        return self.judge in (Judge.PSNR, Judge.RETURN)

    @property
    def extrapolates(self) -> bool:
        """Whether it may need a network, and the key frames before the last one."""
        if self.path is None:
            return self.judge is not None
        return PATHS[self.path].extrapolates


def _hold(interval: Interval, slot: int) -> Predicted:
    """Repeat the key frame."""
    pixels = repair(interval.key.image.pixels)
    return Predicted(pixels, FrameKind.DROPPED, "hold", (interval.key.number,), HOLD)


def repeat_held(interval: Interval) -> Predicted:
    """Repeat the key frame of a held interval, whatever the method: nothing new is to be seen."""
    return replace(_hold(interval, 1), method=HELD)


def take(path: str, interval: Interval, slot: int) -> Predicted:
    """Make the frame of a slot as one of the paper's paths has it.

    Whatever is warped is sampled once, through the whole motion from the last frame that was
    rendered or extrapolated.
    """
    made_by, name = PATHS[path].made_by, path.lower()
    maker = made_by[slot - 1]
    if maker == HOLD:
        shown = _hold(interval, slot) if slot == 1 else take(path, interval, slot - 1)
        return replace(shown, kind=FrameKind.DROPPED, method=name, made_by=HOLD)
    sources: tuple[int, ...] = (interval.key.number,)
    if maker == EXTRAPOLATE:
        pixels, sources = interval.extrapolated(slot), _seen(interval)
    elif slot == 3 and made_by[1] == EXTRAPOLATE:
        pixels = Mover(interval.step_back(3), interval.linear).warp_alone(interval.extrapolated(2))
        sources = _seen(interval)
    else:
        return replace(_warp(interval, slot), method=name)
    risk = _risk_of_warp(interval, slot, pixels)
    return Predicted(pixels, FrameKind.GENERATED, name, sources, maker, risk)


def take_tiles(plan: TilePlan, interval: Interval, slot: int) -> Predicted:
    """Make the frame of a slot tile by tile, as each tile's path has it.

    Where all tiles take one path, the frame is that of `take`.
    """
    makers = plan.makers(slot)
    if not (makers.made_by(EXTRAPOLATE) | makers.made_by(REWARP)).any():
        return replace(_warp(interval, slot), method=CAUSAL)
    pixels = _composed(plan, interval, slot)
    made_by = EXTRAPOLATE if makers.share(EXTRAPOLATE) else WARP
    risk = _risk_of_warp(interval, slot, pixels)
    return Predicted(pixels, FrameKind.GENERATED, CAUSAL, _seen(interval), made_by, risk)


def _composed(plan: TilePlan, interval: Interval, slot: int) -> Float32:
    """Make a slot of what warping and the network make in their tiles."""

    def make() -> Float32:
        makers = plan.makers(slot)
        if interval.linear:
            pixels = interval.warp(slot).make(interval.key.image.pixels)
        else:  # what the network sees of it as well
            pixels = interval.warped(slot)
        warped_again, extrapolated = map(makers.made_by, (REWARP, EXTRAPOLATE))
        if warped_again.any():
            before = _composed(plan, interval, slot - 1)
            again = Mover(interval.step_back(slot), interval.linear).warp_alone(before)
            pixels = lay_over(pixels, again, interval.mosaic.weight(warped_again))
        if extrapolated.any():
            made = interval.extrapolated_in(slot, extrapolated)
            pixels = lay_over(pixels, made, interval.mosaic.weight(extrapolated))
        return pixels

    return interval.composed(slot, make)


def _warp(interval: Interval, slot: int) -> Predicted:
    """Warp the key frame, the paper's path S6, and let light move on as it did before."""
    if interval.estimated and not interval.has_motion:
        return _hold(interval, slot)  # nothing comes before it by which motion could be estimated
    pixels = interval.warp(slot).make(interval.key.image.pixels)
    risk = _risk_of_warp(interval, slot, pixels)
    return Predicted(pixels, FrameKind.GENERATED, "s6", (interval.key.number,), WARP, risk)


def _risk_of_warp(interval: Interval, slot: int, pixels: Float32) -> Risk:
    """Predict the error of a frame of what came before its slot."""
    terms = terms_of_warp(interval, slot, pixels)
    formula = WARPED if interval.past else FIRST_WARPED
    return predict_risk(terms, formula, interval.time(slot))


def _seen(interval: Interval) -> tuple[int, ...]:
    """Numbers of the key frames that the network sees."""
    return tuple(sorted((interval.key.number, *(past.frame.number for past in interval.past))))


def terms_of_warp(interval: Interval, slot: int, pixels: Float32) -> F64:
    """Return the terms of a frame of what came before its slot; see `synthesis.risk.terms_of`."""
    tiles, back = interval.tiles, interval.back(slot)
    evidence = evidence_of_warp(tiles, back.hole | back.ghosts)
    return terms_of(tiles, evidence, interval.residual, pixels)


def _causal(interval: Interval, slot: int) -> Predicted:
    """Do what can be done without a next key frame."""
    return _warp(interval, slot) if interval.has_motion else _hold(interval, slot)


def _blend(interval: Interval, slot: int) -> Predicted:
    """Cross-fade the key frames."""
    if interval.following is None:
        return _causal(interval, slot)
    frames = (interval.key.image.pixels, interval.following.image.pixels)
    pixels = cross_fade(*frames, interval.time(slot))
    sources = (interval.key.number, interval.following.number)
    return Predicted(pixels, FrameKind.GENERATED, BLEND, sources, BLEND)


def _look_ahead(name: str, weighs: bool, interval: Interval, slot: int) -> Predicted:
    """Warp both key frames to the slot and mix them; by the interval's network if it `weighs`."""
    if interval.following is None:
        return _causal(interval, slot)
    frames = (interval.key.image.pixels, interval.following.image.pixels)
    mixer = interval.look_ahead(slot, weighs)
    made_by = LOOKAHEAD if mixer.weighs else SOFTSPLAT
    pixels = mixer.make(*frames)
    sources = (interval.key.number, interval.following.number)
    risk = _risk_of_sides(interval, slot, mixer.evidence, pixels)
    return Predicted(pixels, FrameKind.GENERATED, name, sources, made_by, risk)


def _risk_of_sides(
    interval: Interval, slot: int, evidence: Evidence | None, pixels: Float32
) -> Risk | None:
    """Predict the error of a frame of both key frames around its slot."""
    if evidence is None:
        return None
    terms = terms_of(interval.tiles, evidence, interval.residual, pixels)
    return predict_risk(terms, MIXED, interval.time(slot))


def predict_both_ways(interval: Interval, slot: int, lookahead: bool) -> tuple[Float32, Float32]:
    """Predict a slot by warping and by a network, as the gate compares them.

    Returns
    -------
    tuple of float32 [H, W, C]
        Scene-linear: of `softsplat` and `lookahead`, or else of W and E.
    """
    if not lookahead:
        return _warp(interval, slot).pixels, interval.extrapolated(slot)
    made = (_look_ahead(LOOKAHEAD, weighs, interval, slot) for weighs in (False, True))
    cheap, dear = (shown.pixels for shown in made)
    return cheap, dear


def _onnx(interval: Interval, slot: int) -> Predicted:
    """Have a network interpolate the key frames."""
    if interval.following is None:
        return _causal(interval, slot)
    assert interval.interpolator is not None
    assert not isinstance(interval.interpolator, LookAheadNetwork)
    frames = (repair(interval.key.image.pixels), repair(interval.following.image.pixels))
    pixels = between(*frames, interval.time(slot), interval.interpolator)
    if interval.leads_both_ways:
        fields = (interval.back(slot), interval.forward(slot))
        hold_within(pixels, sources_between(frames, fields))
    else:
        hold_in_range(pixels, frames)
    sources = (interval.key.number, interval.following.number)
    return Predicted(pixels, FrameKind.GENERATED, "onnx", sources, INTERPOLATE)


def _fixed(path: str) -> Method:
    """Return the method that takes one path in every key interval."""
    predict = _warp if path == "S6" else partial(take, path)
    return Method(path.lower(), predict, lookahead=False, needs_motion=True, path=path)


def _looking_ahead(name: str, weighs: bool = False, gated: bool = False) -> Method:
    """Return a method that moves both key frames to each slot; a network may weigh them."""
    predict = partial(_look_ahead, name, weighs)
    return Method(name, predict, lookahead=True, needs_motion=True, weighs=weighs, gated=gated)


def _judged(name: str, judge: Judge, gated: bool = False) -> Method:
    """Return the method that decides the path of each interval."""
    return Method(name, None, lookahead=False, needs_motion=True, judge=judge, gated=gated)


FRAMEWISE = _judged(CAUSAL, Judge.POLICY, gated=True)
"""`causal` as the paper has it: a policy chooses one path for whole frames."""

METHODS: Mapping[str, Method] = {
    method.name: method
    for method in (
        _looking_ahead(EXWARP, weighs=True, gated=True),
        _judged(CAUSAL, Judge.TILES, gated=True),
        *map(_fixed, PATHS),
        _judged("oracle", Judge.PSNR),
        _judged("oracle-return", Judge.RETURN),
        _looking_ahead(SOFTSPLAT),
        _looking_ahead(LOOKAHEAD, weighs=True),
        Method("onnx", _onnx, lookahead=True, needs_motion=False, interpolates=True),
        Method(BLEND, _blend, lookahead=True, needs_motion=False),
        Method("hold", _hold, lookahead=False, needs_motion=False),
    )
}
