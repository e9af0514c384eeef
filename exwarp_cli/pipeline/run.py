"""One run under way: interval by interval, from what was read to what is written and recorded."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from exwarp_cli import __version__
from exwarp_cli.domain.decision import Plan
from exwarp_cli.domain.frame import Bool, Image, place
from exwarp_cli.domain.results import FrameKind, FrameRecord
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.errors import LayoutError
from exwarp_cli.io.decisions import decision_text, parse_decision
from exwarp_cli.io.footage import picture
from exwarp_cli.io.frame_files import quantised
from exwarp_cli.io.output import PREFIX, compression_of
from exwarp_cli.io.template import Plane, PlaneKey, Template
from exwarp_cli.pipeline.choosing import Chooser
from exwarp_cli.pipeline.geometry import Staging
from exwarp_cli.pipeline.layers import Beside, named_by_path
from exwarp_cli.pipeline.loaded import Loaded
from exwarp_cli.pipeline.progress import Progress
from exwarp_cli.pipeline.recipes import key_recipe
from exwarp_cli.pipeline.schedule import read_ahead
from exwarp_cli.pipeline.scoring import IntervalScores
from exwarp_cli.pipeline.sink import Sink
from exwarp_cli.pipeline.slots_at_once import Begun, SlotsAtOnce, timed
from exwarp_cli.pipeline.source import Source
from exwarp_cli.pipeline.staged import Staged, hole_fraction, nonfinite_pixels, with_write_times
from exwarp_cli.pipeline.views import JointLoader
from exwarp_cli.pipeline.watching import Watcher
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import Judge, Method, Predicted, take

INTERVALS_AHEAD = 1
"""How many key intervals are read ahead of the one that is worked on."""

MOST_AHEAD = 4 * 2**20
"""Pixels of a frame up to which any are: of 3840x2160 a key frame with its geometry takes 430 MB,
and decoding keeps all cores busy by itself."""


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
    chooser: Chooser | None
    at_once: SlotsAtOnce
    watcher: Watcher | None = None
    records: list[FrameRecord] = field(default_factory=list)
    _scoring: IntervalScores | None = None
    _broken: dict[int, int] = field(default_factory=dict)

    def write_all(self, loader: JointLoader, keys: tuple[int, ...]) -> tuple[FrameRecord, ...]:
        """Work through the intervals: reading ahead, computing here, writing behind."""
        tasks = (partial(loader.load, key, self._needed) for key in keys)
        with self.sink, self.at_once:
            for loaded in read_ahead(tasks, self._ahead):
                if self.source.timeline.shows(loaded.key):
                    self._pass_key(loaded)
                loaded, staged = self._staged(loaded)
                self._interval(loaded, staged)
                del loaded, staged  # before the next one is waited for, and staged
        return with_write_times(self.records, self.sink.write_ms)

    @property
    def _ahead(self) -> int:
        """How many intervals to read ahead."""
        display = self.source.keys.display
        return INTERVALS_AHEAD if display.width * display.height <= MOST_AHEAD else 0

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
            chosen = self.chooser(loaded, interval)
        shares = {"geometry": geometry_ms / max(len(slots), 1)}
        if chosen is not None:
            shares |= {step: ms / len(slots) for step, ms in chosen.timing_ms.items()}
        staged = Staged(interval, chosen, frozenset(there), shares)
        if interval is not None and staged.extrapolates and loaded.late is not None:
            loaded = loaded.late(loaded)
            staged = replace(staged, interval=self.staging.led_back(interval, loaded))
        elif interval is not None and self._only_moves(loaded, staged):
            staged = replace(staged, interval=interval.without("position", "normal"))
        return loaded.lean(), staged

    def _only_moves(self, loaded: Loaded, staged: Staged) -> bool:
        """Whether slots are made by settled motion, depth and ids of key frames alone."""
        return not (loaded.slots or loaded.truth or self.beside.anything or staged.extrapolates)

    def _interval(self, loaded: Loaded, staged: Staged) -> None:
        """Make the slots after a key frame."""
        self._broken.clear()
        interval, slots = staged.interval, self.source.timeline.made_of(loaded.key)
        self.beside.begin(loaded, interval if len(staged.there) < len(slots) else None)
        self._scoring = self._scores(loaded, interval)
        begun = self._begun(loaded, staged)
        for slot in slots:
            if interval is None or slot in staged.there:
                record, shown = self._resume(slot, interval, loaded)
            else:
                record, shown = self._make(slot, interval, loaded, staged.plan, begun)
                record = replace(record, timing_ms=staged.shares | record.timing_ms)
            self.records.append(record)
            watched = self.watcher is not None and self.watcher.wants(record.number, record.score)
            if shown is None and (watched or self.sink.shows):
                shown = self.sink.read(record.number)
            if shown is not None and watched:
                self._show(record, shown, interval, loaded)
            if shown is not None:
                self.sink.show(shown)
            self.progress.advance(record.number, record.method)
            if interval is not None and self._scoring is None:
                # Of the paper's paths a slot may be made by way of the one before it.
                interval.forget(slot.index - 1 if staged.extrapolates else slot.index)
            del shown
        self._complete(loaded)

    def _begun(self, loaded: Loaded, staged: Staged) -> Begun[Predicted] | None:
        """Begin the slots that are to be made, where none goes by another and memory permits."""
        interval, path = staged.interval, None if staged.plan is None else staged.plan.path
        others = self.beside.anything or loaded.slots or self.method.interpolates
        if interval is None or others or path not in (None, "S6"):
            return None
        if self._ahead == 0 or not self.at_once.pays:
            return None
        slots = set(self.source.timeline.made_of(loaded.key)) - staged.there
        make = partial(self._predict, interval, staged.plan)
        return self.at_once.begin(make, sorted(slot.index for slot in slots))

    def _predict(self, interval: Interval, plan: Plan | None, slot: int) -> Predicted:
        """Make a slot's frame: by the interval's path, or by the method itself."""
        if self.method.predict is not None:
            return self.method.predict(interval, slot)
        assert plan is not None
        return replace(take(plan.path, interval, slot), method=self.method.name)

    def _pass_key(self, loaded: Loaded) -> None:
        """Pass the key frame through."""
        number = self.source.timeline.numbers[loaded.key]
        output = self.source.timeline.number(Slot(loaded.key, 0))
        path = self.source.keys.sequence.files[number]
        copied = self.sink.copies(path)
        resumed = self.sink.pass_key(output, path) if copied else self._write_key(output, loaded)
        name = self.sink.name(output)
        record = FrameRecord(output, name, number, 0, FrameKind.KEY, "key", (number,))
        timing = {} if resumed else {"read": loaded.read_ms}
        render = loaded.template.render
        self.records.append(replace(record, resumed=resumed, timing_ms=timing, render=render))
        watched = self.watcher is not None and self.watcher.wants(output, None)
        if watched or self.sink.shows:
            image = self._key_image(loaded)
            if watched:
                self._show(record, image, None, loaded)
            self.sink.show(image)
        self.progress.advance(output, "key")

    def _write_key(self, output: int, loaded: Loaded) -> bool:
        """Write a key frame that is no file of the output's format; return whether it is there."""
        keys, number = self.source.keys, self.source.timeline.numbers[loaded.key]
        if not self.sink.keeps_frames:
            return False
        recipe = key_recipe(keys, number)
        if self.sink.has(output, recipe, masked=False):
            return True
        attributes = {
            "framesPerSecond": self.source.output_fps,
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

    def _show(
        self, record: FrameRecord, image: Image, interval: Interval | None, loaded: Loaded
    ) -> None:
        """Show a frame to the watcher as its file has it, beside its truth and holes."""
        assert self.watcher is not None
        if record.kind is not FrameKind.KEY:
            image = replace(image, pixels=quantised(image.pixels, loaded.template))
        truth = loaded.truth.get(record.slot)
        slot = Slot(loaded.key, record.slot)
        self.watcher.frame(
            record.number,
            image.on(self.source.keys.display).pixels,
            None if truth is None else truth.on(truth.display_window).pixels,
            None if interval is None else self._mask(interval, slot),
            is_key=record.kind is FrameKind.KEY,
        )

    def _make(
        self,
        slot: Slot,
        interval: Interval,
        loaded: Loaded,
        plan: Plan | None,
        begun: Begun[Predicted] | None,
    ) -> tuple[FrameRecord, Image]:
        """Make, write and score the frame of a slot, which may have been begun."""
        assert loaded.frame is not None
        if begun is not None and slot.index in begun:
            predicted, elapsed = begun.take(slot.index)
        else:
            predicted, elapsed = timed(partial(self._predict, interval, plan), slot.index)
        begin = time.perf_counter()
        canvas = interval.key.image.data_window
        image = Image(predicted.pixels, canvas, self.source.keys.display)
        beside = self._beside(slot, predicted, loaded, plan)
        layers_ms = 1e3 * (time.perf_counter() - begin)
        mask = self._mask(interval, slot)
        record = FrameRecord(
            number=self.source.timeline.number(slot),
            file=self.sink.name(self.source.timeline.number(slot)),
            key=interval.key.number,
            slot=slot.index,
            kind=self._kind(predicted, slot),
            method=predicted.method,
            sources=predicted.sources,
            hole_fraction=hole_fraction(mask),
            nonfinite_pixels=nonfinite_pixels(loaded, predicted.sources, self._broken),
            timing_ms={predicted.made_by: elapsed} | ({"layers": layers_ms} if beside else {}),
            made_by=predicted.made_by,
            path=None if plan is None else plan.path,
            decision=None if plan is None else plan.decision_of(slot.index),
        )
        attributes = self._attributes(record, loaded.recipes[slot.index])
        self.sink.write(record.number, image, mask, loaded.template, attributes, beside)
        if loaded.truth or self.sink.shows:
            image = replace(image, pixels=quantised(image.pixels, loaded.template))
        return self._scored(record, image, mask, loaded), image

    def _beside(
        self, slot: Slot, predicted: Predicted, loaded: Loaded, plan: Plan | None
    ) -> dict[PlaneKey, Plane]:
        """Make what is written with a slot's beauty: further layers, and other views."""
        if not self.beside.anything:
            return {}
        path = None if plan is None else plan.path

        def predict(interval: Interval) -> Predicted:
            return named_by_path(self._predict(interval, plan, slot.index), path)

        shown = named_by_path(predicted, path)
        assert isinstance(loaded.template, Template)  # layers are for EXR
        return self.beside.make(slot.index, shown, predict, loaded.template)

    def _kind(self, predicted: Predicted, slot: Slot) -> FrameKind:
        """Return a frame's kind: who repeats a key frame that was not shown shows it first."""
        first = slot.index == 1 and not self.source.timeline.shows(slot.key)
        return FrameKind.GENERATED if first else predicted.kind

    def _resume(
        self, slot: Slot, interval: Interval | None, loaded: Loaded
    ) -> tuple[FrameRecord, Image | None]:
        """Record a frame that an earlier run wrote, and score it."""
        number = self.source.timeline.number(slot)
        known = self.sink.written(number)
        holes = known.get("holeFraction")
        record = FrameRecord(
            number=number,
            file=self.sink.name(number),
            key=self.source.timeline.numbers[slot.key],
            slot=slot.index,
            kind=FrameKind(known["kind"]),
            method=str(known["method"]),
            sources=tuple(int(n) for n in str(known["sources"]).split(",")),
            hole_fraction=None if holes is None else float(holes),
            resumed=True,
            made_by=known.get("madeBy"),
            path=known.get("path"),
            decision=parse_decision(known.get("decision")),
        )
        if interval is None or slot.index not in loaded.truth:
            return record, None
        image = self.sink.read(number)
        return self._scored(record, image, self._mask(interval, slot), loaded), image

    def _scored(
        self, record: FrameRecord, image: Image, mask: Bool | None, loaded: Loaded
    ) -> FrameRecord:
        """Score a frame against ground truth, where there is some, on the display window."""
        truth = loaded.truth.get(record.slot)
        if truth is None:
            return record
        display = self.source.keys.display
        if truth.display_window.shape != display.shape:
            raise LayoutError(
                f"--ground-truth for frame {record.number} is {truth.display_window} and the input "
                f"is {display}; give a sequence of the same resolution"
            )
        assert self._scoring is not None
        begin = time.perf_counter()
        reference, test = truth.on(truth.display_window).pixels, image.on(display).pixels
        everything, holes = self._scoring.frame(record.slot, reference, test, mask)
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

    def _mask(self, interval: Interval, slot: Slot) -> Bool | None:
        """Hole mask of a slot on the display window."""
        mask = interval.hole_mask(slot.index)
        if mask is None:
            return None
        return place(mask, interval.key.image.data_window, self.source.keys.display)

    def _attributes(self, record: FrameRecord, recipe: str) -> dict[str, Any]:
        """Header attributes of a generated frame."""
        out: dict[str, Any] = {
            "framesPerSecond": self.source.output_fps,
            f"{PREFIX}version": __version__,
            f"{PREFIX}method": record.method,
            f"{PREFIX}kind": record.kind.value,
            f"{PREFIX}sources": ",".join(str(n) for n in record.sources),
            f"{PREFIX}key": record.key,
            f"{PREFIX}slot": record.slot,
            f"{PREFIX}setting": self.source.setting,
            f"{PREFIX}recipe": recipe,
        }
        if record.made_by is not None:
            out[f"{PREFIX}madeBy"] = record.made_by
        if record.path is not None:
            out[f"{PREFIX}path"] = record.path
        if record.decision is not None:
            out[f"{PREFIX}decision"] = decision_text(record.decision)
        if record.hole_fraction is not None:
            out[f"{PREFIX}holeFraction"] = record.hole_fraction
        if self.beside.moves_vectors:
            # Those of a key frame, too, lead over a key interval, which is so many output frames.
            out[f"{PREFIX}vectorSpan"] = float(self.source.timeline.factor)
        compression = compression_of(self.settings.compression)
        if compression is not None:
            out["compression"] = compression
        return out
