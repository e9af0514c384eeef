"""From what was read of an interval to what synthesis works on: one window, settled motion."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from exwarp_cli.domain import network_api
from exwarp_cli.domain.decision import Plan, Trial
from exwarp_cli.domain.frame import SURFACE_PARTS, GBuffer, KeyFrame, Window, require_canvas
from exwarp_cli.domain.tiles import TilePlan
from exwarp_cli.domain.timeline import Slot, ranges
from exwarp_cli.io.layers import LayerKind
from exwarp_cli.io.shot import count_nonfinite
from exwarp_cli.pipeline.decide import PathSelector, make_selector, only_warps
from exwarp_cli.pipeline.extra_layers import ExtraLayers
from exwarp_cli.pipeline.gate import Gate
from exwarp_cli.pipeline.interval_inputs import IntervalInputs, ViewsReader
from exwarp_cli.pipeline.key_frames import slots_back_to, without_surface
from exwarp_cli.pipeline.scheduling import record_time
from exwarp_cli.runtime.frame_pool import IN_MEMORY, ScratchFrames
from exwarp_cli.synthesis.history import OlderKeyFrame
from exwarp_cli.synthesis.holds import adapt_motion_to_holds
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import DecisionSource, Method
from exwarp_cli.synthesis.motion_fields import find_moving, moving_ids, select_ids, settle_motion
from exwarp_cli.synthesis.sub_intervals import SubSlot, sub_slots, vector_spans
from exwarp_cli.synthesis.trajectory import displacement, span_motion

if TYPE_CHECKING:
    from exwarp_cli.pipeline.frame_writer import FrameWriter
    from exwarp_cli.pipeline.job import Job
    from exwarp_cli.pipeline.progress import Progress

Ids = frozenset[int]

# What settled geometry goes by: the window, and which objects move, where the frames tell.
Basis = tuple[Window, Ids | None]

# One or two instants with their windows (a key frame's data may fill less than its G-buffer), and
# the canvas.
ComparedInstants = tuple[tuple[tuple[Slot, Window], ...], Window]

# A key frame's index, what its geometry goes by, and whether it has its surface.
FrameKey = tuple[int, Basis, bool]


@dataclass(frozen=True)
class PreparedInterval:
    """A key interval whose slots can be rendered."""

    interval: Interval | None  # on one window; None where every slot of it is written
    # The path that was decided, or one for each tile; None outside the decision tree.
    plan: Plan | TilePlan | None
    existing: frozenset[Slot]  # slots that nothing makes: rendered, or written by an earlier run
    timing_ms: Mapping[str, float]  # milliseconds that all this took, by step: a slot's share
    broken: Mapping[int, int]  # how many pixels of the frames around are broken, by number
    trial: Trial | None = None  # what the gate decided by; None where it decides nothing
    # How slots are made that lie beside frames which were rendered after all.
    parts: Mapping[int, SubSlot] = field(default_factory=dict)

    @property
    def extrapolates(self) -> bool:
        """True if its network makes any of the slots."""
        return self.plan is not None and self.plan.extrapolates


@dataclass
class IntervalBuilder:
    """Builds intervals in order; what several of them share is settled once.

    Data windows may differ from frame to frame, and what moves from interval to interval, so what
    is shared goes by these, too.
    """

    display: Window  # of all frames
    network: network_api.Extrapolator | None = None
    interpolator: network_api.Interpolator | network_api.LookAheadNetwork | None = None
    estimated: bool = False  # key frames come with estimated motion, which needs no settling
    bare: bool = False  # only motion and depth of key frames' settled geometry are used
    scratch: ScratchFrames = IN_MEMORY  # for large settled frames if a network extrapolates
    linear: bool = False  # colour is moved in linear light, as layers add up to it
    back: int = 0  # how many older key frames a later interval goes by, without a network
    # Ids of what moves, by the instants that tell it.
    _moving: dict[ComparedInstants, Ids] = field(default_factory=dict)
    _frames: dict[FrameKey, KeyFrame] = field(default_factory=dict)
    _instants: dict[tuple[Slot, Basis], GBuffer] = field(default_factory=dict)
    _past: dict[FrameKey, OlderKeyFrame] = field(default_factory=dict)

    def build(self, inputs: IntervalInputs) -> Interval:
        """Bring what was read onto one window, and settle its motion.

        The window is the display's and the data of the frames around; of a region, its own. What
        was built without history may be built again with it, before the next interval.
        """
        assert inputs.frame is not None
        window = inputs.frame.image.data_window
        if not inputs.region:
            leading = [each.frame for each in inputs.rendered.frames.values() if each.leads]
            for frame in (inputs.following, *leading):
                if frame is not None:
                    window = window.union(frame.image.data_window)
            window = window.union(self.display)
        require_canvas(f"frame {inputs.frame.number} and the next one", window)
        ids = self.find_moving_objects(inputs, window)
        basis = window, ids

        def marked(gbuffer: GBuffer) -> GBuffer:
            if gbuffer.objects is None or ids is None:
                return gbuffer
            return replace(gbuffer, stencil=select_ids(gbuffer.objects, ids), objects=None)

        inputs = inputs.map_geometry(marked)
        assert inputs.frame is not None
        following = None
        if inputs.following is not None:
            following = self._frame(inputs.key + 1, inputs.following, basis)
        key = self._frame(inputs.key, inputs.frame, basis)
        slots = tuple(
            self.scratch.store(settle_motion(gbuffer.on(window))) for gbuffer in inputs.slots
        )
        past = self._lead_back(inputs, key, basis)
        self._release_before(inputs, slots, basis)
        if not (self.estimated or inputs.held or slots):
            key, following = adapt_motion_to_holds(key, following, inputs.after_hold)
        # Frames of slots that were rendered after all, as far as they have motion.
        rendered = {
            slot: self._settle_frame(each.frame, window)
            for slot, each in inputs.rendered.frames.items()
            if each.leads and window.covers(each.frame.image.data_window)
        }
        return Interval(
            key,
            following,
            slots,
            past,
            self.network,
            self.interpolator,
            inputs.times,
            estimated=self.estimated,
            keeps=bool(inputs.truth.frames),
            held=inputs.held,
            after_hold=inputs.after_hold,
            scratch=self.scratch,
            linear=self.linear,
            display=self.display,
            rendered=rendered,
        )

    def find_moving_objects(self, inputs: IntervalInputs, canvas: Window) -> Ids | None:
        """Return the ids of what moves between any two instants of an interval.

        None where there are no ids of what is shown. `canvas` is what the interval is built on.
        Decided once per interval: an object that counted as moving in one instant and as standing
        still in the next would be a hole to itself. It is decided by what the interval reads
        anyway, so that any part of a sequence comes to the same.
        """
        instants = list(_instants(inputs))
        if all(gbuffer.objects is None for _, gbuffer in instants):
            return None
        # Each instant with the one before it; one that is alone with none.
        pairs: list[tuple[tuple[Slot, GBuffer], ...]] = [(instants[0],)]
        if len(instants) > 1:
            pairs = list(zip(instants[1:], instants, strict=False))
        compared: dict[ComparedInstants, Ids] = {}
        for pair in pairs:
            place = tuple((slot, gbuffer.window) for slot, gbuffer in pair), canvas
            if place in self._moving:
                compared[place] = self._moving[place]
                continue
            compared[place] = frozenset()
            now = pair[0][1]
            if now.objects is not None and now.has_motion:
                raw = now.on(canvas)
                before = pair[1][1].on(canvas) if len(pair) > 1 else None
                moves = find_moving(settle_motion(raw), before, raw)
                if moves is not None and raw.objects is not None:
                    compared[place] = moving_ids(raw.objects, moves)
        self._moving = compared
        return frozenset().union(*compared.values())

    def _settle_frame(self, frame: KeyFrame, window: Window) -> KeyFrame:
        placed = frame.extended(window)
        if placed.gbuffer is None:
            return placed
        settled = settle_motion(placed.gbuffer)
        return replace(placed, gbuffer=settled.bare() if self.bare else settled)

    def _frame(self, index: int, frame: KeyFrame, basis: Basis) -> KeyFrame:
        """Return a settled key frame; what was settled before is kept."""
        if self.estimated:  # the flows of an interval are its own
            return frame.extended(basis[0])
        frame_key = index, basis, has_surface(frame)
        if frame_key not in self._frames:
            settled = self._frames.get((index, basis, False))
            if settled is None or settled.gbuffer is None:
                settled = self._settle_frame(frame, basis[0])
            else:  # only its surface was read since; settling takes 0.7 s of a core at 1920x1080
                surface = frame.extended(basis[0]).gbuffer
                parts = {part: getattr(surface, part) for part in SURFACE_PARTS}
                settled = replace(settled, gbuffer=replace(settled.gbuffer, **parts))
            self._frames[frame_key] = self.scratch.store(settled)
        return self._frames[frame_key]

    def _lead_back(
        self, inputs: IntervalInputs, key: KeyFrame, basis: Basis
    ) -> tuple[OlderKeyFrame, ...]:
        """Return the key frames before, each with the motion that leads back to it."""
        steps: list[OlderKeyFrame] = []
        newer, window = key, basis[0]
        for index, older in zip(range(inputs.key - 1, -1, -1), inputs.history, strict=False):
            frame_key = index, basis, has_surface(older.frame)
            if frame_key not in self._past:
                if older.held:
                    motion = np.zeros((*window.shape, 2), np.float32)
                elif older.instants:
                    slots = slots_back_to(index, len(older.instants) - 1)
                    *way, (_, last) = zip(slots, older.instants, strict=True)
                    settled = []
                    for slot, gbuffer in way:
                        kept = self._instants.get((slot, basis))
                        settled.append(settle_motion(gbuffer.on(window)) if kept is None else kept)
                    motion = span_motion([*settled, last.on(window)], -1)
                else:
                    assert newer.gbuffer is not None
                    motion = displacement(newer.gbuffer, -1)
                motion = self.scratch.store(motion)
                frame = self._frame(index, older.frame, basis)
                # Guessed is motion that is made of vectors to the key frame after `newer`.
                leads = older.held or bool(older.instants)
                has_vectors = newer.gbuffer is None or newer.gbuffer.to_previous is not None
                is_guessed = not leads and not has_vectors
                self._past[frame_key] = OlderKeyFrame(frame, motion, is_guessed)
            steps.append(self._past[frame_key])
            newer = steps[-1].frame
        return tuple(steps)

    def _release_before(
        self, inputs: IntervalInputs, slots: tuple[GBuffer, ...], basis: Basis
    ) -> None:
        """Drop what no later interval needs, and keep the slots' geometry that leads back."""
        key = inputs.key
        # Of frames without their surface, of which others are read late, warps go by the last.
        back = self.back if self.network is None else network_api.HISTORY_FRAMES - 1
        oldest = {surface: key + 1 - back for surface in (False, True)}
        if inputs.lacks_history:
            oldest[False] = key
        self._frames = {k: frame for k, frame in self._frames.items() if k[0] >= oldest[k[2]]}
        self._past = {k: past for k, past in self._past.items() if k[0] >= oldest[k[2]]}
        if back:
            self._instants = {
                (Slot(key, i), basis): without_surface(gbuffer)
                for i, gbuffer in enumerate(slots, start=1)
            }


@dataclass(frozen=True)
class IntervalJudge:
    """What decides how intervals of a method are made."""

    method: Method
    selector: PathSelector | None  # selects their path
    gate: Gate | None


@dataclass
class IntervalPreparer:
    """Builds the intervals of a run in order, and decides how their slots are made."""

    job: Job
    reader: ViewsReader  # of what only extrapolation needs
    builder: IntervalBuilder  # of the view that decides
    writer: FrameWriter  # knows what earlier runs wrote
    progress: Progress
    has_layers: bool  # whether more than the beauty is written

    def __post_init__(self) -> None:
        judges, job = [], self.job
        for method in (job.method, *(() if job.method.tail is None else (job.method.tail,))):
            selector = make_selector(method, job.source, job.policy, job.settings.spent)
            gate = Gate(job, method) if job.method.gated and job.settings.gate else None
            judges.append(IntervalJudge(method, selector, gate))
        # Of intervals with a next key frame, or of all; and of those without, if others make them.
        self._judge, self._last_judge = judges[0], judges[-1]
        if job.method.tail is not None:
            self._last_builder = IntervalBuilder(
                job.source.keys.display, job.network, scratch=job.source.scratch
            )

    def prepare(self, inputs: IntervalInputs) -> tuple[PreparedInterval, IntervalInputs]:
        """Build an interval, and decide its path; return it with what is left of its inputs.

        Raises InputError when a file cannot be read that only extrapolation needs.
        """
        timeline = self.job.source.timeline
        slots = timeline.made_of(inputs.key)
        if inputs.frame is None:  # every slot of it is written
            written = PreparedInterval(None, None, frozenset(slots), {}, {})
            return written, inputs.without_geometry()
        timing_ms: dict[str, float] = {}
        judge = self._judge if inputs.following is not None else self._last_judge
        if judge.gate is not None and inputs.trial is not None:
            judge.gate.receive(inputs.trial)
        with record_time(timing_ms, "geometry", len(slots)):
            interval = replace(self.builder.build(inputs), chooser=self.job.chooser)
        existing = frozenset(
            slot
            for slot in slots
            if slot.index in inputs.rendered.frames
            or self.writer.has(timeline.number(slot), inputs.recipes[slot.index])
        )
        has_missing = len(existing) < len(slots)
        has_new = has_missing and not interval.held
        plan, trial = None, None
        if judge is not self._judge and (inputs.rendered.frames or not interval.has_motion):
            judge = self._judge  # which warps
        ends_shot = judge.method.lookahead and inputs.following is None
        if has_new and not ends_shot and judge.gate is not None and inputs.trial is not None:
            with record_time(timing_ms, "gate", len(slots)):
                trial = judge.gate.decide(inputs.trial)
        # A policy looks at every interval: the states of later ones hold what it saw.
        looks = has_new or judge.method.judge is DecisionSource.POLICY
        if judge.selector is not None and slots and looks:
            decided_ms: dict[str, float] = {}
            decided = judge.selector(inputs, interval, decided_ms)
            if not interval.held:
                plan = decided
                timing_ms |= {step: ms / len(slots) for step, ms in decided_ms.items()}
        if trial is not None and not trial.pays:
            interval = replace(interval, interpolator=None)
            plan = None if plan is None else only_warps(plan)
        extrapolates = plan is not None and plan.extrapolates
        if extrapolates and inputs.lacks_history:
            # It is built again with what only extrapolation needs.
            inputs = self.reader.leader.add_history(inputs)
            builder = self.builder if judge is self._judge else self._last_builder
            with record_time(timing_ms, "geometry", len(slots)):
                interval = builder.build(inputs)
        elif not (extrapolates or inputs.slots or inputs.truth.frames or self.has_layers):
            interval = interval.bare()  # slots are warped from the key frame
        broken: dict[int, int] = {}
        parts: Mapping[int, SubSlot] = {}
        if has_missing:
            around = (inputs.frame, inputs.following, *(past.frame for past in inputs.history))
            # Counting takes 12 ms for a frame of 1920x1080, too little to keep counts for the next.
            broken = {f.number: count_nonfinite((f.image.pixels,)) for f in around if f is not None}
            parts = self._split(interval, inputs)
        prepared = PreparedInterval(interval, plan, existing, timing_ms, broken, trial, parts)
        return prepared, inputs.without_geometry()

    def _split(self, interval: Interval, inputs: IntervalInputs) -> Mapping[int, SubSlot]:
        """Return how slots beside rendered frames are made, and say where these are of no use."""
        rendered = inputs.rendered.frames
        reader = self.reader.leader.rendered
        if reader is None or not (rendered and reader.leads and interval.has_motion):
            return {}
        timeline = self.job.source.timeline
        spans = vector_spans(interval, float(1 / timeline.factor))
        numbers = [timeline.number(Slot(inputs.key, i)) for i in rendered if i not in spans]
        if numbers:
            self.progress.message(
                f"--rendered has no vectors like the key frames' in {ranges(numbers)}: frames "
                "beside are made from key frames alone"
            )
        if self._judge.gate is not None and interval.following is None:
            interval = replace(interval, interpolator=None)  # the gate tried nothing here
        return sub_slots(interval, spans)


def make_builders(job: Job) -> list[IntervalBuilder]:
    """Return what builds the intervals of each view, the one that decides first."""
    layers, method = ExtraLayers(job.contents), job.method
    warps_alone = job.source.slots is None and not method.extrapolates and not layers.any
    return [
        IntervalBuilder(
            source.keys.display,
            job.network if method.extrapolates else None,
            job.interpolator,
            source.estimated,
            warps_alone,
            source.scratch,
            LayerKind.COLOUR in layers.kinds,  # layers of colour may add up to the beauty
            method.older_keys(method.lookahead),
        )
        for source in job.sources
    ]


def has_surface(frame: KeyFrame) -> bool:
    """Return True if a key frame comes with any of its surface."""
    parts = () if frame.gbuffer is None else SURFACE_PARTS
    return any(getattr(frame.gbuffer, part) is not None for part in parts)


def _instants(inputs: IntervalInputs) -> Iterator[tuple[Slot, GBuffer]]:
    """Yield the instants of an interval in order, each with motion from the one before it."""
    key, frame, following = inputs.key, inputs.frame, inputs.following
    if frame is None or frame.gbuffer is None:
        return
    oldest_first = list(enumerate(inputs.history, start=1))[::-1]
    if any(past.instants for _, past in oldest_first):
        for back, past in oldest_first:  # from the oldest key frame on, where slots have G-buffers
            slots = slots_back_to(key - back, len(past.instants) - 1)
            way = list(zip(slots, past.instants, strict=True))
            yield from reversed(way[1:])
        yield way[0]
    else:
        for back, past in oldest_first:
            if past.frame.gbuffer is not None:
                yield Slot(key - back, 0), past.frame.gbuffer
        yield Slot(key, 0), frame.gbuffer
    yield from ((Slot(key, i), gbuffer) for i, gbuffer in enumerate(inputs.slots, start=1))
    if not inputs.slots and following is not None and following.gbuffer is not None:
        yield Slot(key + 1, 0), following.gbuffer
