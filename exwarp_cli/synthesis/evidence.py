"""How well readings of motion channels explain pairs of frames.

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
import numpy.typing as npt

from exwarp_cli.domain.motion import STILL_MIDDLE, STILL_TOLERANCE, AxisMap
from exwarp_cli.synthesis.probing import Probe, probe, trail
from exwarp_cli.synthesis.sampling import Interval, Sampled

F64 = npt.NDArray[np.float64]

TIME_SCALES = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 0.5, 0.25)
"""A fast sequence thinned out carries the short vectors of its full rate."""

SHARES = (1.0, 0.5, 2.0)
"""Vectors are normalised to the frame, to half of it, or to twice it."""

USUAL = 0.75
"""Share of pixels that must look like a form: silhouettes are mixtures of two vectors."""

UNIT_TOLERANCE = 0.02
"""How far from 1 the length of a direction may be: half's rounding, and some filtering."""

FREE_STEP = 1.15
"""Ratio of neighbouring scales that are tried where the scale is free."""


@dataclass(frozen=True)
class Form:
    """What values are: see AxisMap; `unit` is the factor that makes a direction's length 1."""

    still: float = 0.0
    length: int | None = None
    alpha: int | None = None
    unit: float = 1.0

    def map(self, axes: tuple[int, int], x_scale: float, y_scale: float) -> AxisMap:
        """Return the reading of these channels in this form."""
        x, y = axes
        return AxisMap(
            x, y, self.unit * x_scale, self.unit * y_scale, self.still, self.length, self.alpha
        )


def forms(
    raw: F64, channels: tuple[int, int], length: int | None, alpha: int | None
) -> tuple[Form, ...]:
    """Return the forms that values look like.

    Parameters
    ----------
    raw
        Samples [N, C] of all motion channels, finite.
    channels
        The two that are read.
    length, alpha
        Which further channel may be a length, which is alpha; None without.
    """
    values = raw[:, channels]
    if length is not None:
        directed = _directions(values, raw[:, length], length)
        if directed:
            return directed
    out = [Form()]
    if _about_the_middle(values):
        out.append(Form(STILL_MIDDLE))
    if alpha is not None and np.mean((raw[:, alpha] > 0) & (raw[:, alpha] < 1)) > 0:
        out += [replace(form, alpha=alpha) for form in out]
    return tuple(out)


def _directions(values: F64, size: F64, length: int) -> tuple[Form, ...]:
    """Return the form of a direction with its length, where values are of length 1."""
    moving = np.abs(size) > 1e-6
    if not moving.any():
        return ()
    for form in (Form(length=length), Form(STILL_MIDDLE, length, unit=2.0)):
        reach = np.linalg.norm(form.unit * (values[moving] - form.still), axis=1)
        if np.mean(np.abs(reach - 1) < UNIT_TOLERANCE) >= USUAL:
            return (form,)
    return ()


def _about_the_middle(values: F64) -> bool:
    """Whether values may be clamped vectors: within 0 … 1."""
    return bool(np.mean((values >= -1e-3) & (values <= 1 + 1e-3)) > 1 - 1e-3)


def fixed(form: Form, channels: tuple[int, int], width: int, height: int) -> Iterator[AxisMap]:
    """Yield a form's readings of two channels: which is x, signs, and the usual scales.

    Scales are pixels (times the time scales), and vectors normalised to the frame, to half of it
    and to twice it, by width and height each or by width alone. Clamped displacements of at most
    a pixel are none.
    """
    scales = [(s, s) for s in TIME_SCALES] if not form.still or form.length is not None else []
    for share in SHARES:
        scales += [(share * width, share * height), (share * width, share * width)]
    for (sx, sy), axes in itertools.product(scales, (channels, channels[::-1])):
        for gx, gy in itertools.product((1.0, -1.0), repeat=2):
            yield form.map(axes, gx * sx, gy * sy)


def free(
    form: Form, channels: tuple[int, int], raw: F64, width: int, height: int
) -> Iterator[AxisMap]:
    """Yield a form's readings at any scale that makes most vectors half a pixel to half a frame."""
    unscaled = form.map(channels, 1.0, 1.0).apply(raw.astype(np.float32))
    typical = float(np.percentile(np.abs(unscaled).max(axis=1), 90))
    if not typical > 0:
        return
    least, most = 0.5 / typical, 0.5 * width / typical
    count = int(np.log(most / least) / np.log(FREE_STEP)) + 1
    for step, aspect in itertools.product(range(count), (1.0, height / width)):
        scale = least * FREE_STEP**step
        for axes in (channels, channels[::-1]):
            for gx, gy in itertools.product((1.0, -1.0), repeat=2):
                yield form.map(axes, gx * scale, gy * scale * aspect)


def nearby(reading: AxisMap, reach: float) -> Iterator[AxisMap]:
    """Yield a reading at somewhat other scales: up to a ratio more or less, finer and finer."""
    for factor in (1 / reach, reach ** (-0.5), reach**0.5, reach):
        yield rounded(
            replace(reading, x_scale=reading.x_scale * factor, y_scale=reading.y_scale * factor)
        )


def rounded(reading: AxisMap) -> AxisMap:
    """Return a reading with scales of four digits: a measured one is not surer."""
    return replace(
        reading, x_scale=float(f"{reading.x_scale:.4g}"), y_scale=float(f"{reading.y_scale:.4g}")
    )


ROUGH, COARSE = 400, 1500
"""Samples that candidates are compared on: the many of any scale, and those of the usual ones."""

SAME_PIXELS = 0.3
"""Candidates whose vectors differ by less than this on average count as one."""

AROUND, FITTED = 1.15, 1.002
"""Ratio of neighbouring scales at which fitting one begins around a usual one, and ends."""

CLEARLY_BETTER, CLEAR_FLOOR = 1.25, 0.01
"""A usual scale stands unless another near it has an error that is smaller by this ratio, and
more."""

ALPHA = ("a", "alpha")
"""Names of a channel that others are premultiplied by."""

Key = tuple[tuple[int, int], bool]


@dataclass
class Evidence:
    """Errors of candidates for one pair of channels in one direction, over all frame pairs."""

    channels: tuple[int, int]
    later: bool
    size: tuple[int, int]
    more: tuple[int | None, int | None] = (None, None)
    probes: list[Probe] = field(default_factory=list)

    def errors(self, readings: Iterable[AxisMap], count: int | None = None) -> list[float]:
        """Mean errors of candidates."""
        maps = list(readings)
        if not maps:
            return []
        each = [p.errors(p.shifts(maps, count), count) for p in self.probes]
        return [float(error) for error in self._mean(each)]

    def error(self, reading: AxisMap) -> float:
        """Mean error of one candidate."""
        return self.errors([reading])[0]

    def still(self) -> float:
        """Mean error of no motion."""
        return float(self._mean([_still(p) for p in self.probes]))

    def moved(self) -> float:
        """Mean error of no motion, less what noise alone makes."""
        return self.still() - float(self._mean([p.floor for p in self.probes]))

    def _mean(self, each: Sequence[F64 | float]) -> F64:
        """Average over the probes, each by how much it tells points apart."""
        weights = [p.weight for p in self.probes]
        usable = weights if sum(weights) > 0 else None
        return np.asarray(np.average(np.stack(each), axis=0, weights=usable))

    @property
    def raw(self) -> F64:
        """The motion channels' values, [N, C]."""
        return np.concatenate([p.raw for p in self.probes]).astype(np.float64)

    @property
    def empty(self) -> bool:
        """Whether both channels hold one value everywhere: a pass that was never written.

        Of moving pixels alone, that value has to be one of no motion: all may move alike.
        """
        values = self.raw[:, self.channels]
        constant = bool((np.ptp(values, axis=0) == 0).all())
        if not any(p.resting for p in self.probes):
            return constant
        rests = (values[0] == 0) | (np.abs(values[0] - STILL_MIDDLE) < STILL_TOLERANCE)
        return constant and bool(rests.all())

    @property
    def forms(self) -> tuple[Form, ...]:
        """What the values may be."""
        return forms(self.raw, self.channels, *self.more)

    def ranked(self) -> list[tuple[float, AxisMap]]:
        """Candidates of usual scale by error: all roughly, the best of them on every sample."""
        every = list(self.usual())
        rough = sorted(enumerate(self.errors(every, COARSE)), key=_by_error)
        best = sorted(i for i, _ in rough[:12])
        exact = sorted(zip(best, self.errors([every[i] for i in best]), strict=True), key=_by_error)
        return [(error, every[i]) for i, error in exact]

    def usual(self) -> Iterator[AxisMap]:
        """Yield the candidates of the usual scales."""
        for form in self.forms:
            yield from fixed(form, self.channels, *self.size)

    def ranked_freely(self) -> list[tuple[float, AxisMap]]:
        """Candidates of any scale by error, the best ones' scales fitted."""
        raw, seen = self.raw, self.forms
        # Where values may be offsets, they are all of one sign: as displacements, unlikely.
        likely = [form for form in seen if form.still] or seen
        every = [c for f in likely for c in free(f, self.channels, raw, *self.size)]
        one = replace(self, probes=[max(self.probes, key=_still)])
        rough = sorted(enumerate(one.errors(every, ROUGH)), key=_by_error)
        # Readings of one sign and aspect stand side by side; the best of each is fitted.
        kinds = list({_kind(every[i]): every[i] for i, _ in reversed(rough)}.values())
        by_error = sorted(enumerate(self.errors(kinds, COARSE)), key=_by_error)
        best = [kinds[i] for i, _ in by_error[:4]]
        fitted = [self._scaled(c, FREE_STEP) for c in best]
        others = [c for c in kinds if c not in best]
        rest = list(zip(self.errors(others), others, strict=True))
        return sorted(fitted + rest, key=lambda entry: entry[0])

    def scaled_is_better(self, axis_map: AxisMap) -> bool:
        """Whether another scale, near a candidate's own, is clearly better."""
        better, _ = self._scaled(axis_map, AROUND)
        return better * CLEARLY_BETTER + CLEAR_FLOOR < self.error(axis_map)

    def _scaled(self, axis_map: AxisMap, reach: float) -> tuple[float, AxisMap]:
        """Fit a candidate's scale within a ratio, by ever smaller steps."""
        best = (self.errors([axis_map], COARSE)[0], axis_map)
        while reach > FITTED:
            near = list(nearby(best[1], reach))
            tried = zip(self.errors(near, COARSE), near, strict=True)
            best = min([best, *tried], key=lambda entry: entry[0])
            reach **= 0.5
        return self.error(best[1]), best[1]

    def differ(self, a: AxisMap, b: AxisMap) -> bool:
        """Whether two candidates move the samples differently enough to be distinguished."""
        gaps = []
        for one in self.probes:
            moved_a, moved_b = one.shifts([a, b], COARSE).astype(np.float64)
            apart = np.abs(moved_a - moved_b)
            # Points that leave the frame by both are no difference; by one of them, a large one.
            apart[np.isnan(moved_a) != np.isnan(moved_b)] = 2 * SAME_PIXELS
            gaps.append(np.nan_to_num(apart).mean())
        return float(np.mean(gaps)) > SAME_PIXELS


def _by_error(ranked: tuple[int, float]) -> tuple[float, int]:
    index, error = ranked
    return error, index


def _still(sampled: Probe) -> float:
    """Return the mean error of no motion."""
    return float(sampled.errors(np.zeros((1, len(sampled.xy), 2), np.float32))[0])


def _kind(axis_map: AxisMap) -> tuple[object, ...]:
    """What tells candidates apart but their scale."""
    return (
        axis_map.x_channel,
        axis_map.x_scale > 0,
        axis_map.y_scale > 0,
        abs(axis_map.x_scale) == abs(axis_map.y_scale),
        axis_map.still,
        axis_map.alpha,
    )


def channel_pairs(names: tuple[str, ...]) -> list[tuple[int, int]]:
    """Return the pairs of channels that may be one direction's."""
    return [(first, first + 1) for first in range(0, len(names) - 1, 2)]


def gathered(
    pairs: Sequence[tuple[Sampled, Sampled]],
    names: tuple[str, ...],
    intervals: Sequence[Interval] = (),
) -> dict[Key, Evidence]:
    """Gather empty or filled evidence for every pair of channels and both directions."""
    odd = len(names) - 1 if len(names) % 2 else None
    more = (
        (None, odd)
        if odd is not None and names[odd].rsplit(".")[-1].lower() in ALPHA
        else (odd, None)
    )
    further = [index for index in more if index is not None]
    channels = channel_pairs(names)
    used = [(*one, *further) for one in channels]
    out = {
        (one, later): Evidence(one, later, pairs[0][0].size, more)
        for one in channels
        for later in (False, True)
    }
    for before, after in pairs:
        for later, ends in ((False, (after, before)), (True, (before, after))):
            for one, found in zip(channels, probe(*ends, used), strict=True):
                if found is not None:
                    out[one, later].probes.append(found)
    for way in intervals:
        for later in (False, True):
            followed = trail(way, later)
            if followed is not None:
                for one in channels:
                    out[one, later].probes.append(followed)
    return out


TIE_FLOOR = 0.01
"""Errors that differ by less than this, of 6000 samples, are equal."""

CLEARLY_WORSE = 1.5
"""Every other reading's error above this multiple settles a convention known by name: of 6000
samples the mean error is known to a hundredth."""

Ranked = dict[Key, list[tuple[float, AxisMap]]]
"""Readings of channels in a direction, and their errors: the best first."""

Chosen = dict[Key, tuple[float, AxisMap]]
"""A reading of each direction's channels, and its error."""


def together(
    ranked: Ranked, measured: dict[Key, Evidence], chosen: Chosen
) -> tuple[Chosen, float] | None:
    """Return the best reading of both directions that has one span and one sign convention.

    Each direction by itself may be explained a little better by another span: vectors over one
    frame of four, read as three of them in a shot that slows down.

    Returns
    -------
    tuple or None
        The readings, and the error of the best such reading that moves points elsewhere. None
        where the directions agree already, or are clearly better apart.
    """
    if len(chosen) != 2 or alike(*(axes for _, axes in chosen.values())):
        return None
    joint = sorted(_joint(ranked, measured, tuple(chosen)), key=mean_error)
    best = joint[0]
    if any(axes not in measured[key].usual() for key, (_, axes) in best.items()):
        best = fitted_together(best, measured, FREE_STEP)
    if mean_error(best) > CLEARLY_WORSE * mean_error(chosen) + TIE_FLOOR:
        return None

    def differs(other: Chosen) -> bool:
        return any(measured[key].differ(other[key][1], best[key][1]) for key in best)

    return best, next((mean_error(other) for other in joint if differs(other)), 1.0)


def _joint(
    ranked: Ranked, measured: dict[Key, Evidence], option: tuple[Key, ...]
) -> Iterator[Chosen]:
    """Yield readings of both directions with one span and one sign convention."""
    for key, other in (option, option[::-1]):
        places = dict(zip(key[0], other[0], strict=True))
        for error, axes in ranked[key]:
            partners = [
                replace(
                    axes,
                    x_channel=places[axes.x_channel],
                    y_channel=places[axes.y_channel],
                    x_scale=sign * axes.x_scale,
                    y_scale=sign * axes.y_scale,
                )
                for sign in (1.0, -1.0)
            ]
            for partner_error, partner in zip(
                measured[other].errors(partners), partners, strict=True
            ):
                yield {key: (error, axes), other: (partner_error, partner)}


def fitted_together(chosen: Chosen, measured: dict[Key, Evidence], reach: float) -> Chosen:
    """Fit the scale of readings together within a ratio, by ever smaller steps."""
    best = chosen
    while reach > FITTED:
        near = {key: list(nearby(axes, reach)) for key, (_, axes) in best.items()}
        tried = {
            key: list(zip(measured[key].errors(maps, COARSE), maps, strict=True))
            for key, maps in near.items()
        }
        count = len(next(iter(near.values())))
        steps = [{key: entries[i] for key, entries in tried.items()} for i in range(count)]
        best = min([best, *steps], key=mean_error)
        reach **= 0.5
    return {key: (measured[key].error(axes), axes) for key, (_, axes) in best.items()}


def mean_error(chosen: Chosen) -> float:
    """Return the mean error of readings."""
    return float(np.mean([error for error, _ in chosen.values()]))


def alike(a: AxisMap, b: AxisMap) -> bool:
    """Whether readings of two directions have one span and one sign convention."""
    return (
        (a.x_channel < a.y_channel) == (b.x_channel < b.y_channel)
        and abs(a.x_scale) == abs(b.x_scale)
        and a.x_scale * b.y_scale == a.y_scale * b.x_scale
        and (a.still, a.length, a.alpha) == (b.still, b.length, b.alpha)
    )
