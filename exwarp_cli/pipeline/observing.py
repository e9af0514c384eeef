"""What a policy sees of a run: the features around each key interval, each computed once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from exwarp_cli.domain.features import Features
from exwarp_cli.domain.frame import GBuffer, Window
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.pipeline.loading import Loaded, Observed
from exwarp_cli.policy.features import observe
from exwarp_cli.policy.state import KEYS_BACK, Surroundings
from exwarp_cli.synthesis.camera import scene_of
from exwarp_cli.synthesis.geometry import settle_motion, stands_still
from exwarp_cli.synthesis.interval import Interval

MOVING = 1
"""Id of all that moves, where only motion tells it: connected areas are the objects then."""


class Observer:
    """Computes features interval by interval, all on the display window.

    Parameters
    ----------
    display
        The display window of all frames.
    setting
        "key" or "slot".
    """

    def __init__(self, display: Window, setting: str) -> None:
        self._display = display
        self._span = FACTOR if setting == "key" else 1
        self._starts: dict[int, Features] = {}

    def surroundings(
        self,
        key: int,
        observed: Sequence[Observed],
        slots: Sequence[GBuffer],
        settled: GBuffer | None = None,
    ) -> Surroundings:
        """Return what the states of an interval are made of.

        Parameters
        ----------
        key
            Index of the key frame.
        observed
            Its instant, and those that were not seen before.
        slots
            G-buffers of slots 1 to 3 on the display window with settled motion; empty where there
            are none.
        settled
            The key frame's on the display window with settled motion, where it is at hand.
        """
        for instant in observed:
            before = None if instant.before is None else instant.before.on(self._display)
            now = settled if instant.key == key else None
            if now is None:
                now = settle_motion(instant.now.on(self._display))
            self._starts[instant.key] = observe(with_ids(now), before, self._span)
        start = self._starts[key]
        now_on = (start, start, start)
        if slots:
            first, second = (with_ids(slot) for slot in slots[:2])
            at_key = observed[-1].now.on(self._display)
            now_on = (start, observe(first, at_key, 1), observe(second, first, 1))
        older = range(key - 1, max(key - 1 - KEYS_BACK, -1), -1)
        before_it = tuple(self._starts[i] for i in older)
        self._starts = {i: found for i, found in self._starts.items() if i > key - KEYS_BACK}
        return Surroundings(now_on, before_it)

    def of(self, loaded: Loaded, interval: Interval) -> Surroundings:
        """Return what the states of an interval are made of that was read and staged.

        Motion settled on another window than the display's differs in its last digits, as other
        points are looked at; so it is settled again then.
        """
        settled, slots = None, interval.slots
        whole = loaded.frame is not None and loaded.frame.image.data_window == self._display
        if self._span == FACTOR and whole and interval.key.image.data_window == self._display:
            settled = interval.key.gbuffer
        if interval.key.image.data_window != self._display:
            slots = self.settled(loaded.slots)
        return self.surroundings(loaded.key, loaded.observed, slots, settled)

    def settled(self, slots: Sequence[GBuffer]) -> tuple[GBuffer, ...]:
        """Return G-buffers of slots as `surroundings` takes them."""
        return tuple(settle_motion(slot.on(self._display)) for slot in slots)


def with_ids(gbuffer: GBuffer) -> GBuffer:
    """Return a G-buffer with object ids: its own, else of what moves otherwise than the camera.

    Parameters
    ----------
    gbuffer
        With settled motion. Without ids, positions or depth it stays as it is.
    """
    if gbuffer.stencil is not None:
        return gbuffer
    still = stands_still(gbuffer, scene_of(gbuffer))
    if still is None:
        return gbuffer
    moving = ~still & ~gbuffer.background
    return replace(gbuffer, stencil=np.where(moving, MOVING, 0).astype(np.int32))
