"""The main job: a key sequence in, a sequence at four times its rate out, or at another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from time import perf_counter

from exwarp_cli import __version__
from exwarp_cli.domain.cores import working
from exwarp_cli.domain.decision import ONLY_WARPS, Plan, Trial
from exwarp_cli.domain.frame import Image, Window
from exwarp_cli.domain.joining import Outcome
from exwarp_cli.domain.results import FrameKind, FrameRecord, LeftOut, RunSummary
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.tiles import TilePlan
from exwarp_cli.domain.timeline import Slot, ranges
from exwarp_cli.errors import InputError
from exwarp_cli.io.footage import picture
from exwarp_cli.io.output import PREFIX
from exwarp_cli.io.threads import use_threads
from exwarp_cli.kernels import _row_bands
from exwarp_cli.pipeline.announcing import left_out, tell_left_out, unscored, unusable
from exwarp_cli.pipeline.choosing import Chooser, Chosen, always, by_policy, by_tiles, by_truth
from exwarp_cli.pipeline.finding import is_usual
from exwarp_cli.pipeline.frame_sizes import remark
from exwarp_cli.pipeline.frame_writer import FRAMES_BEHIND, FrameWriter
from exwarp_cli.pipeline.gate import Gate
from exwarp_cli.pipeline.interval_builder import IntervalBuilder, PreparedInterval, count_broken
from exwarp_cli.pipeline.interval_inputs import (
    IntervalInputs,
    IntervalReader,
    SkippedInterval,
    ViewsReader,
)
from exwarp_cli.pipeline.job import Job, open_job
from exwarp_cli.pipeline.layers import ExtraLayers
from exwarp_cli.pipeline.progress import FrameListener, NoProgress, Progress, kind_of, kinds_of
from exwarp_cli.pipeline.recipes import key_recipe
from exwarp_cli.pipeline.rendered_frames import leads_on
from exwarp_cli.pipeline.scheduling import (
    Mode,
    ParallelSlots,
    mode,
    prefetch,
    read_depth,
    record_time,
)
from exwarp_cli.pipeline.scoring import IntervalScores, broken_pixels_of
from exwarp_cli.pipeline.sharpness import KeyedPulses
from exwarp_cli.pipeline.slot_renderer import RenderedSlot, SlotRenderer, rate_attribute, rounded
from exwarp_cli.pipeline.verifying import Sums, files_of, verify, verify_video
from exwarp_cli.pipeline.without_vectors import BY_EXWARP, is_kept, note_of, video_look
from exwarp_cli.runtime.frame_pool import pool
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import Judge
from exwarp_cli.synthesis.sub_intervals import SubSlot, sub_slots, vector_spans

MAX_BYTES_BEHIND = 80 * 10**6
"""Bytes of frames that wait to be written, beside those that are being written."""

PIXEL_BYTES = 16
"""Four channels in float32."""


def upsample(
    settings: UpsampleSettings,
    progress: Progress | None = None,
    listener: FrameListener | None = None,
) -> RunSummary:
    """Write the slots of the selected key frames; return what was written and how good it is.

    Raises
    ------
    ExwarpError
        For anything that a user can cause; frames written until then are complete.
    """
    return run_job(open_job(settings), progress or NoProgress(), listener)


def run_job(job: Job, progress: Progress, listener: FrameListener | None = None) -> RunSummary:
    """Do a job that is open; see `upsample`."""
    job.refuse()
    job.targets.make_folders()
    job.announce(progress)
    begin = perf_counter()
    progress.start(len(job.slots), kinds_of(job.slots))
    try:
        if listener is not None:
            listener.plan(job.groups)
        outcome = write_intervals(job, progress, listener)
    finally:
        progress.finish()
    return job.summary(outcome, perf_counter() - begin)


def write_intervals(job: Job, progress: Progress, listener: FrameListener | None = None) -> Outcome:
    """Do the work of a job whose folders are there, in this thread.

    The caller starts and finishes `progress`, and has planned `listener`. The outcome has no frames
    for a video alone that was there as this run would make it.

    Raises
    ------
    OutputError
        When files are not on the disk as they were written, where that is verified.
    """
    settings = job.settings
    use_threads(settings.threads)
    reader = make_reader(job)
    note = ""
    if job.targets.frames is None:
        note = note_of(reader.leading_recipes, settings, job.keys, job.rendered)
    try:
        if listener is None and is_kept(job.targets, settings, note):
            return Outcome(cuts=reader.cuts)
        run = Run(job, reader, note, progress, listener)
        with working():
            frames = run.render_all()
        outcome = Outcome(
            frames,
            reader.cuts,
            tuple(run.left_out),
            nonfinite=broken_pixels_of(job, reader.truth.nonfinite, reader.rendered),
        )
        return _verified(outcome, job, run.writer.sums)
    finally:
        job.close()


def _verified(outcome: Outcome, job: Job, sums: Sums) -> Outcome:
    """Add checksums of the files to an outcome, and read these back, where that is asked."""
    settings = job.settings
    if not (job.sums and outcome.frames):
        return outcome
    files = files_of(job.targets, outcome.frames, sums)
    count = None
    if settings.verify:
        count = verify(job.targets, outcome.frames, files, job.source.keys.view, outcome.shown)
        if job.targets.frames is not None and job.targets.video is not None:
            verify_video(job.targets.video, outcome.shown)
    return replace(outcome, files=files, verified=count)


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
        listener: FrameListener | None = None,
    ) -> None:
        self._job, self._reader = job, reader
        self._progress, self._listener = progress, listener
        display = job.source.keys.display
        warps = job.source.slots is None and not job.method.extrapolates
        leader = ExtraLayers(job.contents)
        bare = warps and not leader.any
        self._builder, *others = (
            IntervalBuilder(
                source.keys.display,
                job.network,
                job.interpolator,
                source.estimated,
                bare,
                source.scratch,
                leader.moves_light,
                job.method.older_keys(job.method.lookahead),
            )
            for source in job.sources
        )
        self._layers = ExtraLayers(job.contents, tuple(others))
        self._gate = make_gate(job)
        # Frames with all their layers are large, and few may wait.
        self.writer = make_writer(job, note, 0 if self._layers.any else _writes_behind(display))
        self._chooser = make_chooser(job)
        self._renderer = SlotRenderer(
            job.settings,
            job.source,
            job.method,
            self.writer,
            self._layers,
            job.measures_key_pulse,
        )
        self._pulses = KeyedPulses(job.source) if job.measures_key_pulse else None
        most = max((len(job.source.timeline.made_of(key)) for key in job.keys), default=0)
        self._slots = ParallelSlots(_row_bands.threads(), most)
        self._records: list[FrameRecord] = []
        self.left_out: list[LeftOut] = []
        self._broken: dict[int, int] = {}
        self._remarked: set[bool] = set()

    def render_all(self) -> tuple[FrameRecord, ...]:
        """Work through the intervals: reading ahead, rendering here, writing behind."""
        keys = self._job.keys
        tasks = (partial(self._reader.read, key, self._is_needed) for key in keys)
        with self.writer, self._slots:
            for text in self.writer.remarks:
                self._progress.message(text)
            intervals = prefetch(tasks, read_depth(self._job.source.keys.display.pixels))
            for _ in keys:
                # Handed on at once: a variable would hold the raw geometry while the next is read.
                self._do_interval(next(intervals))
                pool.trim()
        written = self.writer.write_ms
        records = self._records if self._pulses is None else self._pulses.complete(self._records)
        return tuple(
            replace(record, timing_ms=record.timing_ms | {"write": written[record.number]})
            if record.number in written
            else record
            for record in records
        )

    def _do_interval(self, inputs: IntervalInputs | SkippedInterval) -> None:
        """Render an interval's frames, or skip them."""
        if isinstance(inputs, SkippedInterval):
            self._skip(inputs)
            return
        self._remark_window(inputs)
        try:
            prepared, inputs = self._prepare(inputs)
        except InputError as error:  # of what only extrapolation needs
            if not self._job.settings.source.keep_going:
                raise
            self._skip(SkippedInterval(inputs.key, str(error), inputs.without_geometry()))
            return
        timeline, interval = self._job.source.timeline, prepared.interval
        self._replace_key(inputs)
        self._take_gradient(inputs)
        self._tell_unusable(inputs)
        if timeline.shows(inputs.key):
            self._pass_key(inputs)
        slots = timeline.made_of(inputs.key)
        missing = [slot for slot in slots if slot not in prepared.existing]
        self._layers.begin(inputs, interval if missing else None)
        scores = self._scores(inputs, interval)
        pixels = self._job.source.keys.display.pixels
        how = mode(prepared, self._job.method, pixels, self._layers.any, self._slots.workers)
        render = partial(self._renderer.render, prepared, inputs, in_pool=how is Mode.IN_POOL)
        rendered = self._slots.render(render, missing, how)
        first_record = len(self._records)
        for slot in slots:
            if slot.index in inputs.rendered.frames:
                self._record(self._renderer.pass_rendered(slot, inputs), inputs, scores)
            elif slot in prepared.existing:
                masked = self._listener is not None
                self._record(self._renderer.resume(slot, interval, inputs, masked), inputs, scores)
            else:
                self._record(next(rendered), inputs, scores)
            if interval is not None:
                # Of the paper's paths a slot may be made by way of the one before it.
                interval.forget(slot.index - 1 if prepared.extrapolates else slot.index)
            check_stop()
        if scores is not None:
            self._complete_scores(first_record, inputs, scores)
        self._layers.begin(inputs, None)

    def _tell_unusable(self, inputs: IntervalInputs) -> None:
        """Record and say which ground truth and which rendered frames cannot be used."""
        timeline = self._job.source.timeline
        for found in (
            *unscored(timeline, inputs.key, inputs.truth.unscored),
            *unusable(timeline, inputs.key, inputs.rendered.unusable),
        ):
            self.left_out.append(found)
            tell_left_out(self._progress, found)

    def _prepare(self, inputs: IntervalInputs) -> tuple[PreparedInterval, IntervalInputs]:
        """Build an interval, and decide its path; return it with what is left of its inputs."""
        method, slots = self._job.method, self._job.source.timeline.made_of(inputs.key)
        timing_ms: dict[str, float] = {}
        interval: Interval | None = None
        if self._gate is not None and inputs.trial is not None:
            self._gate.receive(inputs.trial)
        with record_time(timing_ms, "geometry", len(slots)):
            if inputs.frame is not None:
                interval = self._builder.build(inputs)
        existing = {slot for slot in slots if interval is None or self._exists(slot, inputs)}
        trial = None
        if interval is not None and not interval.held and len(existing) < len(slots):
            trial = self._try(inputs, timing_ms)
        choice = None
        # A policy looks at every interval: the states of later ones hold what it saw.
        looks = len(existing) < len(slots) or method.judge is Judge.POLICY
        if slots and looks and interval is not None:
            choice = self._choose(inputs, interval)
        if trial is not None and not trial.pays and interval is not None:
            interval = replace(interval, interpolator=None)
            choice = None if choice is None else replace(choice, plan=only_warps(choice.plan))
        if choice is not None:
            timing_ms |= {step: ms / len(slots) for step, ms in choice.timing_ms.items()}
        self._broken = count_broken(inputs, self._broken) if len(existing) < len(slots) else {}
        prepared = PreparedInterval(
            interval, choice, frozenset(existing), timing_ms, self._broken, trial
        )
        if interval is not None and prepared.extrapolates and inputs.lacks_history:
            inputs = self._reader.add_history(inputs)
            self._broken = count_broken(inputs, self._broken)
            interval = self._builder.add_history(interval, inputs)
        elif interval is not None and not (
            prepared.extrapolates or inputs.slots or inputs.truth.frames or self._layers.any
        ):
            interval = interval.bare()  # slots are warped from the key frame
        parts = self._split(interval, inputs) if len(existing) < len(slots) else {}
        prepared = replace(prepared, interval=interval, broken=self._broken, parts=parts)
        return prepared, inputs.without_geometry()

    def _split(self, interval: Interval | None, inputs: IntervalInputs) -> Mapping[int, SubSlot]:
        """Return how slots beside rendered frames are made, and say where these are of no use."""
        source, rendered = self._job.source, inputs.rendered.frames
        if interval is None or not interval.has_motion or not rendered:
            return {}
        if not leads_on(source, self._job.method, self._job.contents):
            return {}
        spans = vector_spans(interval, float(1 / source.timeline.factor))
        numbers = [source.timeline.number(Slot(inputs.key, i)) for i in rendered if i not in spans]
        if numbers:
            self._progress.message(
                f"--rendered has no vectors like the key frames' in {ranges(numbers)}: frames "
                "beside are made from key frames alone"
            )
        if self._gate is not None and interval.following is None:
            interval = replace(interval, interpolator=None)  # the gate tried nothing here
        return sub_slots(interval, spans)

    def _try(self, inputs: IntervalInputs, timing_ms: dict[str, float]) -> Trial | None:
        """Return what the gate decides by; None where no network would make the frames."""
        ends = self._job.method.lookahead and inputs.following is None
        if self._gate is None or inputs.trial is None or ends:
            return None
        with record_time(timing_ms, "gate", len(self._job.source.timeline.made_of(inputs.key))):
            return self._gate.decide(inputs.trial)

    def _choose(self, inputs: IntervalInputs, interval: Interval) -> Chosen | None:
        """Decide an interval's path; None where it is held, and nothing is to be decided.

        A policy looks at it all the same.
        """
        if self._chooser is None or (interval.held and self._job.method.judge is not Judge.POLICY):
            return None
        choice = self._chooser(inputs, interval)
        return None if interval.held else choice

    def _is_needed(self, key: int, recipes: dict[int, str]) -> bool:
        """Return True if any slot is missing or must be scored."""
        settings = self._job.settings
        if not settings.skip_existing or settings.ground_truth is not None:
            return True
        number = self._job.source.timeline.number
        return not all(self.writer.has(number(Slot(key, i)), recipes[i]) for i in recipes)

    def _exists(self, slot: Slot, inputs: IntervalInputs) -> bool:
        """Return True if nothing makes a slot's frame: it was rendered, or an earlier run did."""
        if slot.index in inputs.rendered.frames:
            return True
        number, recipe = self._job.source.timeline.number(slot), inputs.metadata.recipes[slot.index]
        return self.writer.has(number, recipe)

    def _skip(self, skipped: SkippedInterval) -> None:
        """Pass the key frame through if it can be read, and record what is missing."""
        timeline = self._job.source.timeline
        slots = timeline.slots_of(skipped.key)
        if skipped.passed is not None and timeline.shows(skipped.key):
            self._pass_key(skipped.passed)
            slots = timeline.made_of(skipped.key)
        left = left_out(timeline, skipped.key, slots, skipped.reason)
        if left.frames:
            self.left_out.append(left)
            tell_left_out(self._progress, left)
        for slot in slots:
            self.writer.show_again()
            number = timeline.number(slot)
            self._progress.advance(number, "left out", kind_of(slot.index), made=False)

    def _remark_window(self, inputs: IntervalInputs) -> None:
        """Say how windows smaller than the display window are read, once each way."""
        if inputs.frame is None or inputs.region in self._remarked:
            return
        text = remark(inputs.frame.image, inputs.region)
        if text is not None:
            self._remarked.add(inputs.region)
            self._progress.message(text)

    def _replace_key(self, inputs: IntervalInputs) -> None:
        """Replace a copy of an earlier render before any frame that is made of the new one."""
        source = self._job.source
        path = source.keys.sequence.files[source.timeline.numbers[inputs.key]]
        if source.timeline.shows(inputs.key) and self.writer.copies(path):
            self.writer.replace_key(source.timeline.number(Slot(inputs.key, 0)), path)

    def _pass_key(self, inputs: IntervalInputs) -> None:
        """Pass the key frame through."""
        source, writer = self._job.source, self.writer
        number = source.timeline.numbers[inputs.key]
        output = source.timeline.number(Slot(inputs.key, 0))
        path = source.keys.sequence.files[number]
        replaced = writer.was_replaced(output) or writer.is_in_the_way(output)
        if writer.copies(path):
            resumed = writer.pass_key(output, path)
        else:
            resumed = self._write_key(output, inputs)
        record = FrameRecord(
            output, writer.name(output), number, 0, FrameKind.KEY, "key", (number,),
            resumed=resumed,
            replaced=replaced and not resumed,
            timing_ms={} if resumed else {"read": inputs.read_ms},
            render=inputs.metadata.template.render,
        )  # fmt: skip
        self._records.append(record)
        self._show(RenderedSlot(record), inputs)
        self._progress.advance(output, "key", kind_of(0), made=not resumed)

    def _write_key(self, output: int, inputs: IntervalInputs) -> bool:
        """Write a key frame that is no file of the output's format; return whether it is there."""
        source = self._job.source
        number = source.timeline.numbers[inputs.key]
        if not self.writer.keeps_frames:
            return False
        recipe = key_recipe(source.keys, number, source.written_fps)
        if self.writer.has(output, recipe, masked=False):
            return True
        attributes = {
            **rate_attribute(source),
            f"{PREFIX}version": __version__,
            f"{PREFIX}kind": FrameKind.KEY.value,
            f"{PREFIX}key": number,
            f"{PREFIX}recipe": recipe,
        }
        template = inputs.metadata.template
        self.writer.write(output, self._key_image(inputs), None, template, attributes)
        return False

    def _key_image(self, inputs: IntervalInputs) -> Image:
        """Return a key frame's colour, from disk where nothing else of its interval was read."""
        if inputs.frame is not None:
            return inputs.frame.image
        source = self._job.source
        number = source.timeline.numbers[inputs.key]
        return picture(source.keys.sequence, number, source.keys.view)

    def _take_gradient(self, inputs: IntervalInputs) -> None:
        """Keep how sharp the key frame is, where new frames are compared with it."""
        if self._pulses is not None:
            self._pulses.add_key(inputs.key, self._key_image(inputs), inputs.followed)

    def _record(
        self, rendered: RenderedSlot, inputs: IntervalInputs, scores: IntervalScores | None
    ) -> None:
        """Score, record and show a slot's frame."""
        record, image = rendered.record, rendered.image
        if self._pulses is not None and rendered.gradient is not None:
            self._pulses.add(record.number, Slot(inputs.key, record.slot), rendered.gradient)
        truth = inputs.truth.frames.get(record.slot)
        if scores is not None and truth is not None and image is not None:
            timing_ms = dict(record.timing_ms)
            with record_time(timing_ms, "score"):
                reference = truth.on(truth.display_window).pixels
                test = image.on(self._job.source.keys.display).pixels
                overall, holes = scores.frame(record.slot, reference, test, rendered.mask)
            record = replace(record, score=overall, hole_score=holes, timing_ms=timing_ms)
        self._records.append(record)
        self._show(replace(rendered, record=record), inputs)
        self._progress.advance(
            record.number, record.method, kind_of(record.slot), made=not record.resumed
        )

    def _show(self, rendered: RenderedSlot, inputs: IntervalInputs) -> None:
        """Show a frame as its file has it: to the video, and with its truth to the listener."""
        record, writer = rendered.record, self.writer
        listens = self._listener is not None and self._listener.wants(
            record.number, record.score, record.risk
        )
        if not (listens or writer.shows):
            return
        is_key = record.kind is FrameKind.KEY
        if is_key:
            image = self._key_image(inputs)
        elif rendered.image is None:
            image = writer.read(record.number)
        elif rendered.rounded:
            image = rendered.image
        else:
            image = rounded(rendered.image, inputs.metadata.template)
        if listens:
            assert self._listener is not None
            truth = inputs.truth.frames.get(record.slot)
            self._listener.frame(
                record.number,
                writer.displayed(image.on(self._job.source.keys.display).pixels),
                None if truth is None else writer.displayed(truth.on(truth.display_window).pixels),
                rendered.mask,
                is_key=is_key,
            )
        writer.show(image)

    def _scores(self, inputs: IntervalInputs, interval: Interval | None) -> IntervalScores | None:
        """Return what scores an interval's slots; None without ground truth."""
        if interval is None or not inputs.truth.frames:
            return None
        measured = self._job.settings.measured
        return IntervalScores(interval, self._job.source.keys.display, measured, inputs.followed)

    def _complete_scores(self, first: int, inputs: IntervalInputs, scores: IntervalScores) -> None:
        """Add what takes all frames of an interval to its scores; `first` is its first record."""
        timing_ms: dict[str, float] = {}
        with record_time(timing_ms, "score", len(inputs.truth.frames)):
            ends = {slot: i.on(i.display_window).pixels for slot, i in inputs.truth.ends.items()}
            complete = scores.complete(ends)
        for index, record in enumerate(self._records[first:], start=first):
            if record.slot in complete:
                overall, holes = complete[record.slot]
                elapsed = record.timing_ms["score"] + timing_ms["score"]
                self._records[index] = replace(
                    record,
                    score=overall,
                    hole_score=holes,
                    timing_ms=record.timing_ms | {"score": elapsed},
                )


def only_warps(plan: Plan | TilePlan) -> Plan | TilePlan:
    """Return a plan of the same kind that runs no network."""
    if isinstance(plan, TilePlan):
        return TilePlan.fixed(plan.columns, plan.rows, ONLY_WARPS)
    return Plan.fixed(ONLY_WARPS)


def make_chooser(job: Job) -> Chooser | None:
    """Return what decides the path of each key interval; None outside the decision tree."""
    method, source = job.method, job.source
    if method.path is not None:
        return always(method.path) if is_usual(source) else None
    if job.policy is not None and job.policy.of_tiles:
        return by_tiles(job.policy, job.settings.spent)
    if job.policy is not None:
        from exwarp_cli.pipeline.observing import Observer
        from exwarp_cli.policy.state import LearnedPolicy

        observer = Observer(source.keys.display, source.setting)
        return by_policy(LearnedPolicy(job.policy.network), observer)
    return None if method.judge is None else by_truth(method.judge, source.keys.display)


def make_gate(job: Job) -> Gate | None:
    """Return what decides where the network of a run may make frames; None without a gate."""
    source, method = job.source, job.method
    if not job.is_gated:
        return None
    builder = IntervalBuilder(
        source.keys.display, job.network, job.interpolator, source.estimated,
        scratch=source.scratch,
    )  # fmt: skip
    return Gate(method, builder, source.keys.display)


def make_reader(job: Job) -> ViewsReader:
    """Return what reads the views that are written; the first decides, and is scored."""
    contents, method, settings = job.contents, job.method, job.settings
    leader = IntervalReader(
        contents[0].source,
        method,
        settings,
        job.truth,
        job.depends_on,
        contents,
        rendered=job.rendered,
    )
    others = (
        IntervalReader(content.source, method, settings, None, job.depends_on, (content,), leader)
        for content in contents[1:]
    )
    return ViewsReader(leader, tuple(others))


def make_writer(job: Job, note: str = "", behind: int = FRAMES_BEHIND) -> FrameWriter:
    """Return where frames go; `note` is what a video that is written alone says of itself."""
    keys, rate = job.source.keys, job.source.output_rate
    look = video_look(job.source, job.keys, note or BY_EXWARP)
    return FrameWriter(
        job.targets, job.settings, keys.display, rate, keys.view, behind, look, job.sums
    )


def _writes_behind(display: Window) -> int:
    """Return how many frames may wait to be written: fewer of large ones."""
    return min(FRAMES_BEHIND, MAX_BYTES_BEHIND // (display.pixels * PIXEL_BYTES))
