"""Frame numbers, slots, selections and rates; and cuts, where shots begin."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import Any

from exwarp_cli.errors import MissingFrameError, UsageError

# Default output frames per key frame: the paper goes from 30 to 120 fps. Its decisions, and so the
# policy and the extrapolators, are for this factor alone.
FACTOR = 4

MAX_FACTOR = 8

# Frames up to which a sequence is filled: the gap before a stray number may be millions.
MAX_FILLED = 100_000


@dataclass(frozen=True, order=True)
class Slot:
    """An output instant: a key frame's own, or one between it and the next key frame."""

    key: int  # index of the key frame in the whole sequence, from 0
    index: int  # 0 for the key frame itself; 1, 2 … for the instants after it


@dataclass(frozen=True)
class Timeline:
    """Numbering of a whole sequence and of its output."""

    numbers: tuple[int, ...]  # input numbers of all key frames, ascending, in constant steps
    start: int  # number of the first output frame
    tail: bool = True  # slots are predicted past the last key frame
    # Output frames per key frame, above 1. Output instant j is at j / factor key intervals. Unless
    # the factor is an integer, most key frames are no output instants: every other one of 24 fps
    # brought to 60.
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
        steps of the factor have their gaps filled. Both come to the same: the first number, and one
        more for each output instant.

        MissingFrameError: the steps between the numbers are not all equal.
        """
        ordered = sorted(set(numbers))
        if not ordered:
            raise MissingFrameError("the sequence has no frames; check the path or pattern")
        step = number_step(ordered)
        if gaps := [(a, b) for a, b in pairwise(ordered) if b - a != step]:
            # By their ends: a list could be as long as the largest number.
            ends = [
                (before + step, before + (after - before - 1) // step * step)
                for before, after in gaps
            ]
            missing = ",".join(f"{a}-{b}" if b > a else str(a) for a, b in ends)
            raise MissingFrameError(
                f"frame {missing} is missing from the sequence "
                f"{ranges(ordered)}; render it, or move the frames on one side of the gap "
                "elsewhere"
            )
        first = ordered[0] if start is None else start
        return cls(tuple(ordered), first, tail, Fraction(factor))

    @property
    def steps(self) -> int | None:
        """The factor if it is an integer, else None; then all key frames are output instants."""
        return self.factor.numerator if self.factor.denominator == 1 else None

    def order(self, slot: Slot) -> int:
        """Return the position of a slot among all output instants, from 0."""
        return math.floor(slot.key * self.factor) + slot.index

    def number(self, slot: Slot) -> int:
        """Return the output number of a slot."""
        return self.start + self.order(slot)

    def time(self, slot: Slot) -> Fraction:
        """Return the time of a slot in its key interval, 0 <= time < 1."""
        return self.order(slot) / self.factor - slot.key if slot.index else Fraction(0)

    def between(self, key: int) -> tuple[Slot, ...]:
        """Return the slots after key frame `key` (an index) and before the next one."""
        count = math.ceil((key + 1) * self.factor) - 1 - math.floor(key * self.factor)
        return tuple(Slot(key, i) for i in range(1, count + 1))

    def shows(self, key: int) -> bool:
        """Return whether a key frame is an output instant itself."""
        return (key * self.factor).denominator == 1

    def slots_of(self, key: int) -> tuple[Slot, ...]:
        """Return the slots of key frame `key` (an index), in order."""
        last = key == len(self.numbers) - 1
        itself = (Slot(key, 0),) if self.shows(key) else ()
        return itself if last and not self.tail else (*itself, *self.between(key))

    def made_of(self, key: int) -> tuple[Slot, ...]:
        """Return the slots of key frame `key` without the key frame itself."""
        return tuple(slot for slot in self.slots_of(key) if slot.index)

    def select(self, frames: str | None) -> tuple[int, ...]:
        """Return the indices of the key frames that a frame range names; all of them for None.

        UsageError: the range does not parse. MissingFrameError: it names a frame that the
        sequence does not have.
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


def fill_gaps(numbers: Iterable[int]) -> tuple[int, ...]:
    """Return frame numbers, ascending, with the missing ones between them.

    Unchanged where steps are no multiples of the smallest one, or where more than MAX_FILLED would
    result: then `Timeline.of` reports what is missing.
    """
    ordered = sorted(set(numbers))
    step = number_step(ordered)
    if any((b - a) % step for a, b in pairwise(ordered)):
        return tuple(ordered)
    full = range(ordered[0], ordered[-1] + 1, step) if ordered else range(0)
    return tuple(full) if len(full) <= max(MAX_FILLED, len(ordered)) else tuple(ordered)


def parse_frames(text: str) -> list[int]:
    """Parse a frame range such as ``1001-1100``, ``1-10x2``, ``1-10:2`` or ``1,5,9-12``.

    Numbers are sorted, without duplicates. ``:`` means a step, as in Open Job Description.
    UsageError: the text is not a frame range.
    """
    example = "write for example 1001-1100, 1-10x2 or 1,5,9"
    try:
        frames = list_numbers(text)
    except ValueError as error:
        raise UsageError(f"--frames {text!r} is not a frame range; {example}") from error
    if not frames:
        raise UsageError(f"--frames {text!r} names no frame; {example}")
    if fractions := [str(number) for number in frames if number != int(number)]:
        raise UsageError(
            f"--frames {text!r} names the subframe {fractions[0]}; "
            "key frames have whole numbers, and the slots between them come by themselves"
        )
    return sorted({int(number) for number in frames})


def list_numbers(text: str) -> list[Any]:
    """List the numbers of a frame range, whole or not; ValueError if it is none."""
    if re.search(r"\d\s+\d", text):
        raise ValueError(f"no comma between two numbers of {text!r}")  # one would be made of both
    from fileseq.frameset import FrameSet  # not for `exwarp --help`

    try:
        return list(FrameSet(re.sub(r"\s", "", text).replace(":", "x")))
    except (TypeError, OverflowError) as error:
        raise ValueError(str(error)) from error


def ranges(numbers: Collection[int]) -> str:
    """Write frame numbers compactly, for messages: ``1-4,7``."""
    from fileseq.frameset import FrameSet

    return str(FrameSet(sorted(set(numbers))))


# Relative distance at which a rate counts as a standard one: 23.98 is 24000/1001, not 24.
RATE_TOLERANCE = Fraction(2, 10_000)

NTSC_RATIO = Fraction(1000, 1001)  # NTSC rates are integer multiples of this

# Largest denominator and numerator of a rate that is read: eight times it, or a part of it, still
# fits OpenEXR's 32-bit integers.
MAX_DENOMINATOR, MAX_NUMERATOR = 10**6, 2**27


def parse_rate(value: Any) -> Fraction | None:
    """Return the rate of an attribute, rational, int, float, double or text; see `standard_rate`.

    None if it is no positive number of a possible size.
    """
    if getattr(value, "size", 0) == 1:  # how OpenEXR's bindings have a double: an array
        value = value.item()
    if isinstance(value, bool) or not isinstance(value, (int, float, str, Fraction)):
        return None
    try:
        rate = Fraction(value.strip() if isinstance(value, str) else value)
    except (ValueError, ArithmeticError):  # no number, NaN, infinity, or over 0
        return None
    return standard_rate(rate) if Fraction(1, MAX_DENOMINATOR) <= rate <= MAX_NUMERATOR else None


def standard_rate(rate: Fraction) -> Fraction:
    """Return the standard rate within RATE_TOLERANCE, else the rate itself, simplified.

    Standard are integers, and these times 1000/1001 (NTSC).
    """
    whole = Fraction(max(round(rate), 1))
    for standard in (whole, whole * NTSC_RATIO):
        if abs(rate - standard) <= RATE_TOLERANCE * standard:
            return standard
    return rate.limit_denominator(min(MAX_DENOMINATOR, max(1, int(MAX_NUMERATOR / rate))))


def number_step(numbers: Iterable[int]) -> int:
    """Return the step of a sequence's frame numbers; 1 for a single frame."""
    return min((b - a for a, b in pairwise(sorted(set(numbers)))), default=1)


# Words of ``--cuts``: search cuts, and do not.
AUTO_CUTS, NO_CUTS = "auto", "none"

_EXAMPLE = (
    f"write {AUTO_CUTS}, {NO_CUTS}, or the first frame of each new shot, for example 1045,1101"
)


@dataclass(frozen=True)
class Cut:
    """A cut, by the key frame after it."""

    number: int  # input number of the first key frame of the new shot
    source: str  # "given" by hand, or "detected"


@dataclass(frozen=True)
class CutOption:
    """The parsed ``--cuts`` option."""

    detect: bool = True  # cuts are searched
    numbers: tuple[int, ...] = ()  # input numbers of key frames that begin a shot, ascending

    def starts_in(self, sequence: Sequence[int]) -> frozenset[int]:
        """Return the indices of the key frames before which a cut is given; the first is allowed.

        `sequence`: input numbers of all key frames, ascending. MissingFrameError: it lacks a named
        frame.
        """
        index = {number: i for i, number in enumerate(sequence)}
        if absent := [number for number in self.numbers if number not in index]:
            raise MissingFrameError(
                f"frame {ranges(absent)} of --cuts is not in the sequence, which has "
                f"{ranges(list(sequence))}; name the first key frame of each new shot"
            )
        return frozenset(index[number] for number in self.numbers) - {0}


def parse_cuts(text: str) -> CutOption:
    """Read the ``--cuts`` option: ``auto``, ``none``, or numbers of first frames.

    With numbers nothing is searched, unless ``auto`` is among them. UsageError: the text is
    neither.
    """
    words = [word.strip().lower() for word in text.split(",")]
    if words == [NO_CUTS]:
        return CutOption(detect=False)
    named = ",".join(word for word in words if word != AUTO_CUTS)
    if not named and AUTO_CUTS in words:
        return CutOption()
    try:
        frames = list_numbers(named)
    except ValueError as error:
        raise UsageError(f"--cuts {text!r} is not understood; {_EXAMPLE}") from error
    if not frames or any(number != int(number) for number in frames):
        raise UsageError(f"--cuts {text!r} names no whole frame; {_EXAMPLE}")
    return CutOption(AUTO_CUTS in words, tuple(sorted({int(number) for number in frames})))
