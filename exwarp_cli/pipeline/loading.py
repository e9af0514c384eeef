"""What one key interval needs from disk, read ahead of the computation."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from itertools import takewhile

from exwarp_cli.domain.extrapolator import HISTORY
from exwarp_cli.domain.frame import SURFACE_PARTS, GBuffer, Image, KeyFrame
from exwarp_cli.domain.results import InterpolatorSummary, NetworkSummary
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.timeline import FACTOR, Slot
from exwarp_cli.io.channels import Role
from exwarp_cli.io.frames import GEOMETRY, SURFACE, read_image, read_raw
from exwarp_cli.io.output import Template, read_template
from exwarp_cli.io.sequence import Sequence
from exwarp_cli.pipeline.recipes import Recipes
from exwarp_cli.pipeline.source import FrameOf, Source
from exwarp_cli.policy.state import KEYS_BACK
from exwarp_cli.synthesis.interval import QUARTERS
from exwarp_cli.synthesis.methods import Judge, Method


@dataclass(frozen=True)
class Older:
    """A key frame before the interval's own.

    Attributes
    ----------
    frame
        As read.
    instants
        With slot G-buffers those on the way to it, without surface: the key frame after it, the
        slots between from the last to the first, and this key frame; motion reaches over one slot.
        Empty in the key setting.
    """

    frame: KeyFrame
    instants: tuple[GBuffer, ...]


@dataclass(frozen=True)
class Observed:
    """A key frame's instant whose features a policy wants; neither G-buffer has settled motion.

    Attributes
    ----------
    key
        Index of the key frame.
    now
        Its geometry; with slot G-buffers motion reaches over one slot.
    before
        Geometry of the instant before, a key interval or a slot earlier; None at the first.
    """

    key: int
    now: GBuffer
    before: GBuffer | None


@dataclass(frozen=True)
class Loaded:
    """One key interval as read: nothing computed yet.

    Attributes
    ----------
    key
        Index of the key frame.
    frame, following
        The key frames on both sides; `following` only for look-ahead methods. None where every
        slot of the interval was found written, and nothing has to be computed.
    slots
        G-buffers of the slots after the key frame, empty in the key setting.
    past
        The key frames before, the newest first, as far as motion leads back to them; only for
        methods that extrapolate.
    observed
        The key frame's instant, and before it those of older key frames that no interval before
        brought along; only for the policy.
    truth
        Ground truth by slot, where there is some.
    truth_ends
        The same at slot 0 and, counted on as a slot, at the next key frame's instant; only for
        VMAF.
    times
        When the slots are, as in `Interval`.
    template
        What generated frames take over from the key frame's file.
    recipes
        For each slot, what its frame depends on, digested.
    read_ms
        Milliseconds that reading took.
    """

    key: int
    frame: KeyFrame | None
    following: KeyFrame | None
    slots: tuple[GBuffer, ...]
    past: tuple[Older, ...]
    observed: tuple[Observed, ...]
    truth: dict[int, Image]
    template: Template
    recipes: dict[int, str]
    read_ms: float
    truth_ends: dict[int, Image] = field(default_factory=dict)
    times: tuple[float, ...] = QUARTERS


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
    ) -> None:
        self._source = source
        self._method = method
        self._settings = settings
        self._truth = truth
        self._recipes = Recipes(
            source, method, settings.compression, truth, network, interpolator, policy
        )
        self._frames: dict[int, KeyFrame] = {}
        self._instants: dict[Slot, GBuffer] = {}
        self._shapes: dict[Slot, GBuffer] = {}
        self._told: set[int] = set()

    def load(self, key: int, needed: Callable[[int, dict[int, str]], bool]) -> Loaded:
        """Read an interval.

        Parameters
        ----------
        key
            Index of the key frame.
        needed
            Called with the index and the recipes before anything is decoded; False leaves the
            pixels unread.
        """
        begin = time.perf_counter()
        source = self._source
        number = source.timeline.numbers[key]
        last = key + 1 == len(source.timeline.numbers)
        lookahead = self._method.lookahead and not last
        recipes = self._recipe(key, lookahead)
        template = read_template(
            source.keys.sequence.files[number], source.keys.layout.roles[Role.COLOUR]
        )
        if not needed(key, recipes):
            elapsed = 1e3 * (time.perf_counter() - begin)
            return Loaded(key, None, None, (), (), (), {}, template, recipes, elapsed)
        frame = self._key_frame(key)
        following = self._key_frame(key + 1) if lookahead else None
        gbuffers = tuple(self._slot_gbuffer(slot) for slot in self._slots(key))
        past = tuple(Older(self._key_frame(i), self._way_back(i)) for i in self._history(key))
        observed = self._observed(key)
        slots = self._source.timeline.made_of(key)
        truth = self._read_truth(slots)
        ends = self._read_truth(self._ends(key))
        self._forget(key)
        elapsed = 1e3 * (time.perf_counter() - begin)
        times = tuple(float(source.timeline.time(slot)) for slot in source.timeline.between(key))
        return Loaded(
            key, frame, following, gbuffers, past, observed, truth, template, recipes, elapsed,
            ends, times,
        )  # fmt: skip

    def look(self, key: int) -> tuple[tuple[Observed, ...], tuple[GBuffer, ...]]:
        """Read only what features of an interval come from: see `Loaded.observed`, and slots."""
        observed = self._observed(key)
        slots = tuple(self._slot_gbuffer(slot) for slot in self._slots(key))
        self._forget(key)
        return observed, slots

    def _slots(self, key: int) -> tuple[Slot, ...]:
        """Return the slots of an interval that have G-buffers: all of them, or none."""
        slots = self._source.timeline.between(key)
        known = all(self._source.slot_number(slot) is not None for slot in slots)
        return slots if known else ()

    def _history(self, key: int) -> tuple[int, ...]:
        """Return the indices of the key frames that lead back from one, the newest first."""
        if not self._method.extrapolates:
            return ()
        older = tuple(range(key - 1, max(key - HISTORY, -1), -1))
        return older if self._source.slots is None else tuple(takewhile(self._slots, older))

    def _key_frame(self, key: int) -> KeyFrame:
        """Read a key frame, unless it is at hand."""
        if key not in self._frames:
            source = self._source
            number = source.timeline.numbers[key]
            convention = None if source.finding is None else source.finding.convention
            if source.slots is None:
                frame = read_raw(source.keys, number, self._key_roles).key(convention)
            else:
                frame = read_raw(source.keys, number, (Role.COLOUR,)).key(None)
                steps = source.timeline.steps
                assert steps is not None  # slots have G-buffers where the factor is whole
                gbuffer = _stretched(self._slot_gbuffer(Slot(key, 0)), steps)
                frame = replace(frame, gbuffer=gbuffer.on(frame.image.data_window))
            self._frames[key] = frame
        return self._frames[key]

    @property
    def _key_roles(self) -> tuple[Role, ...]:
        """What is read of a key frame in the key setting.

        Methods without motion still report holes by the geometry. Normals tell nothing there but
        Unreal's background, in sets of one file per AOV; networks want them, and the surface.
        """
        if self._source.finding is None:
            return (Role.COLOUR,)
        if self._method.extrapolates:
            return (Role.COLOUR, *GEOMETRY, *SURFACE)
        if self._source.keys.aovs:
            return (Role.COLOUR, *GEOMETRY)
        return (Role.COLOUR, *(role for role in GEOMETRY if role is not Role.NORMAL))

    def _slot_gbuffer(self, slot: Slot) -> GBuffer:
        """Read the G-buffer of a slot; what leads through it stays at hand."""
        source = self._source
        number = source.slot_number(slot)
        assert source.slots is not None and number is not None
        convention = None if source.finding is None else source.finding.convention
        roles = (*GEOMETRY, *SURFACE) if self._method.extrapolates else GEOMETRY
        gbuffer = read_raw(source.slots, number, roles).settle(convention)
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
        return self._method.judge is Judge.POLICY

    def _starts(self, key: int) -> range:
        """Return the indices of the key frames whose features a state at this one holds."""
        return range(max(key - KEYS_BACK, 0), key + 1) if self._observes else range(0)

    def _observed(self, key: int) -> tuple[Observed, ...]:
        """Return the instants of key frames that no earlier interval brought along."""
        found = []
        for index in self._starts(key):
            if index not in self._told:
                before = self._shape(self._instant_before(index)) if index else None
                found.append(Observed(index, self._shape(Slot(index, 0)), before))
                self._told.add(index)
        self._told = {index for index in self._told if index > key - KEYS_BACK}
        return tuple(found)

    def _instant_before(self, key: int) -> Slot:
        """Return the instant that a key frame's is compared with."""
        return Slot(key - 1, 0 if self._source.slots is None else FACTOR - 1)

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
            convention = None if source.finding is None else source.finding.convention
            # With colour, whose window may be smaller, as in the key frames that are at hand.
            roles = (Role.COLOUR, *GEOMETRY)
            self._shapes[slot] = read_raw(source.keys, number, roles).settle(convention)
        return self._shapes[slot]

    def _forget(self, key: int) -> None:
        """Drop what no interval after this one needs."""
        self._shapes = {slot: shape for slot, shape in self._shapes.items() if slot.key >= key}
        oldest = key + 1 - (HISTORY - 1 if self._method.extrapolates else 0)
        self._frames = {i: frame for i, frame in self._frames.items() if i >= oldest}
        self._instants = {s: buffer for s, buffer in self._instants.items() if s.key >= oldest}

    def _ends(self, key: int) -> tuple[Slot, ...]:
        """Return the rendered instants around an interval, for what scores it as a video."""
        if "vmaf" not in self._settings.measured:
            return ()
        timeline = self._source.timeline
        last = key + 1 == len(timeline.numbers)
        after = Slot(key, len(timeline.between(key)) + 1)
        return (Slot(key, 0),) if last else (Slot(key, 0), after)

    def _read_truth(self, slots: Iterable[Slot]) -> dict[int, Image]:
        """Read ground truth by the slots' index."""
        if self._truth is None:
            return {}
        sequence, frame_of = self._truth
        found = {}
        for slot in slots:
            number = frame_of(slot)
            if number is not None:
                found[slot.index] = read_image(sequence.files[number])
        return found

    def _recipe(self, key: int, lookahead: bool) -> dict[int, str]:
        """Digest what each slot's frame depends on."""
        history = self._history(key)
        keys = (key, *((key + 1,) if lookahead else ()), *history)
        seen = self._seen(key)
        if self._source.slots is None:
            return self._recipes.of(key, keys, seen)
        way = (slot for i in history for slot in self._slots(i))
        return self._recipes.of(key, keys, (*self._slots(key), *way, *seen))

    def _seen(self, key: int) -> list[Slot]:
        """Return the instants that the features of an interval's states come from."""
        starts = self._starts(key)
        return [
            slot
            for index in starts
            for slot in (Slot(index, 0), *((self._instant_before(index),) if index else ()))
        ]


def without_surface(gbuffer: GBuffer) -> GBuffer:
    """Return what motion is found by: a third of the memory, where frames are kept for later."""
    return gbuffer.without("normal", *SURFACE_PARTS)


def between(key: int) -> tuple[Slot, ...]:
    """Return the instants from the key frame after one back to it."""
    return (Slot(key + 1, 0), *(Slot(key, i) for i in range(FACTOR - 1, -1, -1)))


def _stretched(gbuffer: GBuffer, steps: int) -> GBuffer:
    """Turn motion per slot into motion per key interval, at constant velocity.

    A key frame's vectors span a key interval in either setting. With slot G-buffers they are only
    used where the slots' own do not lead: after the last key frame, and to the next one where the
    renderer writes none that way.
    """
    if gbuffer.to_next is not None:
        return replace(gbuffer, to_next=steps * gbuffer.to_next, to_previous=None)
    assert gbuffer.to_previous is not None
    return replace(gbuffer, to_previous=steps * gbuffer.to_previous)
