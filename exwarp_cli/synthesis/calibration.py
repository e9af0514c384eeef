"""Finding out what a renderer's motion vectors mean, by trying them on pairs of frames.

Names and manuals are often wrong about sign, axis, unit and direction, so a convention is measured:
of all candidates the one counts whose vectors lead surface points back to themselves, best judged
by world position (with the right convention 96 % of static pixels find their own position again,
with a flipped axis 68 %, with anything else under 18 %), else by depth and colour.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.motion import AxisMap, MotionConvention, MotionFinding
from exwarp_cli.errors import MotionError
from exwarp_cli.synthesis.probing import Instant, Probe, probe

F64 = npt.NDArray[np.float64]

COARSE = 1500
TIME_SCALES = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 0.5, 0.25)
"""A fast sequence thinned out carries the short vectors of its full rate."""

TIE_RATIO, TIE_FLOOR = 1.1, 0.01
"""An error up to this much above the least does not speak against a convention known by name."""

STILL_ERROR = 0.08
"""Mean error without any motion below which a pair has too little motion to tell anything."""

BEATS_STILL = 0.7
"""The best candidate's error must be below this share of the error without motion."""

HARDLY_BEATS = 0.9
"""Up to this share, and no other reading better, a convention known by name stands untested: pixels
at silhouettes miss whatever the vectors, and in a slow shot they are most of the error."""

SAME_PIXELS = 0.3
"""Candidates whose vectors differ by less than this on average count as one."""


@dataclass
class _Evidence:
    """Errors of candidates for one pair of channels in one direction, over all frame pairs."""

    channels: tuple[int, int]
    later: bool
    probes: list[Probe] = field(default_factory=list)

    def error(self, axis_map: AxisMap, count: int | None = None) -> float:
        """Mean error of a candidate."""
        return float(np.mean([p.error(_apply(axis_map, p, count), count) for p in self.probes]))

    def still(self) -> float:
        """Mean error of no motion."""
        return float(np.mean([p.error(np.zeros((1, 2))) for p in self.probes]))

    def ranked(self, width: int, height: int) -> list[tuple[float, AxisMap]]:
        """Candidates by error: all roughly, the best of them on every sample."""
        rough = [
            (self.error(c, COARSE), i, c)
            for i, c in enumerate(candidates(self.channels, width, height))
        ]
        best = sorted(rough, key=lambda entry: entry[:2])[:12]
        exact = [(self.error(c), i, c) for _, i, c in best]
        return [(e, c) for e, _, c in sorted(exact, key=lambda entry: entry[:2])]

    def differ(self, a: AxisMap, b: AxisMap) -> bool:
        """Whether two candidates move the samples differently enough to be told apart."""
        gaps = [np.abs(_apply(a, p, COARSE) - _apply(b, p, COARSE)).mean() for p in self.probes]
        return float(np.mean(gaps)) > SAME_PIXELS


def candidates(channels: tuple[int, int], width: int, height: int) -> list[AxisMap]:
    """Return every reading of two channels: which is x, signs, and scales.

    Scales are pixels (times the time scales), and vectors normalised to the frame, to half of it
    and to twice it, by width and height each or by width alone.
    """
    scales = [(s, s) for s in TIME_SCALES]
    for share in (1.0, 0.5, 2.0):
        scales += [(share * width, share * height), (share * width, share * width)]
    out = []
    for (sx, sy), swap in itertools.product(scales, (False, True)):
        x, y = channels[::-1] if swap else channels
        for gx, gy in itertools.product((1.0, -1.0), repeat=2):
            out.append(AxisMap(x, y, gx * sx, gy * sy))
    return out


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
    measured = {k: e for k, e in _readings(pairs, len(names)).items() if e.probes}
    if max((e.still() for e in measured.values()), default=0.0) < STILL_ERROR:
        return _untested(guess, f"frames {frames} hold too little motion to measure")
    height, width = pairs[0][0].motion.shape[:2]
    ranked = {key: evidence.ranked(width, height) for key, evidence in measured.items()}
    chosen = {
        key: _named_or_best(ranked[key], measured[key], guess)
        for key in _assign(ranked, measured, guess)
    }
    maps = {later: axis_map for (_, later), (_, axis_map) in chosen.items()}
    verdict = _Verdict(
        MotionConvention(maps.get(False), maps.get(True)),
        float(np.mean([error for error, _ in chosen.values()])),
        float(np.mean([measured[key].still() for key in chosen])),
        min(_rival(ranked[key], measured[key], found) for key, (_, found) in chosen.items()),
    )
    return verdict.finding(guess, names, frames)


@dataclass(frozen=True)
class _Verdict:
    """The best convention with its mean error, that of no motion, and that of its best rival."""

    convention: MotionConvention
    error: float
    still: float
    rival: float

    def finding(
        self, guess: MotionConvention | None, names: tuple[str, ...], frames: str
    ) -> MotionFinding:
        """Accept the convention, or say why not; see :func:`calibrate`."""
        read = self.convention.describe(names)
        told = None if guess is None else guess.describe(names)
        if self.error > BEATS_STILL * self.still:
            if self.convention == guess and self.error < HARDLY_BEATS * self.still:
                return _untested(guess, f"frames {frames} hold too little motion to measure")
            raise MotionError(
                "no reading of the motion channels explains the motion between frames "
                f"{frames} (error {self.error:.3f}, {self.still:.3f} without motion); check the "
                "pass, or give --motion"
            )
        if self.convention != guess and self.rival < self.error * TIE_RATIO:
            known = "are not known" if told is None else f"say {told}, which is worse"
            raise MotionError(
                f"frames {frames} do not tell the conventions {read} and others apart and the "
                f"channel names {known}; give --motion"
            )
        corrected = guess is not None and self.convention != guess
        evidence = (
            f"{read} measured on frames {frames}: error {self.error:.3f}, {self.rival:.3f} for the "
            f"next best reading, {self.still:.3f} without motion"
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


Key = tuple[tuple[int, int], bool]


def _readings(pairs: Sequence[tuple[Instant, Instant]], count: int) -> dict[Key, _Evidence]:
    """Return empty or filled evidence for every pair of channels and both directions."""
    out: dict[Key, _Evidence] = {}
    for first in range(0, count - count % 2, 2):
        for later in (False, True):
            channels = (first, first + 1)
            evidence = _Evidence(channels, later)
            for a, b in pairs:
                found = probe(a, b) if later else probe(b, a)
                if found is not None:
                    evidence.probes.append(found)
            out[channels, later] = evidence
    return out


def _assign(
    ranked: dict[Key, list[tuple[float, AxisMap]]],
    measured: dict[Key, _Evidence],
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
        named = guess is not None and all(_named(key, guess) is not None for key in option)
        if named and total(option) <= total(best) * TIE_RATIO + TIE_FLOOR:
            return option
    return best


def _named(key: Key, guess: MotionConvention) -> AxisMap | None:
    """Return the guessed map of these channels in this direction."""
    found = guess.to_next if key[1] else guess.to_previous
    if found is None or {found.x_channel, found.y_channel} != set(key[0]):
        return None
    return found


def _named_or_best(
    ranked: list[tuple[float, AxisMap]], evidence: _Evidence, guess: MotionConvention | None
) -> tuple[float, AxisMap]:
    """Return the guessed map unless another is clearly better."""
    named = None if guess is None else _named((evidence.channels, evidence.later), guess)
    if named is not None:
        error = evidence.error(named)
        if error <= ranked[0][0] * TIE_RATIO + TIE_FLOOR:
            return error, named
    return ranked[0]


def _rival(ranked: list[tuple[float, AxisMap]], evidence: _Evidence, chosen: AxisMap) -> float:
    """Return the error of the best candidate that moves points elsewhere."""
    return next((e for e, c in ranked if evidence.differ(c, chosen)), 1.0)


def _apply(axis_map: AxisMap, sampled: Probe, count: int | None) -> F64:
    """Displacements [N, 2] of a probe's samples."""
    raw = sampled.raw if count is None else sampled.raw[:: max(1, len(sampled.xy) // count)]
    return np.stack(
        [
            raw[:, axis_map.x_channel] * axis_map.x_scale,
            raw[:, axis_map.y_channel] * axis_map.y_scale,
        ],
        axis=1,
    )
