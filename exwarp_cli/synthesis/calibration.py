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

from exwarp_cli.domain.frame import Float32, GBuffer
from exwarp_cli.domain.motion import AxisMap, MotionConvention, MotionFinding
from exwarp_cli.errors import MotionError

F64 = npt.NDArray[np.float64]

SAMPLES = 6000
COARSE = 1500
TIME_SCALES = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 0.5, 0.25)
"""A fast sequence thinned out carries the short vectors of its full rate."""

TIE_RATIO, TIE_FLOOR = 1.1, 0.01
"""An error up to this much above the least does not speak against a convention known by name."""

STILL_ERROR = 0.08
"""Mean error without any motion below which a pair has too little motion to tell anything."""

BEATS_STILL = 0.7
"""The best candidate's error must be below this share of the error without motion."""

DEPTH_TOLERANCE = 0.02
"""Relative error of depth that counts as a miss."""

HARDLY_BEATS = 0.9
"""Up to this share, and no other reading better, a convention known by name stands untested: pixels
at silhouettes miss whatever the vectors, and in a slow shot they are most of the error."""

SAME_PIXELS = 0.3
"""Candidates whose vectors differ by less than this on average count as one."""


@dataclass(frozen=True)
class Instant:
    """A frame of a pair: geometry, raw motion channels, and colour where there is some."""

    number: int
    gbuffer: GBuffer
    motion: Float32
    colour: Float32 | None


@dataclass
class _Probe:
    """Sampled pixels of one frame, to be looked up in its neighbour.

    Values of one component are depth, others are fixed to the surface point.
    """

    xy: F64
    raw: F64
    here: list[F64]
    there: list[Float32]
    tolerance: list[F64]

    def error(self, displacement: F64, count: int | None = None) -> float:
        """Return the mean error of displacements [N, 2], 0 (all find themselves) to 1."""
        part = slice(None) if count is None else slice(None, None, max(1, len(self.xy) // count))
        target = self.xy[part] + displacement
        losses = []
        for here, there, tolerance in zip(self.here, self.there, self.tolerance, strict=True):
            found, wanted = _bilinear(there, target), here[part]
            if wanted.shape[1] == 1:
                wanted = _depth_later(wanted, found, self.xy[part], tolerance[part])
            distance = np.linalg.norm(found - wanted, axis=1) / tolerance[part]
            losses.append(np.where(np.isfinite(distance), np.minimum(distance, 1.0), 1.0))
        return float(np.mean(losses))


@dataclass
class _Evidence:
    """Errors of candidates for one pair of channels in one direction, over all frame pairs."""

    channels: tuple[int, int]
    later: bool
    probes: list[_Probe] = field(default_factory=list)

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
    readings = _readings(pairs, len(names))
    measured = {key: evidence for key, evidence in readings.items() if evidence.probes}
    still = max((e.still() for e in measured.values()), default=0.0)
    frames = ", ".join(f"{a.number}-{b.number}" for a, b in pairs)
    if still < STILL_ERROR:
        return _untested(guess, f"frames {frames} hold too little motion to measure")
    height, width = pairs[0][0].motion.shape[:2]
    ranked = {key: evidence.ranked(width, height) for key, evidence in measured.items()}
    choice = _assign(ranked, measured, guess)
    error = float(np.mean([_named_or_best(ranked[k], measured[k], guess)[0] for k in choice]))
    still = float(np.mean([measured[k].still() for k in choice]))
    maps = {
        later: _named_or_best(ranked[(c, later)], measured[(c, later)], guess)[1]
        for c, later in choice
    }
    convention = MotionConvention(maps.get(False), maps.get(True))
    if error > BEATS_STILL * still:
        if convention == guess and error < HARDLY_BEATS * still:
            return _untested(guess, f"frames {frames} hold too little motion to measure")
        raise MotionError(
            f"no reading of the motion channels explains the motion between frames {frames} (error "
            f"{error:.3f}, {still:.3f} without motion); check the pass, or give --motion"
        )
    rival = min(_rival(ranked[k], measured[k], maps[k[1]]) for k in choice)
    if convention != guess and rival < error * TIE_RATIO:
        known = "are not known" if guess is None else f"say {guess.describe(names)}, which is worse"
        raise MotionError(
            f"frames {frames} do not tell the conventions {convention.describe(names)} and others "
            f"apart and the channel names {known}; give --motion"
        )
    source = "calibrated" if guess is None or convention == guess else "corrected"
    told = f"; the names say {guess.describe(names)}" if guess and source == "corrected" else ""
    evidence = (
        f"{convention.describe(names)} measured on frames {frames}: error {error:.3f}, "
        f"{rival:.3f} for the next best reading, {still:.3f} without motion{told}"
    )
    return MotionFinding(convention, source, evidence, error, still, rival)


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
                probe = _probe(a, b) if later else _probe(b, a)
                if probe is not None:
                    evidence.probes.append(probe)
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


def _probe(here: Instant, there: Instant) -> _Probe | None:
    """Sample pixels of `here` and prepare to look them up in `there`; None without any."""
    usable = np.asarray(np.isfinite(here.motion).all(axis=-1))
    if here.gbuffer.depth is not None:
        usable &= np.isfinite(here.gbuffer.depth)
    if here.gbuffer.position is not None:
        usable &= np.isfinite(here.gbuffer.position).all(axis=-1)
    usable[[0, -1]] = False
    usable[:, [0, -1]] = False
    index = np.flatnonzero(usable)
    if len(index) < 100:
        return None
    index = index[:: max(1, len(index) // SAMPLES)]
    y, x = np.divmod(index, usable.shape[1])
    values = _observables(here, there, y, x)
    if not values:
        return None
    return _Probe(
        np.stack([x, y], axis=1).astype(np.float64),
        here.motion[y, x].astype(np.float64),
        [v[0] for v in values],
        [v[1] for v in values],
        [v[2] for v in values],
    )


def _observables(
    here: Instant, there: Instant, y: npt.NDArray[np.intp], x: npt.NDArray[np.intp]
) -> list[tuple[F64, Float32, F64]]:
    """Return (values here, image there, tolerance) of what identifies a surface point."""
    a, b = here.gbuffer, there.gbuffer
    if a.position is not None and b.position is not None:
        return [(a.position[y, x].astype(np.float64), b.position, _pixel_size(a.position, y, x))]
    out: list[tuple[F64, Float32, F64]] = []
    if a.depth is not None and b.depth is not None:
        depth = a.depth[y, x][:, None].astype(np.float64)
        out.append((depth, b.depth[..., None], DEPTH_TOLERANCE * depth[:, 0]))
    if here.colour is not None and there.colour is not None:
        mine, other = _perceived(here.colour), _perceived(there.colour)
        out.append((mine[y, x].astype(np.float64), other, np.full(len(y), 0.15)))
    return out


def _depth_later(depth: F64, found: F64, xy: F64, tolerance: F64) -> F64:
    """Return the depth [N, 1] that static points have in the other frame, as its camera moved.

    That is linear in a point's place (x z, y z, z): the four coefficients are fitted to what was
    found there, robustly. Unfitted, a camera's way forward spoke for half the right vectors.
    """
    seen = np.isfinite(found[:, 0])
    x, y = (xy / xy.max() - 0.5).T
    z = depth[:, 0]
    terms = np.stack([x * z, y * z, z, np.ones_like(z)], axis=1) / tolerance[:, None]
    known, values = terms[seen], found[seen, 0] / tolerance[seen]
    predicted = z[seen] / tolerance[seen]
    if len(known) < 50:
        return depth
    for _ in range(4):
        weighted = known / (1.0 + (values - predicted) ** 2)[:, None]
        fitted = np.linalg.lstsq(weighted.T @ known, weighted.T @ values, rcond=None)[0]
        predicted = known @ fitted
    return np.asarray((terms @ fitted * tolerance)[:, None])


def _pixel_size(position: Float32, y: npt.NDArray[np.intp], x: npt.NDArray[np.intp]) -> F64:
    """World-space size of a pixel, plus the rounding of positions stored as half."""
    p = position.astype(np.float64)
    steps = [
        np.minimum(
            np.linalg.norm(p[y, x] - p[y - dy, x - dx], axis=1),
            np.linalg.norm(p[y, x] - p[y + dy, x + dx], axis=1),
        )
        for dy, dx in ((0, 1), (1, 0))
    ]
    size = np.maximum(steps[0], steps[1])
    largest = np.abs(p[y, x]).max(axis=1)
    with np.errstate(over="ignore"):
        half = bool((position[y, x].astype(np.float16) == position[y, x]).all())
    return np.asarray(size + largest * (2.0**-10 if half else 2.0**-22) + 1e-12)


def _perceived(colour: Float32) -> Float32:
    """Scene-linear RGB compressed roughly as the eye does, float32 [H, W, 3]."""
    return np.sqrt(np.maximum(np.nan_to_num(colour[..., :3], posinf=0, neginf=0), 0))


def _apply(axis_map: AxisMap, probe: _Probe, count: int | None) -> F64:
    """Displacements [N, 2] of a probe's samples."""
    raw = probe.raw if count is None else probe.raw[:: max(1, len(probe.xy) // count)]
    return np.stack(
        [
            raw[:, axis_map.x_channel] * axis_map.x_scale,
            raw[:, axis_map.y_channel] * axis_map.y_scale,
        ],
        axis=1,
    )


def _bilinear(image: Float32, target: F64) -> F64:
    """Sample an image [H, W, C] at (x, y) positions [N, 2]; NaN outside it."""
    height, width = image.shape[:2]
    corner = np.floor(target)
    inside = ((target >= 0) & (target <= (width - 1, height - 1))).all(axis=1)
    x = np.where(inside, corner[:, 0], 0).astype(np.intp)
    y = np.where(inside, corner[:, 1], 0).astype(np.intp)
    x1, y1 = np.minimum(x + 1, width - 1), np.minimum(y + 1, height - 1)
    fx, fy = (target - corner)[:, :1], (target - corner)[:, 1:]
    with np.errstate(invalid="ignore"):
        upper = image[y, x] * (1 - fx) + image[y, x1] * fx
        lower = image[y1, x] * (1 - fx) + image[y1, x1] * fx
        found: F64 = np.asarray(upper * (1 - fy) + lower * fy, dtype=np.float64)
    found[~inside] = np.nan
    return found
