"""From what was read of an interval to what synthesis works on: one window, settled motion."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from exwarp_cli.domain.bounds import require_canvas
from exwarp_cli.domain.extrapolator import HISTORY, Extrapolator
from exwarp_cli.domain.frame import SURFACE_PARTS, Float32, GBuffer, KeyFrame, Window
from exwarp_cli.domain.interpolator import Interpolator
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.pipeline.instants import between, without_surface
from exwarp_cli.pipeline.loaded import Loaded, Older
from exwarp_cli.pipeline.moving_ids import Ids, MovingIds, with_stencils
from exwarp_cli.runtime.frame_pool import IN_MEMORY, ScratchFrames
from exwarp_cli.synthesis.geometry import settle_motion
from exwarp_cli.synthesis.history import Past
from exwarp_cli.synthesis.holds import around_holds
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.span import span_motion
from exwarp_cli.synthesis.trajectory import displacement

Basis = tuple[Window, Ids | None]
"""What settled geometry goes by: the window, and which objects move, where the frames tell."""


class Staging:
    """Makes intervals in order; what several of them share is settled once.

    Data windows may differ from frame to frame, and what moves from interval to interval, so what
    is shared goes by these, too.

    Parameters
    ----------
    display
        The display window of all frames.
    network
        For methods that extrapolate.
    interpolator
        For methods that have a network interpolate.
    estimated
        Whether key frames come with estimated motion, which is settled as it is.
    bare
        Whether nobody asks for more of key frames' settled geometry than motion and depth.
    scratch
        Where settled key frames lie that a network may see.
    """

    def __init__(
        self,
        display: Window,
        network: Extrapolator | None = None,
        interpolator: Interpolator | None = None,
        estimated: bool = False,
        bare: bool = False,
        scratch: ScratchFrames = IN_MEMORY,
    ) -> None:
        self._display = display
        self._network = network
        self._interpolator = interpolator
        self._estimated = estimated
        self._bare = bare
        self._scratch = scratch
        self._moving = MovingIds()
        self._frames: dict[tuple[int, Basis], KeyFrame] = {}
        self._instants: dict[tuple[Slot, Basis], GBuffer] = {}
        self._past: dict[tuple[int, Basis], Past] = {}
        self._incomplete: KeyFrame | None = None

    def interval(self, loaded: Loaded) -> Interval:
        """Bring what was read onto one window: the display's and the data of the frames around.

        Of a region of a picture, its own.
        """
        assert loaded.frame is not None
        window = loaded.frame.image.data_window
        canvas = window if loaded.region else self._display.union(window)
        if loaded.following is not None and not loaded.region:
            canvas = canvas.union(loaded.following.image.data_window)
        require_canvas(f"frame {loaded.frame.number} and the next one", canvas)
        ids = self._moving.of(loaded, canvas)
        return self._settled(with_stencils(loaded, ids), (canvas, ids))

    def led_back(self, interval: Interval, loaded: Loaded) -> Interval:
        """Return an interval with what only extrapolation wants.

        Parameters
        ----------
        interval
            Of the key setting, as it was made without that; nothing was made of it yet.
        loaded
            What it was made of, and that.
        """
        frame, settled = loaded.frame, interval.key.gbuffer
        if frame is None or frame.gbuffer is None or settled is None:
            return interval
        window = interval.key.image.data_window
        surface = _surface(GBuffer(frame.gbuffer.window, **_surface(frame.gbuffer)).on(window))
        key = replace(interval.key, gbuffer=replace(settled, **surface))
        basis = window, None
        # What leads back goes by all vectors of the key frame: those of the interval may lack some.
        whole = self._incomplete
        assert whole is not None and whole.gbuffer is not None
        whole = replace(whole, gbuffer=replace(whole.gbuffer, **surface))
        self._frames[loaded.key, basis] = whole
        return replace(interval, key=key, past=self._led_back(loaded, whole, basis))

    def _settled(self, loaded: Loaded, basis: Basis) -> Interval:
        """Settle what was read, on one window and with what moves as its stencil."""
        assert loaded.frame is not None
        following = None
        if loaded.following is not None:
            following = self._frame(loaded.key + 1, loaded.following, basis)
        key = self._frame(loaded.key, self._whole(loaded, basis), basis)
        if loaded.late is not None:  # without its surface, none that follows has a use for it
            self._incomplete = self._frames.pop((loaded.key, basis))
        slots = tuple(
            self._scratch.store(settle_motion(gbuffer.on(basis[0]))) for gbuffer in loaded.slots
        )
        past = self._led_back(loaded, key, basis)
        self._keep(loaded.key, slots, basis)
        networks = (self._network, self._interpolator)
        if not (self._estimated or loaded.held or slots):
            key, following = around_holds(key, following, loaded.after_hold)
        return Interval(
            key,
            following,
            slots,
            past,
            *networks,
            loaded.times,
            estimated=self._estimated,
            keeps=bool(loaded.truth),
            held=loaded.held,
            scratch=self._scratch,
        )

    def _whole(self, loaded: Loaded, basis: Basis) -> KeyFrame:
        """Return a key frame as it was read, unless it is settled and no more than colour came."""
        assert loaded.frame is not None
        if loaded.again is None or (loaded.key, basis) in self._frames:
            return loaded.frame
        return loaded.again()

    def _frame(self, index: int, frame: KeyFrame, basis: Basis) -> KeyFrame:
        if self._estimated:  # the flows of an interval are its own
            return frame.extended(basis[0])
        if (index, basis) not in self._frames:
            placed = frame.extended(basis[0])
            if placed.gbuffer is not None:
                placed = replace(placed, gbuffer=settle_motion(placed.gbuffer))
            if self._bare and placed.gbuffer is not None:
                placed = replace(placed, gbuffer=placed.gbuffer.bare())
            self._frames[index, basis] = self._scratch.store(placed)
            self._scratch.page_out()
        return self._frames[index, basis]

    def _led_back(self, loaded: Loaded, key: KeyFrame, basis: Basis) -> tuple[Past, ...]:
        found: list[Past] = []
        newer = key
        for index, older in zip(range(loaded.key - 1, -1, -1), loaded.past, strict=False):
            if (index, basis) not in self._past:
                motion = self._scratch.store(self._motion(index, older, newer, basis))
                self._past[index, basis] = Past(self._frame(index, older.frame, basis), motion)
            found.append(self._past[index, basis])
            newer = found[-1].frame
        return tuple(found)

    def _motion(self, index: int, older: Older, newer: KeyFrame, basis: Basis) -> Float32:
        """Return the motion, float32 [H, W, 2], from a key frame to the one before it."""
        if older.held:
            return np.zeros((*basis[0].shape, 2), np.float32)
        if not older.instants:
            assert newer.gbuffer is not None
            return displacement(newer.gbuffer, -1)
        *way, end = zip(between(index), older.instants, strict=True)
        instants = [self._instant(slot, gbuffer, basis) for slot, gbuffer in way]
        return span_motion([*instants, end[1].on(basis[0])], -1)

    def _instant(self, slot: Slot, gbuffer: GBuffer, basis: Basis) -> GBuffer:
        known = self._instants.get((slot, basis))
        return settle_motion(gbuffer.on(basis[0])) if known is None else known

    def _keep(self, key: int, slots: tuple[GBuffer, ...], basis: Basis) -> None:
        """Drop what no later interval needs."""
        oldest = key + 1 - (HISTORY - 1 if self._network is not None else 0)
        self._frames = {place: f for place, f in self._frames.items() if place[0] >= oldest}
        self._past = {place: past for place, past in self._past.items() if place[0] >= oldest}
        if self._network is not None:
            self._instants = {
                (Slot(key, i), basis): without_surface(gbuffer)
                for i, gbuffer in enumerate(slots, start=1)
            }


def _surface(gbuffer: GBuffer) -> dict[str, Any]:
    return {part: getattr(gbuffer, part) for part in SURFACE_PARTS}
