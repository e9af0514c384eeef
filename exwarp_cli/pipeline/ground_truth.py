"""Ground truth: found, matched to slots, even at another rate, and read interval by interval."""

from __future__ import annotations

import math
from collections import abc
from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache

import numpy as np

from exwarp_cli.domain.frame import Float32, Image, Window
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

# Returns the display window of the frame at a position from 0, as `read_display` does.
Read = Callable[[int], Float32]


def read_display(sequence: Sequence, number: int, view: str) -> Float32:
    """Read the display window of a frame, float32 [H, W, C], scene-linear; raises InputError."""
    image = read_sequence_picture(sequence, number, view)
    return image.on(image.display_window).pixels


def find_truth(
    spec: str, source: Source, tolerant: bool = False, scan: str = SourceSettings.scan
) -> tuple[Sequence, FrameOf]:
    """Find ground truth of any kind, and refuse one of another size before any work.

    Its first frame tells, or where some may be of no use (`tolerant`) the first that is of any.
    Where it is certainly at another rate than the output, its frames go to the slots at their
    instants; see `OtherRate`. Raises InputError when it is not found, has gaps, is of another size,
    or has no frame at any slot's instant.
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

    first_usable(sequence.numbers if tolerant else sequence.numbers[:1], require_same_size)
    timeline, keys = source.timeline, source.keys
    first = frame_of(Slot(0, 0))
    numbers = tuple(n for n in sorted(sequence.numbers) if first is not None and n >= first)
    indices = range(len(timeline.numbers))
    key_at = {timeline.order(Slot(key, 0)): key for key in indices if timeline.shows(key)}
    rate = truth_rate(
        sorted(key_at),
        math.ceil(len(timeline.numbers) * timeline.factor),
        len(numbers),
        lambda place: read_display(keys.sequence, timeline.numbers[key_at[place]], keys.view),
        lambda place: read_display(sequence, numbers[place], keys.view),
    )
    if rate == 1:
        return sequence, frame_of
    match = OtherRate(timeline, numbers, rate)
    if all(match(slot) is None for key in indices for slot in timeline.made_of(key)):
        raise InputError(
            f"--ground-truth {sequence.pattern} has {float(timeline.factor * rate):g} frames for "
            f"each key frame and the output {float(timeline.factor):g}, so none is of a new "
            f"frame's instant; give a sequence at {float(source.output_fps):g} fps"
        )
    return sequence, match


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


def truth_rate(
    outputs: abc.Sequence[int], count: int, truth: int, of_output: Read, of_truth: Read
) -> Fraction:
    """Return how many frames a true sequence has per frame of the output; 1 unless it is certain.

    Both begin at the same instant. A length that fits is believed without looking. `outputs` are
    positions of output frames that are rendered, ascending, from 0: their truth is the same
    picture. Also others will do, if less surely. `count` is the length of the output, with frames
    past the last key frame, `truth` that of the true sequence. `of_output` and `of_truth` read a
    frame of either.
    """
    last = outputs[-1] if outputs else 0
    if last < truth <= count:
        return Fraction(1)

    output = cache(lambda place: to_display(of_output(place)))

    def error(place: int, truth_place: int) -> float:
        shown = to_display(of_truth(truth_place))
        return float(np.abs(output(place).astype(np.int16) - shown).mean())

    rates = {Fraction(a, b) for a in range(1, MOST + 1) for b in range(1, MOST + 1)} - {1}
    # Those at which a true sequence of this length ends where the output does.
    fitting = [r for r in sorted(rates) if last * r + 1 <= truth <= math.ceil(count * r)]
    shares = []  # errors at other rates, as shares of that at one frame per frame
    try:
        for rate in fitting or USUAL:
            # Frames, far apart, that have a truth at one frame per frame and at this rate.
            end = min(Fraction(truth), truth / rate)
            usable = [p for p in outputs if 0 < p < end and (p * rate).denominator == 1]
            steps = (len(usable) - 1) / (ANCHORS - 1)
            places = sorted({usable[round(i * steps)] for i in range(ANCHORS) if usable})
            usual = sum(error(place, place) for place in places)
            if usual:
                other = sum(error(place, int(place * rate)) for place in places)
                shares.append((other / usual, rate))
    except (InputError, ValueError):  # it is said when the frame's turn comes
        return Fraction(1)
    share, rate = min(shares, default=(math.inf, Fraction(1)))
    return rate if share < CLEAR else Fraction(1)


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

        Raises InputError when a frame is damaged, holds no colour or is of another size, unless
        tolerant.
        """
        truth = IntervalTruth()
        if self.truth is None:
            return truth
        sequence, frame_of = self.truth
        timeline, keys = self.source.timeline, self.source.keys
        wanted = [(truth.frames, slot) for slot in timeline.made_of(key)]
        if "vmaf" in self.measured:
            wanted.append((truth.ends, Slot(key, 0)))
            if key + 1 < len(timeline.numbers):
                wanted.append((truth.ends, Slot(key, len(timeline.between(key)) + 1)))
        for frames, slot in wanted:
            number = frame_of(slot)
            if number is None:
                continue
            output = timeline.number(slot)
            try:
                image = read_sequence_picture(sequence, number, keys.view)
                if image.display_window.shape != keys.display.shape:
                    raise truth_of_another_size(output, image.display_window, keys.display)
            except InputError as error:
                if not self.tolerant:
                    raise
                truth.unscored[slot.index] = str(error)
                continue
            self.nonfinite.note(output, {CHANNELS: count_nonfinite((image.pixels,))})
            frames[slot.index] = image
        return truth


def truth_of_another_size(output: int, size: Window, display: Window) -> LayoutError:
    """Build the error for the truth of an output frame that has another size than the input."""
    return LayoutError(
        f"--ground-truth for frame {output} is {size} and the input is {display}; give a sequence "
        "of the same resolution"
    )
