"""Which frames there are and how they are numbered: key frames, slots, selections."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from fileseq.frameset import FrameSet

from exwarp_cli.errors import MissingFrameError, UsageError

FACTOR = 4
"""Output frames per key frame: the paper goes from 30 to 120 fps."""


@dataclass(frozen=True, order=True)
class Slot:
    """An output instant: slot 0 is the key frame itself, slots 1 to 3 lie at k + i/4.

    Attributes
    ----------
    key
        Index of the key frame in the whole sequence, from 0.
    index
        0 to FACTOR - 1.
    """

    key: int
    index: int

    @property
    def order(self) -> int:
        """Position among all output instants of the whole sequence, from 0."""
        return self.key * FACTOR + self.index

    @property
    def time(self) -> float:
        """Fraction of the key interval, 0 <= time < 1."""
        return self.index / FACTOR


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
    """

    numbers: tuple[int, ...]
    start: int
    tail: bool = True

    @classmethod
    def of(cls, numbers: list[int], start: int | None = None, tail: bool = True) -> Timeline:
        """Build the timeline of a sequence with these frame numbers.

        Frames numbered in steps of one are spread out from the first number on; frames numbered in
        steps of the factor have their gaps filled. Both come to the same: first + 4k + i.

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
        return cls(tuple(ordered), ordered[0] if start is None else start, tail)

    def number(self, slot: Slot) -> int:
        """Output number of a slot."""
        return self.start + slot.order

    def slots_of(self, key: int) -> tuple[Slot, ...]:
        """Return the slots that key frame `key` (an index) brings forth, slot 0 first."""
        last = key == len(self.numbers) - 1
        count = 1 if last and not self.tail else FACTOR
        return tuple(Slot(key, i) for i in range(count))

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
                f"which has {ranges(list(self.numbers))}"
            )
        return tuple(index[number] for number in wanted)


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
        found = list(FrameSet(text.replace(":", "x")))
    except (ValueError, TypeError, OverflowError) as error:
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


def ranges(numbers: list[int]) -> str:
    """Write frame numbers compactly, for messages: ``1-4,7``."""
    return str(FrameSet(sorted(set(numbers)))) if numbers else ""


def _missing(gaps: list[tuple[int, int]], step: int) -> str:
    """Name the missing frames by their ends: a list could be as long as the largest number."""
    named = []
    for before, after in gaps:
        count = (after - before - 1) // step
        first, last = before + step, before + count * step
        named.append(f"{first}-{last}" if count > 1 else str(first))
    return ",".join(named)
