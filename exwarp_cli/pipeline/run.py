"""The main job: a key sequence in, a sequence at four times its rate out, or at another.

`Run.render_all` goes through the key intervals. Of each, a thread reads the files ahead
(`interval_inputs`, from `key_frames`). This thread brings them onto one window and decides the path
of the interval (`interval_builder`, `decide`, `gate`). It renders the slots, or a pool of threads
does (`slot_renderer`, `scheduling`). Threads behind write the files (`frame_writer`).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import partial
from time import perf_counter

from exwarp_cli.domain.frame import Image
from exwarp_cli.domain.results import FrameKind, FrameRecord, LeftOut, RunOutcome, RunSummary
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.errors import InputError
from exwarp_cli.io.footage import read_sequence_picture
from exwarp_cli.kernels import _row_bands
from exwarp_cli.pipeline import frame_writer, scheduling
from exwarp_cli.pipeline.extra_layers import ExtraLayers
from exwarp_cli.pipeline.fingerprint import key_fingerprint
from exwarp_cli.pipeline.frame_writer import FRAMES_BEHIND, FrameWriter
from exwarp_cli.pipeline.interval_builder import IntervalPreparer, PreparedInterval, make_builders
from exwarp_cli.pipeline.interval_inputs import (
    IntervalInputs,
    IntervalReader,
    SkippedInterval,
    ViewsReader,
)
from exwarp_cli.pipeline.job import Job, open_job
from exwarp_cli.pipeline.key_frames import window_note
from exwarp_cli.pipeline.messages import announce_skipped
from exwarp_cli.pipeline.output_plan import is_video_kept, video_fingerprint, video_look, video_note
from exwarp_cli.pipeline.progress import FrameListener, Progress, kind_of
from exwarp_cli.pipeline.scoring import IntervalScores, KeyedPulses, broken_pixels_of
from exwarp_cli.pipeline.slot_renderer import RenderedSlot, SlotRenderer, header_attributes
from exwarp_cli.runtime.cores import hold_cores
from exwarp_cli.runtime.stop import check_stop

# Bytes of frames that wait to be written, beside those that are being written.
MAX_BYTES_BEHIND = 80 * 10**6

# Four channels in float32.
PIXEL_BYTES = 16


def upsample(settings: UpsampleSettings, progress: Progress | None = None) -> RunSummary:
    """Write the slots of the selected key frames; return what was written and how good it is.

    Raises ExwarpError for anything that a user can cause; frames written until then are complete.
    """
    return run_job(open_job(settings), progress or Progress(), None)


def run_job(job: Job, progress: Progress, listener: FrameListener | None) -> RunSummary:
    """Do a job that is open; see `upsample`."""
    job.refuse()
    job.targets.make_folders()
    job.announce(progress)
    begin = perf_counter()
    progress.start(len(job.slots), Counter(kind_of(slot.index) for slot in job.slots))
    try:
        if listener is not None:
            listener.plan(job.groups)
        outcome = write_intervals(job, progress, listener)
    finally:
        progress.finish()
    return job.summary(outcome, perf_counter() - begin)


def write_intervals(job: Job, progress: Progress, listener: FrameListener | None) -> RunOutcome:
    """Do the work of a job whose folders exist, in this thread.

    The caller starts and finishes `progress`, and has planned `listener`. The outcome has no frames
    for a video alone that existed as this run would make it. Raises OutputError when files are not
    on the disk as they were written, where that is verified.
    """
    settings, targets = job.settings, job.targets
    scheduling.use_threads(settings.threads)
    reader = make_reader(job)
    leader = reader.leader
    try:
        note = ""
        if targets.frames is None:
            note = video_fingerprint(leader.fingerprinter, settings, job.keys, job.rendered)
        if listener is None and is_video_kept(targets, settings, note):
            return RunOutcome(cuts=leader.shots.cuts)
        run = Run(job, reader, note, progress, listener)
        with hold_cores():
            frames = run.render_all()
        broken = broken_pixels_of(job, leader.truth.nonfinite, leader.rendered)
        outcome = RunOutcome(frames, leader.shots.cuts, tuple(run.left_out), nonfinite=broken)
        if not (job.sums and frames):
            return outcome
        files, verified = frame_writer.list_files(targets, frames, run.writer.sums), None
        if settings.verify:
            frame_writer.require_sound(files, job.source.keys.view, outcome.shown)
            verified = len(files)
            if targets.frames is not None and targets.video is not None:
                frame_writer.verify_video(targets.video, outcome.shown)
        return replace(outcome, files=tuple(f.written for f in files), verified=verified)
    finally:
        job.close()


class Run:
    """One run: reads, renders, writes and records interval by interval.

    `note` is what a video that is written alone says of itself.
    """

    def __init__(
        self,
        job: Job,
        reader: ViewsReader,
        note: str,
        progress: Progress,
        listener: FrameListener | None,
    ) -> None:
        self._job, self._reader = job, reader
        self._progress, self._listener = progress, listener
        self._source, self._timeline = job.source, job.source.timeline
        self._display = job.source.keys.display
        builder, *view_builders = make_builders(job)
        self._layers = ExtraLayers(job.contents, tuple(view_builders))
        # Frames with all their layers are large, and few may wait; so are large ones.
        behind = min(FRAMES_BEHIND, MAX_BYTES_BEHIND // (self._display.pixels * PIXEL_BYTES))
        self.writer = make_writer(job, note, 0 if self._layers.any else behind)
        self._preparer = IntervalPreparer(
            job, reader, builder, self.writer, progress, self._layers.any
        )
        # New frames without ground truth are compared with their key frames.
        is_asked = job.reported or job.settings.metrics is not None
        measures = is_asked and "pulse" in job.settings.measured
        self._pulses = KeyedPulses(job.source) if measures else None
        self._renderer = SlotRenderer(
            job.source, job.method, self.writer, self._layers, self._pulses, listener is not None
        )
        most = max((len(self._timeline.made_of(key)) for key in job.keys), default=0)
        self._slots = scheduling.ParallelSlots(_row_bands.threads(), most)
        self._records: list[FrameRecord] = []
        self.left_out: list[LeftOut] = []
        self._noted_windows: set[bool] = set()

    def render_all(self) -> tuple[FrameRecord, ...]:
        """Work through the intervals: reading ahead, rendering in this thread, writing behind."""
        keys = self._job.keys
        tasks = (partial(self._reader.read, key, self._is_needed) for key in keys)
        with self.writer, self._slots:
            for text in self.writer.remarks:
                self._progress.message(text)
            intervals = scheduling.prefetch(tasks, scheduling.read_depth(self._display.pixels))
            for _ in keys:
                # Handed on at once: a variable would hold the raw geometry while the next is read.
                self._render_interval(next(intervals))
        records = self._records
        if self._pulses is not None:
            records = list(self._pulses.complete(records))
        for record in records:
            if record.number in self.writer.write_ms:
                record.timing_ms["write"] = self.writer.write_ms[record.number]
        return tuple(records)

    def _is_needed(self, key: int, recipes: dict[int, str]) -> bool:
        """Return True if any slot is missing or must be scored."""
        settings = self._job.settings
        if not settings.skip_existing or settings.ground_truth is not None:
            return True
        number = self._timeline.number
        return not all(self.writer.has(number(Slot(key, i)), recipes[i]) for i in recipes)

    def _render_interval(self, inputs: IntervalInputs | SkippedInterval) -> None:
        if isinstance(inputs, SkippedInterval):
            self._skip(inputs)
            return
        if inputs.frame is not None and inputs.region not in self._noted_windows:
            # How windows smaller than the display window are read is said once each way.
            note = window_note(inputs.frame.image, inputs.region)
            if note is not None:
                self._noted_windows.add(inputs.region)
                self._progress.message(note)
        try:
            prepared, inputs = self._preparer.prepare(inputs)
        except InputError as error:  # of what only extrapolation needs
            if not self._job.settings.source.keep_going:
                raise
            self._skip(SkippedInterval(inputs.key, str(error), inputs.without_geometry()))
            return
        key, number = self._timeline.numbers[inputs.key], self._timeline.number
        unusable = {"scores": inputs.truth.unscored, "rendered": inputs.rendered.unusable}
        for lost, reasons in unusable.items():
            for slot, reason in sorted(reasons.items()):
                problem = LeftOut(key, (), reason, **{lost: (number(Slot(inputs.key, slot)),)})
                self.left_out.append(problem)
                announce_skipped(self._progress, problem)
        if self._pulses is not None:
            self._pulses.add(Slot(inputs.key, 0), self._key_image(inputs), inputs.followed)
        if self._timeline.shows(inputs.key):
            self._write_key(inputs)
        self._render_slots(prepared, inputs)

    def _render_slots(self, prepared: PreparedInterval, inputs: IntervalInputs) -> None:
        """Render the slots of an interval that are missing, and record all of them."""
        interval, slots = prepared.interval, self._timeline.made_of(inputs.key)
        missing = [slot for slot in slots if slot not in prepared.existing]
        self._layers.begin(inputs, interval if missing else None)
        scores = None
        if interval is not None and inputs.truth.frames:
            measured = self._job.settings.measured
            scores = IntervalScores(interval, self._display, measured, inputs.followed)
        in_pool = scheduling.fits_pool(
            prepared, self._job.method, self._display.pixels, self._layers.any, self._slots.workers
        )
        render = partial(self._renderer.render, prepared, inputs, in_pool=in_pool)
        in_order = self._slots.render(render, missing, in_pool)
        first_record = len(self._records)
        for slot in slots:
            # Handed on at once: a variable would hold a frame while the next is rendered.
            if slot.index in inputs.rendered.frames:
                self._record(self._renderer.pass_rendered(slot, inputs), inputs, scores)
            elif slot in prepared.existing:
                masked = self._listener is not None
                self._record(self._renderer.resume(slot, interval, inputs, masked), inputs, scores)
            else:
                self._record(next(in_order), inputs, scores)
            if interval is not None:
                # Of the paper's paths a slot may be made by way of the one before it.
                interval.forget(slot.index - 1 if prepared.extrapolates else slot.index)
            check_stop()
        if scores is not None:
            # What takes all frames of the interval is added to their scores.
            timing_ms: dict[str, float] = {}
            with scheduling.record_time(timing_ms, "score", len(inputs.truth.frames)):
                ends = {
                    slot: i.on(i.display_window).pixels for slot, i in inputs.truth.ends.items()
                }
                complete = scores.complete(ends)
            for index, record in enumerate(self._records[first_record:], start=first_record):
                if record.slot in complete:
                    overall, holes = complete[record.slot]
                    record.timing_ms["score"] += timing_ms["score"]
                    self._records[index] = replace(record, score=overall, hole_score=holes)
        self._layers.begin(inputs, None)

    def _skip(self, skipped: SkippedInterval) -> None:
        """Pass the key frame through if it can be read, and record what is missing."""
        slots = self._timeline.slots_of(skipped.key)
        if skipped.passed is not None and self._timeline.shows(skipped.key):
            self._write_key(skipped.passed)
            slots = self._timeline.made_of(skipped.key)
        frames = tuple(map(self._timeline.number, slots))
        missing = LeftOut(self._timeline.numbers[skipped.key], frames, skipped.reason)
        if missing.frames:
            self.left_out.append(missing)
            announce_skipped(self._progress, missing)
        for slot in slots:
            self.writer.show(None)
            number = self._timeline.number(slot)
            self._progress.advance(number, "left out", kind_of(slot.index), made=False)

    def _write_key(self, inputs: IntervalInputs) -> None:
        """Copy the key frame's file, or write what it decodes to, and record it."""
        source, writer = self._source, self.writer
        number = self._timeline.numbers[inputs.key]
        output = self._timeline.number(Slot(inputs.key, 0))
        path = source.keys.sequence.files[number]
        replaced = writer.is_in_the_way(output)
        if writer.copies(path):
            resumed = writer.has_copy(output, path)
            if not resumed:
                writer.pass_frame(output, path)
        elif writer.output.frames is None:
            resumed = False
        else:
            recipe = key_fingerprint(source.keys, number, source.written_fps)
            resumed = writer.has(output, recipe, masked=False)
            if not resumed:
                facts = {"kind": FrameKind.KEY.value, "key": number, "recipe": recipe}
                attributes, image = header_attributes(source, facts), self._key_image(inputs)
                writer.write(output, image, inputs.template, attributes)
        record = FrameRecord(
            output,
            writer.name(output),
            number,
            0,
            FrameKind.KEY,
            "key",
            (number,),
            resumed=resumed,
            replaced=replaced and not resumed,
            timing_ms={} if resumed else {"read": inputs.read_ms},
            render=inputs.template.render,
        )
        self._record(RenderedSlot(record), inputs, None)

    def _key_image(self, inputs: IntervalInputs) -> Image:
        """Return a key frame's colour, from disk where nothing else of its interval was read."""
        if inputs.frame is not None:
            return inputs.frame.image
        number, keys = self._timeline.numbers[inputs.key], self._source.keys
        return read_sequence_picture(keys.sequence, number, keys.view)

    def _record(
        self, rendered: RenderedSlot, inputs: IntervalInputs, scores: IntervalScores | None
    ) -> None:
        """Score and record a frame; show it to the video, and with its truth to the listener."""
        record, image, writer = rendered.record, rendered.image, self.writer
        truth = inputs.truth.frames.get(record.slot)
        true_pixels = None if truth is None else truth.on(truth.display_window).pixels
        if scores is not None and true_pixels is not None and image is not None:
            with scheduling.record_time(record.timing_ms, "score"):
                test = image.on(self._display).pixels
                overall, holes = scores.frame(record.slot, true_pixels, test, rendered.mask)
            record = replace(record, score=overall, hole_score=holes)
        self._records.append(record)
        listener, is_key = self._listener, record.kind is FrameKind.KEY
        if listener is not None and not listener.wants(record.number, record.score, record.risk):
            listener = None
        if listener is not None or writer.output.video is not None:
            if is_key:
                image = self._key_image(inputs)
            elif image is None:
                image = writer.read(record.number)
            if listener is not None:
                look = writer.display_look
                listener.frame(
                    record.number,
                    look.apply(image.on(self._display).pixels),
                    None if true_pixels is None else look.apply(true_pixels),
                    rendered.mask,
                    is_key=is_key,
                )
            writer.show(image)
        self._progress.advance(
            record.number, record.method, kind_of(record.slot), made=not record.resumed
        )


def make_reader(job: Job) -> ViewsReader:
    """Return what reads the views that are written; the first decides, and is scored."""
    contents, method, settings = job.contents, job.method, job.settings
    leader = IntervalReader(
        job.source, method, settings, job.truth, job.depends_on, contents, rendered=job.rendered
    )
    followers = (
        IntervalReader(content.source, method, settings, None, job.depends_on, (content,), leader)
        for content in contents[1:]
    )
    return ViewsReader(leader, tuple(followers))


def make_writer(job: Job, note: str = "", behind: int = FRAMES_BEHIND) -> FrameWriter:
    """Return where frames go; `note` is what a video that is written alone says of itself."""
    source, keys = job.source, job.source.keys
    key_rate = None if job.targets.keeps_bytes else source.written_fps
    look = video_look(source, job.keys, note or video_note(job.settings))
    return FrameWriter(
        job.targets, keys.display, source.output_fps, key_rate, keys.view, behind, look, job.sums
    )
