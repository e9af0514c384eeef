"""Scores of a run: each frame's own, and those that depend on the frames around it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import TYPE_CHECKING

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, Image, UInt8, Window, place_on_canvas
from exwarp_cli.domain.metric import WITHOUT_TRUTH
from exwarp_cli.domain.results import BrokenPixels, FrameRecord, Score
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.timeline import FACTOR, Slot
from exwarp_cli.errors import InputError, UsageError
from exwarp_cli.io.display_colour import to_display
from exwarp_cli.io.ffmpeg import compute_vmaf, require_vmaf_size
from exwarp_cli.io.footage import read_sequence_picture
from exwarp_cli.metrics.temporal import (
    Transition,
    compare_with_previous,
    compare_with_rendered,
    display_error,
    interpolate_gradient,
    interval_flicker,
    mean_gradient,
    pulse,
)
from exwarp_cli.synthesis.interval import Interval

if TYPE_CHECKING:
    from exwarp_cli.io.shot_files import NonFinite
    from exwarp_cli.pipeline.job import Job
    from exwarp_cli.pipeline.rendered_frames import RenderedReader
    from exwarp_cli.pipeline.source import Source

Scores = tuple[Score, Score | None]  # over all pixels, and in holes

SLOTS = range(1, FACTOR)  # the slots that the paper's decisions are for


@dataclass(frozen=True)
class Steps:
    """The motion of surfaces through an interval, on the display window."""

    # By slot, 1 or more: float32 [H, W, 2], pixels, to the instant before; NaN where unknown
    fields: dict[int, Float32]
    # By slot, bool [H, W]: the instant before does not show the surface point
    hidden: dict[int, Bool]
    followed: bool  # whether a rendered frame comes after the last slot


def steps_of(interval: Interval, display: Window, followed: bool = True) -> Steps | None:
    """Return an interval's steps, along which flicker is measured; None without motion."""
    if not interval.has_motion:
        return None
    canvas = interval.key.image.data_window
    slots = range(1, len(interval.times) + 1)
    motion = {s: interval.back(1) if s == 1 else interval.step_back(s) for s in slots}
    return Steps(
        {slot: place_on_canvas(m.field, canvas, display, np.nan) for slot, m in motion.items()},
        {slot: place_on_canvas(m.hole, canvas, display, True) for slot, m in motion.items()},
        followed,
    )


def flicker_of(
    errors: Mapping[int, Float32], masks: Mapping[int, Bool], steps: Steps
) -> list[tuple[float | None, float | None]]:
    """Return the flicker of an interval's slots, in order, over all pixels and in holes.

    Parameters
    ----------
    errors
        By slot, from `metrics.flicker.error`; the key frames around have none. The flicker of a
        slot that is missing is (None, None).
    masks
        By slot, bool [H, W].
    steps
        Of the interval.
    """

    def into(slot: int) -> Transition | None:
        if slot not in errors or (slot > 1 and slot - 1 not in errors):
            return None
        before = errors.get(slot - 1)
        return compare_with_previous(errors[slot], before, steps.fields[slot], steps.hidden[slot])

    slots = sorted(steps.fields)
    last = errors.get(slots[-1]) if steps.followed else None
    transitions = [*map(into, slots), None if last is None else compare_with_rendered(last)]
    return interval_flicker(transitions, [masks.get(slot) for slot in slots])


def vmaf_of(truth: Mapping[int, Float32], rows: Sequence[Sequence[Float32]]) -> list[list[float]]:
    """Return the VMAF of the slots of several versions of an interval.

    Parameters
    ----------
    truth
        Slot 0, those after it and, where a rendered frame follows, one more: float32 [H, W, 3] or
        more, scene-linear. What is shown at the first and at the rendered one counts as right.
    rows
        A version each: its frames at the slots after the first.
    """
    reference = [to_display(truth[slot]) for slot in sorted(truth)]
    slots = len(rows[0])
    ends = reference[slots + 1 :]
    videos = [[reference[0], *map(to_display, row), *ends] for row in rows]
    if ends:  # the next interval has no effect on a closed one, so one ffmpeg takes all
        values = compute_vmaf(reference * len(rows), [frame for video in videos for frame in video])
    else:
        values = [value for video in videos for value in compute_vmaf(reference, video)]
    count = len(reference)
    return [values[i * count + 1 : i * count + 1 + slots] for i in range(len(rows))]


def require_measurable(settings: UpsampleSettings, display: Window, whole: bool = True) -> None:
    """Refuse metrics that cannot be measured, before any work begins.

    `display` is the window that is scored; `whole` is True if all key frames are output instants.

    Raises
    ------
    UsageError
        For metrics without ground truth, or of the video between key frames that are not shown.
    LayoutError
        For VMAF of frames that are too small for it.
    """
    has_truth = settings.ground_truth is not None
    if not has_truth and set(settings.metrics or ()) - set(WITHOUT_TRUTH):
        raise UsageError(
            "--metrics names what is measured against --ground-truth; give that too, or leave "
            f"--metrics out; only {' and '.join(WITHOUT_TRUTH)} is measured without, against the "
            "key frames"
        )
    together = [name for name in ("vmaf", "flicker") if name in settings.measured]
    if has_truth and together and not whole:
        raise UsageError(
            f"{' and '.join(together)} are measured from key frame to key frame, and at this rate "
            "most of them are no output instants; measure psnr, ssim and flip, or give a whole "
            "--factor"
        )
    if has_truth and "vmaf" in settings.measured:
        require_vmaf_size(display.height, display.width, "the input")


class IntervalScores:
    """Scores the slots of one interval, in order, on the display window.

    Any division into chunks gives the same scores, because VMAF and flicker depend on nothing
    outside the interval: of VMAF's features only the reference's own motion spans frames, and
    rendered frames have no error.

    Parameters
    ----------
    interval
        With the motion along which flicker is measured; without motion it is not measured.
    display
        The window that is scored.
    names
        What is measured, as in `Score`.
    followed
        Whether a rendered frame comes after the last slot.
    """

    def __init__(
        self, interval: Interval, display: Window, names: tuple[str, ...], followed: bool
    ) -> None:
        self._names = names
        self._count = len(interval.times)
        self._steps = steps_of(interval, display, followed) if "flicker" in names else None
        self._scores: dict[int, Scores] = {}
        self._masks: dict[int, Bool] = {}
        self._errors: dict[int, Float32] = {}
        self._shown: dict[int, tuple[UInt8, UInt8]] = {}

    def frame(self, slot: int, truth: Float32, test: Float32, mask: Bool | None) -> Scores:
        """Score a slot's frame by the metrics of single frames.

        Parameters
        ----------
        slot
            1 or more.
        truth, test
            float32 [H, W, 3] or more, scene-linear.
        mask
            bool [H, W], the slot's holes; None without motion.
        """
        from exwarp_cli.metrics.registry import score_frame  # not every run needs its kernels

        self._scores[slot] = score_frame(truth, test, mask, self._names)
        if mask is not None:
            self._masks[slot] = mask
        if self._steps is not None:
            self._errors[slot] = display_error(truth, test)
        if "vmaf" in self._names:
            self._shown[slot] = (to_display(truth), to_display(test))
        return self._scores[slot]

    def complete(self, ends: Mapping[int, Float32]) -> dict[int, Scores]:
        """Return the scores of all slots, with those that depend on several frames.

        Parameters
        ----------
        ends
            Ground truth at slot 0 and, counted on as a slot, at the next key frame's instant, if
            it exists; float32 [H, W, 3] or more, scene-linear. Only for VMAF.
        """
        scores = dict(self._scores)
        if "vmaf" in self._names:
            for slot, value in self._vmaf(ends).items():
                scores[slot] = (replace(scores[slot][0], vmaf=value), scores[slot][1])
        if self._steps is not None:
            values = flicker_of(self._errors, self._masks, self._steps)
            for slot, (overall, masked) in zip(sorted(self._steps.fields), values, strict=True):
                if slot in scores:
                    all_pixels, inside = scores[slot]
                    inside = None if inside is None else replace(inside, flicker=masked)
                    scores[slot] = (replace(all_pixels, flicker=overall), inside)
        return scores

    def _vmaf(self, ends: Mapping[int, Float32]) -> dict[int, float]:
        """Score the interval as a video between two rendered frames, which count as the truth."""
        pairs = dict(self._shown)
        for slot, pixels in ends.items():
            pairs[slot] = (to_display(pixels),) * 2
        # From the key frame on, up to the first instant without truth.
        video = list(takewhile(pairs.__contains__, range(self._count + 2)))
        values = compute_vmaf(
            (pairs[slot][0] for slot in video), (pairs[slot][1] for slot in video)
        )
        return {slot: v for slot, v in zip(video, values, strict=True) if slot in self._shown}


def broken_pixels_of(
    job: Job, truth: NonFinite, rendered: RenderedReader | None = None
) -> tuple[BrokenPixels, ...]:
    """Return the non-finite pixels of the selected key frames, and of the slots after them.

    The chunks of the frames around report those, although they were read here too.

    All frames of the job were read; `truth` has those of ground truth, by output frame.
    """
    in_rendered = {} if rendered is None else rendered.nonfinite
    broken: list[BrokenPixels] = []
    for key in job.keys:
        for source in job.sources:
            by_output = [truth] if source is job.source else []
            by_output += [in_rendered[source.keys.view]] if in_rendered else []
            broken += _in_interval(source, key, by_output)
    return tuple(broken)


def _in_interval(
    source: Source, key: int, by_output: Iterable[NonFinite]
) -> Iterator[BrokenPixels]:
    """Yield those of one view of a key interval; `by_output` has them by output number."""
    timeline, view = source.timeline, source.keys.view
    number = timeline.numbers[key]
    for channels, pixels in source.keys.nonfinite.of(number):
        yield BrokenPixels(number, 0, view, channels, pixels)
    for slot in (Slot(key, 0), *timeline.between(key)):
        instant = None if source.slots is None else source.slot_number(slot)
        if instant is not None and source.slots is not None:
            for channels, pixels in source.slots.nonfinite.of(instant):
                yield BrokenPixels(number, slot.index, view, channels, pixels)
        for nonfinite in by_output:
            for channels, pixels in nonfinite.of(timeline.number(slot)):
                yield BrokenPixels(number, slot.index, view, channels, pixels)


class KeyedPulses:
    """Collects mean gradients during a run; adds the pulse to the records of new frames at its end.

    It needs no ground truth. A pulse depends only on a frame and the key frames around it, so any
    division into chunks gives the same values.

    Parameters
    ----------
    source
        The view that is scored.
    """

    def __init__(self, source: Source) -> None:
        self._source = source
        self._keys: dict[int, float] = {}
        self._frames: dict[int, tuple[Slot, float]] = {}
        self._last_of_shot: set[int] = set()

    def add_key(self, key: int, image: Image, followed: bool) -> None:
        """Add a key frame by its index; `followed` if one of the same shot comes after it."""
        self._keys[key] = mean_gradient(image.on(self._source.keys.display).pixels)
        if not followed:
            self._last_of_shot.add(key)

    def add(self, number: int, slot: Slot, gradient: float) -> None:
        """Add a new frame, by its output number, after its key frame."""
        self._frames[number] = slot, gradient

    def complete(self, records: Sequence[FrameRecord]) -> Iterator[FrameRecord]:
        """Yield the records of a run, with the pulse of the frames that were added."""
        for record in records:
            if record.number in self._frames:
                yield replace(record, key_pulse=self._pulse(*self._frames[record.number]))
            else:
                yield record

    def _pulse(self, slot: Slot, gradient: float) -> float:
        following, keys = slot.key + 1, self._source.keys
        if slot.key not in self._last_of_shot and following not in self._keys:  # of another chunk
            # A causal method makes its frames without it, so a damaged one is no error.
            with suppress(InputError):
                number = self._source.timeline.numbers[following]
                image = read_sequence_picture(keys.sequence, number, keys.view)
                self._keys[following] = mean_gradient(image.on(keys.display).pixels)
        after = None if slot.key in self._last_of_shot else self._keys.get(following)
        time = float(self._source.timeline.time(slot))
        return pulse(gradient, interpolate_gradient(self._keys[slot.key], after, time))
