"""One key interval: its frames and networks, and lazily the motion fields of its slots."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from threading import Lock

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, GBuffer, KeyFrame, Window, place_on_canvas
from exwarp_cli.domain.network_api import Extrapolator, Interpolator, LookAheadNetwork
from exwarp_cli.domain.tiles import TILE_FEATURES, TILE_ROWS
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.errors import LayoutError
from exwarp_cli.runtime.frame_pool import IN_MEMORY, ScratchFrames, pool
from exwarp_cli.synthesis import history, motion_fields, predicted_error
from exwarp_cli.synthesis.camera import F64, Scene, scene_of
from exwarp_cli.synthesis.extrapolation import Prepared, prepare
from exwarp_cli.synthesis.look_ahead import LookAhead
from exwarp_cli.synthesis.mosaic import Mosaic, Tiles, lay_tiles
from exwarp_cli.synthesis.residual_flow import CarriedLight, LightFlow, find_light_flow
from exwarp_cli.synthesis.trajectory import displacement, span_motion
from exwarp_cli.synthesis.warp import Coverage, CoverageSide, Mover

# Times of slots 1 to 3 at the usual factor.
QUARTERS = tuple(index / FACTOR for index in range(1, FACTOR))

# Chooses the tiles whose key frames a network weighs, bool [rows, columns], by their
# `LOOK_AHEAD_FEATURES`, float64 [rows, columns, 6], and the time of the slot.
TileChooser = Callable[[F64, float], Bool]


@dataclass
class Interval:
    """A key frame, the frames around it, and lazily the motion fields of its slots."""

    key: KeyFrame  # the key frame F_k; its motion is settled
    # F_k+1 on the same window, for look-ahead methods; None for causal ones and at the end.
    following: KeyFrame | None = None
    # G-buffers of all slots after the key frame, with settled motion between neighbouring ones;
    # empty when only the key frames have G-buffers. The key frames' vectors are then those to a
    # slot beside them, times the slots of an interval.
    slots: tuple[GBuffer, ...] = ()
    # F_k-1 and F_k-2, the newer first, as far as they exist; the second only for extrapolation.
    past: tuple[history.OlderKeyFrame, ...] = ()
    # The network that extrapolates; None for methods that only warp.
    extrapolator: Extrapolator | None = None
    # The network that interpolates, or that weighs both key frames.
    interpolator: Interpolator | LookAheadNetwork | None = None
    # Of the slots after the key frame, in order: fractions of the key interval, 0 < time < 1. With
    # G-buffers of the slots they are evenly spaced from key frame to key frame.
    times: tuple[float, ...] = QUARTERS
    estimated: bool = False  # whether motion was estimated from colour rather than rendered
    # Whether results for slots are needed again once the slots are made, to score them.
    keeps: bool = False
    # True if every slot shows the picture of the key frame, as the next key frame repeats it.
    held: bool = False
    # True if the key frame repeats the picture of the one before it: light stood still.
    after_hold: bool = False
    scratch: ScratchFrames = IN_MEMORY  # where arrays are kept that wait for a network
    # Whether colour is moved and mixed in linear light, as layers that add up to it go along.
    linear: bool = False
    # The window whose tiles get a predicted error; None for that of the frames.
    display: Window | None = None
    # Frames of slots, by index, that were rendered after all, with settled motion; their vectors
    # may lead over another time than the key frames' do.
    rendered: Mapping[int, KeyFrame] = field(default_factory=dict)
    chooser: TileChooser | None = None  # of the tiles in which a network weighs; None for all
    # Frames of slots that are made by several makers, kept as the next may be warped from them.
    composed: dict[int, Float32] = field(default_factory=dict, init=False)
    _warps: dict[int, CarriedLight] = field(default_factory=dict, init=False)
    _mixers: dict[int, LookAhead] = field(default_factory=dict, init=False)
    _back: dict[int, motion_fields.SlotField] = field(default_factory=dict, init=False)
    _forward: dict[int, motion_fields.SlotField] = field(default_factory=dict, init=False)
    _scenes: dict[int, Scene | None] = field(default_factory=dict, init=False)
    # Empty until the first of several threads has found them for all, under the lock.
    _light: list[LightFlow | None] = field(default_factory=list, init=False)
    _residual: list[predicted_error.KeyResidual] = field(default_factory=list, init=False)
    _lock: Lock = field(default_factory=Lock, init=False)
    _extrapolated: dict[int, Float32] = field(default_factory=dict, init=False)
    _warped: dict[int, Float32] = field(default_factory=dict, init=False)
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
        """Return when a slot is, 1 for the first: fraction of the key interval."""
        return self.times[slot - 1]

    def back(self, slot: int) -> motion_fields.SlotField:
        """Return the motion field from a slot, 1 or more, to the key frame before it.

        Raises LayoutError without motion vectors, or where slots have G-buffers without those to
        the previous one.
        """
        if slot not in self._back:
            if self.slots and self.key.gbuffer is not None:
                if any(gbuffer.to_previous is None for gbuffer in self.slots):
                    raise LayoutError(
                        f"the G-buffers of the slots after frame {self.key.number} have no vectors "
                        "to the previous slot; render them, or leave those G-buffers out"
                    )
                scenes = self._scene(slot), self._scene(slot - 1), self._scene(0)
                self._back[slot] = motion_fields.compose(
                    self.slots[:slot], self.key.gbuffer, -1, scenes
                )
            else:
                gbuffer = _require_motion(self.key)
                self._back[slot] = motion_fields.reproject(gbuffer, self.time(slot))
        return self._back[slot]

    def forward(self, slot: int) -> motion_fields.SlotField:
        """Return the motion field from a slot, 1 or more, to the key frame after it.

        With slot G-buffers their to-next vectors are followed; where a renderer writes none, the
        next key frame's own geometry is moved back, as with key G-buffers only.
        """
        assert self.following is not None
        if slot not in self._forward:
            after, steps = self.following.gbuffer, self.slots[slot - 1 :]
            if steps and after is not None and all(s.to_next is not None for s in self.slots):
                last = len(self.slots) + 1
                scenes = self._scene(slot), self._scene(slot + 1), self._scene(last)
                self._forward[slot] = motion_fields.compose(steps[::-1], after, 1, scenes)
            else:
                time = self.time(slot) - 1
                self._forward[slot] = motion_fields.reproject(_require_motion(self.following), time)
        return self._forward[slot]

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
    def residual(self) -> predicted_error.KeyResidual:
        """How well the next key frame predicts this one, or this one is by the one before.

        0 where no motion leads from one to the other.
        """
        key, after, tiles = self.key, self.following, self.tiles
        with self._lock:
            if not self._residual:
                none = np.zeros((TILE_ROWS, tiles.columns))
                residual = predicted_error.KeyResidual(none, none)
                if after is None and self.past:
                    older = self.past[0]
                    residual = predicted_error.key_residual(tiles, key, older.frame, older.motion)
                elif after is not None and after.gbuffer is not None and after.gbuffer.has_motion:
                    motion = displacement(after.gbuffer, -1)
                    residual = predicted_error.key_residual(tiles, after, key, motion)
                self._residual.append(residual)
        return self._residual[0]

    def warp(self, slot: int, as_shown: bool = False) -> CarriedLight:
        """Return what moves the key frame before a slot to it; one for all layers of the slot.

        With `as_shown`, it moves the beauty alone, and not in linear light.
        """
        linear = self.linear and not as_shown
        if linear and slot in self._warps:
            return self._warps[slot]
        light = None
        if self.past and not self.estimated and not self.after_hold:
            with self._lock:
                if not self._light:
                    self._light.append(self.scratch.store(find_light_flow(self.key, self.past[0])))
            light = self._light[0]
        time, side = self.time(slot), self._side(slot, ahead=False)
        source, coverage, moving = self.back(slot), None, None
        if side is not None:
            # The slot's own surface where none of the key frame's arrives.
            source = motion_fields.fill_unknown(side.moved(), source) if self.slots else source
            coverage = Coverage((side,), (source,), time, linear)
        if light is not None:
            shifted, weight = light.shifted(source, time)
            moving = (Mover(shifted, linear), weight) if weight.any() else None
        warp = CarriedLight(Mover(source, linear), moving, coverage)
        if linear:  # else no layers follow
            self._warps[slot] = warp
        return warp

    def warped(self, slot: int) -> Float32:
        """Return W's frame of a slot, float32 [H, W, C], colour moved as shown; made once."""
        if slot not in self._warped:
            frame = self.warp(slot, as_shown=True).make(self.key.image.pixels)
            self._warped[slot] = self.scratch.store(frame)
        return self._warped[slot]

    def look_ahead(self, slot: int, weighs: bool = False) -> LookAhead:
        """Return what mixes the key frames around a slot; one for all layers of the slot.

        With `weighs`, by the weights of the interval's network, if it has one.
        """
        if slot in self._mixers:
            return self._mixers[slot]
        time = self.time(slot)
        before, after = self._side(slot, ahead=False), self._side(slot, ahead=True)
        sides = None if before is None or after is None else (before, after)
        if self.slots and sides is not None:
            fields = sides[0].moved(), sides[1].moved()
        else:
            fields = self.back(slot), self.forward(slot)
        coverage = None if sides is None else Coverage(sides, fields, time, self.linear)
        network = choose = None
        if weighs and isinstance(self.interpolator, LookAheadNetwork):
            network, chooser = self.interpolator, self.chooser
            if chooser is not None:

                def choose(evidence: predicted_error.TileEvidence) -> Bool:
                    features = predicted_error.look_ahead_features(evidence, self.residual)
                    return chooser(features, time)

        movers = Mover(fields[0], self.linear), Mover(fields[1], self.linear)
        mixer = LookAhead(movers, time, coverage, network, self.tiles, choose)
        if self.linear:  # else no layers follow
            self._mixers[slot] = mixer
        return mixer

    def _side(self, slot: int, ahead: bool) -> CoverageSide | None:
        """Return how the surfaces of the key frame before a slot, or after it, move to the slot.

        None where motion was estimated, which comes without depth, and where slots have G-buffers
        without vectors that way.
        """
        frame = self.following if ahead else self.key
        gbuffer = None if frame is None else frame.gbuffer
        if self.estimated or gbuffer is None or not gbuffer.has_motion:
            return None
        if not self.slots:
            side = CoverageSide(gbuffer, displacement(gbuffer, self.time(slot) - ahead))
            # Also the slot's motion field, for holes and reports.
            fields = self._forward if ahead else self._back
            if slot not in fields:
                fields[slot] = side.moved()
            return side
        # By the exact motion of the slots' G-buffers. By the slot's own surfaces alone `softsplat`
        # was 0.1 to 1.6 dB worse, and `s6` 0.3 to 0.9 dB: what is not quite the same surface is a
        # hole then, and edges are not covered.
        to_previous, to_next = (
            None if vectors is None else vectors / np.float32(len(self.times) + 1)
            for vectors in (gbuffer.to_previous, gbuffer.to_next)
        )
        start = replace(gbuffer, to_previous=to_previous, to_next=to_next, bend=None)
        steps = start, *(self.slots[slot - 1 :][::-1] if ahead else self.slots[:slot])
        if any((step.to_previous if ahead else step.to_next) is None for step in steps[:-1]):
            return None
        return CoverageSide(gbuffer, span_motion(steps, -1 if ahead else 1))

    def step_back(self, slot: int) -> motion_fields.SlotField:
        """Return the motion field from a slot, 2 or more, to the slot before it."""
        if slot not in range(2, len(self.times) + 1):
            raise ValueError(f"before slot {slot} there is no slot of this interval")
        if self.slots:
            gbuffer, before = self.slots[slot - 1], self.slots[slot - 2]
            assert gbuffer.to_previous is not None
            return motion_fields.field_between(gbuffer, before, gbuffer.to_previous, 1)
        there = displacement(_require_motion(self.key), self.time(slot - 1))
        return history.step_back(self.back(slot), there, self.back(slot - 1))

    def look_back(self, slot: int) -> history.HistorySamples:
        """Return the surfaces of a slot, 1 to 3, in this and the older key frames."""
        back, key = self.back(slot), self.key.gbuffer
        assert key is not None  # the motion came from it
        scene = self._scene(slot if self.slots else 0) if self.past else None
        sources = key, self.past, scene, self.scratch
        if self.slots:
            return history.look_back_rendered(slot, self.slots[slot - 1], back, *sources)
        return history.look_back_reprojected(slot / FACTOR, back, *sources)

    def _scene(self, index: int) -> Scene | None:
        """Return the points of a slot's G-buffer, of the key frame (0) or of the following one."""
        if index not in self._scenes:
            after = None if self.following is None else self.following.gbuffer
            gbuffer = (self.key.gbuffer, *self.slots, after)[index]
            self._scenes[index] = None if gbuffer is None else scene_of(gbuffer)
        return self._scenes[index]

    def prepared(self, slot: int) -> Prepared:
        """Return what a network needs to extrapolate to a slot, 1 to 3."""
        samples = self.scratch.store(self.look_back(slot))
        return prepare(
            slot, self.warped(slot), self.back(slot), samples, self.key, self.past, self.scratch
        )

    def extrapolated(self, slot: int, chosen: Bool | None = None) -> Float32:
        """Return E's frame for a slot, 2 or 3: float32 [H, W, C], scene-linear.

        At slot 2 it is E(F), at slot 3 E(P1): the network never sees what was predicted. It is made
        once; with `chosen`, bool [rows, columns], each time, and valid in these tiles alone.
        """
        network = self.extrapolator
        assert network is not None
        if chosen is None and slot in self._extrapolated:
            return self._extrapolated[slot]
        self._back[slot] = self.scratch.store(self.back(slot))
        prepared = self.prepared(slot)
        pool.clear()  # the network takes a gigabyte
        if chosen is None or chosen.all():
            answer = network(prepared.inputs)
        else:
            inputs, mosaic = prepared.inputs, self.mosaic
            answer = np.zeros((3, *mosaic.shape), np.float32)
            parts = mosaic.parts(chosen)
            answers = ((*part, network(inputs.part(part[1], part[2]))) for part in parts)
            lay_tiles(mosaic, answers, answer)
        frame = prepared.finish(answer)
        if chosen is None:
            frame = self._extrapolated[slot] = self.scratch.store(frame)
        return frame

    def forget(self, slot: int) -> None:
        """Drop what was computed for a slot, but for its holes; it may be computed again.

        Motion fields of three slots take as much memory as a key frame.
        """
        self._warps.pop(slot, None)
        self._mixers.pop(slot, None)
        self._warped.pop(slot, None)
        self.composed.pop(slot, None)
        if self.keeps:
            return
        if slot in self._back:
            self._holes[slot] = self._back[slot].hole
        self._back.pop(slot, None)
        self._forward.pop(slot, None)

    def bare(self) -> Interval:
        """Return the interval with no more than warps from the key frame use."""
        frames = (self.key, *(step.frame for step in self.past[:1]))
        key, *older = (replace(f, gbuffer=f.gbuffer and f.gbuffer.bare()) for f in frames)
        past = (replace(self.past[0], frame=older[0]),) if older else ()
        return replace(self, key=key, past=past)

    def on(self, window: Window) -> Interval:
        """Return the interval as if only a window inside its frames had been rendered."""
        past = tuple(
            replace(
                step,
                frame=step.frame.on(window),
                motion=place_on_canvas(step.motion, step.frame.image.data_window, window, np.nan),
            )
            for step in self.past
        )
        return replace(
            self,
            key=self.key.on(window),
            following=None if self.following is None else self.following.on(window),
            slots=tuple(gbuffer.on(window) for gbuffer in self.slots),
            past=past,
        )

    def hole_mask(self, slot: int) -> np.ndarray | None:
        """bool [H, W]: what the warp from the key frame cannot see; None without motion."""
        if not self.has_motion:
            return None
        if self.held:  # the key frame shows all of it
            return np.zeros(self.key.image.pixels.shape[:2], np.bool_)
        return self._holes[slot] if slot in self._holes else self.back(slot).hole


def _require_motion(frame: KeyFrame) -> GBuffer:
    if frame.gbuffer is None or not frame.gbuffer.has_motion:
        raise LayoutError(
            f"frame {frame.number} has no motion vectors, which this method needs; "
            "render the motion pass, or use --method hold or blend"
        )
    return frame.gbuffer


def tile_features(
    interval: Interval,  # With motion. Its next key frame is not used.
    slot: int,  # 1 or more; nothing of it needs to be made
) -> F64:
    """Return the features of a slot's tiles, by which a policy chooses what makes each of them.

    Returns float64 [rows, columns, 6]: in the order of `TILE_FEATURES`; the key residuals are 0
    after the first key frame of a shot.
    """
    # Earth mover's distances of the tiles' normals and positions, as the paper has them of frames,
    # were tried as well: at a quarter of the area the choice was no better for them, and they took
    # 20 ms a tile.
    tiles, back, time = interval.tiles, interval.back(slot), interval.time(slot)
    # Unknown motion has no variance either.
    motion = np.nan_to_num(tiles.sample(back.field)).astype(np.float64) / time
    masks = [tiles.sample(mask).astype(np.float64) for mask in (back.hole, back.ghosts)]
    moments = [motion[..., axis] ** power for power in (1, 2) for axis in (0, 1)]
    holes, outlines, x, y, xx, yy = tiles.means([*masks, *moments])
    variances = (np.maximum(square - mean**2, 0) for square, mean in ((xx, x), (yy, y)))
    residual = interval.residual
    parts = holes, outlines, *variances, residual.light, residual.motion
    features = np.stack(parts, axis=-1)
    assert features.shape[-1] == len(TILE_FEATURES)
    return features
