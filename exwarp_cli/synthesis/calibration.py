"""Finding out what a renderer's motion vectors mean, by trying them on pairs of frames.

Names and manuals are often wrong about sign, axis, unit and direction, so a convention is measured:
of all candidates the one counts whose vectors lead surface points back to themselves, best judged
by world position (with the right convention 96 % of static pixels find their own position again,
with a flipped axis 68 %, with anything else under 18 %), else by depth and colour.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.motion import AxisMap, MotionConvention, MotionFinding
from exwarp_cli.errors import MotionError
from exwarp_cli.synthesis.evidence import CLEARLY_BETTER, Evidence, Key, gathered
from exwarp_cli.synthesis.probing import Instant

TIE_RATIO, TIE_FLOOR = 1.1, 0.01
"""An error up to this much above the least does not speak against a convention known by name."""

STILL_ERROR = 0.08
"""Mean error without any motion below which a pair has too little motion to tell anything."""

BEATS_STILL = 0.7
"""The best candidate's error must be below this share of the error without motion."""

HARDLY_BEATS = 0.9
"""Up to this share, and no other reading better, a convention known by name stands untested: pixels
at silhouettes miss whatever the vectors, and in a slow shot they are most of the error."""


def calibrate(
    pairs: Sequence[tuple[Instant, Instant]], guess: MotionConvention | None, names: tuple[str, ...]
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

    Raises
    ------
    MotionError
        When there is motion and no candidate explains it, or when nothing separates the candidates
        and no name is known.
    """
    if not pairs:
        return _untested(guess, "one frame alone shows no motion")
    frames = ", ".join(f"{a.number}-{b.number}" for a, b in pairs)
    measured = {k: e for k, e in gathered(pairs, names).items() if e.probes}
    if max((e.still() for e in measured.values()), default=0.0) < STILL_ERROR:
        return _untested(guess, f"frames {frames} hold too little motion to measure")
    verdict = _judged({key: e.ranked() for key, e in measured.items()}, measured, guess)
    if not verdict.stands(measured, guess):
        freely = {key: evidence.ranked_freely() for key, evidence in measured.items()}
        if all(freely.values()):
            scaled = _judged(freely, measured, guess)
            better = scaled.error * CLEARLY_BETTER + TIE_FLOOR < verdict.error
            verdict = scaled if scaled.explains and better else verdict
    return verdict.finding(measured, guess, names, frames)


def _judged(
    ranked: dict[Key, list[tuple[float, AxisMap]]],
    measured: dict[Key, Evidence],
    guess: MotionConvention | None,
) -> _Verdict:
    """Choose among ranked candidates of every key."""
    chosen = {
        key: _named_or_best(ranked[key], measured[key], guess)
        for key in _assign(ranked, measured, guess)
    }
    return _Verdict(
        {key: found for key, (_, found) in chosen.items()},
        float(np.mean([error for error, _ in chosen.values()])),
        float(np.mean([measured[key].still() for key in chosen])),
        min(_rival(ranked[key], measured[key], found) for key, (_, found) in chosen.items()),
    )


@dataclass(frozen=True)
class _Verdict:
    """The best convention with its mean error, that of no motion, and that of its best rival."""

    maps: dict[Key, AxisMap]
    error: float
    still: float
    rival: float

    @property
    def convention(self) -> MotionConvention:
        """The convention."""
        maps = {later: axis_map for (_, later), axis_map in self.maps.items()}
        return MotionConvention(maps.get(False), maps.get(True))

    @property
    def explains(self) -> bool:
        """Whether the convention explains the motion."""
        return self.error <= BEATS_STILL * self.still

    @property
    def alone(self) -> bool:
        """Whether no other is as good."""
        return self.rival >= self.error * TIE_RATIO

    def hardly(self, guess: MotionConvention | None) -> bool:
        """Whether it is what the names say, and better than no motion, if not by much."""
        return self.convention == guess and self.error < HARDLY_BEATS * self.still

    def stands(self, measured: dict[Key, Evidence], guess: MotionConvention | None) -> bool:
        """Whether there is no need to look for other scales than the usual ones."""
        if self.convention == guess:
            return self.explains or self.hardly(guess)
        return (
            self.explains
            and self.alone
            and not any(measured[key].scaled_is_better(m) for key, m in self.maps.items())
        )

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
    ) -> MotionFinding:
        """Accept the convention, or say why not; see :func:`calibrate`."""
        read = self.convention.describe(names)
        told = None if guess is None else guess.describe(names)
        if not self.explains:
            if self.hardly(guess):
                return _untested(guess, f"frames {frames} hold too little motion to measure")
            raise MotionError(
                "no reading of the motion channels explains the motion between frames "
                f"{frames} (error {self.error:.3f}, {self.still:.3f} without motion); check the "
                "pass, or give --motion"
            )
        if self.convention != guess and not self.alone:
            known = "are not known" if told is None else f"say {told}, which is worse"
            raise MotionError(
                f"frames {frames} do not tell the conventions {read} and others apart and the "
                f"channel names {known}; give --motion"
            )
        corrected = guess is not None and self.convention != guess
        fitted = self.fitted(measured, guess)
        evidence = (
            f"{read} measured on frames {frames}: error {self.error:.3f}, {self.rival:.3f} for the "
            f"next best reading, {self.still:.3f} without motion"
            + ("; the factor is none of the usual ones and was fitted" if fitted else "")
            + (f"; the names say {told}" if corrected else "")
        )
        source = "corrected" if corrected else "calibrated"
        return MotionFinding(self.convention, source, evidence, self.error, self.still, self.rival)


def _untested(guess: MotionConvention | None, reason: str) -> MotionFinding:
    if guess is None:
        raise MotionError(
            f"the motion convention is unknown: {reason} and the channel names are not known; "
            "give --motion"
        )
    return MotionFinding(guess, "untested", f"taken from the channel names: {reason}")


def _assign(
    ranked: dict[Key, list[tuple[float, AxisMap]]],
    measured: dict[Key, Evidence],
    guess: MotionConvention | None,
) -> list[Key]:
    """Decide which channels lead to the previous and which to the next frame."""
    pairs = sorted({channels for channels, _ in ranked})
    if len(pairs) == 1:
        options = [[(pairs[0], False)], [(pairs[0], True)]]
    else:
        options = [[(pairs[0], False), (pairs[1], True)], [(pairs[0], True), (pairs[1], False)]]

    def total(option: list[Key]) -> float:
        return sum(ranked[key][0][0] for key in option)

    best = min(options, key=total)
    for option in options:
        named = all(_as_named(ranked[key], measured[key], guess) for key in option)
        if named and total(option) <= total(best) * TIE_RATIO + TIE_FLOOR:
            return option
    return best


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
