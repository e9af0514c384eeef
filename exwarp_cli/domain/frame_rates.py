"""Frame rates: what a header or an option means by a number, as an exact fraction."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np

NEAR = Fraction(2, 10_000)
"""Relative distance at which a rate counts as a standard one: 23.98 is 24000/1001, not 24."""

BROADCAST = Fraction(1000, 1001)
"""How much slower than a whole number the rates of NTSC television are."""

FINEST, LARGEST = 10**6, 2**27
"""Largest denominator and numerator of a rate that is read: eight times it, or a part of it, still
fits OpenEXR's 32-bit integers."""


@dataclass(frozen=True)
class OutputRate:
    """Frames per second of an output.

    Attributes
    ----------
    fps
        What a video has.
    written
        What headers of frames say; None where the rate is only assumed.
    """

    fps: Fraction
    written: Fraction | None


def parsed_rate(value: Any) -> Fraction | None:
    """Return the rate that an attribute holds: rational, int, float, double or text.

    None for what is no positive number of a possible size; see :func:`standard_rate`.
    """
    if isinstance(value, np.ndarray) and value.size == 1:  # how OpenEXR's bindings have a double
        value = value.item()
    if isinstance(value, bool) or not isinstance(value, (int, float, str, Fraction)):
        return None
    try:
        rate = Fraction(value.strip() if isinstance(value, str) else value)
    except (ValueError, ArithmeticError):  # no number, NaN, infinity, or over 0
        return None
    return standard_rate(rate) if Fraction(1, FINEST) <= rate <= LARGEST else None


def standard_rate(rate: Fraction) -> Fraction:
    """Return the standard rate that one stands for, else the rate itself, simplified.

    Standard are whole numbers, and these times 1000/1001 as NTSC television has them.
    """
    whole = Fraction(max(round(rate), 1))
    for standard in (whole, whole * BROADCAST):
        if abs(rate - standard) <= NEAR * standard:
            return standard
    return rate.limit_denominator(min(FINEST, max(1, int(LARGEST / rate))))


def compatible_rate(base: Fraction, target: Fraction) -> Fraction:
    """Return the rate within 0.1 % of `target` at which most key frames are output instants.

    From 24000/1001 to 60 fps only one key frame in a thousand is an output instant; to 60000/1001
    every other one is. The target itself is kept where nothing is gained.
    """
    rates = (target, target * BROADCAST, target / BROADCAST)
    return min(rates, key=lambda rate: (rate / base).denominator)


def number_step(numbers: Iterable[int]) -> int:
    """Return the step in which a sequence's frames are numbered; 1 for a single frame."""
    return min((b - a for a, b in pairwise(sorted(set(numbers)))), default=1)
