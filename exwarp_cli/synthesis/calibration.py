"""Measures what a renderer's motion vectors mean, by trying readings on pairs of frames.

Names and manuals are often wrong about sign, axis, unit and direction, so a convention is measured:
of all candidates that one is chosen whose vectors lead surface points back to themselves. World
position is the best measure (with the right convention 96 % of static pixels find their position
again, with a flipped axis 68 %, with anything else under 18 %), else depth and colour.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from exwarp_cli.domain.motion import AxisMap, MotionConvention, MotionFinding
from exwarp_cli.errors import MotionError
from exwarp_cli.kernels._row_bands import threads
from exwarp_cli.synthesis.calibration_evidence import (
    CLEARLY_WORSE,
    TIE_FLOOR,
    Evidence,
    Key,
    Ranked,
    fit_scales,
    gather_evidence,
    is_alike,
    mean_error,
    rank_jointly,
)
from exwarp_cli.synthesis.calibration_samples import FrameSamples, KeyPair

# An error up to this much above the least does not speak against a convention known by name.
TIE_RATIO = 1.1

# A usual scale stands unless another near it has an error that is smaller by this ratio, and more.
CLEARLY_BETTER, CLEAR_FLOOR = 1.25, 0.01

# Mean error without any motion below which a pair has too little motion to measure.
STILL_ERROR = 0.08

# The best candidate's error must be below this share of the error without motion.
BEATS_STILL = 0.7

# Error without motion below which a measurement is too weak to refuse a known name.
DECISIVE = 0.25

# An error of short vectors must be below that of full ones by this to be read so.
SPAN_FLOOR = 0.01

# Up to this share, and no other reading better, a convention known by name stands untested: pixels
# at silhouettes miss whatever the vectors, and in a slow shot they are most of the error.
HARDLY_BEATS = 0.9

Pairs = Sequence[tuple[FrameSamples, FrameSamples]]


def calibrate(
    # Neighbouring frames (earlier, later), fixed by the whole sequence, so that every part of it
    # finds the same.
    pairs: Pairs,
    guess: MotionConvention | None,  # what the channel names say; None when they say nothing
    names: tuple[str, ...],  # names of the motion channels' components, for the evidence
    # Neighbouring key frames with colour, where these frames have none.
    intervals: Sequence[KeyPair] = (),
    # Conventions by the name that ``--motion`` takes, in pixels: those that fit are named.
    presets: Mapping[str, MotionConvention] | None = None,
    # By how much numbers rise from frame to frame: vectors may span one of these numbers.
    step: int = 1,
) -> MotionFinding:
    """Find the convention of motion channels.

    Raises MotionError if there is motion and no candidate explains it, if nothing separates the
    candidates and no name is known, or if the channels hold no values.
    """
    if not pairs:
        return _untested(guess, "one frame alone shows no motion")
    frames = ", ".join(f"{a.number}-{b.number}" for a, b in pairs)
    if intervals:
        keys = ", ".join(f"{first}-{last}" for first, last in (pair.numbers for pair in intervals))
        frames += f" and the colour of key frames {keys}"
    usable_guess = None if guess is None else _without_vanishing(guess, pairs)
    evidence = gather_evidence(pairs, names, intervals)
    measured = {key: each for key, each in evidence.items() if each.probes}
    if not measured:
        if all(frame.empty for pair in pairs for frame in pair):
            raise MotionError(
                f"the motion channels {', '.join(names)} of frames {frames} hold no numbers, only "
                "NaN or infinity; render the motion pass again, or give other vectors"
            )
        reason = (
            f"frames {frames} hold nothing to measure by: no surfaces, or no depth and no colour"
        )
        return _untested(usable_guess, reason)
    if max(each.moved() for each in measured.values()) < STILL_ERROR:
        return _too_little_motion(pairs, usable_guess, names, frames)
    spanning = guess
    if guess is not None and step > 1:
        # Both directions are compared together: they span the same.
        short = guess.scaled(step)
        if _convention_error(short, measured) + SPAN_FLOOR < _convention_error(guess, measured):
            spanning = short
    channels = sorted({pair for pair, _ in evidence})
    finding = _measure(measured, channels, spanning, names, frames, presets or {})
    if spanning == guess or finding.convention != spanning:
        return finding
    span = f"{finding.evidence}; vectors span one frame of the {step} from key frame to key frame"
    return replace(finding, evidence=span)


def _too_little_motion(
    pairs: Pairs, guess: MotionConvention | None, names: tuple[str, ...], frames: str
) -> MotionFinding:
    """Return the reading where too little moves to measure: at rest, all readings are the same."""
    reason = f"frames {frames} hold too little motion to measure"
    if any((frame.moving & frame.usable).any() for pair in pairs for frame in pair):
        return _untested(guess, reason)
    if guess is not None:
        return replace(_untested(guess, reason), resting=True)
    rest = float(np.nan_to_num(np.nanmedian(pairs[0][0].motion[:, :2])))
    convention = MotionConvention(AxisMap(0, 1, 1.0, -1.0, still=rest))
    evidence = (
        f"{convention.describe(names)} assumed, as the channel names are not known: nothing moves "
        f"in frames {frames}, where every reading is the same"
    )
    return MotionFinding(convention, "untested", evidence, resting=True)


def _without_vanishing(guess: MotionConvention, pairs: Pairs) -> MotionConvention:
    """Return the named convention without a length or alpha that makes every vector vanish."""
    moving = np.concatenate(
        [frame.motion[frame.moving & frame.usable] for pair in pairs for frame in pair]
    )
    ways = []
    for axes in (guess.to_previous, guess.to_next):
        if axes is not None and len(moving) and not np.nan_to_num(axes.apply(moving)).any():
            plain = replace(axes, length=None, alpha=None)
            axes = plain if np.nan_to_num(plain.apply(moving)).any() else axes
        ways.append(axes)
    return replace(guess, to_previous=ways[0], to_next=ways[1])


def _maps(convention: MotionConvention | None) -> dict[Key, AxisMap]:
    """Return the maps of a convention, by the channels that they read and their direction."""
    maps: dict[Key, AxisMap] = {}
    if convention is not None:
        for axes, later in ((convention.to_previous, False), (convention.to_next, True)):
            if axes is not None:
                x, y = sorted((axes.x_channel, axes.y_channel))
                maps[(x, y), later] = axes
    return maps


def _convention_error(convention: MotionConvention, measured: dict[Key, Evidence]) -> float:
    """Return the mean error of a convention, by those directions that can be measured."""
    maps = _maps(convention)
    errors = [measured[key].error(maps[key]) for key in measured if key in maps]
    return float(np.mean(errors)) if errors else math.inf


def _measure(
    measured: dict[Key, Evidence],
    channels: Sequence[tuple[int, int]],  # all pairs of them
    guess: MotionConvention | None,
    names: tuple[str, ...],
    frames: str,
    presets: Mapping[str, MotionConvention],
) -> MotionFinding:
    """Find the convention of those channels that hold vectors; see `calibrate`."""
    written = {key[0] for key, evidence in measured.items() if not evidence.empty}
    lost = [pair for pair in channels if written and pair not in written]
    if lost:
        measured = {key: evidence for key, evidence in measured.items() if key[0] in written}
        maps = {key[1]: axes for key, axes in _maps(guess).items() if key[0] in written}
        guess = MotionConvention(maps.get(False), maps.get(True)) if maps else None
    with ThreadPoolExecutor(min(threads(), len(measured)), "exwarp-measure") as executor:
        each = executor.map(Evidence.ranked, measured.values())
        ranked = dict(zip(measured, each, strict=True))
    verdict = _judge(ranked, measured, guess)
    if not verdict.stands:
        freely = {key: evidence.ranked_freely() for key, evidence in measured.items()}
        if all(freely.values()):
            scaled = _judge(freely, measured, guess)
            better = scaled.error * CLEARLY_BETTER + TIE_FLOOR < verdict.error
            verdict = scaled if scaled.explains and better else verdict
    finding = verdict.finding(names, frames, presets)
    if not lost:
        return finding
    listed = " and ".join(f"{names[x]},{names[y]}" for x, y in lost)
    evidence = f"{finding.evidence}; {listed} hold no vectors and are left out"
    return replace(finding, evidence=evidence, clear=False)


def _judge(
    ranked: Ranked, measured: dict[Key, Evidence], guess: MotionConvention | None
) -> _Verdict:
    """Choose among ranked candidates of every key."""
    named = _maps(guess)
    # The ways to have channels lead to the previous and to the next frame. Where a frame has no
    # vectors, there is nothing to assign.
    pairs = sorted({channels for channels, _ in ranked})
    both = [
        [(channels, later != bool(i)) for i, channels in enumerate(pairs)]
        for later in (False, True)
    ]
    options = list(filter(None, (tuple(key for key in keys if key in ranked) for keys in both)))
    option = _assign_directions(options, ranked, measured, named)
    chosen = {key: ranked[key][0] for key in option}
    for key, (least, _) in chosen.items():
        if key in named:
            error = measured[key].error(named[key])
            if error <= least * TIE_RATIO + TIE_FLOOR:  # no other is clearly better
                chosen[key] = error, named[key]
    turned = [[ranked[key][0][0] for key in o] for o in options if o != option]
    joint = rank_jointly(ranked, measured, chosen)
    if joint:
        chosen, rival = joint
    maps = {key: axes for key, (_, axes) in chosen.items()}
    if not joint:
        rival = min(
            next((e for e, axes in ranked[key] if measured[key].differ(axes, best)), 1.0)
            for key, best in maps.items()
        )
    untried: dict[Key, AxisMap] = {}
    if all(named.get(key) == axes for key, axes in maps.items()):
        # Some programs write no vectors in the first frame, or in the last.
        untried = {key: axes for key, axes in named.items() if key not in measured}
    return _Verdict(
        measured,
        guess,
        maps,
        mean_error(chosen),
        float(np.mean([measured[key].still() for key in chosen])),
        rival,
        max(error / (measured[key].still() or 1.0) for key, (error, _) in chosen.items()),
        untried,
        min(map(max, turned), default=math.inf),
    )


def _fitting_preset(
    presets: Mapping[str, MotionConvention],
    measured: dict[Key, Evidence],
    convention: MotionConvention | None,
) -> str:
    """Return the preset that reads vectors as a convention does; "" without."""
    channels, maps = len(next(iter(measured.values())).raw[0]), _maps(convention)
    fits = []
    for name, preset in presets.items():
        own = _maps(preset)
        if preset.count <= channels and own.keys() == maps.keys():
            apart = [key for key, axes in own.items() if axes != maps[key]]
            if all(k in measured and not measured[k].differ(own[k], maps[k]) for k in apart):
                fits.append(name)
    # Many programs write alike: the shortest of their names is as good as any.
    return min(fits, key=len, default="")


@dataclass(frozen=True)
class _Verdict:
    """The best convention and its errors."""

    measured: dict[Key, Evidence]
    guess: MotionConvention | None  # what the names say
    maps: dict[Key, AxisMap]
    error: float  # mean
    still: float  # of no motion
    rival: float  # of the best other reading
    worst: float  # the largest error of a direction, as a share of that of no motion
    untried: dict[Key, AxisMap]  # maps that could not be tried, and are as the names say
    # Where channels to the previous and to the next frame change places: the largest error then.
    turned: float

    @property
    def convention(self) -> MotionConvention:
        every = {**self.untried, **self.maps}
        maps = {later: axis_map for (_, later), axis_map in every.items()}
        return MotionConvention(maps.get(False), maps.get(True))

    @property
    def explains(self) -> bool:
        """Whether the convention explains the motion, and each direction contributes."""
        return self.error <= BEATS_STILL * self.still and self.worst <= HARDLY_BEATS

    @property
    def alone(self) -> bool:
        """Whether no other is as good."""
        return self.rival >= self.error * TIE_RATIO

    @property
    def is_hardly_better(self) -> bool:
        """Whether it is what the names say, and only a little better than no motion."""
        hardly = BEATS_STILL * self.still < self.error < HARDLY_BEATS * self.still
        return self.convention == self.guess and hardly

    @property
    def stands(self) -> bool:
        """Whether no other scales than the usual ones need to be tried."""
        if self.convention == self.guess:
            return self.explains or self.is_hardly_better
        if not self.explains or not self.alone:
            return False
        # Another scale near the convention's own may be clearly better, one for both directions.
        errors = {key: self.measured[key].error(axes) for key, axes in self.maps.items()}
        if len(self.maps) == 2 and is_alike(*self.maps.values()):
            own = {key: (errors[key], axes) for key, axes in self.maps.items()}
            fits = [(mean_error(fit_scales(own, self.measured)), mean_error(own))]
        else:
            fits = [
                (self.measured[key].fit_scale(axes)[0], errors[key])
                for key, axes in self.maps.items()
            ]
        return not any(better * CLEARLY_BETTER + CLEAR_FLOOR < error for better, error in fits)

    def finding(
        self, names: tuple[str, ...], frames: str, presets: Mapping[str, MotionConvention]
    ) -> MotionFinding:
        """Accept the convention, or say why not; see :func:`calibrate`."""
        guess = self.guess
        read = self.convention.describe(names)
        stated = None if guess is None else guess.describe(names)
        if not self.explains:
            if self.is_hardly_better:
                return _untested(guess, f"frames {frames} hold too little motion to measure")
            strongest = max(evidence.moved() for evidence in self.measured.values())
            if guess is not None and strongest < DECISIVE:
                return _untested(guess, f"frames {frames} tell too little to contradict them")
            direction = (
                " in one of the two directions" if self.error <= BEATS_STILL * self.still else ""
            )
            hint, cause = "", "check the pass"
            if all(evidence.empty for evidence in self.measured.values()):
                cause = (
                    "they hold one value everywhere, so the pass is empty, or motion blur was on: "
                    "switch it off and render the pass again"
                )
            else:
                hint = preset_hint(_fitting_preset(presets, self.measured, guess))
            raise MotionError(
                "no reading of the motion channels explains the motion between frames "
                f"{frames}{direction} (error {self.error:.3f}, {self.still:.3f} without motion); "
                f"{cause}, or give --motion{hint}"
            )
        fitting = _fitting_preset(presets, self.measured, self.convention)
        if self.convention != guess and not self.alone:
            if guess is not None:
                error = _convention_error(guess, self.measured)
                if error <= HARDLY_BEATS * self.still and error <= CLEARLY_WORSE * self.error:
                    return _untested(guess, f"frames {frames} do not tell it and others apart")
            name_problem = "are not known" if stated is None else f"say {stated}, which is worse"
            raise MotionError(
                f"frames {frames} do not tell the conventions {read} and others apart and the "
                f"channel names {name_problem}; give --motion{preset_hint(fitting)}"
            )
        corrected = guess is not None and self.convention != guess
        named = () if guess is None else (guess.to_previous, guess.to_next)
        fitted = any(
            axes not in named and axes not in self.measured[key].usual()
            for key, axes in self.maps.items()
        )
        evidence = (
            f"{read} measured on frames {frames}: error {self.error:.3f}, {self.rival:.3f} for the "
            f"next best reading, {self.still:.3f} without motion"
            + ("; the factor is none of the usual ones and was fitted" if fitted else "")
            + (f"; the names say {stated}" if corrected else "")
        )
        errors = self.error, self.still, self.rival
        source = "corrected" if corrected else "calibrated"
        as_named = self.convention == guess and not self.untried
        clear = as_named and min(self.rival, self.turned) > CLEARLY_WORSE * self.error
        return MotionFinding(self.convention, source, evidence, *errors, clear, preset=fitting)


def preset_hint(preset: str) -> str:
    """Return the end of a sentence that names a preset which fits; "" without."""
    return f" (looks like {preset.capitalize()}: --motion {preset})" if preset else ""


def _untested(guess: MotionConvention | None, reason: str) -> MotionFinding:
    if guess is None:
        raise MotionError(
            f"the motion convention is unknown: {reason} and the channel names are not known; "
            "give --motion"
        )
    return MotionFinding(guess, "untested", f"taken from the channel names: {reason}")


def _assign_directions(
    options: Sequence[tuple[Key, ...]],
    ranked: Ranked,
    measured: dict[Key, Evidence],
    named: dict[Key, AxisMap],
) -> tuple[Key, ...]:
    """Decide which channels lead to the previous and which to the next frame."""
    # Of each option the mean error, each pair of channels by its best reading.
    least = {option: float(np.mean([ranked[key][0][0] for key in option])) for option in options}
    directions = len({channels for channels, _ in ranked})
    most = min(least.values()) * TIE_RATIO + TIE_FLOOR / directions
    as_named = set()
    for key in ranked.keys() & named.keys():
        (error, best), axes = ranked[key][0], named[key]
        # At an even speed, vectors to one frame are those to the other reversed. So a direction is
        # no better for being named when the signs are not as named.
        signs = [(each.x_channel, each.x_scale > 0, each.y_scale > 0) for each in (axes, best)]
        if signs[0] == signs[1] or measured[key].error(axes) <= (error * TIE_RATIO + TIE_FLOOR):
            as_named.add(key)
    for option, error in least.items():
        if error <= most and as_named.issuperset(option):
            return option
    return min(least, key=least.__getitem__)
