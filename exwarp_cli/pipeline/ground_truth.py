"""Ground truth: found, matched to slots, even at another rate, and read interval by interval."""

from __future__ import annotations

import math
from collections import abc
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache

import numpy as np

from exwarp_cli.domain.frame import Image, UInt8, Window
from exwarp_cli.domain.settings import SourceSettings
from exwarp_cli.domain.timeline import Slot, Timeline
from exwarp_cli.errors import InputError, LayoutError
from exwarp_cli.io.display_colour import to_display
from exwarp_cli.io.footage import find_frames, read_display_window, read_sequence_picture
from exwarp_cli.io.sequences import Sequence
from exwarp_cli.io.shot import NonFinite, count_nonfinite, first_usable
from exwarp_cli.io.views import expand_view
from exwarp_cli.pipeline.source import FrameOf, Source, align

# What the report calls the channels of ground truth.
CHANNELS = "ground truth"

# Largest numerator and denominator of a rate.
MOST = 8

# Rates that are tried where the length fits none.
USUAL = tuple(Fraction(a, b) for a, b in ((2, 1), (3, 1), (4, 1), (1, 2), (1, 3), (1, 4)))

# Frames of the output that are compared, at most.
ANCHORS = 3

# Share of the error at one frame per frame below which another rate is certain. Where nothing
# moves, or noise is all that differs, it is not reached.
CLEAR = 0.75

# Returns the frame at a position from 0; raises InputError where it cannot be read.
Read = Callable[[int], Image]


def find_truth(
    spec: str, source: Source, tolerant: bool = False, scan: str = SourceSettings.scan
) -> tuple[Sequence, FrameOf]:
    """Find ground truth of any kind, and refuse one of another size before any work.

    Its first frame tells, or where some may be of no use (`tolerant`) the first that is of any.
    Where it is certainly at another rate than the output, its frames go to the slots at their
    instants; see `OtherRate`.

    Raises
    ------
    InputError
        When it is not found, has gaps, is of another size, or has no frame at any slot's instant.
    """
    sequence = find_frames(expand_view(spec, source.keys.view or None)[0], tolerant, scan)
    frame_of = align(source.timeline, sequence, "--ground-truth")
    display = source.keys.display

    def require_same_size(number: int) -> None:
        window = read_display_window(sequence, number)
        if window.shape != display.shape:
            raise LayoutError(
                f"--ground-truth {sequence.pattern} is {window.width}x{window.height} and the "
                f"input is {display.width}x{display.height}; give one of the same resolution"
            )

    numbers = sequence.numbers
    first_usable(numbers if tolerant else numbers[:1], require_same_size)
    return sequence, _match_by_rate(source, sequence, frame_of)


@dataclass(frozen=True)
class OtherRate:
    """Matches ground truth to slots that is at another rate than the output: by the instant."""

    timeline: Timeline  # of the output
    numbers: tuple[int, ...]  # of the frames of the ground truth, from the first key frame's on
    rate: Fraction  # frames of it per frame of the output

    def __call__(self, slot: Slot) -> int | None:
        """Return the number of a slot's frame; None where it has none."""
        place = self.timeline.order(slot) * self.rate
        exists = place.denominator == 1 and place < len(self.numbers)
        return self.numbers[int(place)] if exists else None

    @property
    def note(self) -> str:
        """A sentence about it for the user."""
        scored = "each new frame is scored against the frame of its own instant"
        if self.rate.denominator > 1:
            scored = "new frames at whose instant it has none are not scored"
        return (
            f"--ground-truth has {float(self.timeline.factor * self.rate):g} frames for each key "
            f"frame and the output {float(self.timeline.factor):g}, as the pictures show: {scored}"
        )


def _match_by_rate(source: Source, sequence: Sequence, frame_of: FrameOf) -> FrameOf:
    """Return what matches ground truth to slots at the rate that its pictures show."""
    timeline, keys = source.timeline, source.keys
    first = frame_of(Slot(0, 0))
    numbers = tuple(n for n in sorted(sequence.numbers) if first is not None and n >= first)
    key_at = {
        timeline.order(Slot(k, 0)): k for k in range(len(timeline.numbers)) if timeline.shows(k)
    }
    rate = truth_rate(
        sorted(key_at),
        math.ceil(len(timeline.numbers) * timeline.factor),
        len(numbers),
        lambda place: read_sequence_picture(
            keys.sequence, timeline.numbers[key_at[place]], keys.view
        ),
        lambda place: read_sequence_picture(sequence, numbers[place], keys.view),
    )
    if rate == 1:
        return frame_of
    match = OtherRate(timeline, numbers, rate)
    slots = (slot for key in range(len(timeline.numbers)) for slot in timeline.made_of(key))
    if all(match(slot) is None for slot in slots):
        raise InputError(
            f"--ground-truth {sequence.pattern} has {float(timeline.factor * rate):g} frames for "
            f"each key frame and the output {float(timeline.factor):g}, so none is of a new "
            f"frame's instant; give a sequence at {float(source.output_fps):g} fps"
        )
    return match


def truth_rate(
    outputs: abc.Sequence[int], count: int, truth: int, of_output: Read, of_truth: Read
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

    def display(image: Image) -> UInt8:
        return to_display(image.on(image.display_window).pixels)

    output = cache(lambda place: display(of_output(place)))

    def error(place: int, truth_place: int) -> float:
        shown = display(of_truth(truth_place))
        return float(np.abs(output(place).astype(np.int16) - shown).mean())

    def error_share(rate: Fraction) -> float:
        """Return the error at a rate as a share of that at one frame per frame."""
        places = _anchors(outputs, rate, truth)
        usual = sum(error(place, place) for place in places)
        if not usual:
            return math.inf
        return sum(error(place, int(place * rate)) for place in places) / usual

    rates = {Fraction(a, b) for a in range(1, MOST + 1) for b in range(1, MOST + 1)} - {1}
    # Those at which a true sequence of this length ends where the output does.
    fitting = [r for r in sorted(rates) if last * r + 1 <= truth <= math.ceil(count * r)]
    try:
        share, rate = min((error_share(r), r) for r in fitting or USUAL)
    except (InputError, ValueError):  # it is said when the frame's turn comes
        return Fraction(1)
    return rate if share < CLEAR else Fraction(1)


def _anchors(outputs: abc.Sequence[int], rate: Fraction, truth: int) -> list[int]:
    """Choose frames, far apart, that have a truth at one frame per frame and at another rate."""
    usable = [
        p for p in outputs if p and p < truth and p * rate < truth and (p * rate).denominator == 1
    ]
    if not usable:
        return []
    return sorted({usable[round(i * (len(usable) - 1) / (ANCHORS - 1))] for i in range(ANCHORS)})


@dataclass(frozen=True)
class IntervalTruth:
    """Ground truth of one interval, as far as there is some, by slot."""

    frames: dict[int, Image] = field(default_factory=dict)  # of the slots that are made
    # The rendered instants around, at slot 0 and, counted on as a slot, at the next key frame's
    # instant; only for VMAF.
    ends: dict[int, Image] = field(default_factory=dict)
    # Why frames cannot be used, where the run goes on without them.
    unscored: dict[int, str] = field(default_factory=dict)


@dataclass(frozen=True)
class TruthReader:
    """Reads ground truth, as far as there is some."""

    source: Source  # the view that is scored
    truth: tuple[Sequence, FrameOf] | None
    measured: tuple[str, ...]  # as in `Score`
    tolerant: bool = False  # whether to go on without frames that cannot be used
    # What was counted in its frames, by the number of the output frame.
    nonfinite: NonFinite = field(default_factory=NonFinite)

    def read(self, key: int) -> IntervalTruth:
        """Read what an interval is scored by.

        Raises
        ------
        InputError
            When a frame is damaged, holds no colour or is of another size, unless tolerant.
        """
        truth = IntervalTruth()
        if self.truth is None:
            return truth
        timeline = self.source.timeline
        self._read_into(truth.frames, timeline.made_of(key), truth.unscored)
        if "vmaf" in self.measured:
            ends = [Slot(key, 0)]
            if key + 1 < len(timeline.numbers):
                ends.append(Slot(key, len(timeline.between(key)) + 1))
            self._read_into(truth.ends, ends, truth.unscored)
        return truth

    def _read_into(
        self, frames: dict[int, Image], slots: Iterable[Slot], unscored: dict[int, str]
    ) -> None:
        for slot in slots:
            try:
                image = self._frame(slot)
            except InputError as error:
                if not self.tolerant:
                    raise
                unscored[slot.index] = str(error)
                continue
            if image is not None:
                frames[slot.index] = image

    def _frame(self, slot: Slot) -> Image | None:
        """Read a frame; None where the sequence has none for the slot."""
        assert self.truth is not None
        sequence, frame_of = self.truth
        number = frame_of(slot)
        if number is None:
            return None
        image, display = (
            read_sequence_picture(sequence, number, self.source.keys.view),
            self.source.keys.display,
        )
        output = self.source.timeline.number(slot)
        if image.display_window.shape != display.shape:
            raise truth_of_another_size(output, image.display_window, display)
        self.nonfinite.note(output, {CHANNELS: count_nonfinite((image.pixels,))})
        return image


def truth_of_another_size(output: int, size: Window, display: Window) -> LayoutError:
    """Build the error for the truth of an output frame that has another size than the input."""
    return LayoutError(
        f"--ground-truth for frame {output} is {size} and the input is {display}; give a sequence "
        "of the same resolution"
    )
