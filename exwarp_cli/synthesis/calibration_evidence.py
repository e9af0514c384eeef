"""How well candidate readings of motion channels explain pairs of frames.

A reading has a form (what the values are: displacements, offsets about 0.5, a direction and a
length, premultiplied), axes (which channel is x, signs) and a scale. Forms beyond displacements are
only tried where the values look like them. A renderer writes vectors to both frames by one
convention: over the same span of time, and with the same axes. Signs may differ, as Blender's do.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from exwarp_cli.domain.motion import STILL_MIDDLE, STILL_TOLERANCE, AxisMap
from exwarp_cli.synthesis import calibration_samples
from exwarp_cli.synthesis.camera import F64

# A fast sequence thinned out carries the short vectors of its full rate.
TIME_SCALES = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 0.5, 0.25)

# Vectors are normalised to the frame, to half of it, or to twice it.
SHARES = (1.0, 0.5, 2.0)

# Share of pixels that must look like a form: silhouettes are mixtures of two vectors.
USUAL = 0.75

# How far from 1 the length of a direction may be: half's rounding, and some filtering.
UNIT_TOLERANCE = 0.02

# Samples that candidates are compared on: the many of any scale, and those of the usual ones.
ROUGH, COARSE = 400, 1500

# Candidates whose vectors differ by less than this on average, in pixels, count as one.
SAME_PIXELS = 0.3

# Ratio of neighbouring scales that are tried where the scale is free, and at which a fit begins; at
# which it ends.
FREE_STEP, FITTED = 1.15, 1.002

# Errors that differ by less than this, of 6000 samples, are equal.
TIE_FLOOR = 0.01

# Every other reading's error above this multiple settles a convention known by name: of 6000
# samples the mean error is known to a hundredth.
CLEARLY_WORSE = 1.5

# Names of a channel that others are premultiplied by.
ALPHA = ("a", "alpha")

# A pair of channels, and whether it leads to the later frame.
Key = tuple[tuple[int, int], bool]

# A reading and its error, of each direction's channels; and all readings, the best first.
Chosen = dict[Key, tuple[float, AxisMap]]
Ranked = dict[Key, list[tuple[float, AxisMap]]]


@dataclass(frozen=True)
class Form:
    """What values are: see AxisMap; `unit` is the factor that makes a direction's length 1."""

    still: float = 0.0
    length: int | None = None
    alpha: int | None = None
    unit: float = 1.0

    def map(self, axes: tuple[int, int], x_scale: float, y_scale: float) -> AxisMap:
        """Return the reading of these channels in this form."""
        scales = self.unit * x_scale, self.unit * y_scale
        return AxisMap(*axes, *scales, self.still, self.length, self.alpha)


@dataclass
class Evidence:
    """Errors of candidates for one pair of channels in one direction, over all frame pairs."""

    channels: tuple[int, int]
    later: bool
    size: tuple[int, int]
    more: tuple[int | None, int | None] = (None, None)  # a channel of lengths, and alpha
    probes: list[calibration_samples.Probe] = field(default_factory=list)

    def errors(self, readings: Iterable[AxisMap], count: int | None = None) -> list[float]:
        """Return the mean errors of candidates, on about `count` samples a probe."""
        maps = list(readings)
        if not maps:
            return []
        each = [p.errors(p.shifts(maps, count), count) for p in self.probes]
        return [float(error) for error in calibration_samples.mean_by_weight(each, self.probes)]

    def error(self, reading: AxisMap) -> float:
        """Return the mean error of one candidate."""
        return self.errors([reading])[0]

    def still(self) -> float:
        """Return the mean error of no motion."""
        errors = [_still_error(probe) for probe in self.probes]
        return float(calibration_samples.mean_by_weight(errors, self.probes))

    def moved(self) -> float:
        """Return the mean error of no motion, less what noise alone makes."""
        floors = [probe.floor for probe in self.probes]
        return self.still() - float(calibration_samples.mean_by_weight(floors, self.probes))

    @property
    def raw(self) -> F64:
        """The motion channels' values, [N, C]."""
        return np.concatenate([p.raw for p in self.probes]).astype(np.float64)

    @property
    def empty(self) -> bool:
        """Whether both channels hold one value everywhere: a pass that was never written."""
        values = self.raw[:, self.channels]
        constant = bool((np.ptp(values, axis=0) == 0).all())
        if not any(p.resting for p in self.probes):
            return constant
        # Of moving pixels alone, that value has to be one of no motion: all may move alike.
        rests = (values[0] == 0) | (np.abs(values[0] - STILL_MIDDLE) < STILL_TOLERANCE)
        return constant and bool(rests.all())

    @property
    def forms(self) -> tuple[Form, ...]:
        """The forms that the values look like."""
        raw, (length, alpha) = self.raw, self.more
        values = raw[:, self.channels]
        if length is not None:
            size = raw[:, length]
            moving = np.abs(size) > 1e-6
            for form in (Form(length=length), Form(STILL_MIDDLE, length, unit=2.0)):
                norms = np.linalg.norm(form.unit * (values[moving] - form.still), axis=1)
                if moving.any() and np.mean(np.abs(norms - 1) < UNIT_TOLERANCE) >= USUAL:
                    return (form,)
        forms = [Form()]
        if np.mean((values >= -1e-3) & (values <= 1 + 1e-3)) > 1 - 1e-3:  # perhaps clamped vectors
            forms.append(Form(STILL_MIDDLE))
        if alpha is not None and np.mean((raw[:, alpha] > 0) & (raw[:, alpha] < 1)) > 0:
            forms += [replace(form, alpha=alpha) for form in forms]
        return tuple(forms)

    def usual(self) -> Iterator[AxisMap]:
        """Yield the candidates of the usual scales: which channel is x, and signs.

        Scales are pixels (times the time scales), and vectors normalised to the frame, to half of
        it and to twice it, by width and height each or by width alone.
        """
        width, height = self.size
        for form in self.forms:
            # Clamped displacements of at most a pixel do not occur.
            is_scaled = not form.still or form.length is not None
            scales = [(s, s) for s in TIME_SCALES] if is_scaled else []
            for share in SHARES:
                scales += [(share * width, share * height), (share * width, share * width)]
            for (sx, sy), axes in itertools.product(scales, (self.channels, self.channels[::-1])):
                for gx, gy in itertools.product((1.0, -1.0), repeat=2):
                    yield form.map(axes, gx * sx, gy * sy)

    def ranked(self) -> list[tuple[float, AxisMap]]:
        """Return candidates of usual scale by error: all roughly, the best on every sample."""
        every = list(self.usual())
        rough = sorted(zip(self.errors(every, COARSE), range(len(every)), strict=True))
        best = sorted(index for _, index in rough[:12])
        exact = sorted(zip(self.errors([every[i] for i in best]), best, strict=True))
        return [(error, every[index]) for error, index in exact]

    def ranked_freely(self) -> list[tuple[float, AxisMap]]:
        """Return candidates of any scale by error, the best ones' scales fitted.

        Scales are those that make most vectors half a pixel to half a frame.
        """
        raw, forms, (width, height) = self.raw.astype(np.float32), self.forms, self.size
        every: list[AxisMap] = []
        # Where values may be offsets, they are all of one sign: as displacements, unlikely.
        for form in [form for form in forms if form.still] or list(forms):
            unscaled = form.map(self.channels, 1.0, 1.0).apply(raw)
            typical = float(np.percentile(np.abs(unscaled).max(axis=1), 90))
            if not typical > 0:
                continue
            least, most = 0.5 / typical, 0.5 * width / typical
            count = int(np.log(most / least) / np.log(FREE_STEP)) + 1
            kinds = itertools.product(range(count), (1.0, height / width))
            for (step, aspect), axes in itertools.product(
                kinds, (self.channels, self.channels[::-1])
            ):
                scale = least * FREE_STEP**step
                for gx, gy in itertools.product((1.0, -1.0), repeat=2):
                    every.append(form.map(axes, gx * scale, gy * scale * aspect))
        most_moved = replace(self, probes=[max(self.probes, key=_still_error)])
        rough = sorted(zip(most_moved.errors(every, ROUGH), range(len(every)), strict=True))
        # Readings of one sign and aspect stand side by side; the best of each is fitted.
        best_of_kind: dict[tuple[object, ...], AxisMap] = {}
        for _, index in reversed(rough):
            each = every[index]
            square = abs(each.x_scale) == abs(each.y_scale)
            signs = each.x_channel, each.x_scale > 0, each.y_scale > 0
            best_of_kind[*signs, square, each.still, each.alpha] = each
        unlike = list(best_of_kind.values())
        by_error = sorted(zip(self.errors(unlike, COARSE), range(len(unlike)), strict=True))
        best = [unlike[index] for _, index in by_error[:4]]
        fitted = [self.fit_scale(candidate) for candidate in best]
        others = [candidate for candidate in unlike if candidate not in best]
        unfitted = list(zip(self.errors(others), others, strict=True))
        return sorted(fitted + unfitted, key=lambda entry: entry[0])

    def fit_scale(self, reading: AxisMap) -> tuple[float, AxisMap]:
        """Fit a candidate's scale as `fit_scales` does; return its error too."""
        key = self.channels, self.later
        start = {key: (self.errors([reading], COARSE)[0], reading)}
        return fit_scales(start, {key: self})[key]

    def differ(self, a: AxisMap, b: AxisMap) -> bool:
        """Return True if two candidates move the samples differently enough to be distinguished."""
        gaps = []
        for each in self.probes:
            moved_a, moved_b = each.shifts([a, b], COARSE).astype(np.float64)
            apart = np.abs(moved_a - moved_b)
            # Points that leave the frame by both are no difference; by one of them, a large one.
            apart[np.isnan(moved_a) != np.isnan(moved_b)] = 2 * SAME_PIXELS
            gaps.append(np.nan_to_num(apart).mean())
        return float(np.mean(gaps)) > SAME_PIXELS


def _still_error(probe: calibration_samples.Probe) -> float:
    return float(probe.errors(np.zeros((1, len(probe.xy), 2), np.float32))[0])


def gather_evidence(
    pairs: Sequence[tuple[calibration_samples.FrameSamples, calibration_samples.FrameSamples]],
    names: tuple[str, ...],
    intervals: Sequence[calibration_samples.KeyPair] = (),
) -> dict[Key, Evidence]:
    """Gather evidence, maybe without probes, for every pair of channels and both directions."""
    more: tuple[int | None, int | None] = (None, None)
    if len(names) % 2:
        odd = len(names) - 1
        is_alpha = names[odd].rsplit(".")[-1].lower() in ALPHA
        more = (None, odd) if is_alpha else (odd, None)
    channels = [(first, first + 1) for first in range(0, len(names) - 1, 2)]
    beside = [index for index in more if index is not None]
    evidence = {
        (each, later): Evidence(each, later, pairs[0][0].size, more)
        for each in channels
        for later in (False, True)
    }
    for before, after in pairs:
        for later, frame, neighbour in ((False, after, before), (True, before, after)):
            probes: dict[bytes, calibration_samples.Probe | None] = {}
            for each in channels:
                usable = frame.usable & np.isfinite(frame.motion[:, [*each, *beside]]).all(axis=-1)
                mask = usable.tobytes()
                if mask not in probes:  # mostly all channels hold values at the same pixels
                    probes[mask] = calibration_samples.make_probe(frame, neighbour, usable)
                if (probe := probes[mask]) is not None:
                    evidence[each, later].probes.append(probe)
    for pair, later in itertools.product(intervals, (False, True)):
        trail = calibration_samples.make_trail(pair, later)
        if trail is not None:
            for each in channels:
                evidence[each, later].probes.append(trail)
    return evidence


def rank_jointly(
    ranked: Ranked, measured: dict[Key, Evidence], chosen: Chosen
) -> tuple[Chosen, float] | None:
    """Return the best reading of both directions that has one span and one sign convention.

    Each direction by itself may be explained a little better by another span: vectors over one
    frame of four, read as three of them in a shot that slows down.

    The readings, and the error of the best such reading that moves points elsewhere. None where the
    directions agree already, or are clearly better apart.
    """
    if len(chosen) != 2 or is_alike(*(axes for _, axes in chosen.values())):
        return None
    joint: list[Chosen] = []
    for key, other in (tuple(chosen), tuple(chosen)[::-1]):
        partner_channel = dict(zip(key[0], other[0], strict=True))
        for error, axes in ranked[key]:
            partners = [
                replace(
                    axes,
                    x_channel=partner_channel[axes.x_channel],
                    y_channel=partner_channel[axes.y_channel],
                    x_scale=sign * axes.x_scale,
                    y_scale=sign * axes.y_scale,
                )
                for sign in (1.0, -1.0)
            ]
            errors = measured[other].errors(partners)
            for entry in zip(errors, partners, strict=True):
                joint.append({key: (error, axes), other: entry})
    joint.sort(key=mean_error)
    best = joint[0]
    if any(axes not in measured[key].usual() for key, (_, axes) in best.items()):
        best = fit_scales(best, measured)
    if mean_error(best) > CLEARLY_WORSE * mean_error(chosen) + TIE_FLOOR:
        return None
    rivals = (
        mean_error(other)
        for other in joint
        if any(measured[key].differ(other[key][1], best[key][1]) for key in best)
    )
    return best, next(rivals, 1.0)


def fit_scales(chosen: Chosen, measured: dict[Key, Evidence]) -> Chosen:
    """Fit one scale of readings, to four digits, within FREE_STEP, by ever smaller steps."""
    best, ratio = chosen, FREE_STEP
    while ratio > FITTED:
        factors = (1 / ratio, ratio ** (-0.5), ratio**0.5, ratio)
        near = {
            key: [
                replace(
                    axes,
                    x_scale=float(f"{axes.x_scale * factor:.4g}"),
                    y_scale=float(f"{axes.y_scale * factor:.4g}"),
                )
                for factor in factors
            ]
            for key, (_, axes) in best.items()
        }
        tried = {
            key: list(zip(measured[key].errors(maps, COARSE), maps, strict=True))
            for key, maps in near.items()
        }
        steps = [
            dict(zip(tried, entries, strict=True)) for entries in zip(*tried.values(), strict=True)
        ]
        best = min([best, *steps], key=mean_error)
        ratio **= 0.5
    return {key: (measured[key].error(axes), axes) for key, (_, axes) in best.items()}


def mean_error(chosen: Chosen) -> float:
    """Return the mean error of readings."""
    return float(np.mean([error for error, _ in chosen.values()]))


def is_alike(a: AxisMap, b: AxisMap) -> bool:
    """Return True if readings of two directions have one span and one sign convention."""
    return (
        (a.x_channel < a.y_channel) == (b.x_channel < b.y_channel)
        and abs(a.x_scale) == abs(b.x_scale)
        and a.x_scale * b.y_scale == a.y_scale * b.x_scale
        and (a.still, a.length, a.alpha) == (b.still, b.length, b.alpha)
    )
