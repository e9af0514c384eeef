"""Scores of the slots of one key interval: each frame's own, and what takes its neighbours too."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import TYPE_CHECKING

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, UInt8, Window, place_on_canvas
from exwarp_cli.domain.metric import WITHOUT_TRUTH
from exwarp_cli.domain.results import BrokenPixels, Score
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.timeline import FACTOR, Slot
from exwarp_cli.errors import UsageError
from exwarp_cli.io.video import to_display
from exwarp_cli.io.vmaf import require_size, vmaf
from exwarp_cli.metrics.temporal import (
    Transition,
    compare_with_previous,
    compare_with_rendered,
    display_error,
    interval_flicker,
)
from exwarp_cli.synthesis.interval import Interval

if TYPE_CHECKING:
    from exwarp_cli.io.soundness import NonFinite
    from exwarp_cli.pipeline.job import Job
    from exwarp_cli.pipeline.rendered_frames import RenderedReader
    from exwarp_cli.pipeline.source import Source

Scores = tuple[Score, Score | None]
"""Over all pixels, and in holes."""

SLOTS = range(1, FACTOR)
"""The slots that the paper's decisions are for."""


@dataclass(frozen=True)
class Steps:
    """How surfaces move through an interval, on the display window.

    Attributes
    ----------
    fields
        By slot, 1 or more: float32 [H, W, 2], pixels, to the instant before; NaN where unknown.
    hidden
        By slot, bool [H, W]: the instant before does not show the surface point.
    followed
        Whether a rendered frame comes after the last slot.
    """

    fields: dict[int, Float32]
    hidden: dict[int, Bool]
    followed: bool


def steps_of(interval: Interval, display: Window, followed: bool = True) -> Steps | None:
    """Return an interval's steps, along which flicker is followed; None without motion."""
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
        By slot, what `metrics.flicker.error` returned; the key frames around count as right. A slot
        that is not there has (None, None).
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
    made = len(rows[0])
    ends = reference[made + 1 :]
    videos = [[reference[0], *map(to_display, row), *ends] for row in rows]
    if ends:  # a closed interval hides what comes after it, so all go through one ffmpeg
        found = vmaf(reference * len(rows), [frame for video in videos for frame in video])
    else:
        found = [value for video in videos for value in vmaf(reference, video)]
    count = len(reference)
    return [found[i * count + 1 : i * count + 1 + made] for i in range(len(rows))]


def require_measurable(settings: UpsampleSettings, display: Window, whole: bool = True) -> None:
    """Refuse metrics that cannot be measured, before any work.

    Parameters
    ----------
    settings
        Of the run.
    display
        The window that is scored.
    whole
        Whether every key frame is an output instant.

    Raises
    ------
    UsageError
        For metrics without ground truth, or of the video between key frames that are not shown.
    LayoutError
        For VMAF of frames that are too small for it.
    """
    if settings.ground_truth is None and set(settings.metrics or ()) - set(WITHOUT_TRUTH):
        raise UsageError(
            "--metrics names what is measured against --ground-truth; give that too, or leave "
            f"--metrics out; only {' and '.join(WITHOUT_TRUTH)} is measured without, against the "
            "key frames"
        )
    together = [name for name in ("vmaf", "flicker") if name in settings.measured]
    if settings.ground_truth is not None and together and not whole:
        raise UsageError(
            f"{' and '.join(together)} are measured from key frame to key frame, and at this rate "
            "most of them are no output instants; measure psnr, ssim and flip, or give a whole "
            "--factor"
        )
    if settings.ground_truth is not None and "vmaf" in settings.measured:
        require_size(display.height, display.width, "the input")


class IntervalScores:
    """Scores the slots of one interval, in order, on the display window.

    VMAF and flicker depend on nothing beyond the interval: of VMAF's features only the reference's
    own motion reaches over frames, and rendered frames have no error. So any split into chunks
    gives the same scores.

    Parameters
    ----------
    interval
        Whose motion flicker is followed along; without motion it is not measured.
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
        """Score a slot's frame by what needs no other one.

        Parameters
        ----------
        slot
            1 or more.
        truth, test
            float32 [H, W, 3] or more, scene-linear.
        mask
            bool [H, W], the slot's holes; None without motion.
        """
        from exwarp_cli.metrics.registry import score_frame  # its kernels are not for every run

        self._scores[slot] = score_frame(truth, test, mask, self._names)
        if mask is not None:
            self._masks[slot] = mask
        if self._steps is not None:
            self._errors[slot] = display_error(truth, test)
        if "vmaf" in self._names:
            self._shown[slot] = (to_display(truth), to_display(test))
        return self._scores[slot]

    def complete(self, ends: Mapping[int, Float32]) -> dict[int, Scores]:
        """Return the scores of all slots with what takes several frames.

        Parameters
        ----------
        ends
            Ground truth at slot 0 and, counted on as a slot, at the next key frame's instant, as
            far as it is there; float32 [H, W, 3] or more, scene-linear. Only for VMAF.
        """
        found = dict(self._scores)
        if "vmaf" in self._names:
            for slot, value in self._vmaf(ends).items():
                found[slot] = (replace(found[slot][0], vmaf=value), found[slot][1])
        if self._steps is not None:
            values = flicker_of(self._errors, self._masks, self._steps)
            slots = sorted(self._steps.fields)
            for slot, (overall, masked) in zip(slots, values, strict=True):
                if slot in found:
                    whole, inside = found[slot]
                    inside = None if inside is None else replace(inside, flicker=masked)
                    found[slot] = (replace(whole, flicker=overall), inside)
        return found

    def _vmaf(self, ends: Mapping[int, Float32]) -> dict[int, float]:
        """Score the interval as a video between two rendered frames, taken to be the truth's."""
        pairs = dict(self._shown)
        for slot, pixels in ends.items():
            pairs[slot] = (to_display(pixels),) * 2
        # From the key frame on, up to the first instant without truth.
        video = list(takewhile(pairs.__contains__, range(self._count + 2)))
        values = vmaf((pairs[slot][0] for slot in video), (pairs[slot][1] for slot in video))
        return {slot: v for slot, v in zip(video, values, strict=True) if slot in self._shown}


def broken_pixels_of(
    job: Job, truth: NonFinite, rendered: RenderedReader | None = None
) -> tuple[BrokenPixels, ...]:
    """Return what was found in the selected key frames, and in what the slots after them have.

    The chunks to which the frames around belong report those, although they were read here too.

    Parameters
    ----------
    job
        All of whose frames were read.
    truth
        What was found in ground truth, by output frame.
    rendered
        What read rendered frames; None without.
    """
    in_rendered = {} if rendered is None else rendered.nonfinite
    found: list[BrokenPixels] = []
    for key in job.keys:
        for source in job.sources:
            others = [truth] if source is job.source else []
            others += [in_rendered[source.keys.view]] if in_rendered else []
            found += _in_interval(source, key, others)
    return tuple(found)


def _in_interval(
    source: Source, key: int, by_output: Iterable[NonFinite]
) -> Iterator[BrokenPixels]:
    """Yield what was found in one view of a key interval; the last by number of the output."""
    timeline, view = source.timeline, source.keys.view
    number = timeline.numbers[key]
    for channels, pixels in source.keys.nonfinite.of(number):
        yield BrokenPixels(number, 0, view, channels, pixels)
    for slot in (Slot(key, 0), *timeline.between(key)):
        instant = None if source.slots is None else source.slot_number(slot)
        if instant is not None and source.slots is not None:
            for channels, pixels in source.slots.nonfinite.of(instant):
                yield BrokenPixels(number, slot.index, view, channels, pixels)
        for other in by_output:
            for channels, pixels in other.of(timeline.number(slot)):
                yield BrokenPixels(number, slot.index, view, channels, pixels)
