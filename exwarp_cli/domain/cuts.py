"""Where shots begin: what ``--cuts`` says, and what comes of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from exwarp_cli.domain.timeline import listed, ranges
from exwarp_cli.errors import MissingFrameError, UsageError

AUTO, NONE = "auto", "none"
"""Words that ``--cuts`` knows: look for cuts, and look for none."""

_EXAMPLE = f"write {AUTO}, {NONE}, or the first frame of each new shot, for example 1045,1101"


@dataclass(frozen=True)
class Cut:
    """A cut, by the key frame after it.

    Attributes
    ----------
    number
        Input number of the first key frame of the new shot.
    source
        "given" by hand, or "detected".
    """

    number: int
    source: str


@dataclass(frozen=True)
class CutWish:
    """What the user says about cuts.

    Attributes
    ----------
    detect
        Whether they are looked for.
    numbers
        Input numbers of key frames that begin a shot, ascending.
    """

    detect: bool = True
    numbers: tuple[int, ...] = ()

    def starts_in(self, sequence: Sequence[int]) -> frozenset[int]:
        """Return the indices of the key frames before which a cut is given.

        The first frame of all may be named; it begins a shot anyway.

        Parameters
        ----------
        sequence
            Input numbers of all key frames, ascending.

        Raises
        ------
        MissingFrameError
            When the sequence lacks a frame that is named.
        """
        index = {number: i for i, number in enumerate(sequence)}
        if absent := [number for number in self.numbers if number not in index]:
            raise MissingFrameError(
                f"frame {ranges(absent)} of --cuts is not in the sequence, which has "
                f"{ranges(list(sequence))}; name the first key frame of each new shot"
            )
        return frozenset(index[number] for number in self.numbers) - {0}


def parse_cuts(text: str) -> CutWish:
    """Read the ``--cuts`` option.

    ``auto`` looks for cuts, ``none`` does not; numbers name the cuts and nothing is looked for,
    unless ``auto`` stands among them.

    Raises
    ------
    UsageError
        When the text is neither.
    """
    words = [word.strip().lower() for word in text.split(",")]
    if words == [NONE]:
        return CutWish(detect=False)
    named = ",".join(word for word in words if word != AUTO)
    if not named and AUTO in words:
        return CutWish()
    try:
        found = listed(named)
    except ValueError as error:
        raise UsageError(f"--cuts {text!r} is not understood; {_EXAMPLE}") from error
    if not found or any(number != int(number) for number in found):
        raise UsageError(f"--cuts {text!r} names no whole frame; {_EXAMPLE}")
    return CutWish(AUTO in words, tuple(sorted({int(number) for number in found})))
