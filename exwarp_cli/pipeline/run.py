"""One run under way: interval by interval, from what was read to what is written and recorded."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

from exwarp_cli import __version__
from exwarp_cli.compiled.resident import let_compiler_go
from exwarp_cli.domain.frame import Image
from exwarp_cli.domain.maker import maker_of
from exwarp_cli.domain.results import FrameKind, FrameRecord, LeftOut
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.errors import InputError, OutputError, UnreadableError
from exwarp_cli.io.decisions import parse_decision
from exwarp_cli.io.footage import picture
from exwarp_cli.io.output import PREFIX
from exwarp_cli.pipeline.choosing import Chooser, Chosen
from exwarp_cli.pipeline.eta import kind_of
from exwarp_cli.pipeline.geometry import Staging
from exwarp_cli.pipeline.layers import Beside
from exwarp_cli.pipeline.leaving_out import left_out, tell_left_out, unscored
from exwarp_cli.pipeline.loaded import Loaded, Unmade
from exwarp_cli.pipeline.making import Made, SlotMaker, rate_attribute, rounded
from exwarp_cli.pipeline.progress import Progress
from exwarp_cli.pipeline.recipes import key_recipe
from exwarp_cli.pipeline.regions import remark
from exwarp_cli.pipeline.schedule import read_ahead
from exwarp_cli.pipeline.scoring import IntervalScores
from exwarp_cli.pipeline.sink import Sink
from exwarp_cli.pipeline.slots_at_once import Begun, SlotsAtOnce
from exwarp_cli.pipeline.source import Source
from exwarp_cli.pipeline.staged import Staged, broken_in, with_write_times
from exwarp_cli.pipeline.views import JointLoader
from exwarp_cli.pipeline.watching import Watcher
from exwarp_cli.runtime.frame_pool import pool
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import Judge, Method

INTERVALS_AHEAD = 1
"""How many key intervals are read ahead of the one that is worked on."""

MOST_AHEAD = 4 * 2**20
"""Pixels of a frame up to which any are: of 3840x2160 a key frame with its geometry takes 430 MB,
and decoding keeps all cores busy by itself."""


@dataclass(frozen=True)
class _Work:
    """An interval as it is staged; `begun` are its slots, where they are made at once."""

    loaded: Loaded
    staged: Staged
    begun: Begun[Slot, Made] | None


@dataclass
class Run:
    """One run under way: settings, open outputs, and what was recorded."""

    settings: UpsampleSettings
    source: Source
    method: Method
    sink: Sink
    progress: Progress
    staging: Staging
    beside: Beside
    maker: SlotMaker
    chooser: Chooser | None
    at_once: SlotsAtOnce
    watcher: Watcher | None = None
    records: list[FrameRecord] = field(default_factory=list)
    left_out: list[LeftOut] = field(default_factory=list)
    _scoring: IntervalScores | None = None
    _broken: dict[int, int] = field(default_factory=dict)
    _told_windows: set[bool] = field(default_factory=set)

    def write_all(self, loader: JointLoader, keys: tuple[int, ...]) -> tuple[FrameRecord, ...]:
        """Work through the intervals: reading ahead, computing here, writing behind."""
        tasks = (partial(loader.load, key, self._needed) for key in keys)
        under_way: Iterator[None] = iter(())
        with self.sink, self.at_once:
            for text in self.sink.remarks:
                self.progress.message(text)
            try:
                for loaded in read_ahead(tasks, self._ahead):
                    work = self._work(loaded)
                    del loaded
                    _finish(under_way)
                    under_way = self._steps(work)
                    del work  # before the next one is waited for, and staged
                    pool.trim()
                    let_compiler_go()
                    next(under_way, None)
            except (InputError, UnreadableError):
                _finish(under_way)  # that is sound
                raise
            _finish(under_way)
        return with_write_times(self.records, self.sink.write_ms)

    def _work(self, loaded: Loaded | Unmade) -> _Work | Unmade:
        """Stage an interval, and begin its slots where that can be done at once."""
        if isinstance(loaded, Unmade):
            return loaded
        self._tell_window(loaded)
        try:
            loaded, staged = self._staged(loaded)
        except InputError as error:  # of what is read late
            if not self.settings.source.keep_going:
                raise
            return Unmade(loaded.key, str(error), loaded.lean())
        begun = None
        self._replace_key(loaded)
        if self._goes_at_once(loaded, staged):
            made_of = self.source.timeline.made_of(loaded.key)
            slots = sorted(slot for slot in made_of if slot not in staged.there)
            begun = self.at_once.begin(partial(self.maker.make, staged, loaded, here=True), slots)
        return _Work(loaded, staged, begun)

    def _tell_window(self, loaded: Loaded) -> None:
        """Say how windows smaller than the display window are read, once each way."""
        if loaded.frame is None or loaded.region in self._told_windows:
            return
        text = remark(loaded.frame.image, loaded.region)
        if text is not None:
            self._told_windows.add(loaded.region)
            self.progress.message(text)

    def _steps(self, work: _Work | Unmade) -> Iterator[None]:
        """Make an interval's frames, or leave them out."""
        return self._leave_out(work) if isinstance(work, Unmade) else self._interval(work)

    def _leave_out(self, work: Unmade) -> Iterator[None]:
        """Pass the key frame through if it is sound, and note what is missing."""
        timeline = self.source.timeline
        slots = timeline.slots_of(work.key)
        if work.passed is not None and timeline.shows(work.key):
            self._pass_key(work.passed)
            slots = timeline.made_of(work.key)
        left = left_out(timeline, work.key, slots, work.reason)
        if left.frames:
            self.left_out.append(left)
            tell_left_out(self.progress, left)
        for slot in slots:
            self.sink.show_again()
            number = timeline.number(slot)
            self.progress.advance(number, "left out", kind_of(slot.index), made=False)
        yield

    def _goes_at_once(self, loaded: Loaded, staged: Staged) -> bool:
        """Whether threads can make a slot each: none goes by another."""
        if not self._may_go_at_once or staged.interval is None or loaded.slots:
            return False
        return staged.plan is None or staged.plan.path == "S6"

    @cached_property
    def _may_go_at_once(self) -> bool:
        """Whether slots of some intervals can be made at once, as far as memory permits."""
        if self.beside.anything or self.method.interpolates or self.source.slots is not None:
            return False
        return self.method.path in (None, "S6") and self._is_small and self.at_once.pays

    @property
    def _is_small(self) -> bool:
        """Whether memory permits to work on an interval before the last is done with."""
        return self.source.keys.display.pixels <= MOST_AHEAD

    @property
    def _ahead(self) -> int:
        """How many intervals to read ahead: none where slots of the last one are made meanwhile.

        But where a network may extrapolate, which takes more memory than that, one is: staging for
        a policy takes so long that a core waited for it, 2 % of the time where it warps.
        """
        waits = self._may_go_at_once and not self.method.extrapolates
        return INTERVALS_AHEAD if self._is_small and not waits else 0

    def _needed(self, key: int, recipes: dict[int, str]) -> bool:
        """Whether an interval has to be computed: something is missing, or is to be scored."""
        if not self.settings.skip_existing or self.settings.ground_truth is not None:
            return True
        return not all(self._is_there(Slot(key, i), recipes) for i in recipes)

    def _is_there(self, slot: Slot, recipes: dict[int, str]) -> bool:
        """Whether an earlier run wrote this slot's files as this one would."""
        return self.sink.has(self.source.timeline.number(slot), recipes[slot.index])

    def _staged(self, loaded: Loaded) -> tuple[Loaded, Staged]:
        """Bring an interval to where slots can be made, and have its path decided."""
        begin = time.perf_counter()
        interval = None if loaded.frame is None else self.staging.interval(loaded)
        geometry_ms = 1e3 * (time.perf_counter() - begin)
        slots = self.source.timeline.made_of(loaded.key)
        there = {slot for slot in slots if interval is None or self._is_there(slot, loaded.recipes)}
        # A policy looks at every interval: the states of later ones hold what it saw.
        looks = len(there) < len(slots) or self.method.judge is Judge.POLICY
        chosen = None  # outside the decision tree
        if slots and looks and self.chooser is not None and interval is not None:
            chosen = self._chosen(loaded, interval)
        shares = {"geometry": geometry_ms / max(len(slots), 1)}
        if chosen is not None:
            shares |= {step: ms / len(slots) for step, ms in chosen.timing_ms.items()}
        self._broken = broken_in(loaded, self._broken) if len(there) < len(slots) else {}
        staged = Staged(interval, chosen, frozenset(there), shares, self._broken)
        if interval is not None and staged.extrapolates and loaded.late is not None:
            loaded = loaded.late(loaded)
            self._broken = broken_in(loaded, self._broken)
            interval = self.staging.led_back(interval, loaded)
            staged = replace(staged, interval=interval, broken=self._broken)
        elif interval is not None and self._only_moves(loaded, staged):
            staged = replace(staged, interval=interval.bare())
        return loaded.lean(), staged

    def _chosen(self, loaded: Loaded, interval: Interval) -> Chosen | None:
        """Have an interval's path decided; None where it is held, and nothing is to be decided.

        A policy looks at it all the same.
        """
        assert self.chooser is not None
        if interval.held and self.method.judge is not Judge.POLICY:
            return None
        chosen = self.chooser(loaded, interval)
        return None if interval.held else chosen

    def _only_moves(self, loaded: Loaded, staged: Staged) -> bool:
        """Whether slots are made by settled motion, depth and ids of key frames alone."""
        return not (loaded.slots or loaded.truth or self.beside.anything or staged.extrapolates)

    def _interval(self, work: _Work) -> Iterator[None]:
        """Pass a key frame on, and make the slots after it, or take those that were begun.

        Of slots that were begun it yields before the first, so that the next interval is read and
        staged meanwhile, and no core waits for slots to make; before the last where a next key
        frame is looked ahead to, as two of them are in memory then.
        """
        loaded, staged, interval = work.loaded, work.staged, work.staged.interval
        for one in unscored(self.source.timeline, loaded.key, loaded.unscored):
            self.left_out.append(one)
            tell_left_out(self.progress, one)
        if self.source.timeline.shows(loaded.key):
            self._pass_key(loaded)
        slots = self.source.timeline.made_of(loaded.key)
        pause = slots[-1:] if self.method.lookahead else slots[:1]
        self.beside.begin(loaded, interval if len(staged.there) < len(slots) else None)
        self._scoring = self._scores(loaded, interval)
        for slot in slots:
            if slot in pause and work.begun is not None:
                yield
            if interval is None or slot in staged.there:
                made = self._resume(slot, interval, loaded)
            elif work.begun is not None:
                made = work.begun.take(slot)
            else:
                made = self.maker.make(staged, loaded, slot)
            record = self._scored(made, loaded)
            self.records.append(record)
            self._show(record, made, loaded)
            self.progress.advance(
                record.number, record.method, kind_of(slot.index), made=not record.resumed
            )
            if interval is not None:
                # Of the paper's paths a slot may be made by way of the one before it.
                interval.forget(slot.index - 1 if staged.extrapolates else slot.index)
            del made
        self._complete(loaded)
        self._scoring = None
        self.beside.begin(loaded, None)  # neither holds the interval on

    def _replace_key(self, loaded: Loaded) -> None:
        """Replace a copy of an earlier render before any frame that is made of the new one."""
        timeline = self.source.timeline
        path = self.source.keys.sequence.files[timeline.numbers[loaded.key]]
        if timeline.shows(loaded.key) and self.sink.copies(path):
            self.sink.replace_key(timeline.number(Slot(loaded.key, 0)), path)

    def _pass_key(self, loaded: Loaded) -> None:
        """Pass the key frame through."""
        number = self.source.timeline.numbers[loaded.key]
        output = self.source.timeline.number(Slot(loaded.key, 0))
        path = self.source.keys.sequence.files[number]
        copied = self.sink.copies(path)
        replaced = self.sink.was_replaced(output) or self.sink.is_in_the_way(output)
        resumed = self.sink.pass_key(output, path) if copied else self._write_key(output, loaded)
        name = self.sink.name(output)
        record = FrameRecord(output, name, number, 0, FrameKind.KEY, "key", (number,))
        timing = {} if resumed else {"read": loaded.read_ms}
        render = loaded.template.render
        record = replace(record, resumed=resumed, replaced=replaced and not resumed)
        self.records.append(replace(record, timing_ms=timing, render=render))
        self._show(self.records[-1], Made(record), loaded)
        self.progress.advance(output, "key", kind_of(0), made=not resumed)

    def _write_key(self, output: int, loaded: Loaded) -> bool:
        """Write a key frame that is no file of the output's format; return whether it is there."""
        keys, number = self.source.keys, self.source.timeline.numbers[loaded.key]
        if not self.sink.keeps_frames:
            return False
        recipe = key_recipe(keys, number, self.source.written_fps)
        if self.sink.has(output, recipe, masked=False):
            return True
        attributes = {
            **rate_attribute(self.source),
            f"{PREFIX}version": __version__,
            f"{PREFIX}kind": FrameKind.KEY.value,
            f"{PREFIX}key": number,
            f"{PREFIX}recipe": recipe,
        }
        self.sink.write(output, self._key_image(loaded), None, loaded.template, attributes)
        return False

    def _key_image(self, loaded: Loaded) -> Image:
        """Return a key frame's colour, from disk where nothing else of its interval was read."""
        if loaded.frame is not None:
            return loaded.frame.image
        keys, number = self.source.keys, self.source.timeline.numbers[loaded.key]
        return picture(keys.sequence, number, keys.view)

    def _show(self, record: FrameRecord, made: Made, loaded: Loaded) -> None:
        """Show a frame as its file has it: to the video, and beside its truth to the watcher."""
        watched = self.watcher is not None and self.watcher.wants(record.number, record.score)
        if not (watched or self.sink.shows):
            return
        is_key = record.kind is FrameKind.KEY
        if is_key:
            image = self._key_image(loaded)
        elif made.image is None:
            image = self.sink.read(record.number)
        else:
            image = made.image if made.rounded else rounded(made.image, loaded.template)
        if watched:
            assert self.watcher is not None
            truth = loaded.truth.get(record.slot)
            self.watcher.frame(
                record.number,
                self.sink.displayed(image.on(self.source.keys.display).pixels),
                None
                if truth is None
                else self.sink.displayed(truth.on(truth.display_window).pixels),
                made.mask,
                is_key=is_key,
            )
        self.sink.show(image)

    def _resume(self, slot: Slot, interval: Interval | None, loaded: Loaded) -> Made:
        """Record a frame that an earlier run wrote."""
        number = self.source.timeline.number(slot)
        try:
            record = self._recorded(slot, self.sink.written(number))
        except (LookupError, TypeError, ValueError, AttributeError, RecursionError) as error:
            raise OutputError(
                f"what {self.sink.name(number)} says of itself was changed by hand; remove it, or "
                "give --overwrite to replace all frames"
            ) from error
        scored = slot.index in loaded.truth
        if interval is None or not (scored or self.watcher is not None):
            return Made(record)
        image = self.sink.read(number) if scored else None
        return Made(record, image, mask=self.maker.mask(interval, slot))

    def _recorded(self, slot: Slot, known: Mapping[str, Any]) -> FrameRecord:
        """Return the record of a frame from what its header says."""
        number, holes = self.source.timeline.number(slot), known.get("holeFraction")
        return FrameRecord(
            number=number,
            file=self.sink.name(number),
            key=self.source.timeline.numbers[slot.key],
            slot=slot.index,
            kind=FrameKind(known["kind"]),
            method=str(known["method"]),
            sources=tuple(int(n) for n in str(known["sources"]).split(",")),
            hole_fraction=None if holes is None else float(holes),
            resumed=True,
            made_by=maker_of(known.get("madeBy"), str(known["method"])),
            path=known.get("path"),
            decision=parse_decision(known.get("decision")),
        )

    def _scored(self, made: Made, loaded: Loaded) -> FrameRecord:
        """Score a frame against ground truth, where there is some, on the display window."""
        record, image = made.record, made.image
        truth = loaded.truth.get(record.slot)
        if truth is None or image is None:
            return record
        display = self.source.keys.display
        assert self._scoring is not None
        begin = time.perf_counter()
        reference, test = truth.on(truth.display_window).pixels, image.on(display).pixels
        everything, holes = self._scoring.frame(record.slot, reference, test, made.mask)
        elapsed = 1e3 * (time.perf_counter() - begin)
        timing = record.timing_ms | {"score": elapsed}
        return replace(record, score=everything, hole_score=holes, timing_ms=timing)

    def _scores(self, loaded: Loaded, interval: Interval | None) -> IntervalScores | None:
        """Return what scores an interval's slots; None where nothing is."""
        if interval is None or not loaded.truth:
            return None
        return IntervalScores(
            interval, self.source.keys.display, self.settings.measured, loaded.followed
        )

    def _complete(self, loaded: Loaded) -> None:
        """Add what takes all frames of the interval to the scores of those recorded last."""
        if self._scoring is None:
            return
        begin = time.perf_counter()
        ends = {i: image.on(image.display_window).pixels for i, image in loaded.truth_ends.items()}
        found = self._scoring.complete(ends)
        elapsed = 1e3 * (time.perf_counter() - begin) / len(found)
        number = self.source.timeline.numbers[loaded.key]
        count = len(self.source.timeline.slots_of(loaded.key))
        for index in range(len(self.records) - count, len(self.records)):
            record = self.records[index]
            if record.key == number and record.slot in found:
                overall, holes = found[record.slot]
                timing = record.timing_ms | {"score": record.timing_ms["score"] + elapsed}
                self.records[index] = replace(
                    record, score=overall, hole_score=holes, timing_ms=timing
                )


def _finish(steps: Iterator[None]) -> None:
    """Go through all steps that are left."""
    for _ in steps:
        pass
