"""Scores of a run, and of a sequence against another: frames' own, and those of several frames."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import takewhile
from typing import TYPE_CHECKING

import numpy as np

from exwarp_cli.domain.colour import round_display
from exwarp_cli.domain.frame import Bool, Float32, GBuffer, Image, UInt8, Window, place_on_canvas
from exwarp_cli.domain.metric import WITHOUT_TRUTH
from exwarp_cli.domain.results import BrokenPixels, FrameRecord, Score
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.timeline import FACTOR, Slot, number_step
from exwarp_cli.errors import InputError, UsageError
from exwarp_cli.io.display_colour import to_display
from exwarp_cli.io.ffmpeg import VmafStream, compute_vmaf, require_vmaf_size
from exwarp_cli.io.footage import read_sequence_picture
from exwarp_cli.io.frames import GEOMETRY, read_raw
from exwarp_cli.metrics import temporal
from exwarp_cli.synthesis.motion_fields import field_between, reproject, settle_motion

if TYPE_CHECKING:
    from exwarp_cli.domain.motion import MotionConvention
    from exwarp_cli.io.shot import NonFinite, Shot
    from exwarp_cli.pipeline.job import Job
    from exwarp_cli.pipeline.rendered_frames import RenderedReader
    from exwarp_cli.pipeline.source import Source
    from exwarp_cli.synthesis.interval import Interval

Scores = tuple[Score, Score | None]  # over all pixels, and in holes

SLOTS = range(1, FACTOR)  # the slots that the paper's decisions are for

ENDS_LEFT_OUT = 4  # frames at either end that ExtraNet's videos lack
SHORTEST_CUT = 12  # videos of no more frames keep their ends


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

    `errors` are by slot, from `metrics.temporal.display_error`; the key frames around have none.
    The flicker of a slot that is missing is (None, None). `masks` are by slot, bool [H, W]. In
    holes only the transition into the frame counts, as what fills a hole did not exist before or
    after; None if the frame before shows no pixel of the mask.
    """
    slots = sorted(steps.fields)
    transitions: list[float | None] = []
    inside: list[float | None] = []
    for slot in slots:
        value = masked = None
        if slot in errors and (slot == 1 or slot - 1 in errors):
            before, step = errors.get(slot - 1), (steps.fields[slot], steps.hidden[slot])
            change = temporal.compare_with_previous(errors[slot], before, *step)
            value = change.mean()
            masked = change.mean(masks[slot]) if slot in masks else None
        transitions.append(value)
        inside.append(masked)
    # The transition to a rendered frame, whose error is 0, is taken at all pixels of the slot
    # itself, and needs no motion.
    value = None
    if steps.followed and slots[-1] in errors:
        last = errors[slots[-1]]
        everywhere = np.ones(last.shape[:2], np.bool_)
        value = temporal.Transition(np.abs(last).mean(axis=-1), everywhere).mean()
    transitions.append(value)
    return list(zip(temporal.frame_flicker(transitions), inside, strict=True))


def vmaf_of(truth: Mapping[int, Float32], rows: Sequence[Sequence[Float32]]) -> list[list[float]]:
    """Return the VMAF of the slots of several versions of an interval.

    `truth` has slot 0, those after it and, where a rendered frame follows, one more: float32 [H, W,
    3] or more, scene-linear. What is shown at the first and at the rendered one counts as right.
    Each of `rows` is a version: its frames at the slots after the first.
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
    Raises UsageError for metrics without ground truth, or of the video between key frames that are
    not shown; LayoutError for VMAF of frames that are too small for it.
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
    rendered frames have no error. Flicker is measured along the interval's motion, and not without.
    `names` is what is measured, as in `Score`; `followed` is True if a rendered frame comes after
    the last slot.
    """

    def __init__(
        self, interval: Interval, display: Window, names: tuple[str, ...], followed: bool
    ) -> None:
        self._names, self._count = names, len(interval.times)
        self._steps = steps_of(interval, display, followed) if "flicker" in names else None
        self._scores: dict[int, Scores] = {}
        self._masks: dict[int, Bool] = {}
        self._errors: dict[int, Float32] = {}
        self._shown: dict[int, tuple[UInt8, UInt8]] = {}

    def frame(self, slot: int, truth: Float32, test: Float32, mask: Bool | None) -> Scores:
        """Score a slot's frame, 1 or more, by the metrics of single frames.

        `truth` and `test` are float32 [H, W, 3] or more, scene-linear; `mask` is bool [H, W], the
        slot's holes, None without motion.
        """
        from exwarp_cli.metrics.registry import score_frame  # not every run needs its kernels

        self._scores[slot] = score_frame(truth, test, mask, self._names)
        if mask is not None:
            self._masks[slot] = mask
        if self._steps is not None:
            self._errors[slot] = temporal.display_error(truth, test)
        if "vmaf" in self._names:
            self._shown[slot] = (to_display(truth), to_display(test))
        return self._scores[slot]

    def complete(self, ends: Mapping[int, Float32]) -> dict[int, Scores]:
        """Return the scores of all slots, with those that depend on several frames.

        `ends` are for VMAF: ground truth at slot 0 and, counted on as a slot, at the next key
        frame's instant, if it exists; float32 [H, W, 3] or more, scene-linear.
        """
        scores = dict(self._scores)
        if "vmaf" in self._names:
            # The interval as a video between two rendered frames, which count as the truth.
            pairs = self._shown | {slot: (to_display(p),) * 2 for slot, p in ends.items()}
            # From the key frame on, up to the first instant without truth.
            video = list(takewhile(pairs.__contains__, range(self._count + 2)))
            vmaf = compute_vmaf(
                (pairs[slot][0] for slot in video), (pairs[slot][1] for slot in video)
            )
            for slot, value in zip(video, vmaf, strict=True):
                if slot in self._shown:
                    scores[slot] = (replace(scores[slot][0], vmaf=value), scores[slot][1])
        if self._steps is not None:
            values = flicker_of(self._errors, self._masks, self._steps)
            for slot, (overall, masked) in zip(sorted(self._steps.fields), values, strict=True):
                if slot in scores:
                    all_pixels, inside = scores[slot]
                    inside = None if inside is None else replace(inside, flicker=masked)
                    scores[slot] = (replace(all_pixels, flicker=overall), inside)
        return scores


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
            timeline, view = source.timeline, source.keys.view
            by_output = [truth] if source is job.source else []
            by_output += [in_rendered[view]] if in_rendered else []
            number = timeline.numbers[key]
            counts = [(0, source.keys.nonfinite.counts[number])]
            for slot in (Slot(key, 0), *timeline.between(key)):
                instant = None if source.slots is None else source.slot_number(slot)
                if instant is not None and source.slots is not None:
                    counts.append((slot.index, source.slots.nonfinite.counts[instant]))
                output = timeline.number(slot)
                counts += [(slot.index, each.counts[output]) for each in by_output]
            broken += [
                BrokenPixels(number, index, view, channels, pixels)
                for index, by_channel in counts
                for channels, pixels in sorted(by_channel.items())
            ]
    return tuple(broken)


@dataclass
class KeyedPulses:
    """Collects mean gradients of the view that is scored, and adds the pulse to records at the end.

    It needs no ground truth. A pulse depends only on a frame and the key frames around it, so any
    division into chunks gives the same values. Several threads may add frames.
    """

    source: Source
    _gradients: dict[Slot, float] = field(default_factory=dict)  # of key frames and new frames
    _last_of_shot: set[int] = field(default_factory=set)  # indices of key frames

    def add(self, slot: Slot, image: Image, followed: bool = True) -> None:
        """Add a frame as its file has it.

        `followed` is of a key frame: False if no key frame of the same shot comes after it.
        """
        self._gradients[slot] = temporal.mean_gradient(image.on(self.source.keys.display).pixels)
        if not followed:
            self._last_of_shot.add(slot.key)

    def complete(self, records: Sequence[FrameRecord]) -> Iterator[FrameRecord]:
        """Yield the records of a run, with the pulse of the new frames that were added."""
        keys, timeline = self.source.keys, self.source.timeline
        slots = {timeline.number(slot): slot for slot in self._gradients if slot.index}
        for record in records:
            if record.number not in slots:
                yield record
                continue
            slot = slots[record.number]
            following, after = Slot(slot.key + 1, 0), None
            if slot.key not in self._last_of_shot:
                if following not in self._gradients:  # of another chunk
                    number = timeline.numbers[following.key]
                    # A causal method makes its frames without it, so a damaged one is no error.
                    with suppress(InputError):
                        image = read_sequence_picture(keys.sequence, number, keys.view)
                        self.add(following, image)
                after = self._gradients.get(following)
            expected = self._gradients[Slot(slot.key, 0)]
            if after is not None:
                time = float(timeline.time(slot))
                expected = (1 - time) * expected + time * after
            yield replace(record, key_pulse=temporal.pulse(self._gradients[slot], expected))


@dataclass
class SequenceMotion:
    """Reads where the pixels of a frame come from; asked frame by frame, ascending."""

    shot: Shot
    convention: MotionConvention
    _previous: tuple[int, GBuffer] | None = None

    def into(self, number: int) -> tuple[Float32, Bool] | None:
        """Return the motion from a frame to the one before it.

        It lies on the display window: float32 [H, W, 2] in pixels, x right, y down, NaN where
        unknown; and bool [H, W], True where the frame before does not show the surface point. None
        where the frame of the last call is not its neighbour.
        """
        raw = read_raw(self.shot, number, GEOMETRY)
        current = settle_motion(raw.settle(self.convention).on(self.shot.display))
        previous, self._previous = self._previous, (number, current)
        if previous is None or previous[0] != number - number_step(self.shot.sequence.numbers):
            return None
        if current.to_previous is None:
            motion = reproject(previous[1], 1.0)
        else:
            motion = field_between(current, previous[1], current.to_previous, 1)
        return motion.field, motion.hole


@dataclass(frozen=True)
class Pair:
    """Two frames of one instant, on the display window."""

    reference: int  # the number of the true one
    # truth, test: float32 [H, W, 3] or more, scene-linear
    truth: Float32
    test: Float32
    mask: Bool | None  # bool [H, W], the holes; None without


class MetricScorer:
    """Takes pairs one by one, and scores them by the metrics of this tool; memory holds one frame.

    `names` is what is measured, as in `Score`; `motion` is for flicker, None where it is not
    measured. The caller enters and leaves `vmaf`.
    """

    notes: tuple[str, ...] = ()  # what a reader of the numbers should know at the end, sentences

    def __init__(self, names: tuple[str, ...], motion: SequenceMotion | None) -> None:
        self._names, self._motion = names, motion
        self.vmaf = VmafStream() if "vmaf" in names else None
        self._scores: list[Scores] = []
        self._error: Float32 | None = None
        self._transitions: list[float | None] = []

    def add(self, pair: Pair) -> None:
        """Score the next pair by what needs no later one."""
        from exwarp_cli.metrics.registry import score_frame  # see above

        overall, inside = score_frame(pair.truth, pair.test, pair.mask, self._names)
        if self.vmaf is not None:
            self.vmaf.write(to_display(pair.truth), to_display(pair.test))
        if self._motion is not None:
            into = self._motion.into(pair.reference)
            before, self._error = self._error, temporal.display_error(pair.truth, pair.test)
            value = masked = None
            if into is not None and before is not None:
                change = temporal.compare_with_previous(self._error, before, *into)
                value = change.mean()
                masked = None if pair.mask is None else change.mean(pair.mask)
            self._transitions.append(value)
            inside = None if inside is None else replace(inside, flicker=masked)
        self._scores.append((overall, inside))

    def finish(self) -> list[Scores]:
        """Return all scores, with VMAF and flicker."""
        scores = self._scores
        if self.vmaf is not None:
            values = self.vmaf.close()
            scores = [(replace(s, vmaf=v), h) for (s, h), v in zip(scores, values, strict=True)]
        if self._motion is not None:
            flickers = temporal.frame_flicker([*self._transitions, None])
            pairs = zip(scores, flickers, strict=True)
            scores = [(replace(s, flicker=v), h) for (s, h), v in pairs]
        return scores


class ExtranetScorer:
    """Scores as ExtraNet's release takes them: see `exwarp_cli.metrics.registry`.

    VMAF is of H.264 videos of both sequences, rendered frames included. `names` are out of psnr_db,
    ssim and vmaf, `count` is how many frames come. `generated` says of each whether it counts in
    PSNR and SSIM; None where that is not known, and a frame counts unless its pixels are those of
    the truth. Otherwise it is as `MetricScorer`.
    """

    notes: tuple[str, ...] = ()

    def __init__(self, names: tuple[str, ...], count: int, generated: list[bool] | None) -> None:
        self._names = names
        cut = ENDS_LEFT_OUT if count > SHORTEST_CUT else 0
        self._video = range(cut, count - cut)
        self._generated = generated
        self.vmaf = VmafStream(is_encoded=True) if "vmaf" in names else None
        self._scores: list[Score] = []
        self._counted = 0

    def add(self, pair: Pair) -> None:
        """Score the next pair if it counts, and append it to the videos."""
        from exwarp_cli.metrics.registry import score_like_extranet  # see above

        index = len(self._scores)
        truth, test = round_display(pair.truth), round_display(pair.test)
        is_different = bool((truth != test).any())
        counts = is_different if self._generated is None else self._generated[index]
        self._counted += counts
        values = score_like_extranet(pair.truth, pair.test) if counts else Score()
        wanted = {"psnr_db", "ssim"}.intersection(self._names)
        self._scores.append(Score(**{name: getattr(values, name) for name in wanted}))
        if self.vmaf is not None and index in self._video:
            self.vmaf.write(truth, test)

    def finish(self) -> list[Scores]:
        """Return all scores, with VMAF; the notes say which frames counted."""
        by = "by their headers" if self._generated else "as their pixels are not those of the truth"
        note = f"{self._counted} of {len(self._scores)} frames count as generated, {by}"
        self.notes = (note,)
        if self.vmaf is not None:
            for index, value in zip(self._video, self.vmaf.close(), strict=True):
                self._scores[index] = replace(self._scores[index], vmaf=value)
            frames = len(self._video)
            self.notes += (f"VMAF is of {frames} frames in H.264, rendered ones included",)
        return [(score, None) for score in self._scores]
