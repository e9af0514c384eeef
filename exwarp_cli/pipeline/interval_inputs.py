"""What key intervals are made of: read from disk ahead of the computation, nothing computed yet."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial

from exwarp_cli.domain.frame import GBuffer, KeyFrame
from exwarp_cli.domain.results import InterpolatorSummary, NetworkSummary
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.timeline import FACTOR, Slot
from exwarp_cli.errors import InputError
from exwarp_cli.io.generated_frames import FrameTemplate
from exwarp_cli.io.sequences import Sequence
from exwarp_cli.pipeline import extra_layers
from exwarp_cli.pipeline.fingerprint import Fingerprinter
from exwarp_cli.pipeline.gate import TrialInputs, TrialReader
from exwarp_cli.pipeline.ground_truth import IntervalTruth, TruthReader
from exwarp_cli.pipeline.key_frames import HistoryFrame, KeyFrameStore, is_opaque, reads_late
from exwarp_cli.pipeline.output_plan import frame_suffix
from exwarp_cli.pipeline.rendered_frames import IntervalRendered, RenderedFrames, RenderedReader
from exwarp_cli.pipeline.scheduling import record_time
from exwarp_cli.pipeline.shots import UnreadableFrames
from exwarp_cli.pipeline.source import FrameOf, Source
from exwarp_cli.policy.state import OLDER_KEYS
from exwarp_cli.synthesis.interval import QUARTERS
from exwarp_cli.synthesis.methods import DecisionSource, Method

# Called with an interval's index and fingerprints; False leaves the rest unread.
Needed = Callable[[int, dict[int, str]], bool]

# How many older key frames a warp from one key frame goes by.
WARPED_BACK = 1

# The network that extrapolates, the one that interpolates, the policy's checksum.
Dependencies = tuple[NetworkSummary | None, InterpolatorSummary | None, str | None]


@dataclass(frozen=True)
class PolicyObservation:
    """A key frame's instant whose features a policy wants; neither G-buffer has settled motion."""

    key: int  # index of the key frame
    now: GBuffer  # its geometry; with slots' G-buffers motion reaches over one slot
    # Geometry of the instant before, a key interval or a slot earlier, which may lack vectors and
    # ids; None at a shot's first.
    before: GBuffer | None


@dataclass(frozen=True)
class IntervalInputs:
    """One key interval as read: all that it needs."""

    key: int  # index of the key frame
    template: FrameTemplate  # what generated frames take over from the key frame's file
    # The key frames on both sides; `following` only for look-ahead methods, and not across a cut.
    # None where every slot of the interval is written: nothing has to be computed.
    frame: KeyFrame | None = None
    following: KeyFrame | None = None
    slots: tuple[GBuffer, ...] = ()  # G-buffers of the slots after; empty in the key setting
    # The key frames before in the same shot, the newest first, as far as motion leads back to them:
    # one where slots are warped from the key frame alone, all where they are extrapolated.
    history: tuple[HistoryFrame, ...] = ()
    # True if the rest of `history` and all frames' surfaces are read only if the interval is
    # extrapolated; see `IntervalReader.add_history`.
    lacks_history: bool = False
    # The key frame's instant, and before it those of older key frames that no interval before
    # brought along; only for the policy.
    observed: tuple[PolicyObservation, ...] = ()
    truth: IntervalTruth = field(default_factory=IntervalTruth)
    layers: extra_layers.LayerFrames | None = None  # those that are written beside the beauty
    older: KeyFrame | None = None  # the key frame before, where layers are led on from there
    views: tuple[IntervalInputs, ...] = ()  # the same interval of the other views
    times: tuple[float, ...] = QUARTERS  # when the slots are, as in `Interval`
    read_ms: float = 0.0
    followed: bool = True  # whether a key frame of the same shot comes after it
    # True if the key frame's data window is all of the picture that there is, and slots keep it.
    region: bool = False
    # True if every slot shows the picture of the key frame: the next key frame repeats it, or at
    # the end of a shot the key frame itself repeats the one before.
    held: bool = False
    after_hold: bool = False  # True if the key frame shows the same picture as the one before it
    trial: TrialInputs | None = None  # what the gate decides by
    recipes: dict[int, str] = field(default_factory=dict)  # fingerprint of each slot that is made
    # Digest of the key frames' files on both sides, by input number; the next one only for
    # look-ahead methods.
    key_digests: dict[int, str] = field(default_factory=dict)
    rendered: IntervalRendered = field(default_factory=IntervalRendered)

    def without_geometry(self) -> IntervalInputs:
        """Return the interval with the colour of its key frames alone, once it is built."""
        # With raw vectors and positions, a key frame takes three times the memory of its colour.
        return replace(self.map_geometry(lambda _: None), observed=(), trial=None)

    def map_geometry(self, change: Callable[[GBuffer], GBuffer | None]) -> IntervalInputs:
        """Return the interval with other G-buffers; None leaves one out."""

        def changed(frame: KeyFrame) -> KeyFrame:
            return frame if frame.gbuffer is None else replace(frame, gbuffer=change(frame.gbuffer))

        history = []
        for past in self.history:
            instants = tuple(g for g in map(change, past.instants) if g is not None)
            history.append(HistoryFrame(changed(past.frame), instants, past.held))
        rendered = {
            slot: replace(each, frame=changed(each.frame))
            for slot, each in self.rendered.frames.items()
        }
        return replace(
            self,
            frame=None if self.frame is None else changed(self.frame),
            following=None if self.following is None else changed(self.following),
            slots=tuple(g for g in map(change, self.slots) if g is not None),
            history=tuple(history),
            rendered=replace(self.rendered, frames=rendered),
        )


@dataclass(frozen=True)
class SkippedInterval:
    """A key interval that is skipped, as a frame that it needs cannot be used."""

    key: int  # index of the key frame
    reason: str  # what is wrong, in a sentence
    # What the key frame is passed through by; None where it cannot be read itself.
    passed: IntervalInputs | None = None


class IntervalReader:
    """Reads intervals of one view, in order; what several intervals share is read once.

    Key frames and intervals are named by their index.
    """

    def __init__(
        self,
        source: Source,
        method: Method,
        settings: UpsampleSettings,
        truth: tuple[Sequence, FrameOf] | None = None,
        depends_on: Dependencies = (None, None, None),
        # What frames hold: of this view first, then of others in the same files; () for the beauty.
        contents: tuple[extra_layers.Content, ...] = (),
        leader: IntervalReader | None = None,  # of the view that decides, where cuts are found
        rendered: RenderedFrames | None = None,
    ) -> None:
        self._source, self._method = source, method
        self._suffix = frame_suffix(settings.output, source.keys.sequence)
        self._contents = contents or (extra_layers.Content(source),)
        content = self._contents[0]
        keep_going = settings.source.keep_going
        tolerant = keep_going and not method.needs_truth
        self.truth = TruthReader(source, truth, settings.measured, tolerant)
        self.fingerprinter = Fingerprinter(
            source,
            method,
            settings.compression,
            truth,
            *depends_on,
            content.names,
            key_rate=None if settings.keep_bytes else source.written_fps,
        )
        self._observes = method.judge is DecisionSource.POLICY and content.leads
        # Of other views everything is read: their frames are built with those of the first.
        is_alone = content.leads and len(self._contents) == 1 and source.slots is None
        has_vectors = source.finding is not None and not source.estimated
        self._reads_late = is_alone and has_vectors and reads_late(source.keys, method)
        unreadable = UnreadableFrames(keep_going) if leader is None else leader.unreadable
        self.unreadable: UnreadableFrames = unreadable
        self.store: KeyFrameStore = KeyFrameStore(
            source,
            method,
            self.unreadable,
            self.fingerprinter.digest,
            self._reads_late,
            self._observes,
            None if leader is None else leader.store,
        )
        self.shots = self.store.shots
        if leader is not None:
            self.fingerprinter.digests = leader.fingerprinter.digests
        trials = self._make_trials(settings.gate) if leader is None else leader.trials
        self.trials: tuple[TrialReader, ...] = trials
        if keep_going:
            self.fingerprinter.reading = self.store.reading
        self._layers = extra_layers.LayerReader(content) if content.extra else None
        if self._layers is not None:
            self.store.companions.append(self._layers.read_key)
        self.rendered: RenderedReader | None = None
        if rendered is not None:
            self.rendered = RenderedReader(rendered, self._contents, method)
        # The key frames whose instants intervals brought along.
        self.observed_keys: frozenset[int] = frozenset()

    def _make_trials(self, gate: bool) -> tuple[TrialReader, ...]:
        """Make the readers of trials; () if no gate decides.

        The first is for intervals with a next key frame, or for all. The second is for those
        without, if another method makes them.
        """
        method = self._method
        if not (method.gated and gate):
            return ()
        first = TrialReader(self.store, method.lookahead, self._history, self._reads_late)
        if method.tail is None:
            return (first,)
        history = partial(self._history, ahead=False)
        return first, TrialReader(self.store, method.tail.lookahead, history, reads_late=True)

    def read(self, key: int, needed: Needed = lambda key, recipes: True) -> IntervalInputs:
        """Read an interval; raises InputError when a file cannot be used.

        `needed` is called before more is decoded than cuts are found by.
        """
        timing_ms: dict[str, float] = {}
        with record_time(timing_ms, "read"):
            recipes = self.fingerprints(key)
            inputs = IntervalInputs(
                key,
                extra_layers.template_of(self._contents, self._suffix, key),
                recipes=recipes,
                followed=self.store.is_followed(key),
                rendered=IntervalRendered() if self.rendered is None else self.rendered.read(key),
            )
            if needed(key, recipes):
                inputs = self._read_frames(inputs)
            self.release(key)
        return replace(inputs, read_ms=timing_ms["read"])

    def _read_frames(self, inputs: IntervalInputs) -> IntervalInputs:
        """Read all that an interval's slots are made from."""
        key, source, store = inputs.key, self._source, self.store
        lookahead = self._looks_ahead(key)
        frame = store.get_in_shot(key)
        following = store.get_in_shot(key + 1, before=True) if lookahead else None
        images = [each.image for each in (frame, following) if each is not None]
        slots = tuple(map(store.get_slot, store.slots_after(key)))
        lacks_history = self._reads_late or (self._method.tail is not None and not lookahead)
        history = store.get_history(self._history(key)[: WARPED_BACK if lacks_history else None])
        older_key = self._older_key(key, lookahead)
        inputs = replace(
            inputs,
            frame=frame,
            following=following,
            slots=slots,
            history=history,
            lacks_history=lacks_history,
            observed=self.observe(key),
            older=None if older_key is None else store.get_in_shot(older_key),
            layers=None if self._layers is None else self._layers.read(key, lookahead, older_key),
            truth=self.truth.read(key),
            times=tuple(float(source.timeline.time(s)) for s in source.timeline.between(key)),
            region=store.is_steady(key) and all(map(is_opaque, images)),
            held=self._is_held(key),
            after_hold=self.shots.repeats(key),
            key_digests=self.fingerprinter.key_digests((key, key + 1) if lookahead else (key,)),
        )
        if self.trials and self._contents[0].leads:
            trials = self.trials[0 if lookahead else -1]
            inputs = replace(inputs, trial=trials.read(key, inputs))
        return inputs

    def add_history(self, inputs: IntervalInputs) -> IntervalInputs:
        """Return an interval with its older key frames, and the surface of its key frame.

        Another thread may read the next interval meanwhile. Raises InputError when a file cannot be
        read.
        """
        assert inputs.frame is not None
        # Look-ahead methods read no normals either.
        known = inputs.frame if self._method.tail is None else None
        frame = self.store.get_complete(inputs.key, known)
        history = self.store.get_history(self._history(inputs.key), complete=True)
        return replace(inputs, frame=frame, history=history, lacks_history=False)

    def skip(self, key: int, reason: str) -> SkippedInterval:
        """Skip an interval, but for its key frame if that can be read."""
        passed, timing_ms = None, dict[str, float]()
        with suppress(InputError):
            with record_time(timing_ms, "read"):
                frame = replace(self.store.get(key), gbuffer=None)
                template = extra_layers.template_of(self._contents, self._suffix, key)
            passed = IntervalInputs(key, template, frame, read_ms=timing_ms["read"])
        self.release(key)
        return SkippedInterval(key, reason, passed)

    def release(self, key: int) -> None:
        """Drop what no interval after this one needs, or not yet, as it was read to find cuts."""
        # A look-ahead method reads one again at a cut.
        is_last = key + 2 >= len(self._source.timeline.numbers)
        back = self._keys_back(self._method.lookahead and not is_last)
        is_late = self._reads_late or self._method.tail is not None
        oldest = key + 1 - (min(back, WARPED_BACK) if is_late else back)
        if self._layers is not None:
            self._layers.release_before(key)
            oldest = min(oldest, key) if self._contents[0].looks_back else oldest
        self.store.release_before(oldest, key)

    def fingerprints(self, key: int) -> dict[int, str]:
        """Digest what the frame of each slot depends on, but for those that were rendered."""
        lookahead, history = self._looks_ahead(key), self._history(key)
        extrapolates = (self._method if lookahead else self._method.last).extrapolates
        keys = [key, *((key + 1,) if lookahead else ())]
        instants: list[Slot] = []
        if self._source.estimated:  # key frames on both sides tell the motion of theirs
            if key and not self.shots.starts_at(key):
                keys.append(key - 1)
            if lookahead and self.store.is_followed(key + 1):
                keys.append(key + 2)
            facts = [*self.shots.cut_facts(key, 0, ()), f"flow {[index - key for index in keys]}"]
        else:
            keys += history
            older = self._older_key(key, lookahead)
            if older is not None and older not in keys:
                keys.append(older)
            instants += [slot for i in (key, *history) for slot in self.store.slots_after(i)]
            observed_keys = self._observed_keys(key)
            pairs = ((Slot(index, 0), self._instant_before(index)) for index in observed_keys)
            instants += [slot for pair in pairs for slot in pair if slot is not None]
            # Fingerprints hold the files of a warp's history.
            back = self._keys_back(lookahead) if extrapolates else 0
            back = max(OLDER_KEYS if self._observes else back, int(older is not None))
            facts = self.shots.cut_facts(key, back, (*keys, *observed_keys))
        if self.store.is_steady(key):
            facts.append("steady window")
        if self._is_held(key):
            facts.append("held")
        later = {key, *(index + 1 for index in history)}
        facts += [f"repeats {i - key}" for i in sorted(later) if self.shots.repeats(i)]
        if self.trials:
            trial_keys, trial_instants, text = self.trials[0 if lookahead else -1].frames(key)
            keys += [index for index in trial_keys if index not in keys]
            instants += trial_instants
            facts.append(text)
        rendered = {} if self.rendered is None else self.rendered.read(key).frames
        facts += [f"rendered {i} {each.recipe}" for i, each in rendered.items() if each.leads]
        recipes = self.fingerprinter.fingerprints(key, keys, instants, facts, extrapolates)
        return {slot: recipe for slot, recipe in recipes.items() if slot not in rendered}

    def _looks_ahead(self, key: int) -> bool:
        return self._method.lookahead and self.store.is_followed(key)

    def _is_held(self, key: int) -> bool:
        """Return True if the slots after a key frame show its picture."""
        if self.store.is_followed(key):
            return self.shots.repeats(key + 1)
        # What comes after a hold at the end of a shot, only the slots' G-buffers tell: the vectors
        # of a frame that was copied are those of its first.
        return not self.store.slots_after(key) and self.shots.repeats(key)

    def _older_key(self, key: int, lookahead: bool) -> int | None:
        """Return the key frame that points are led on from where no next one tells."""
        if lookahead or key == 0 or not self._contents[0].looks_back:
            return None
        return None if self.shots.starts_at(key) else key - 1

    def _history(self, key: int, ahead: bool | None = None) -> tuple[int, ...]:
        """Return the indices of the key frames that lead back from one, the newest first.

        `ahead` says whether its interval has a next key frame that is used; None: as it is.
        """
        back = self._keys_back(self._looks_ahead(key) if ahead is None else ahead)
        older = tuple(range(key - 1, self.shots.begin(key, back) - 1, -1))
        if self._source.slots is None:
            return older
        for count, index in enumerate(older):
            slots = self.store.slots_after(index)
            if not slots or self.unreadable.has(*slots):
                return older[:count]
        return older

    def _keys_back(self, looks_ahead: bool) -> int:
        """Return how many older key frames slots may depend on, along rendered motion."""
        return 0 if self._source.finding is None else self._method.older_keys(looks_ahead)

    def _observed_keys(self, key: int) -> range:
        """Return the indices of the key frames whose features a state at this one holds."""
        return range(self.shots.begin(key, OLDER_KEYS), key + 1) if self._observes else range(0)

    def observe(self, key: int) -> tuple[PolicyObservation, ...]:
        """Return the instants of key frames that no earlier interval brought along."""
        observed = []
        for index in self._observed_keys(key):
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
        return None if self.unreadable.has(before) else before


@dataclass(frozen=True)
class ViewsReader:
    """Reads an interval of every view: the other views' are in `IntervalInputs.views`."""

    leader: IntervalReader  # of the view that decides
    followers: tuple[IntervalReader, ...] = ()  # of the others, made with that leader

    def read(self, key: int, needed: Needed) -> IntervalInputs | SkippedInterval:
        """Read an interval; see `IntervalReader.read`. A frame depends on all its views.

        Where frames may be unreadable it is read again when it meets one, without what lies behind.
        """
        leader = self.leader
        observed_keys = leader.observed_keys
        last_trials = [trials.last_read for trials in leader.trials]
        while True:
            count = len(leader.unreadable)
            try:
                return self._read_all(key, needed)
            except InputError as error:
                if not leader.unreadable.tolerant:
                    raise
                # No interval brought along what this one did.
                leader.observed_keys = observed_keys
                for trials, last in zip(leader.trials, last_trials, strict=True):
                    trials.last_read = last
                if len(leader.unreadable) == count:
                    for reader in self.followers:
                        reader.release(key)
                    return leader.skip(key, str(error))

    def _read_all(self, key: int, needed: Needed) -> IntervalInputs:
        if not self.followers:
            return self.leader.read(key, needed)
        by_view = [reader.fingerprints(key) for reader in (self.leader, *self.followers)]
        recipes = {
            slot: hashlib.sha256(" ".join(view[slot] for view in by_view).encode()).hexdigest()
            for slot in by_view[0]
        }
        inputs = self.leader.read(key, lambda index, _: needed(index, recipes))
        is_needed = inputs.frame is not None
        views = tuple(reader.read(key, lambda *_: is_needed) for reader in self.followers)
        read_ms = inputs.read_ms + sum(view.read_ms for view in views)
        return replace(inputs, recipes=recipes, views=views, read_ms=read_ms)
