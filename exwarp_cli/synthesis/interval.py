"""One key interval: what is known of it, and the motion fields of its slots."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from threading import Lock

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, GBuffer, KeyFrame, Window, place_on_canvas
from exwarp_cli.domain.network_api import (
    Extrapolator,
    ExtrapolatorInputs,
    Interpolator,
    LookAheadNetwork,
)
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.errors import LayoutError
from exwarp_cli.runtime.frame_pool import IN_MEMORY, ScratchFrames, pool
from exwarp_cli.synthesis.camera import Scene, scene_of
from exwarp_cli.synthesis.carried_light import CarriedLight, LightFlow, light_flow
from exwarp_cli.synthesis.coverage import Coverage, Side
from exwarp_cli.synthesis.extrapolate import Prepared, prepare
from exwarp_cli.synthesis.geometry import (
    SlotField,
    completed,
    compose_forward,
    composed_back,
    matched,
    reproject,
)
from exwarp_cli.synthesis.history import (
    BetweenKeys,
    LookBack,
    Past,
    look_back,
    step_back,
)
from exwarp_cli.synthesis.look_ahead import LookAhead
from exwarp_cli.synthesis.mosaic import Mosaic, extrapolate_in
from exwarp_cli.synthesis.risk import KeyResidual, Tiles, key_residual
from exwarp_cli.synthesis.trajectory import displaced, displacement, reach_of, span_motion

QUARTERS = tuple(index / FACTOR for index in range(1, FACTOR))
"""When slots 1 to 3 are at the usual factor."""


@dataclass
class Interval:
    """A key frame, what follows it, and lazily the motion fields of its slots.

    Attributes
    ----------
    key
        The key frame F_k; its motion is settled.
    following
        F_k+1 on the same window, for look-ahead methods; None for causal ones and at the end.
    slots
        G-buffers of all slots after the key frame, with settled motion between neighbouring ones;
        empty when only the key frames have G-buffers. The key frames' vectors are then those to a
        slot beside them, times the slots of an interval.
    past
        F_k-1 and F_k-2, the newer first, as far as they exist; the second only for extrapolation.
    extrapolator
        The network that extrapolates; None for methods that only warp.
    interpolator
        The network that interpolates, or that weighs both key frames; None for methods that do
        without.
    times
        When the slots after the key frame are, in order: fractions of the key interval, 0 < time <
        1. With G-buffers of the slots they are evenly spaced from key frame to key frame.
    estimated
        Whether motion was estimated from colour rather than rendered.
    keeps
        Whether what was worked out for slots is asked for again once they are made, to score them.
    held
        True if every slot shows the picture of the key frame, as the next key frame repeats it.
    after_hold
        True if the key frame repeats the picture of the one before it: light stood still.
    scratch
        Where arrays lie that wait for a network.
    linear
        Whether colour is moved and mixed in linear light, as layers that add up to it go along.
    display
        The window whose tiles get a predicted error; None for that of the frames.
    rendered
        Frames of slots, by index, that were rendered after all, with settled motion; their vectors
        may lead over another time than the key frames' do.
    """

    key: KeyFrame
    following: KeyFrame | None = None
    slots: tuple[GBuffer, ...] = ()
    past: tuple[Past, ...] = ()
    extrapolator: Extrapolator | None = None
    interpolator: Interpolator | LookAheadNetwork | None = None
    times: tuple[float, ...] = QUARTERS
    estimated: bool = False
    keeps: bool = False
    held: bool = False
    after_hold: bool = False
    scratch: ScratchFrames = IN_MEMORY
    linear: bool = False
    display: Window | None = None
    rendered: Mapping[int, KeyFrame] = field(default_factory=dict)
    _warps: dict[int, CarriedLight] = field(default_factory=dict, init=False)
    _mixers: dict[int, LookAhead] = field(default_factory=dict, init=False)
    _back: dict[int, SlotField] = field(default_factory=dict, init=False)
    _forward: dict[int, SlotField] = field(default_factory=dict, init=False)
    _scenes: dict[int, Scene | None] = field(default_factory=dict, init=False)
    _looked: dict[int, LookBack] = field(default_factory=dict, init=False)
    _between: BetweenKeys | None = field(default=None, init=False)
    _light: list[LightFlow | None] = field(default_factory=list, init=False)
    _finding_light: Lock = field(default_factory=Lock, init=False)
    _residual: list[KeyResidual | None] = field(default_factory=list, init=False)
    _finding_residual: Lock = field(default_factory=Lock, init=False)
    _extrapolated: dict[int, Float32] = field(default_factory=dict, init=False)
    _warped: dict[int, Float32] = field(default_factory=dict, init=False)
    _composed: dict[int, Float32] = field(default_factory=dict, init=False)
    _holes: dict[int, Bool] = field(default_factory=dict, init=False)

    @property
    def has_motion(self) -> bool:
        """Whether slots can be warped from the key frame."""
        return bool(self.slots) or (self.key.gbuffer is not None and self.key.gbuffer.has_motion)

    @property
    def leads_both_ways(self) -> bool:
        """True if motion fields lead from the slots to both key frames."""
        after = None if self.following is None else self.following.gbuffer
        if after is None or not after.has_motion or not self.has_motion:
            return False
        return all(slot.to_previous is not None for slot in self.slots)

    def time(self, slot: int) -> float:
        """When a slot is, 1 for the first after the key frame: fraction of the key interval."""
        return self.times[slot - 1]

    def back(self, slot: int) -> SlotField:
        """Motion field from a slot, 1 or more, to the key frame before it.

        Raises
        ------
        LayoutError
            Without motion vectors, or where slots have G-buffers without those to the previous one.
        """
        if slot not in self._back:
            if self.slots and self.key.gbuffer is not None:
                _require_steps(self.slots, self.key)
                scenes = self._scene(slot), self._scene(slot - 1), self._scene(0)
                self._back[slot] = composed_back(self.slots[:slot], self.key.gbuffer, scenes)
            else:
                self._back[slot] = reproject(_moving(self.key), self.time(slot))
        return self._back[slot]

    def forward(self, slot: int) -> SlotField:
        """Motion field from a slot, 1 or more, to the key frame after it.

        With slot G-buffers their to-next vectors are followed; where a renderer writes none, the
        next key frame's own geometry is moved back, as with key G-buffers only.
        """
        assert self.following is not None
        if slot not in self._forward:
            composable = self.slots and all(s.to_next is not None for s in self.slots)
            if composable and self.following.gbuffer is not None:
                fields = compose_forward(self.slots, self.following.gbuffer)
                self._forward = dict(enumerate(fields, start=1))
            else:
                self._forward[slot] = reproject(_moving(self.following), self.time(slot) - 1)
        return self._forward[slot]

    @property
    def light(self) -> LightFlow | None:
        """How light moves on after the key frame; None where nothing tells. Found once."""
        if not self.past or self.estimated or self.after_hold:
            return None
        with self._finding_light:  # threads that make the slots share it
            if not self._light:
                self._light.append(self.scratch.store(light_flow(self.key, self.past[0])))
        return self._light[0]

    @property
    def tiles(self) -> Tiles:
        """The tiles whose error is predicted."""
        canvas = self.key.image.data_window
        return Tiles(canvas, self.display or canvas)

    @property
    def mosaic(self) -> Mosaic:
        """Where the pixels of `tiles` lie."""
        return Mosaic.of(self.tiles)

    @property
    def residual(self) -> KeyResidual | None:
        """How well one key frame predicts another: the next one, or by the one before. Found once.

        None where no motion leads from one to the other.
        """
        with self._finding_residual:  # threads that make the slots share it
            if not self._residual:
                self._residual.append(self._key_residual())
        return self._residual[0]

    def _key_residual(self) -> KeyResidual | None:
        after = self.following
        if after is not None:
            if after.gbuffer is None or not after.gbuffer.has_motion:
                return None
            return key_residual(self.tiles, after, self.key, displacement(after.gbuffer, -1))
        if not self.past:
            return None
        return key_residual(self.tiles, self.key, self.past[0].frame, self.past[0].motion)

    def warp(self, slot: int) -> CarriedLight:
        """Return what moves the key frame before a slot to it; one for all layers of the slot."""
        if slot in self._warps:
            return self._warps[slot]
        warp = self._warp(slot, self.linear)
        if self.linear:  # else no layers follow
            self._warps[slot] = warp
        return warp

    def _warp(self, slot: int, linear: bool) -> CarriedLight:
        time, side = self.time(slot), self._side(slot, ahead=False)
        field, coverage = self.back(slot), None
        if side is not None:
            # The slot's own surface where none of the key frame's arrives.
            field = completed(side.moved(), field) if self.slots else field
            coverage = Coverage((side,), (field,), time, linear)
        return CarriedLight(field, time, self.light, linear, coverage)

    def warped(self, slot: int) -> Float32:
        """W's frame of a slot, float32 [H, W, C], light moved as it is shown; made once."""
        if slot not in self._warped:
            made = self._warp(slot, linear=False).make(self.key.image.pixels)
            self._warped[slot] = self.scratch.store(made)
        return self._warped[slot]

    def look_ahead(self, slot: int, weighs: bool = False) -> LookAhead:
        """Return what mixes the key frames around a slot; one for all layers of the slot.

        With `weighs`, by the weights of its network, if it has one.
        """
        if slot in self._mixers:
            return self._mixers[slot]
        time, before, after = self.time(slot), *(self._side(slot, ahead) for ahead in (False, True))
        sides = None if before is None or after is None else (before, after)
        if self.slots and sides is not None:
            fields = sides[0].moved(), sides[1].moved()
        else:
            fields = self.back(slot), self.forward(slot)
        coverage = None if sides is None else Coverage(sides, fields, time, self.linear)
        network = None
        if weighs and isinstance(self.interpolator, LookAheadNetwork):
            network = self.interpolator
        mixer = LookAhead(*fields, time, self.linear, coverage, network, self.tiles)
        if self.linear:  # else no layers follow
            self._mixers[slot] = mixer
        return mixer

    def _side(self, slot: int, ahead: bool) -> Side | None:
        """Return how the surfaces of the key frame before a slot, or after it, move to the slot.

        With G-buffers of the slots, by their exact motion. By the slot's own surfaces alone
        `softsplat` was 0.1 to 1.6 dB worse, and `s6` 0.3 to 0.9 dB: what is not quite the same
        surface is a hole then, and edges are not covered.

        None where motion was estimated, which comes without depth, and where slots have G-buffers
        without vectors that way.
        """
        frame = self.following if ahead else self.key
        gbuffer = None if frame is None else frame.gbuffer
        if self.estimated or gbuffer is None or not gbuffer.has_motion:
            return None
        if not self.slots:
            side = Side(gbuffer, *displaced(gbuffer, self.time(slot) - ahead))
            # Also the slot's motion field, which holes and reports are made by.
            fields = self._forward if ahead else self._back
            if slot not in fields:
                fields[slot] = side.moved()
            return side
        start = _over_slot(gbuffer, len(self.times) + 1)
        steps = start, *(self.slots[slot - 1 :][::-1] if ahead else self.slots[:slot])
        if any((step.to_previous if ahead else step.to_next) is None for step in steps[:-1]):
            return None
        motion = span_motion(steps, -1 if ahead else 1)
        return Side(gbuffer, motion, reach_of(motion))

    def step_back(self, slot: int) -> SlotField:
        """Motion field from a slot, 2 or more, to the slot before it."""
        if slot not in range(2, len(self.times) + 1):
            raise ValueError(f"before slot {slot} there is no slot of this interval")
        if self.slots:
            here, before = self.slots[slot - 1], self.slots[slot - 2]
            assert here.to_previous is not None
            return matched(here, before, here.to_previous, 1)
        there = displacement(_moving(self.key), self.time(slot - 1))
        return step_back(self.back(slot), there, self.back(slot - 1))

    def look_back(self, slot: int) -> LookBack:
        """What is known of the surfaces of a slot, 1 to 3, in this and the older key frames."""
        if slot not in self._looked:
            back, key = self.back(slot), self.key.gbuffer
            assert key is not None  # the motion came from it
            between = self._between = self._between or BetweenKeys(key, self.past, self.scratch)
            here = self._scene(slot) if self.slots else None
            seen = look_back(slot, back, self.slots, between, here)
            self._looked[slot] = self.scratch.store(seen)
        return self._looked[slot]

    def _scene(self, slot: int) -> Scene | None:
        """Points of a slot with a G-buffer, 0 for the key frame; found once."""
        if slot not in self._scenes:
            gbuffer = self.slots[slot - 1] if slot else self.key.gbuffer
            self._scenes[slot] = None if gbuffer is None else scene_of(gbuffer)
        return self._scenes[slot]

    def prepared(self, slot: int) -> Prepared:
        """What a network needs to extrapolate to a slot, 1 to 3."""
        seen = self.look_back(slot)
        return prepare(
            slot, self.warped(slot), self.back(slot), seen, self.key, self.past, self.scratch
        )

    def extrapolated(self, slot: int) -> Float32:
        """E's frame for a slot, 2 or 3: float32 [H, W, C], scene-linear; made once.

        At slot 2 it is E(F), at slot 3 E(P1): the network never sees what was predicted.
        """
        assert self.extrapolator is not None
        if slot not in self._extrapolated:
            made = self._extrapolate(slot, self.extrapolator)
            self._extrapolated[slot] = self.scratch.store(made)
        return self._extrapolated[slot]

    def extrapolated_in(self, slot: int, chosen: Bool) -> Float32:
        """E's frame for a slot, 2 or 3, of use in chosen tiles, bool [rows, columns], alone.

        float32 [H, W, C], scene-linear; of all tiles it is what `extrapolated` makes.
        """
        network, mosaic = self.extrapolator, self.mosaic
        assert network is not None

        def answer(inputs: ExtrapolatorInputs) -> Float32:
            return extrapolate_in(mosaic, chosen, lambda *part: network(inputs.part(*part)))

        return self._extrapolate(slot, network if chosen.all() else answer)

    def composed(self, slot: int, make: Callable[[], Float32]) -> Float32:
        """A slot's frame of several makers, made once; the slot after it may be warped from it."""
        if slot not in self._composed:
            self._composed[slot] = self.scratch.store(make())
        return self._composed[slot]

    def _extrapolate(self, slot: int, network: Callable[[ExtrapolatorInputs], Float32]) -> Float32:
        self._back[slot] = self.scratch.store(self.back(slot))
        prepared = self.prepared(slot)
        self._looked.pop(slot, None)
        pool.clear()  # the network takes a gigabyte
        return prepared.finish(network(prepared.inputs))

    def forget(self, slot: int) -> None:
        """Let go of what was worked out for a slot, but for its holes; it may be asked for again.

        Motion fields of three slots take as much memory as a key frame.
        """
        self._warps.pop(slot, None)
        self._mixers.pop(slot, None)
        self._warped.pop(slot, None)
        self._composed.pop(slot, None)
        if self.keeps:
            return
        if slot in self._back:
            self._holes[slot] = self._back[slot].hole
        for known in (self._back, self._forward, self._looked):
            known.pop(slot, None)

    def without(self, *parts: str) -> Interval:
        """Return the interval as if its G-buffers lacked some parts; nothing is made yet."""
        return replace(
            self,
            key=self.key.without(*parts),
            slots=tuple(gbuffer.without(*parts) for gbuffer in self.slots),
            past=tuple(replace(step, frame=step.frame.without(*parts)) for step in self.past),
        )

    def bare(self) -> Interval:
        """Return the interval with what warps from the key frame go by; nothing is made yet."""

        def bare(frame: KeyFrame) -> KeyFrame:
            return replace(frame, gbuffer=None if frame.gbuffer is None else frame.gbuffer.bare())

        past = tuple(replace(step, frame=bare(step.frame)) for step in self.past[:1])
        return replace(self, key=bare(self.key), past=past)

    def on(self, window: Window) -> Interval:
        """Return the interval as if only a part of its frames had been rendered.

        Parameters
        ----------
        window
            Inside that of the frames.
        """

        def part(step: Past) -> Past:
            motion = place_on_canvas(step.motion, step.frame.image.data_window, window, np.nan)
            return replace(step, frame=step.frame.on(window), motion=motion)

        return replace(
            self,
            key=self.key.on(window),
            following=None if self.following is None else self.following.on(window),
            slots=tuple(gbuffer.on(window) for gbuffer in self.slots),
            past=tuple(part(step) for step in self.past),
        )

    def hole_mask(self, slot: int) -> np.ndarray | None:
        """bool [H, W]: what the warp from the key frame cannot see; None without motion."""
        if not self.has_motion:
            return None
        if self.held:  # the key frame shows all of it
            return np.zeros(self.key.image.pixels.shape[:2], np.bool_)
        return self._holes[slot] if slot in self._holes else self.back(slot).hole


def _require_steps(slots: tuple[GBuffer, ...], key: KeyFrame) -> None:
    """Refuse G-buffers of slots that colour cannot be led along."""
    if any(slot.to_previous is None for slot in slots):
        raise LayoutError(
            f"the G-buffers of the slots after frame {key.number} have no vectors to the previous "
            "slot; render them, or leave those G-buffers out"
        )


def _over_slot(gbuffer: GBuffer, steps: int) -> GBuffer:
    """Return the geometry of a key frame of `steps` slots with vectors to the slots beside it."""
    before, after = (
        None if way is None else way / np.float32(steps)
        for way in (gbuffer.to_previous, gbuffer.to_next)
    )
    return replace(gbuffer, to_previous=before, to_next=after, bend=None)


def _moving(frame: KeyFrame) -> GBuffer:
    """Return a frame's G-buffer, which must have motion."""
    if frame.gbuffer is None or not frame.gbuffer.has_motion:
        raise LayoutError(
            f"frame {frame.number} has no motion vectors, which this method needs; "
            "render the motion pass, or use --method hold or blend"
        )
    return frame.gbuffer
