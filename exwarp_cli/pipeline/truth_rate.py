"""At how many frames per frame of an output a true sequence is, by its length and its pictures."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import cache

import numpy as np

from exwarp_cli.domain.frame import Image, UInt8
from exwarp_cli.errors import InputError
from exwarp_cli.io.video import to_display

MOST = 8
"""Largest numerator and denominator of a rate."""

USUAL = tuple(Fraction(a, b) for a, b in ((2, 1), (3, 1), (4, 1), (1, 2), (1, 3), (1, 4)))
"""Rates that are tried where the length fits none."""

ANCHORS = 3
"""Frames of the output that are compared, at most."""

CLEAR = 0.75
"""Share of the error at one frame per frame below which another rate is certain. Where nothing
moves, or noise is all that differs, it is not reached."""

Read = Callable[[int], Image]
"""Gives the frame at a position from 0; raises InputError where it cannot be read."""


def truth_rate(
    outputs: Sequence[int], count: int, truth: int, of_output: Read, of_truth: Read
) -> Fraction:
    """Return how many frames a true sequence has per frame of the output; 1 unless it is certain.

    Both begin at the same instant. A length that fits is believed without looking.

    Parameters
    ----------
    outputs
        Positions of output frames that are rendered, ascending, from 0: their truth is the same
        picture. Also others will do, if less surely.
    count
        Length of the output, with frames past the last key frame.
    truth
        Length of the true sequence.
    of_output, of_truth
        Read a frame of either.
    """
    last = outputs[-1] if outputs else 0
    if last < truth <= count:
        return Fraction(1)
    output = cache(lambda place: _shown(of_output(place)))

    def remaining(rate: Fraction) -> float:
        """Return the error at a rate as a share of that at one frame per frame."""
        places = _anchors(outputs, rate, truth)
        known = sum(_difference(output(p), _shown(of_truth(p))) for p in places)
        if not known:
            return math.inf
        return sum(_difference(output(p), _shown(of_truth(int(p * rate)))) for p in places) / known

    try:
        share, rate = min((remaining(r), r) for r in _fitting(last, count, truth) or USUAL)
    except (InputError, ValueError):  # it is said when the frame's turn comes
        return Fraction(1)
    return rate if share < CLEAR else Fraction(1)


def _fitting(last: int, count: int, truth: int) -> tuple[Fraction, ...]:
    """Return the rates at which a true sequence of a length ends where the output does."""
    rates = {Fraction(a, b) for a in range(1, MOST + 1) for b in range(1, MOST + 1)}
    return tuple(
        rate for rate in sorted(rates - {1}) if last * rate + 1 <= truth <= math.ceil(count * rate)
    )


def _anchors(outputs: Sequence[int], rate: Fraction, truth: int) -> list[int]:
    """Choose frames, far apart, that have a truth at one frame per frame and at another rate."""
    able = [
        p for p in outputs if p and p < truth and p * rate < truth and (p * rate).denominator == 1
    ]
    return sorted(
        {able[round(i * (len(able) - 1) / (ANCHORS - 1))] for i in range(ANCHORS)} if able else ()
    )


def _shown(image: Image) -> UInt8:
    return to_display(image.on(image.display_window).pixels)


def _difference(one: UInt8, other: UInt8) -> float:
    return float(np.abs(one.astype(np.int16) - other).mean())
