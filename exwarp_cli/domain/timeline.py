"""Which frames there are and how they are numbered: key frames, slots, selections."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import Any

from exwarp_cli.errors import MissingFrameError, UsageError

FACTOR = 4
"""Output frames per key frame where nothing else is asked for: the paper goes from 30 to 120 fps.
Its decisions, and so the policy and the networks that extrapolate, are for this factor alone."""

MOST = 8
"""The largest factor."""

MOST_FILLED = 100_000
"""Frames up to which a sequence is filled: the gap before a stray number may be millions."""


@dataclass(frozen=True, order=True)
class Slot:
    """An output instant: a key frame's own, or one of those between it and the next key frame.

    Attributes
    ----------
    key
        Index of the key frame in the whole sequence, from 0.
    index
        0 for the key frame itself; 1, 2 … for the output instants after it. At the usual factor
        those are 1 to 3, at k + i/4.
    """

    key: int
    index: int


@dataclass(frozen=True)
class Timeline:
    """Numbering of a whole sequence and of what is written for it.

    Attributes
    ----------
    numbers
        Input numbers of all key frames, ascending, in constant steps.
    start
        Number of the first output frame.
    tail
        Whether slots are predicted past the last key frame.
    factor
        Output frames per key frame, above 1. Output instant j lies at j / factor key intervals, so
        where the factor is no whole number most key frames are no output instants: of 24 fps
        brought to 60 every other one is.
    """

    numbers: tuple[int, ...]
    start: int
    tail: bool = True
    factor: Fraction = Fraction(FACTOR)

    @classmethod
    def of(
        cls,
        numbers: list[int],
        start: int | None = None,
        tail: bool = True,
        factor: Fraction | int = FACTOR,
    ) -> Timeline:
        """Build the timeline of a sequence with these frame numbers.

        Frames numbered in steps of one are spread out from the first number on; frames numbered in
        steps of the factor have their gaps filled. Both come to the same: the first number, and
        one more for each output instant.

        Raises
        ------
        MissingFrameError
            When the steps between the numbers are not all equal.
        """
        ordered = sorted(set(numbers))
        if not ordered:
            raise MissingFrameError("the sequence has no frames; check the path or pattern")
        step = min((b - a for a, b in pairwise(ordered)), default=1)
        if gaps := [(a, b) for a, b in pairwise(ordered) if b - a != step]:
            raise MissingFrameError(
                f"frame {_missing(gaps, step)} is missing from the sequence {ranges(ordered)}; "
                "render it, or move the frames on one side of the gap elsewhere"
            )
        first = ordered[0] if start is None else start
        return cls(tuple(ordered), first, tail, Fraction(factor))

    @property
    def steps(self) -> int | None:
        """The factor where it is a whole number, else None: key frames are output instants then."""
        return self.factor.numerator if self.factor.denominator == 1 else None

    def order(self, slot: Slot) -> int:
        """Position of a slot among all output instants of the whole sequence, from 0."""
        return math.floor(slot.key * self.factor) + slot.index

    def number(self, slot: Slot) -> int:
        """Output number of a slot."""
        return self.start + self.order(slot)

    def time(self, slot: Slot) -> Fraction:
        """Fraction of the key interval at which a slot lies, 0 <= time < 1."""
        return self.order(slot) / self.factor - slot.key if slot.index else Fraction(0)

    def between(self, key: int) -> tuple[Slot, ...]:
        """Return the slots after key frame `key` (an index) and before the next one."""
        count = math.ceil((key + 1) * self.factor) - 1 - math.floor(key * self.factor)
        return tuple(Slot(key, i) for i in range(1, count + 1))

    def shows(self, key: int) -> bool:
        """Whether a key frame is an output instant itself."""
        return (key * self.factor).denominator == 1

    def slots_of(self, key: int) -> tuple[Slot, ...]:
        """Return the slots that key frame `key` (an index) brings forth, in order."""
        last = key == len(self.numbers) - 1
        itself = (Slot(key, 0),) if self.shows(key) else ()
        return itself if last and not self.tail else (*itself, *self.between(key))

    def made_of(self, key: int) -> tuple[Slot, ...]:
        """Return those of them that are made, without the key frame itself."""
        return tuple(slot for slot in self.slots_of(key) if slot.index)

    def select(self, frames: str | None) -> tuple[int, ...]:
        """Indices of the key frames that a frame range names; all of them for None.

        Raises
        ------
        UsageError
            When the range does not parse.
        MissingFrameError
            When it names a frame that the sequence does not have.
        """
        if frames is None:
            return tuple(range(len(self.numbers)))
        wanted = parse_frames(frames)
        index = {number: i for i, number in enumerate(self.numbers)}
        absent = [number for number in wanted if number not in index]
        if absent:
            raise MissingFrameError(
                f"frame {ranges(absent)} of --frames {frames} is not in the sequence, "
                f"which has {ranges(self.numbers)}"
            )
        return tuple(index[number] for number in wanted)


def without_gaps(numbers: Iterable[int]) -> tuple[int, ...]:
    """Return frame numbers with those that are missing between them, ascending.

    They are returned as they are where their steps are no multiples of the smallest one, or where
    more than `MOST_FILLED` would come of it: then `Timeline.of` says what is missing.
    """
    ordered = sorted(set(numbers))
    step = min((b - a for a, b in pairwise(ordered)), default=1)
    if any((b - a) % step for a, b in pairwise(ordered)):
        return tuple(ordered)
    full = range(ordered[0], ordered[-1] + 1, step) if ordered else range(0)
    return tuple(full) if len(full) <= max(MOST_FILLED, len(ordered)) else tuple(ordered)


def parse_frames(text: str) -> list[int]:
    """Parse a frame range such as ``1001-1100``, ``1-10x2``, ``1-10:2`` or ``1,5,9-12``.

    ``:`` means a step, as in Open Job Description, the same as ``x``.

    Returns
    -------
    list of int
        Sorted, without duplicates.

    Raises
    ------
    UsageError
        When the text is not a frame range.
    """
    try:
        found = listed(text)
    except ValueError as error:
        raise UsageError(
            f"--frames {text!r} is not a frame range; write for example 1001-1100, 1-10x2 or 1,5,9"
        ) from error
    if not found:
        raise UsageError(
            f"--frames {text!r} names no frame; write for example 1001-1100, 1-10x2 or 1,5,9"
        )
    if fractions := [str(number) for number in found if number != int(number)]:
        raise UsageError(
            f"--frames {text!r} names the subframe {fractions[0]}; "
            "key frames have whole numbers, and the slots between them come by themselves"
        )
    return sorted({int(number) for number in found})


def listed(text: str) -> list[Any]:
    """List the numbers of a frame range, whole or not; ``:`` means a step, the same as ``x``.

    Raises
    ------
    ValueError
        When the text is not a frame range.
    """
    if re.search(r"\d\s+\d", text):
        raise ValueError(f"no comma between two numbers of {text!r}")  # one would be made of both
    plain = re.fullmatch(r"\s*(\d{1,5})\s*(?:-\s*(\d{1,5})\s*)?", text, re.ASCII)
    if plain and int(plain[1]) <= int(plain[2] or plain[1]):  # most often, and at once
        return list(range(int(plain[1]), int(plain[2] or plain[1]) + 1))
    from fileseq.frameset import FrameSet  # not for `exwarp --help`, nor where all is done

    try:
        return list(FrameSet(re.sub(r"\s", "", text).replace(":", "x")))
    except (TypeError, OverflowError) as error:
        raise ValueError(str(error)) from error


def ranges(numbers: Collection[int]) -> str:
    """Write frame numbers compactly, for messages: ``1-4,7``."""
    ordered = sorted(set(numbers))
    if not ordered or ordered[-1] - ordered[0] == len(ordered) - 1:  # most often, and at once
        return "-".join(str(number) for number in dict.fromkeys(ordered[:1] + ordered[-1:]))
    from fileseq.frameset import FrameSet

    return str(FrameSet(ordered))


def _missing(gaps: list[tuple[int, int]], step: int) -> str:
    """Name the missing frames by their ends: a list could be as long as the largest number."""
    named = []
    for before, after in gaps:
        count = (after - before - 1) // step
        first, last = before + step, before + count * step
        named.append(f"{first}-{last}" if count > 1 else str(first))
    return ",".join(named)


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
    if getattr(value, "size", 0) == 1:  # how OpenEXR's bindings have a double: an array
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
