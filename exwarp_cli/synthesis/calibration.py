"""Finding out what a renderer's motion vectors mean, by trying them on pairs of frames.

Names and manuals are often wrong about sign, axis, unit and direction, so a convention is measured:
of all candidates the one counts whose vectors lead surface points back to themselves, best judged
by world position (with the right convention 96 % of static pixels find their own position again,
with a flipped axis 68 %, with anything else under 18 %), else by depth and colour.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from exwarp_cli.domain.frame import Bool
from exwarp_cli.domain.motion import AxisMap, MotionConvention, MotionFinding
from exwarp_cli.errors import MotionError
from exwarp_cli.kernels._row_bands import threads
from exwarp_cli.synthesis.evidence import (
    AROUND,
    CLEAR_FLOOR,
    CLEARLY_BETTER,
    CLEARLY_WORSE,
    TIE_FLOOR,
    Evidence,
    Key,
    Ranked,
    alike,
    channel_pairs,
    fitted_together,
    gathered,
    mean_error,
    together,
)
from exwarp_cli.synthesis.sampling import Interval, Sampled

TIE_RATIO = 1.1
"""An error up to this much above the least does not speak against a convention known by name."""

STILL_ERROR = 0.08
"""Mean error without any motion below which a pair has too little motion to tell anything."""

BEATS_STILL = 0.7
"""The best candidate's error must be below this share of the error without motion."""

TELLING = 0.25
"""Error without motion below which what is measured is too weak to refuse a known name."""

SPAN_FLOOR = 0.01
"""An error of short vectors must be below that of full ones by this to be read so."""

HARDLY_BEATS = 0.9
"""Up to this share, and no other reading better, a convention known by name stands untested: pixels
at silhouettes miss whatever the vectors, and in a slow shot they are most of the error."""


def calibrate(
    pairs: Sequence[tuple[Sampled, Sampled]],
    guess: MotionConvention | None,
    names: tuple[str, ...],
    intervals: Sequence[Interval] = (),
    presets: Mapping[str, MotionConvention] | None = None,
    step: int = 1,
) -> MotionFinding:
    """Find the convention of motion channels.

    Parameters
    ----------
    pairs
        Neighbouring frames (earlier, later), fixed by the whole sequence, so that every part of it
        finds the same.
    guess
        What the channel names say; None when they say nothing.
    names
        Names of the motion channels' components, for the evidence.
    intervals
        Neighbouring key frames with colour, where these frames have none.
    presets
        Conventions by the name that ``--motion`` takes, in pixels: those that fit are named.
    step
        By how much numbers rise from frame to frame: vectors may span one of these numbers.

    Raises
    ------
    MotionError
        When there is motion and no candidate explains it, when nothing separates the candidates
        and no name is known, or when the channels hold no values.
    """
    if not pairs:
        return _untested(guess, "one frame alone shows no motion")
    frames = ", ".join(f"{a.number}-{b.number}" for a, b in pairs)
    if intervals:
        keys = ", ".join(f"{first}-{last}" for first, last in (one.numbers for one in intervals))
        frames += f" and the colour of key frames {keys}"
    visible = None if guess is None else _visible(guess, pairs)
    measured = {k: e for k, e in gathered(pairs, names, intervals).items() if e.probes}
    if not measured:
        return _untested(visible, _why_nothing(pairs, frames, names))
    if max(e.moved() for e in measured.values()) < STILL_ERROR:
        return _too_little(pairs, visible, names, frames)
    wanted = _spanning(guess, measured, step)
    finding = _of_written(measured, wanted, names, frames, presets or {})
    if wanted == guess or finding.convention != wanted:
        return finding
    span = f"{finding.evidence}; vectors span one frame of the {step} from key frame to key frame"
    return replace(finding, evidence=span)


def _of_written(
    measured: dict[Key, Evidence],
    guess: MotionConvention | None,
    names: tuple[str, ...],
    frames: str,
    presets: Mapping[str, MotionConvention],
) -> MotionFinding:
    """Find the convention of all channels, but for those that hold no vectors."""
    written = {key: e for key, e in measured.items() if not e.empty}
    if written and {channels for channels, _ in written} != set(channel_pairs(names)):
        kept = {channels for channels, _ in written}
        measured = {key: e for key, e in measured.items() if key[0] in kept}
        return _settled(measured, _without(guess, kept), names, frames, kept, presets)
    return _settled(measured, guess, names, frames, channel_pairs(names), presets)


def _too_little(
    pairs: Sequence[tuple[Sampled, Sampled]],
    guess: MotionConvention | None,
    names: tuple[str, ...],
    frames: str,
) -> MotionFinding:
    """Return what is read where too little moves to measure: at rest, every reading is the same."""
    if any(_movers(one).any() for pair in pairs for one in pair):
        return _untested(guess, f"frames {frames} hold too little motion to measure")
    if guess is not None:
        reason = f"frames {frames} hold too little motion to measure"
        return replace(_untested(guess, reason), resting=True)
    rest = float(np.nan_to_num(np.nanmedian(pairs[0][0].motion[:, :2])))
    convention = MotionConvention(AxisMap(0, 1, 1.0, -1.0, still=rest))
    evidence = (
        f"{convention.describe(names)} assumed, as the channel names are not known: nothing moves "
        f"in frames {frames}, where every reading is the same"
    )
    return MotionFinding(convention, "untested", evidence, resting=True)


def _movers(frame: Sampled) -> Bool:
    """Return which samples of a frame have vectors that are not at rest."""
    return np.asarray(frame.moving & frame.usable)


def _visible(guess: MotionConvention, pairs: Sequence[tuple[Sampled, Sampled]]) -> MotionConvention:
    """Return the named convention without a length or alpha that makes every vector vanish."""
    moving = np.concatenate([one.motion[_movers(one)] for pair in pairs for one in pair])

    def seen(axes: AxisMap | None) -> AxisMap | None:
        if axes is None or not len(moving):
            return axes
        plain = replace(axes, length=None, alpha=None)
        vanishes = not np.nan_to_num(axes.apply(moving)).any()
        return plain if vanishes and np.nan_to_num(plain.apply(moving)).any() else axes

    return replace(guess, to_previous=seen(guess.to_previous), to_next=seen(guess.to_next))


def _spanning(
    guess: MotionConvention | None, measured: dict[Key, Evidence], step: int
) -> MotionConvention | None:
    """Return what the names say, for vectors over one frame or all that key frames are apart.

    Both directions are judged together: they span the same.
    """
    if guess is None or step == 1:
        return guess
    short = guess.scaled(step)
    full_error, short_error = (_error(one, measured) for one in (guess, short))
    return short if short_error + SPAN_FLOOR < full_error else guess


def _error(convention: MotionConvention, measured: dict[Key, Evidence]) -> float:
    """Return the mean error of a convention, by those directions that can be measured."""
    named = {key: _named(key, convention) for key in measured}
    errors = [measured[key].error(axes) for key, axes in named.items() if axes is not None]
    return float(np.mean(errors)) if errors else math.inf


def _settled(
    measured: dict[Key, Evidence],
    guess: MotionConvention | None,
    names: tuple[str, ...],
    frames: str,
    kept: Collection[tuple[int, int]],
    presets: Mapping[str, MotionConvention],
) -> MotionFinding:
    """Find the convention of those channels that hold vectors; see `calibrate`."""
    with ThreadPoolExecutor(min(threads(), len(measured)), "exwarp-measure") as pool:
        each = pool.map(Evidence.ranked, measured.values())
        ranked = dict(zip(measured, each, strict=True))
    verdict = _judged(ranked, measured, guess)
    if not verdict.stands(measured, guess):
        freely = {key: evidence.ranked_freely() for key, evidence in measured.items()}
        if all(freely.values()):
            scaled = _judged(freely, measured, guess)
            better = scaled.error * CLEARLY_BETTER + TIE_FLOOR < verdict.error
            verdict = scaled if scaled.explains and better else verdict
    fits = [_fitting(presets, measured, one) for one in (verdict.convention, guess)]
    found = verdict.finding(measured, guess, names, frames, (fits[0], fits[1]))
    lost = [f"{names[x]},{names[y]}" for x, y in channel_pairs(names) if (x, y) not in kept]
    if not lost:
        return found
    said = f"{found.evidence}; {' and '.join(lost)} hold no vectors and are left out"
    return replace(found, evidence=said, clear=False)


def _without(
    guess: MotionConvention | None, kept: Collection[tuple[int, int]]
) -> MotionConvention | None:
    """Return what the names say of some pairs of channels alone; None where that is nothing."""
    if guess is None:
        return None
    before, after = (
        one if one is not None and _key(one, False)[0] in kept else None
        for one in (guess.to_previous, guess.to_next)
    )
    if before is None and after is None:
        return None
    return replace(guess, to_previous=before, to_next=after)


def _why_nothing(
    pairs: Sequence[tuple[Sampled, Sampled]], frames: str, names: tuple[str, ...]
) -> str:
    """Say why there was nothing to measure; what holds no vectors at all is an error."""
    if all(one.empty for pair in pairs for one in pair):
        raise MotionError(
            f"the motion channels {', '.join(names)} of frames {frames} hold no numbers, only NaN "
            "or infinity; render the motion pass again, or give other vectors"
        )
    return f"frames {frames} hold nothing to measure by: no surfaces, or no depth and no colour"


def _judged(
    ranked: Ranked,
    measured: dict[Key, Evidence],
    guess: MotionConvention | None,
) -> _Verdict:
    """Choose among ranked candidates of every key."""
    option = _assign(ranked, measured, guess)
    chosen = {key: _named_or_best(ranked[key], measured[key], guess) for key in option}
    others = [[ranked[key][0][0] for key in o] for o in _options(ranked) if o != option]
    rival = math.inf
    joint = together(ranked, measured, chosen)
    if joint:
        chosen, rival = joint
    maps = {key: found for key, (_, found) in chosen.items()}
    if not joint:
        rival = min(_rival(ranked[key], measured[key], found) for key, found in maps.items())
    return _Verdict(
        maps,
        float(np.mean([error for error, _ in chosen.values()])),
        float(np.mean([measured[key].still() for key in chosen])),
        rival,
        max(error / (measured[key].still() or 1.0) for key, (error, _) in chosen.items()),
        _untried(maps, measured, guess),
        min(map(max, others), default=math.inf),
    )


def _fitting(
    presets: Mapping[str, MotionConvention],
    measured: dict[Key, Evidence],
    convention: MotionConvention | None,
) -> str:
    """Return the preset that reads vectors as a convention does; "" without.

    Many programs write alike: the shortest of their names is as good as any.
    """
    if convention is None:
        return ""

    def same(a: AxisMap | None, b: AxisMap | None, later: bool) -> bool:
        if a is None or b is None or a == b:
            return a == b
        key = _key(a, later)
        return key == _key(b, later) and key in measured and not measured[key].differ(a, b)

    channels = len(next(iter(measured.values())).raw[0])
    fits = [
        name
        for name, preset in presets.items()
        if preset.count <= channels
        and same(preset.to_previous, convention.to_previous, False)
        and same(preset.to_next, convention.to_next, True)
    ]
    return min(fits, key=len, default="")


def _untried(
    maps: dict[Key, AxisMap], measured: dict[Key, Evidence], guess: MotionConvention | None
) -> dict[Key, AxisMap]:
    """Return the named maps of a direction whose frames hold no vectors, if the other is as named.

    Some programs write none in the first frame, or in the last.
    """
    if guess is None or any(_named(key, guess) != found for key, found in maps.items()):
        return {}
    named = ((guess.to_previous, False), (guess.to_next, True))
    keys = {_key(one, later): one for one, later in named if one is not None}
    return {key: one for key, one in keys.items() if key not in measured}


@dataclass(frozen=True)
class _Verdict:
    """The best convention with its mean error, that of no motion, and that of its best rival.

    `worst` is the largest error of a direction, as a share of that of no motion; `untried` are maps
    that could not be tried, and are as the names say; `turned` is the error where channels to the
    previous and to the next frame change places: of those which that explains worst.
    """

    maps: dict[Key, AxisMap]
    error: float
    still: float
    rival: float
    worst: float
    untried: dict[Key, AxisMap]
    turned: float

    @property
    def convention(self) -> MotionConvention:
        """The convention."""
        every = {**self.untried, **self.maps}
        maps = {later: axis_map for (_, later), axis_map in every.items()}
        return MotionConvention(maps.get(False), maps.get(True))

    @property
    def explains(self) -> bool:
        """Whether the convention explains the motion, and no direction is there for nothing."""
        return self.error <= BEATS_STILL * self.still and self.worst <= HARDLY_BEATS

    @property
    def alone(self) -> bool:
        """Whether no other is as good."""
        return self.rival >= self.error * TIE_RATIO

    def hardly(self, guess: MotionConvention | None) -> bool:
        """Whether it is what the names say, and better than no motion, if not by much."""
        hard = BEATS_STILL * self.still < self.error < HARDLY_BEATS * self.still
        return self.convention == guess and hard

    def stands(self, measured: dict[Key, Evidence], guess: MotionConvention | None) -> bool:
        """Whether there is no need to look for other scales than the usual ones."""
        if self.convention == guess:
            return self.explains or self.hardly(guess)
        return self.explains and self.alone and not self._scaled_is_better(measured)

    def _scaled_is_better(self, measured: dict[Key, Evidence]) -> bool:
        """Whether another scale near the convention's own is clearly better, one for both."""
        if len(self.maps) < 2 or not alike(*self.maps.values()):
            return any(measured[key].scaled_is_better(m) for key, m in self.maps.items())
        own = {key: (measured[key].error(axes), axes) for key, axes in self.maps.items()}
        better = mean_error(fitted_together(own, measured, AROUND))
        return better * CLEARLY_BETTER + CLEAR_FLOOR < mean_error(own)

    def fitted(self, measured: dict[Key, Evidence], guess: MotionConvention | None) -> bool:
        """Whether a scale is none of the usual ones."""
        known = () if guess is None else (guess.to_previous, guess.to_next)
        return any(
            m not in known and m not in measured[key].usual() for key, m in self.maps.items()
        )

    def finding(
        self,
        measured: dict[Key, Evidence],
        guess: MotionConvention | None,
        names: tuple[str, ...],
        frames: str,
        presets: tuple[str, str],
    ) -> MotionFinding:
        """Accept the convention, or say why not; see :func:`calibrate`.

        `presets` are those that read as this convention does, and as the names say; "" without.
        """
        read = self.convention.describe(names)
        stated = None if guess is None else guess.describe(names)
        if not self.explains:
            if self.hardly(guess):
                return _untested(guess, f"frames {frames} hold too little motion to measure")
            telling = max(evidence.moved() for evidence in measured.values())
            if guess is not None and telling < TELLING:
                return _untested(guess, f"frames {frames} tell too little to contradict them")
            raise MotionError(self._unexplained(measured, frames, presets[1]))
        if self.convention != guess and not self.alone:
            if guess is not None and self._nearly(guess, measured):
                return _untested(guess, f"frames {frames} do not tell it and others apart")
            known = "are not known" if stated is None else f"say {stated}, which is worse"
            raise MotionError(
                f"frames {frames} do not tell the conventions {read} and others apart and the "
                f"channel names {known}; give --motion{looks_like(presets[0])}"
            )
        corrected = guess is not None and self.convention != guess
        fitted = self.fitted(measured, guess)
        evidence = (
            f"{read} measured on frames {frames}: error {self.error:.3f}, {self.rival:.3f} for the "
            f"next best reading, {self.still:.3f} without motion"
            + ("; the factor is none of the usual ones and was fitted" if fitted else "")
            + (f"; the names say {stated}" if corrected else "")
        )
        errors = self.error, self.still, self.rival
        source = "corrected" if corrected else "calibrated"
        clear = self._clear(guess)
        return MotionFinding(self.convention, source, evidence, *errors, clear, preset=presets[0])

    def _unexplained(self, measured: dict[Key, Evidence], frames: str, named: str) -> str:
        """Say that nothing explains the motion, what may be the cause, and what to do."""
        one = " in one of the two directions" if self.error <= BEATS_STILL * self.still else ""
        empty = all(evidence.empty for evidence in measured.values())
        cause = (
            "they hold one value everywhere, so the pass is empty, or motion blur was on: switch "
            "it off and render the pass again"
            if empty
            else "check the pass"
        )
        return (
            f"no reading of the motion channels explains the motion between frames {frames}{one} "
            f"(error {self.error:.3f}, {self.still:.3f} without motion); {cause}, or give --motion"
            f"{'' if empty else looks_like(named)}"
        )

    def _nearly(self, guess: MotionConvention, measured: dict[Key, Evidence]) -> bool:
        """Whether what the names say explains the motion, and no worse than the best, clearly."""
        error = _error(guess, measured)
        return error <= HARDLY_BEATS * self.still and error <= CLEARLY_WORSE * self.error

    def _clear(self, guess: MotionConvention | None) -> bool:
        """Whether `MotionFinding.clear` holds, where no channels were left out."""
        as_named = self.convention == guess and not self.untried
        return as_named and min(self.rival, self.turned) > CLEARLY_WORSE * self.error


def looks_like(preset: str) -> str:
    """Return the end of a sentence that names a preset which fits, as a hint; "" without."""
    return f" (looks like {preset.capitalize()}: --motion {preset})" if preset else ""


def _untested(guess: MotionConvention | None, reason: str) -> MotionFinding:
    if guess is None:
        raise MotionError(
            f"the motion convention is unknown: {reason} and the channel names are not known; "
            "give --motion"
        )
    return MotionFinding(guess, "untested", f"taken from the channel names: {reason}")


def _assign(
    ranked: Ranked,
    measured: dict[Key, Evidence],
    guess: MotionConvention | None,
) -> tuple[Key, ...]:
    """Decide which channels lead to the previous and which to the next frame."""
    least = {option: _least(option, ranked) for option in _options(ranked)}
    directions = len({channels for channels, _ in ranked})
    most = min(least.values()) * TIE_RATIO + TIE_FLOOR / directions
    for option, error in least.items():
        named = all(_as_named(ranked[key], measured[key], guess) for key in option)
        if named and error <= most:
            return option
    return min(least, key=least.__getitem__)


def _options(ranked: Ranked) -> list[tuple[Key, ...]]:
    """Return the ways to have channels lead to the previous and to the next frame."""
    pairs = sorted({channels for channels, _ in ranked})
    both = [
        [(channels, later != bool(i)) for i, channels in enumerate(pairs)]
        for later in (False, True)
    ]
    # Where a frame has no vectors, there is no telling what they lead to.
    return list(filter(None, (tuple(key for key in keys if key in ranked) for keys in both)))


def _least(option: Sequence[Key], ranked: Ranked) -> float:
    """Return the mean error of channels in one of these ways, each by its best reading."""
    return float(np.mean([ranked[key][0][0] for key in option]))


def _as_named(
    ranked: list[tuple[float, AxisMap]], evidence: Evidence, guess: MotionConvention | None
) -> bool:
    """Whether the guess holds for these channels in this direction, or does but for its scale.

    At an even speed, vectors to one frame are those to the other turned round. So a direction is
    no better for being named when the signs are not as named.
    """
    named = None if guess is None else _named((evidence.channels, evidence.later), guess)
    if named is None:
        return False
    error, best = ranked[0]
    return _signs(named) == _signs(best) or evidence.error(named) <= error * TIE_RATIO + TIE_FLOOR


def _signs(axis_map: AxisMap) -> tuple[int, bool, bool]:
    return axis_map.x_channel, axis_map.x_scale > 0, axis_map.y_scale > 0


def _key(axis_map: AxisMap, later: bool) -> Key:
    """Return which channels a map reads, for a direction."""
    x, y = sorted((axis_map.x_channel, axis_map.y_channel))
    return (x, y), later


def _named(key: Key, guess: MotionConvention) -> AxisMap | None:
    """Return the guessed map of these channels in this direction."""
    found = guess.to_next if key[1] else guess.to_previous
    if found is None or {found.x_channel, found.y_channel} != set(key[0]):
        return None
    return found


def _named_or_best(
    ranked: list[tuple[float, AxisMap]], evidence: Evidence, guess: MotionConvention | None
) -> tuple[float, AxisMap]:
    """Return the guessed map unless another is clearly better."""
    named = None if guess is None else _named((evidence.channels, evidence.later), guess)
    if named is not None:
        error = evidence.error(named)
        if error <= ranked[0][0] * TIE_RATIO + TIE_FLOOR:
            return error, named
    return ranked[0]


def _rival(ranked: list[tuple[float, AxisMap]], evidence: Evidence, chosen: AxisMap) -> float:
    """Return the error of the best candidate that moves points elsewhere."""
    return next((e for e, c in ranked if evidence.differ(c, chosen)), 1.0)
