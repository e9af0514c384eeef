"""The readings of motion channels that come into question: which of them, for the values seen.

A reading has a form (what the values are: displacements, offsets about 0.5, a direction and a
length, premultiplied), axes (which channel is x, signs) and a scale. Forms beyond displacements are
only tried where the values look like them.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.motion import MIDDLE, AxisMap

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
        out.append(Form(MIDDLE))
    if alpha is not None and np.mean((raw[:, alpha] > 0) & (raw[:, alpha] < 1)) > 0:
        out += [replace(form, alpha=alpha) for form in out]
    return tuple(out)


def _directions(values: F64, size: F64, length: int) -> tuple[Form, ...]:
    """Return the form of a direction with its length, where values are of length 1."""
    moving = np.abs(size) > 1e-6
    if not moving.any():
        return ()
    for form in (Form(length=length), Form(MIDDLE, length, unit=2.0)):
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
