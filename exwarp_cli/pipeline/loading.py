"""What one key interval needs from disk, read ahead of the computation."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from itertools import takewhile

from exwarp_cli.domain.extrapolator import HISTORY
from exwarp_cli.domain.frame import SURFACE_PARTS, GBuffer, KeyFrame, Window
from exwarp_cli.domain.results import InterpolatorSummary, NetworkSummary
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.timeline import FACTOR, Slot
from exwarp_cli.errors import InputError
from exwarp_cli.io.channels import Role
from exwarp_cli.io.footage import ClipSequence, is_plain, key_picture
from exwarp_cli.io.frames import GEOMETRY, SURFACE, colour_window, read_raw
from exwarp_cli.io.sequence import Sequence
from exwarp_cli.pipeline.contents import Content, template_of
from exwarp_cli.pipeline.early_frames import normals_tell, reads_late, run_roles, wants_normals
from exwarp_cli.pipeline.estimating import Estimates
from exwarp_cli.pipeline.handed_over import HandedOver, looks_ahead_alone
from exwarp_cli.pipeline.instants import between, over_interval, stretched, without_surface
from exwarp_cli.pipeline.late_frames import LateFrames
from exwarp_cli.pipeline.layer_frames import LayerReader
from exwarp_cli.pipeline.loaded import Loaded, Observed, Older
from exwarp_cli.pipeline.losses import Losses
from exwarp_cli.pipeline.recipes import Recipes
from exwarp_cli.pipeline.regions import Regions
from exwarp_cli.pipeline.shots import Shots
from exwarp_cli.pipeline.source import FrameOf, Source
from exwarp_cli.pipeline.truth_frames import TruthFrames
from exwarp_cli.policy.state import KEYS_BACK
from exwarp_cli.synthesis.methods import Judge, Method


class IntervalLoader:
    """Reads intervals in order; what several intervals share is read once."""

    def __init__(
        self,
        source: Source,
        method: Method,
        settings: UpsampleSettings,
        truth: tuple[Sequence, FrameOf] | None,
        network: NetworkSummary | None = None,
        policy: str | None = None,
        interpolator: InterpolatorSummary | None = None,
        contents: tuple[Content, ...] = (),
    ) -> None:
        self._source = source
        self._method = method
        self._settings = settings
        bears = settings.source.keep_going and not method.needs_truth
        self.truth = TruthFrames(source, truth, settings.measured, bears)
        self.losses = Losses(settings.source.keep_going)
        """Frames that are lost; all views tell the same."""
        # What frames hold: of this view first, then of others in the same files.
        self._contents = contents or (Content(source),)
        own = self._contents[0]
        self._layers = LayerReader(own) if own.beside else None
        self.recipe_book = Recipes(
            source, method, settings.compression, truth, network, interpolator, policy, own.names
        )
        """What digests the frames of intervals."""
        self.recipe_book.key_rate = None if settings.keep_bytes else source.written_fps
        self.recipe_book.reading = self._reading if self.losses.bearable else None
        self._frames: dict[int, KeyFrame] = {}
        self._instants: dict[Slot, GBuffer] = {}
        self._shapes: dict[Slot, GBuffer] = {}
        self.told: frozenset[int] = frozenset()
        """The key frames whose instants intervals brought along."""
        self._followers: list[IntervalLoader] = []
        numbers, lossy = source.timeline.numbers, isinstance(source.keys.sequence, ClipSequence)
        self.shots = Shots(source.cuts, numbers, self._key_frame, self.losses, lossy)
        self._regions = Regions(source.keys.display, self._window_of)
        # Of other views everything is read: their frames are staged with those of the first.
        alone = own.leads and len(self._contents) == 1 and source.slots is None
        known = source.finding is not None and not source.estimated
        late = alone and known and reads_late(source.keys, method)
        self._late = LateFrames(source, self.shots.within, self.shots.repeats) if late else None
        count = len(source.timeline.numbers)
        self._estimates = None
        if source.estimated:
            self._estimates = Estimates(self._colour, count, lambda key: self.losses.has(key))
        # Whether by key frames' normals cuts are found, alike for every method, or frames made.
        self._normals_tell = normals_tell(source.keys, source.cuts.detect)
        self._wants_normals = wants_normals(source.keys, method.extrapolates)
        self._ahead = None
        if alone and known and looks_ahead_alone(method) and self._layers is None:
            left_out = () if self._wants_normals else ("normal",)
            self._ahead = HandedOver(source, self._key_roles, left_out, self.shots.within)

    def load(self, key: int, needed: Callable[[int, dict[int, str]], bool]) -> Loaded:
        """Read an interval.

        Parameters
        ----------
        key
            Index of the key frame.
        needed
            Called with the index and the recipes before more is decoded than cuts are found by;
            False leaves the rest unread.
        """
        begin = time.perf_counter()
        source = self._source
        number = source.timeline.numbers[key]
        lookahead = self._looks_ahead(key)
        recipes = self.recipes(key)
        template = template_of(self._contents, self._settings.output, number)
        if not needed(key, recipes):
            self.forget(key)
            elapsed = 1e3 * (time.perf_counter() - begin)
            return Loaded(key, None, None, (), (), (), {}, template, recipes, elapsed)
        again = None if self._ahead is None else self._ahead.again(key)
        frame = self._in_shot(key)
        following = self._in_shot(key + 1, before=True) if lookahead else None
        ahead = None if following is None else following.image
        region = self._regions.is_region(key, frame.image, ahead)
        gbuffers = tuple(self._slot_gbuffer(slot) for slot in self._slots(key))
        history = self._history(key)
        past: tuple[Older, ...] = ()
        if self._late is None:
            past = tuple(
                Older(self._in_shot(i), self._way_back(i), self.shots.repeats(i + 1))
                for i in history
            )
        observed = self._observed(key)
        back = self._older(key, lookahead)
        older = None if back is None else self._in_shot(back)
        layers = None if self._layers is None else self._layers.read(key, lookahead, back)
        truth, ends, unscored = self.truth.around(key)
        self.forget(key)
        if self._ahead is not None and following is not None:
            self._frames[key + 1] = self._ahead.lean(key + 1, following)
        elapsed = 1e3 * (time.perf_counter() - begin)
        times = tuple(float(source.timeline.time(slot)) for slot in source.timeline.between(key))
        return Loaded(
            key, frame, following, gbuffers, past, observed, truth, template, recipes, elapsed,
            ends, times, self._followed(key), layers, older,
            late=None if self._late is None else partial(self._late.complete, history=history),
            again=again, unscored=unscored, region=region, key_digests=self.recipe_book.key_digests(
                (key, key + 1) if lookahead else (key,)
            ),
            held=self._held(key), after_hold=self.shots.repeats(key),
        )  # fmt: skip

    def follow(self, leader: IntervalLoader) -> None:
        """Take the cuts of another view, as all are cut alike, and what is known of the files."""
        self.shots.follow(leader.shots)
        self.losses = leader.losses
        leader._followers.append(self)
        self.recipe_book.share(leader.recipe_book)

    def rendered(self, key: int) -> Loaded:
        """Read what a key frame is passed through by, and nothing made of it."""
        frame, number = self._key_frame(key), self._source.timeline.numbers[key]
        template = template_of(self._contents, self._settings.output, number)
        return Loaded(key, replace(frame, gbuffer=None), None, (), (), (), {}, template, {}, 0.0)

    def look(self, key: int) -> tuple[tuple[Observed, ...], tuple[GBuffer, ...]]:
        """Read only what features of an interval come from: see `Loaded.observed`, and slots."""
        observed = self._observed(key)
        slots = tuple(self._slot_gbuffer(slot) for slot in self._slots(key))
        self.forget(key)
        return observed, slots

    def _followed(self, key: int) -> bool:
        """Whether a key frame of the same shot comes after one."""
        last = key + 1 == len(self._source.timeline.numbers)
        return not last and not self.shots.starts_at(key + 1)

    def _held(self, key: int) -> bool:
        """Return True if the slots after a key frame show its picture.

        What comes after a hold at the end of a shot, nothing but G-buffers of the slots tells: the
        vectors of a frame that was copied are those of its first.
        """
        if self._followed(key):
            return self.shots.repeats(key + 1)
        return not self._slots(key) and self.shots.repeats(key)

    def _looks_ahead(self, key: int) -> bool:
        return self._method.lookahead and self._followed(key)

    def _older(self, key: int, lookahead: bool) -> int | None:
        """Return the key frame that points are led on from where no next one tells."""
        if self._layers is None or not self._layers.looks_back or lookahead or key == 0:
            return None
        return None if self.shots.starts_at(key) else key - 1

    def _slots(self, key: int) -> tuple[Slot, ...]:
        """Return the slots of an interval that have G-buffers: all of them, or none."""
        slots = self._source.timeline.between(key)
        known = all(self._source.slot_number(slot) is not None for slot in slots)
        return slots if known else ()

    def _history(self, key: int) -> tuple[int, ...]:
        """Return the indices of the key frames that lead back from one, the newest first."""
        if not self._method.extrapolates:
            return ()
        older = tuple(range(key - 1, self.shots.begin(key, HISTORY - 1) - 1, -1))
        if self._source.slots is None:
            return older
        spare = self.losses.spare
        return tuple(takewhile(lambda i: self._slots(i) and spare(self._slots(i)), older))

    def _window_of(self, key: int) -> Window | None:
        """Return the data window of a key frame's colour; None where none can be read."""
        numbers, keys = self._source.timeline.numbers, self._source.keys
        if is_plain(keys.sequence) or not 0 <= key < len(numbers):
            return None
        if key in self._frames:
            return self._frames[key].image.data_window
        with suppress(InputError):
            return colour_window(keys, numbers[key])
        return None

    def _in_shot(self, key: int, before: bool = False) -> KeyFrame:
        """Return a key frame without vectors that lead to another shot.

        With `before` it is wanted for the interval before it, not for the one after.
        """
        if self._estimates is not None:
            # A repeated picture tells nothing of the motion that leads on from it.
            back = key > 0 and not self.shots.starts_at(key) and not self.shots.repeats(key)
            ahead = self._looks_ahead(key) and not (before and self.shots.repeats(key + 1))
            return self._estimates.moving(key, back, ahead, before)
        frame = self._key_frame(key)
        if frame.gbuffer is None:
            return frame
        return replace(frame, gbuffer=self.shots.within(key, frame.gbuffer))

    @contextmanager
    def _reading(self, slot: Slot) -> Iterator[None]:
        """Read a frame in a block, which is lost where that fails, or one of its files does."""
        with self.losses.at(slot):
            if self.losses.bearable:
                self.recipe_book.digest(slot)
            yield

    def _key_frame(self, key: int) -> KeyFrame:
        """Return a key frame, read unless it is at hand; cuts are found by it."""
        if key not in self._frames:
            with self._reading(Slot(key, 0)):
                frame = self._read_key(key)
                if self.losses.bearable:
                    self._read_beside(key)
            self._frames[key] = self._source.scratch.store(frame)
        return self._frames[key]

    def _read_beside(self, key: int) -> None:
        """Read what a key frame is lost without, too: its layers, and other views."""
        if self._layers is not None:
            self._layers.require(key)
        for other in self._followers:
            other._key_frame(key)

    def _read_key(self, key: int) -> KeyFrame:
        """Read a key frame, and show it to who finds cuts."""
        source = self._source
        number = source.timeline.numbers[key]
        if self._estimates is not None:
            frame = self._estimates.frame(key)
            if source.cuts.detect:
                self.shots.see(key, self._estimates.flowing(key))
        elif is_plain(source.keys.sequence):
            frame = self._colour(key)
            self.shots.see(key, frame)
        elif source.slots is None:
            raw = source.early.take(number, self._key_roles)
            if raw is None:
                raw = read_raw(source.keys, number, self._key_roles, objects=True)
            frame = raw.key(source.convention)
            self.shots.see(key, frame if self._normals_tell else frame.without("normal"))
            if self._normals_tell and not self._wants_normals:
                frame = frame.without("normal")
        else:
            frame = read_raw(source.keys, number, (Role.COLOUR,)).key(None)
            steps = source.timeline.steps
            assert steps is not None  # slots have G-buffers where the factor is whole
            gbuffer = self._slot_gbuffer(Slot(key, 0)).on(frame.image.data_window)
            self.shots.see(key, replace(frame, gbuffer=over_interval(gbuffer, steps)))
            frame = replace(frame, gbuffer=stretched(gbuffer, steps))
        return frame

    def _colour(self, key: int) -> KeyFrame:
        """Read the colour of a key frame, and nothing else."""
        keys, number = self._source.keys, self._source.timeline.numbers[key]
        with self._reading(Slot(key, 0)):
            if is_plain(keys.sequence):
                return KeyFrame(number, key_picture(keys, number), None)
            return read_raw(keys, number, (Role.COLOUR,)).key(None)

    @property
    def _key_roles(self) -> tuple[Role, ...]:
        """What is read of a key frame in the key setting.

        Methods without motion still report holes by the geometry. Networks want the surface too.
        """
        if self._source.finding is None:
            return (Role.COLOUR,)
        late = self._late is not None
        return run_roles(self._source.keys, self._method, self._source.cuts.detect, late)

    def _slot_gbuffer(self, slot: Slot) -> GBuffer:
        """Read the G-buffer of a slot; what leads through it stays at hand."""
        source = self._source
        number = source.slot_number(slot)
        assert source.slots is not None and number is not None
        roles = (*GEOMETRY, *SURFACE) if self._method.extrapolates else GEOMETRY
        with self._reading(slot):
            raw = read_raw(source.slots, number, roles, objects=True)
        gbuffer = source.scratch.store(raw.settle(source.convention))
        if self._method.extrapolates:
            self._instants[slot] = without_surface(gbuffer)
        if self._observes and slot.index in (0, FACTOR - 1):
            self._shapes[slot] = gbuffer.without(*SURFACE_PARTS)
        return gbuffer

    def _way_back(self, key: int) -> tuple[GBuffer, ...]:
        """Return the instants from the key frame after this one back to it."""
        if self._source.slots is None:
            return ()
        way = between(key)
        for slot in way:
            if slot not in self._instants:
                self._slot_gbuffer(slot)
        return tuple(self._instants[slot] for slot in way)

    @property
    def _observes(self) -> bool:
        """Whether a policy looks at features."""
        return self._method.judge is Judge.POLICY and self._contents[0].leads

    def _starts(self, key: int) -> range:
        """Return the indices of the key frames whose features a state at this one holds."""
        return range(self.shots.begin(key, KEYS_BACK), key + 1) if self._observes else range(0)

    def _observed(self, key: int) -> tuple[Observed, ...]:
        """Return the instants of key frames that no earlier interval brought along."""
        found = []
        for index in self._starts(key):
            if index not in self.told:
                slot = self._instant_before(index)
                before = None if slot is None else self._shape(slot)
                now = self.shots.within(index, self._shape(Slot(index, 0)))
                found.append(Observed(index, now, before))
                self.told |= {index}
        self.told = frozenset(index for index in self.told if index > key - KEYS_BACK)
        return tuple(found)

    def _instant_before(self, key: int) -> Slot | None:
        """Return the instant that a key frame's is compared with; None where a shot begins."""
        if key == 0 or self.shots.starts_at(key):
            return None
        before = Slot(key - 1, 0 if self._source.slots is None else FACTOR - 1)
        return before if self.losses.spare((before,)) else None

    def _shape(self, slot: Slot) -> GBuffer:
        """Return the geometry of an instant, with normals."""
        source = self._source
        if slot not in self._shapes and source.slots is not None:
            self._slot_gbuffer(slot)
        elif slot not in self._shapes:
            frame = self._frames.get(slot.key)
            if frame is not None and frame.gbuffer is not None:
                return frame.gbuffer
            number = source.timeline.numbers[slot.key]
            # With colour, whose window may be smaller, as in the key frames that are at hand.
            roles = (Role.COLOUR, *GEOMETRY)
            with self._reading(slot):
                raw = read_raw(source.keys, number, roles, objects=True)
            self._shapes[slot] = raw.settle(source.convention)
        return self._shapes[slot]

    def _keep_shape(self, key: int) -> None:
        """Keep of a key frame what the features of the next one are found by."""
        frame = self._frames.get(key)
        if key in self.told and frame is not None and frame.gbuffer is not None:
            g = frame.gbuffer
            self._shapes[Slot(key, 0)] = GBuffer(g.window, g.depth, g.normal, g.position)

    def forget(self, key: int) -> None:
        """Drop what no interval after this one needs, or not yet, as it only told about cuts."""
        self._source.early.drop()
        self._shapes = {slot: shape for slot, shape in self._shapes.items() if slot.key >= key}
        oldest = key + 1
        if self._late is not None:
            self._late.forget(key)
            self._keep_shape(key)
        elif self._method.extrapolates:
            oldest -= HISTORY - 1
        if self._layers is not None:
            self._layers.forget(key)
            oldest = min(oldest, key) if self._layers.looks_back else oldest
        self._frames = {i: f for i, f in self._frames.items() if oldest <= i <= key + 1}
        self._instants = {s: buffer for s, buffer in self._instants.items() if s.key >= oldest}
        self.shots.forget(min(oldest, key))
        self._regions.forget(key)
        if self._estimates is not None:
            self._estimates.forget(oldest)

    def recipes(self, key: int) -> dict[int, str]:
        """Digest what each slot's frame depends on."""
        lookahead = self._looks_ahead(key)
        if self._estimates is not None:
            return self._estimated_recipe(key, lookahead)
        history = self._history(key)
        keys = (key, *((key + 1,) if lookahead else ()), *history)
        older = self._older(key, lookahead)
        if older is not None and older not in keys:
            keys = (*keys, older)
        seen = self._seen(key)
        back = KEYS_BACK if self._observes else HISTORY - 1 if self._method.extrapolates else 0
        back = max(back, int(older is not None))
        cuts = [
            *self.shots.told(key, back, (*keys, *self._starts(key))),
            *self._steady(key),
            *self._holds(key),
        ]
        instants = tuple(seen)
        if self._source.slots is not None:
            way = (slot for i in history for slot in self._slots(i))
            instants = (*self._slots(key), *way, *seen)
        return self.recipe_book.of(key, keys, instants, cuts)

    def _estimated_recipe(self, key: int, lookahead: bool) -> dict[int, str]:
        """Digest the same where motion is estimated: key frames on both sides tell theirs."""
        keys = [key, *((key + 1,) if lookahead else ())]
        if key and not self.shots.starts_at(key):
            keys.append(key - 1)
        if lookahead and self._followed(key + 1):
            keys.append(key + 2)
        cuts = [
            *self.shots.told(key, 0, ()),
            f"flow {[index - key for index in keys]}",
            *self._steady(key),
            *self._holds(key),
        ]
        return self.recipe_book.of(key, keys, (), cuts)

    def _steady(self, key: int) -> list[str]:
        """Say what slots depend on of the windows of key frames that they are not made of."""
        return ["steady window"] if self._regions.is_steady(key) else []

    def _holds(self, key: int) -> list[str]:
        """Say which holds the frames of an interval depend on; nothing where there are none."""
        later = {key, *(index + 1 for index in self._history(key))}
        repeats = [f"repeats {i - key}" for i in sorted(later) if self.shots.repeats(i)]
        return (["held"] if self._held(key) else []) + repeats

    def _seen(self, key: int) -> list[Slot]:
        """Return the instants that the features of an interval's states come from."""
        around = ((Slot(index, 0), self._instant_before(index)) for index in self._starts(key))
        return [slot for instants in around for slot in instants if slot is not None]
