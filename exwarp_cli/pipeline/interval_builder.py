"""From what was read of an interval to what synthesis works on: one window, settled motion."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from exwarp_cli.domain.decision import Plan, Trial
from exwarp_cli.domain.frame import (
    SURFACE_PARTS,
    Float32,
    GBuffer,
    KeyFrame,
    Window,
    nonfinite_pixels,
    require_canvas,
)
from exwarp_cli.domain.network_api import (
    HISTORY_FRAMES,
    Extrapolator,
    Interpolator,
    LookAheadNetwork,
)
from exwarp_cli.domain.tiles import TilePlan
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.pipeline.choosing import Chosen
from exwarp_cli.pipeline.interval_inputs import IntervalInputs
from exwarp_cli.pipeline.key_frames import HistoryFrame, slots_back_to, without_surface
from exwarp_cli.runtime.frame_pool import IN_MEMORY, ScratchFrames
from exwarp_cli.synthesis.geometry import settle_motion
from exwarp_cli.synthesis.history import Past
from exwarp_cli.synthesis.holds import around_holds
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.movers import chosen, moving, those
from exwarp_cli.synthesis.sub_intervals import SubSlot
from exwarp_cli.synthesis.trajectory import displacement, span_motion

Ids = frozenset[int]
Instant = tuple[Slot, GBuffer]
Place = tuple[tuple[Slot, Window], ...]
"""One or two instants with their windows: a key frame's data may fill less than its G-buffer."""

Basis = tuple[Window, Ids | None]
"""What settled geometry goes by: the window, and which objects move, where the frames tell."""

Settled = tuple[int, Basis, bool]
"""A key frame's index, what its geometry goes by, and whether it has its surface."""


@dataclass(frozen=True)
class PreparedInterval:
    """A key interval whose slots can be rendered.

    Attributes
    ----------
    interval
        On one window; None where every slot of it is written.
    choice
        By whom its path was decided, and how; None outside the decision tree.
    existing
        The slots that an earlier run wrote.
    timing_ms
        Milliseconds that all this took, by step: a slot's share.
    broken
        How many pixels of the frames around are NaN or infinite, by the frame's number.
    trial
        What the gate decided by; None where it decides nothing.
    parts
        How slots are made that lie beside frames which were rendered after all.
    """

    interval: Interval | None
    choice: Chosen | None
    existing: frozenset[Slot]
    timing_ms: Mapping[str, float]
    broken: Mapping[int, int]
    trial: Trial | None = None
    parts: Mapping[int, SubSlot] = field(default_factory=dict)

    @property
    def extrapolates(self) -> bool:
        """Whether its network makes any of the slots."""
        return self.plan is not None and self.plan.extrapolates

    @property
    def plan(self) -> Plan | TilePlan | None:
        """The path that was decided, or one for each tile."""
        return None if self.choice is None else self.choice.plan


class IntervalBuilder:
    """Builds intervals in order; what several of them share is settled once.

    Data windows may differ from frame to frame, and what moves from interval to interval, so what
    is shared goes by these, too.

    Parameters
    ----------
    display
        The display window of all frames.
    network, interpolator
        For methods that extrapolate, and that interpolate by a network.
    estimated
        Whether key frames come with estimated motion, which is settled as it is.
    bare
        Whether only motion and depth of key frames' settled geometry are used.
    scratch
        Where large settled frames lie when a network may extrapolate.
    linear
        Whether colour is moved in linear light, as layers that add up to it go along.
    back
        How many key frames before its own a later interval goes by, without a network.
    """

    def __init__(
        self,
        display: Window,
        network: Extrapolator | None = None,
        interpolator: Interpolator | LookAheadNetwork | None = None,
        estimated: bool = False,
        bare: bool = False,
        scratch: ScratchFrames = IN_MEMORY,
        linear: bool = False,
        back: int = 0,
    ) -> None:
        self._back = back if network is None else HISTORY_FRAMES - 1
        self._linear = linear
        self._display = display
        self._network = network
        self._interpolator = interpolator
        self._estimated = estimated
        self._bare = bare
        self._scratch = scratch
        self._moving = MovingObjects()
        self._frames: dict[Settled, KeyFrame] = {}
        self._instants: dict[tuple[Slot, Basis], GBuffer] = {}
        self._past: dict[Settled, Past] = {}
        self._without_surface: KeyFrame | None = None

    def build(self, inputs: IntervalInputs) -> Interval:
        """Bring what was read onto one window: the display's and the data of the frames around.

        Of a region of a picture, its own.
        """
        assert inputs.frame is not None
        window = inputs.frame.image.data_window
        canvas = window if inputs.region else self._display.union(window)
        if inputs.following is not None and not inputs.region:
            canvas = canvas.union(inputs.following.image.data_window)
        for rendered in inputs.rendered.frames.values():
            if rendered.leads and not inputs.region:
                canvas = canvas.union(rendered.frame.image.data_window)
        require_canvas(f"frame {inputs.frame.number} and the next one", canvas)
        ids = self._moving.find(inputs, canvas)
        return self._settled(with_stencils(inputs, ids), (canvas, ids))

    def add_history(self, interval: Interval, inputs: IntervalInputs) -> Interval:
        """Return an interval with the history and surface that it was built without.

        It is of the key setting, and no slot is rendered yet.
        """
        frame, settled = inputs.frame, interval.key.gbuffer
        if frame is None or frame.gbuffer is None or settled is None:
            return interval
        window = interval.key.image.data_window
        parts = {part: getattr(frame.gbuffer, part) for part in SURFACE_PARTS}
        placed = GBuffer(frame.gbuffer.window, **parts).on(window)
        surface = {part: getattr(placed, part) for part in SURFACE_PARTS}
        key = replace(interval.key, gbuffer=replace(settled, **surface))
        basis = window, None
        # What leads back goes by all vectors of the key frame: those of the interval may lack some.
        complete = self._without_surface
        assert complete is not None and complete.gbuffer is not None
        complete = replace(complete, gbuffer=replace(complete.gbuffer, **surface))
        self._frames[inputs.key, basis, has_surface(complete)] = complete
        return replace(interval, key=key, past=self._led_back(inputs, complete, basis))

    def _settled(self, inputs: IntervalInputs, basis: Basis) -> Interval:
        """Settle what was read, on one window and with what moves as its stencil."""
        assert inputs.frame is not None
        following = None
        if inputs.following is not None:
            following = self._frame(inputs.key + 1, inputs.following, basis)
        key = self._frame(inputs.key, inputs.frame, basis)
        if inputs.lacks_history:
            self._without_surface = key
        slots = tuple(
            self._scratch.store(settle_motion(gbuffer.on(basis[0]))) for gbuffer in inputs.slots
        )
        past = self._led_back(inputs, key, basis)
        self._release(inputs, slots, basis)
        if not (self._estimated or inputs.held or slots):
            key, following = around_holds(key, following, inputs.after_hold)
        return Interval(
            key,
            following,
            slots,
            past,
            self._network,
            self._interpolator,
            inputs.times,
            estimated=self._estimated,
            keeps=bool(inputs.truth.frames),
            held=inputs.held,
            after_hold=inputs.after_hold,
            scratch=self._scratch,
            linear=self._linear,
            display=self._display,
            rendered=self._rendered(inputs, basis[0]),
        )

    def _rendered(self, inputs: IntervalInputs, window: Window) -> dict[int, KeyFrame]:
        """Settle the frames of slots that were rendered after all, as far as they have motion."""
        found = {}
        for slot, rendered in inputs.rendered.frames.items():
            frame = rendered.frame
            if rendered.leads and window.covers(frame.image.data_window):
                placed = frame.extended(window)
                assert placed.gbuffer is not None
                settled = settle_motion(placed.gbuffer)
                found[slot] = replace(placed, gbuffer=settled.bare() if self._bare else settled)
        return found

    def _frame(self, index: int, frame: KeyFrame, basis: Basis) -> KeyFrame:
        if self._estimated:  # the flows of an interval are its own
            return frame.extended(basis[0])
        place = index, basis, has_surface(frame)
        if place not in self._frames:
            placed = frame.extended(basis[0])
            if placed.gbuffer is not None:
                settled = settle_motion(placed.gbuffer)
                placed = replace(placed, gbuffer=settled.bare() if self._bare else settled)
            self._frames[place] = self._scratch.store(placed)
        return self._frames[place]

    def _led_back(self, inputs: IntervalInputs, key: KeyFrame, basis: Basis) -> tuple[Past, ...]:
        steps: list[Past] = []
        newer = key
        for index, older in zip(range(inputs.key - 1, -1, -1), inputs.history, strict=False):
            place = index, basis, has_surface(older.frame)
            if place not in self._past:
                motion = self._scratch.store(self._motion(index, older, newer, basis))
                frame = self._frame(index, older.frame, basis)
                self._past[place] = Past(frame, motion, is_guessed(older, newer))
            steps.append(self._past[place])
            newer = steps[-1].frame
        return tuple(steps)

    def _motion(self, index: int, older: HistoryFrame, newer: KeyFrame, basis: Basis) -> Float32:
        """Return the motion, float32 [H, W, 2], from a key frame to the one before it."""
        if older.held:
            return np.zeros((*basis[0].shape, 2), np.float32)
        if not older.instants:
            assert newer.gbuffer is not None
            return displacement(newer.gbuffer, -1)
        instants = slots_back_to(index, len(older.instants) - 1)
        *way, end = zip(instants, older.instants, strict=True)
        settled = [self._instant(slot, gbuffer, basis) for slot, gbuffer in way]
        return span_motion([*settled, end[1].on(basis[0])], -1)

    def _instant(self, slot: Slot, gbuffer: GBuffer, basis: Basis) -> GBuffer:
        settled = self._instants.get((slot, basis))
        return settle_motion(gbuffer.on(basis[0])) if settled is None else settled

    def _release(self, inputs: IntervalInputs, slots: tuple[GBuffer, ...], basis: Basis) -> None:
        """Drop what no later interval needs."""
        key = inputs.key
        # Of frames without their surface, of which others are read late, warps go by the last.
        oldest = {surface: key + 1 - self._back for surface in (False, True)}
        if inputs.lacks_history:
            oldest[False] = key
        self._frames = {at: frame for at, frame in self._frames.items() if at[0] >= oldest[at[2]]}
        self._past = {at: past for at, past in self._past.items() if at[0] >= oldest[at[2]]}
        if self._back:
            self._instants = {
                (Slot(key, i), basis): without_surface(gbuffer)
                for i, gbuffer in enumerate(slots, start=1)
            }


def is_guessed(older: HistoryFrame, newer: KeyFrame) -> bool:
    """Return True if motion to a key frame is made of vectors to the one after `newer`."""
    leads = older.held or bool(older.instants)
    return not leads and newer.gbuffer is not None and newer.gbuffer.to_previous is None


def has_surface(frame: KeyFrame) -> bool:
    """Return True if a key frame comes with any of its surface."""
    parts = () if frame.gbuffer is None else SURFACE_PARTS
    return any(getattr(frame.gbuffer, part) is not None for part in parts)


def count_broken(inputs: IntervalInputs, counted: Mapping[int, int]) -> dict[int, int]:
    """Count the pixels that are NaN or infinite, by frame; `counted` are counts of some frames."""
    frames: Iterable[KeyFrame | None] = (
        inputs.frame,
        inputs.following,
        *(older.frame for older in inputs.history),
    )
    counts = {}
    for frame in frames:
        if frame is not None:
            count = counted.get(frame.number, frame.broken)
            if count is None:
                count = int(np.count_nonzero(nonfinite_pixels(frame.image.pixels)))
            counts[frame.number] = count
    return counts


class MovingObjects:
    """Decides which objects of a Cryptomatte move in an interval, where no option names them.

    Decided once per interval: an object that counted as moving in one instant and as standing still
    in the next would be a hole to itself. It is decided by what the interval reads anyway, so that
    any part of a sequence comes to the same. What two intervals compare is compared once.
    """

    def __init__(self) -> None:
        self._compared: dict[tuple[Place, Window], Ids] = {}

    def find(self, inputs: IntervalInputs, canvas: Window) -> Ids | None:
        """Return the ids of what moves between any two instants of an interval.

        None where there are no ids of what is shown. `canvas` is what the interval is built on.
        """
        instants = list(_instants(inputs))
        if all(gbuffer.objects is None for _, gbuffer in instants):
            return None
        compared: dict[tuple[Place, Window], Ids] = {}
        # Each instant with the one before it; one that is alone with none.
        pairs: Iterable[tuple[Instant, ...]] = zip(instants[1:], instants, strict=False)
        for pair in pairs if instants[1:] else [(instants[0],)]:
            place = tuple((slot, gbuffer.window) for slot, gbuffer in pair), canvas
            ids = self._compared.get(place)
            compared[place] = _moving_ids(canvas, *(g for _, g in pair)) if ids is None else ids
        self._compared = compared
        return frozenset().union(*compared.values())


def with_stencils(inputs: IntervalInputs, ids: Ids | None) -> IntervalInputs:
    """Return an interval whose G-buffers have the objects of some ids as their stencil.

    With None, as `MovingObjects.find` returns it, the interval stays as it is.
    """
    if ids is None:
        return inputs

    def marked(gbuffer: GBuffer) -> GBuffer:
        if gbuffer.objects is None:
            return gbuffer
        return replace(gbuffer, stencil=chosen(gbuffer.objects, ids), objects=None)

    def with_stencil(frame: KeyFrame) -> KeyFrame:
        return frame if frame.gbuffer is None else replace(frame, gbuffer=marked(frame.gbuffer))

    return replace(
        inputs,
        frame=None if inputs.frame is None else with_stencil(inputs.frame),
        following=None if inputs.following is None else with_stencil(inputs.following),
        slots=tuple(map(marked, inputs.slots)),
        history=tuple(
            HistoryFrame(with_stencil(older.frame), tuple(map(marked, older.instants)))
            for older in inputs.history
        ),
        rendered=inputs.rendered.map_frames(with_stencil),
    )


def _moving_ids(canvas: Window, now: GBuffer, before: GBuffer | None = None) -> Ids:
    """Return the ids of what moves between two instants, or by the vectors of one alone."""
    if now.objects is None or not now.has_motion:
        return frozenset()
    raw = now.on(canvas)
    moves = moving(settle_motion(raw), None if before is None else before.on(canvas), raw)
    return frozenset() if moves is None or raw.objects is None else those(raw.objects, moves)


def _instants(inputs: IntervalInputs) -> Iterator[Instant]:
    """Yield the instants of an interval in order, each with motion from the one before it."""
    key, frame, following = inputs.key, inputs.frame, inputs.following
    if frame is None or frame.gbuffer is None:
        return
    older = list(enumerate(inputs.history, start=1))[::-1]
    if any(past.instants for _, past in older):
        for back, past in older:  # from the oldest key frame on, where slots have G-buffers
            way = list(
                zip(slots_back_to(key - back, len(past.instants) - 1), past.instants, strict=True)
            )
            yield from reversed(way[1:])
        yield way[0]
    else:
        for back, past in older:
            if past.frame.gbuffer is not None:
                yield Slot(key - back, 0), past.frame.gbuffer
        yield Slot(key, 0), frame.gbuffer
    yield from ((Slot(key, i), gbuffer) for i, gbuffer in enumerate(inputs.slots, start=1))
    if not inputs.slots and following is not None and following.gbuffer is not None:
        yield Slot(key + 1, 0), following.gbuffer
