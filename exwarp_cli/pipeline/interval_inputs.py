"""What key intervals are made of: read from disk ahead of the computation, nothing computed yet."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import takewhile

from exwarp_cli.domain.frame import GBuffer, KeyFrame
from exwarp_cli.domain.results import InterpolatorSummary, NetworkSummary
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.timeline import FACTOR, Cut, Slot
from exwarp_cli.errors import InputError
from exwarp_cli.io.output import FrameTemplate
from exwarp_cli.io.sequence import Sequence
from exwarp_cli.pipeline.contents import Content, LayerFrames, LayerReader, template_of
from exwarp_cli.pipeline.frame_sizes import Regions
from exwarp_cli.pipeline.gate import TrialInputs, TrialReader
from exwarp_cli.pipeline.key_frames import (
    HistoryFrame,
    IntervalTruth,
    KeyFrameStore,
    TruthReader,
    reads_late,
)
from exwarp_cli.pipeline.recipes import Recipes
from exwarp_cli.pipeline.rendered_frames import (
    IntervalRendered,
    RenderedFrames,
    RenderedReader,
    leads_on,
)
from exwarp_cli.pipeline.scheduling import record_time
from exwarp_cli.pipeline.shots import UnreadableFrames
from exwarp_cli.pipeline.source import FrameOf, Source
from exwarp_cli.policy.state import OLDER_KEYS
from exwarp_cli.synthesis.interval import QUARTERS
from exwarp_cli.synthesis.methods import Judge, Method

Needed = Callable[[int, dict[int, str]], bool]
"""Called with an interval's index and recipes; False leaves the rest unread."""


WARPED_BACK = 1
"""How many older key frames a warp from one key frame goes by."""

Dependencies = tuple[NetworkSummary | None, str | None, InterpolatorSummary | None]
"""The network that extrapolates, the policy's checksum, the network that interpolates."""


@dataclass(frozen=True)
class PolicyObservation:
    """A key frame's instant whose features a policy wants; neither G-buffer has settled motion.

    Attributes
    ----------
    key
        Index of the key frame.
    now
        Its geometry; with slots' G-buffers motion reaches over one slot.
    before
        Geometry of the instant before, a key interval or a slot earlier, which may lack vectors and
        ids; None at a shot's first.
    """

    key: int
    now: GBuffer
    before: GBuffer | None


@dataclass(frozen=True)
class FrameMetadata:
    """What the files of an interval's frames say beside their pixels.

    Attributes
    ----------
    template
        What generated frames take over from the key frame's file.
    recipes
        For each slot that is made, what its frame depends on, digested.
    key_digests
        Digest of the key frames' files on both sides, by input number; the next one only for
        look-ahead methods.
    """

    template: FrameTemplate
    recipes: dict[int, str] = field(default_factory=dict)
    key_digests: dict[int, str] = field(default_factory=dict)


@dataclass(frozen=True)
class IntervalInputs:
    """One key interval as read: all that it needs.

    Attributes
    ----------
    key
        Index of the key frame.
    metadata
        What the files of its frames say.
    frame, following
        The key frames on both sides; `following` only for look-ahead methods, and not across a
        cut. None where every slot of the interval is written: nothing has to be computed.
    slots
        G-buffers of the slots after the key frame, empty in the key setting.
    history
        The key frames before in the same shot, the newest first, as far as motion leads back to
        them: one where slots are warped from the key frame alone, all where they are extrapolated.
    lacks_history
        True if the rest of `history` and all frames' surfaces are read only if the interval is
        extrapolated; see `IntervalReader.add_history`.
    observed
        The key frame's instant, and before it those of older key frames that no interval before
        brought along; only for the policy.
    truth
        Ground truth.
    layers
        Those that are written beside the beauty; None where there are none.
    older
        The key frame before, where layers are led on from there.
    views
        The same interval of the other views that are written.
    times
        When the slots are, as in `Interval`.
    read_ms
        Milliseconds that reading took.
    followed
        Whether a key frame of the same shot comes after it.
    region
        Whether the key frame's data window is all of the picture that there is, and slots keep it.
    held
        True if every slot shows the picture of the key frame: the next key frame repeats it, or at
        the end of a shot the key frame itself repeats the one before.
    after_hold
        True if the key frame shows the same picture as the one before it.
    trial
        What the gate decides by; None without a gate.
    rendered
        Frames that take the place of generated ones.
    """

    key: int
    metadata: FrameMetadata
    frame: KeyFrame | None = None
    following: KeyFrame | None = None
    slots: tuple[GBuffer, ...] = ()
    history: tuple[HistoryFrame, ...] = ()
    lacks_history: bool = False
    observed: tuple[PolicyObservation, ...] = ()
    truth: IntervalTruth = field(default_factory=IntervalTruth)
    layers: LayerFrames | None = None
    older: KeyFrame | None = None
    views: tuple[IntervalInputs, ...] = ()
    times: tuple[float, ...] = QUARTERS
    read_ms: float = 0.0
    followed: bool = True
    region: bool = False
    held: bool = False
    after_hold: bool = False
    trial: TrialInputs | None = None
    rendered: IntervalRendered = field(default_factory=IntervalRendered)

    def without_geometry(self) -> IntervalInputs:
        """Return the interval with the colour of its key frames alone, once it is built.

        With raw vectors and positions, a key frame takes three times the memory of its colour.
        """

        def colour(frame: KeyFrame) -> KeyFrame:
            return replace(frame, gbuffer=None)

        return replace(
            self,
            frame=None if self.frame is None else colour(self.frame),
            following=None if self.following is None else colour(self.following),
            slots=(),
            history=tuple(HistoryFrame(colour(past.frame), (), past.held) for past in self.history),
            observed=(),
            trial=None,
            rendered=self.rendered.map_frames(colour),
        )


@dataclass(frozen=True)
class SkippedInterval:
    """A key interval that is skipped, as a frame that it needs cannot be used.

    Attributes
    ----------
    key
        Index of the key frame.
    reason
        What is wrong, in a sentence.
    passed
        What the key frame is passed through by; None where it cannot be read itself.
    """

    key: int
    reason: str
    passed: IntervalInputs | None = None


class IntervalReader:
    """Reads intervals of one view, in order; what several intervals share is read once.

    Parameters
    ----------
    source, method, settings
        Of the run.
    truth
        Ground truth and its frame for a slot; None without.
    depends_on
        What frames depend on beside their input.
    contents
        What frames hold: of this view first, then of others in the same files; () for the beauty.
    leader
        Of the view that decides, where cuts are found too; None for that view itself.
    rendered
        Frames that take the place of generated ones; None without.
    """

    def __init__(
        self,
        source: Source,
        method: Method,
        settings: UpsampleSettings,
        truth: tuple[Sequence, FrameOf] | None = None,
        depends_on: Dependencies = (None, None, None),
        contents: tuple[Content, ...] = (),
        leader: IntervalReader | None = None,
        rendered: RenderedFrames | None = None,
    ) -> None:
        self._source, self._method, self._output = source, method, settings.output
        self._contents = contents or (Content(source),)
        content = self._contents[0]
        keep_going = settings.source.keep_going
        self.truth = TruthReader(
            source, truth, settings.measured, keep_going and not method.needs_truth
        )
        network, policy, interpolator = depends_on
        self.recipe_book = Recipes(
            source, method, settings.compression, truth, network, interpolator, policy,
            content.names, key_rate=None if settings.keep_bytes else source.written_fps,
        )  # fmt: skip
        self._observes = method.judge is Judge.POLICY and content.leads
        # Of other views everything is read: their frames are built with those of the first.
        alone = content.leads and len(self._contents) == 1 and source.slots is None
        moves = source.finding is not None and not source.estimated
        self._reads_late = alone and moves and reads_late(source.keys, method)
        self.unreadable: UnreadableFrames = (
            UnreadableFrames(keep_going) if leader is None else leader.unreadable
        )
        self.store: KeyFrameStore = KeyFrameStore(
            source, method, self.unreadable, self.recipe_book.digest, self._reads_late,
            self._observes, None if leader is None else leader.store,
        )  # fmt: skip
        self.shots = self.store.shots
        self.trials: TrialReader | None = None
        if leader is not None:
            self.trials = leader.trials
        elif method.gated and settings.gate:
            self.trials = TrialReader(source, method, self.store, self._history, self._reads_late)
        if leader is not None:
            self.recipe_book.share(leader.recipe_book)
        if keep_going:
            self.recipe_book.reading = self.store.reading
        self._regions = Regions(source.keys.display, self.store.get_window)
        self._layers = LayerReader(content) if content.beside else None
        self.rendered: RenderedReader | None = None
        if rendered is not None:
            self.rendered = RenderedReader(
                rendered, self._contents, source.written_fps, keep_going,
                leads_on(source, method, self._contents),
            )  # fmt: skip
        if self._layers is not None:
            self.store.read_with(self._layers.require)
        self.observed_keys: frozenset[int] = frozenset()
        """The key frames whose instants intervals brought along."""

    def read(self, key: int, needed: Needed = lambda key, recipes: True) -> IntervalInputs:
        """Read an interval, by the index of its key frame.

        `needed` is called before more is decoded than cuts are found by.

        Raises
        ------
        InputError
            When a file cannot be used.
        """
        timing_ms: dict[str, float] = {}
        with record_time(timing_ms, "read"):
            inputs = self._read(key, needed)
        return replace(inputs, read_ms=timing_ms["read"])

    def _read(self, key: int, needed: Needed) -> IntervalInputs:
        source, store, shots = self._source, self.store, self.shots
        lookahead = self._looks_ahead(key)
        rendered = self._read_rendered(key)
        recipes = self.recipes(key)
        template = template_of(self._contents, self._output, source.timeline.numbers[key])
        if not needed(key, recipes):
            self.release(key)
            followed = store.is_followed(key)  # known by the recipes
            metadata = FrameMetadata(template, recipes)
            return IntervalInputs(key, metadata, followed=followed, rendered=rendered)
        frame = store.get_in_shot(key)
        following = store.get_in_shot(key + 1, before=True) if lookahead else None
        region = self._regions.is_region(
            key, frame.image, None if following is None else following.image
        )
        slots = tuple(map(store.get_slot, store.slots_after(key)))
        history = tuple(
            HistoryFrame(store.get_in_shot(i), store.get_way_back(i), shots.repeats(i + 1))
            for i in self._history(key)[: WARPED_BACK if self._reads_late else None]
        )
        observed = self._observe(key)
        back = self._older(key, lookahead)
        older = None if back is None else store.get_in_shot(back)
        layers = None if self._layers is None else self._layers.read(key, lookahead, back)
        truth = self.truth.read(key)
        digests = self.recipe_book.key_digests((key, key + 1) if lookahead else (key,))
        inputs = IntervalInputs(
            key,
            FrameMetadata(template, recipes, digests),
            frame,
            following,
            slots,
            history,
            self._reads_late,
            observed,
            truth,
            layers,
            older,
            times=tuple(float(source.timeline.time(s)) for s in source.timeline.between(key)),
            followed=store.is_followed(key),
            region=region,
            held=self._held(key),
            after_hold=shots.repeats(key),
            rendered=rendered,
        )
        if self.trials is not None and self._contents[0].leads:
            inputs = replace(inputs, trial=self.trials.read(key, inputs))
        self.release(key)
        return inputs

    def add_history(self, inputs: IntervalInputs) -> IntervalInputs:
        """Return an interval with its older key frames, and the surface of its key frame.

        Another thread may read the next interval meanwhile.

        Raises
        ------
        InputError
            When a file cannot be read.
        """
        assert inputs.frame is not None
        frame = self.store.get_complete(inputs.key, inputs.frame)
        history = tuple(
            HistoryFrame(self.store.get_complete(i), (), self.shots.repeats(i + 1))
            for i in self._history(inputs.key)
        )
        return replace(inputs, frame=frame, history=history, lacks_history=False)

    def read_key(self, key: int) -> IntervalInputs:
        """Read what a key frame is passed through by, and no more of its interval."""
        timing_ms: dict[str, float] = {}
        with record_time(timing_ms, "read"):
            frame = replace(self.store.get(key), gbuffer=None)
            number = self._source.timeline.numbers[key]
            metadata = FrameMetadata(template_of(self._contents, self._output, number))
        return IntervalInputs(key, metadata, frame, read_ms=timing_ms["read"])

    def read_observed(self, key: int) -> tuple[tuple[PolicyObservation, ...], tuple[GBuffer, ...]]:
        """Read what features of an interval come from: its instants, and its slots' G-buffers."""
        observed = self._observe(key)
        slots = tuple(map(self.store.get_slot, self.store.slots_after(key)))
        self.release(key)
        return observed, slots

    def release(self, key: int) -> None:
        """Drop what no interval after this one needs, or not yet, as it was read to find cuts."""
        if self._reads_late and key in self.observed_keys:
            self.store.keep_shape(key)
        # Who looks ahead reads one again at a cut.
        is_last = key + 2 >= len(self._source.timeline.numbers)
        back = self._back(self._method.lookahead and not is_last)
        oldest = key + 1 - (WARPED_BACK if self._reads_late else back)
        if self._layers is not None:
            self._layers.release_before(key)
            oldest = min(oldest, key) if self._contents[0].looks_back else oldest
        self.store.release_before(oldest, key)
        self._regions.forget(key)

    def recipes(self, key: int) -> dict[int, str]:
        """Digest what the frame of each slot depends on, but for those that were rendered."""
        lookahead = self._looks_ahead(key)
        keys = [key, *((key + 1,) if lookahead else ())]
        if self._source.estimated:  # key frames on both sides tell the motion of theirs
            if key and not self.shots.starts_at(key):
                keys.append(key - 1)
            if lookahead and self.store.is_followed(key + 1):
                keys.append(key + 2)
            cuts = [*self.shots.cut_facts(key, 0, ()), f"flow {[index - key for index in keys]}"]
            return self._digest(key, keys, [], cuts)
        history = self._history(key)
        keys += history
        older = self._older(key, lookahead)
        if older is not None and older not in keys:
            keys.append(older)
        around = ((Slot(index, 0), self._instant_before(index)) for index in self._starts(key))
        instants = [slot for pair in around for slot in pair if slot is not None]
        # Recipes hold the files of a warp's history.
        back = (
            OLDER_KEYS
            if self._observes
            else self._back(lookahead)
            if self._method.extrapolates
            else 0
        )
        back = max(back, int(older is not None))
        cuts = self.shots.cut_facts(key, back, (*keys, *self._starts(key)))
        if self._source.slots is not None:
            slots_after = self.store.slots_after
            way = (slot for i in history for slot in slots_after(i))
            instants = [*slots_after(key), *way, *instants]
        return self._digest(key, keys, instants, cuts)

    def _digest(
        self, key: int, keys: list[int], instants: list[Slot], cuts: list[str]
    ) -> dict[int, str]:
        """Digest what slots are made of, and what their gate goes by."""
        around = [*cuts, *self._windows_and_holds(key)]
        if self.trials is not None:
            tried = self.trials.frames(key)
            keys = [*keys, *(index for index in tried.keys if index not in keys)]
            instants = [*instants, *tried.instants]
            around.append(tried.text)
        rendered = self._read_rendered(key).frames
        around += [f"rendered {i} {one.recipe}" for i, one in rendered.items() if one.leads]
        recipes = self.recipe_book.of(key, keys, instants, around)
        return {slot: recipe for slot, recipe in recipes.items() if slot not in rendered}

    def _read_rendered(self, key: int) -> IntervalRendered:
        return IntervalRendered() if self.rendered is None else self.rendered.read(key)

    def _windows_and_holds(self, key: int) -> list[str]:
        """Say what slots depend on of key frames around; nothing where there is no such thing."""
        later = {key, *(index + 1 for index in self._history(key))}
        return [
            *(["steady window"] if self._regions.is_steady(key) else []),
            *(["held"] if self._held(key) else []),
            *(f"repeats {i - key}" for i in sorted(later) if self.shots.repeats(i)),
        ]

    def _looks_ahead(self, key: int) -> bool:
        return self._method.lookahead and self.store.is_followed(key)

    def _held(self, key: int) -> bool:
        """Return True if the slots after a key frame show its picture.

        What comes after a hold at the end of a shot, only the slots' G-buffers tell: the vectors
        of a frame that was copied are those of its first.
        """
        if self.store.is_followed(key):
            return self.shots.repeats(key + 1)
        return not self.store.slots_after(key) and self.shots.repeats(key)

    def _older(self, key: int, lookahead: bool) -> int | None:
        """Return the key frame that points are led on from where no next one tells."""
        if self._layers is None or not self._contents[0].looks_back or lookahead or key == 0:
            return None
        return None if self.shots.starts_at(key) else key - 1

    def _history(self, key: int) -> tuple[int, ...]:
        """Return the indices of the key frames that lead back from one, the newest first."""
        back = self._back(self._looks_ahead(key))
        older = tuple(range(key - 1, self.shots.begin(key, back) - 1, -1))
        if self._source.slots is None:
            return older

        def leads_back(index: int) -> bool:
            slots = self.store.slots_after(index)
            return bool(slots) and self.unreadable.all_readable(slots)

        return tuple(takewhile(leads_back, older))

    def _back(self, looks_ahead: bool) -> int:
        """Return how many older key frames slots may depend on, along rendered motion."""
        return 0 if self._source.finding is None else self._method.older_keys(looks_ahead)

    def _starts(self, key: int) -> range:
        """Return the indices of the key frames whose features a state at this one holds."""
        return range(self.shots.begin(key, OLDER_KEYS), key + 1) if self._observes else range(0)

    def _observe(self, key: int) -> tuple[PolicyObservation, ...]:
        """Return the instants of key frames that no earlier interval brought along."""
        observed = []
        for index in self._starts(key):
            if index not in self.observed_keys:
                slot = self._instant_before(index)
                before = None if slot is None else self.store.get_shape(slot)
                now = self.shots.within(index, self.store.get_shape(Slot(index, 0)))
                observed.append(PolicyObservation(index, now, before))
                self.observed_keys |= {index}
        self.observed_keys = frozenset(i for i in self.observed_keys if i > key - OLDER_KEYS)
        return tuple(observed)

    def _instant_before(self, key: int) -> Slot | None:
        """Return the instant that a key frame's is compared with; None where a shot begins."""
        if key == 0 or self.shots.starts_at(key):
            return None
        before = Slot(key - 1, 0 if self._source.slots is None else FACTOR - 1)
        return before if self.unreadable.all_readable((before,)) else None


class ViewsReader:
    """Reads an interval of every view: the other views' are in `IntervalInputs.views`.

    The other views' readers were made with that leader.
    """

    def __init__(self, leader: IntervalReader, others: tuple[IntervalReader, ...] = ()) -> None:
        self._leader, self._others = leader, others

    @property
    def leading_recipes(self) -> Recipes:
        """What digests the frames of the view that decides."""
        return self._leader.recipe_book

    @property
    def cuts(self) -> tuple[Cut, ...] | None:
        """The cuts that were met so far; None where none are looked for or given."""
        return self._leader.shots.cuts

    @property
    def truth(self) -> TruthReader:
        """What reads ground truth."""
        return self._leader.truth

    @property
    def rendered(self) -> RenderedReader | None:
        """What reads rendered frames; None without."""
        return self._leader.rendered

    def read(self, key: int, needed: Needed) -> IntervalInputs | SkippedInterval:
        """Read an interval; see `IntervalReader.read`. A frame depends on all its views.

        Where frames may be unreadable it is read again when it meets one, without what lies behind.
        """
        unreadable, observed = self._leader.unreadable, self._leader.observed_keys
        trials = self._leader.trials
        tried = None if trials is None else trials.last_read
        if not unreadable.tolerant:
            return self._read_all(key, needed)
        while True:
            count = len(unreadable)
            try:
                return self._read_all(key, needed)
            except InputError as error:
                self._leader.observed_keys = observed  # no interval brought along what this did
                if trials is not None:
                    trials.last_read = tried
                if len(unreadable) == count:
                    return self._skipped(key, str(error))

    def add_history(self, inputs: IntervalInputs) -> IntervalInputs:
        """Return an interval with what extrapolation needs; see `IntervalReader.add_history`."""
        return self._leader.add_history(inputs)

    def _skipped(self, key: int, reason: str) -> SkippedInterval:
        """Skip an interval, but for its key frame if that can be read."""
        passed = None
        with suppress(InputError):
            passed = self._leader.read_key(key)
        for reader in (self._leader, *self._others):
            reader.release(key)
        return SkippedInterval(key, reason, passed)

    def _read_all(self, key: int, needed: Needed) -> IntervalInputs:
        if not self._others:
            return self._leader.read(key, needed)
        each = [reader.recipes(key) for reader in (self._leader, *self._others)]
        recipes = {slot: _joined([recipes[slot] for recipes in each]) for slot in each[0]}
        inputs = self._leader.read(key, lambda index, _: needed(index, recipes))
        is_needed = inputs.frame is not None
        views = tuple(reader.read(key, lambda *_: is_needed) for reader in self._others)
        read_ms = inputs.read_ms + sum(view.read_ms for view in views)
        metadata = replace(inputs.metadata, recipes=recipes)
        return replace(inputs, metadata=metadata, views=views, read_ms=read_ms)


def _joined(recipes: list[str]) -> str:
    return hashlib.sha256(" ".join(recipes).encode()).hexdigest()
