"""Motion of key frames that come without vectors: estimated from colour, pair by pair."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from exwarp_cli.domain.bounds import require_canvas
from exwarp_cli.domain.frame import GBuffer, KeyFrame, Window, place
from exwarp_cli.synthesis.holds import stands_one_way
from exwarp_cli.synthesis.optical_flow import Flow, estimate, moving


class Estimates:
    """Key frames and the flows between neighbouring ones; each is read and estimated once.

    A flow depends on its two frames alone, so any part of a sequence finds the same.

    Parameters
    ----------
    read
        Called with the index of a key frame; reads its colour.
    count
        Number of key frames.
    lost
        Whether a key frame cannot be read, by its index: none moves towards it.
    """

    def __init__(
        self,
        read: Callable[[int], KeyFrame],
        count: int,
        lost: Callable[[int], bool] = lambda key: False,
    ) -> None:
        self._read = read
        self._count = count
        self._lost = lost
        self._frames: dict[int, KeyFrame] = {}
        self._flows: dict[int, tuple[Flow, Flow]] = {}

    def frame(self, key: int) -> KeyFrame:
        """Return a key frame, colour alone."""
        if key not in self._frames:
            self._frames[key] = replace(self._read(key), gbuffer=None)
        return self._frames[key]

    def flowing(self, key: int) -> KeyFrame:
        """Return a key frame with all that was estimated, as cuts are found by it."""
        frame = self.frame(key)
        flows = self._to_previous(key), self._to_next(key)
        back, ahead = (None if flow is None else flow.motion for flow in flows)
        window = frame.image.data_window
        return replace(frame, gbuffer=GBuffer(window, to_previous=back, to_next=ahead))

    def moving(self, key: int, back: bool, ahead: bool, before: bool = False) -> KeyFrame:
        """Return a key frame for synthesis.

        Where the picture stands towards one neighbour and moves towards the other, the motion
        between them is no parabola, and what fits the repeated picture best is no motion. Then the
        flow across the interval counts alone.

        Parameters
        ----------
        key
            Its index.
        back, ahead
            Whether the key frames before and after it may tell how it moves.
        before
            True for the interval before the key frame, False for the one after it.
        """
        to_previous = self._to_previous(key) if back else None
        to_next = self._to_next(key) if ahead else None
        both = None if to_previous is None or to_next is None else (to_previous, to_next)
        if both is not None and stands_one_way(*(flow.motion for flow in both)):
            to_previous, to_next = (to_previous, None) if before else (None, to_next)
        return moving(self.frame(key), to_previous, to_next)

    def forget(self, oldest: int) -> None:
        """Drop what no key frame from one on needs."""
        self._frames = {i: frame for i, frame in self._frames.items() if i >= oldest}
        self._flows = {i: pair for i, pair in self._flows.items() if i >= oldest - 1}

    def _to_previous(self, key: int) -> Flow | None:
        return self._between(key - 1)[1] if key > 0 and not self._lost(key - 1) else None

    def _to_next(self, key: int) -> Flow | None:
        leads = key + 1 < self._count and not self._lost(key + 1)
        return self._between(key)[0] if leads else None

    def _between(self, key: int) -> tuple[Flow, Flow]:
        """Return the flows from a key frame to the next, and back."""
        if key not in self._flows:
            images = self.frame(key).image, self.frame(key + 1).image
            windows = images[0].data_window, images[1].data_window
            canvas = windows[0].union(windows[1])
            require_canvas(f"frame {self.frame(key).number} and the next one", canvas)
            there, back = estimate(*(image.on(canvas).pixels for image in images))
            self._flows[key] = _on(there, canvas, windows[0]), _on(back, canvas, windows[1])
        return self._flows[key]


def _on(flow: Flow, canvas: Window, window: Window) -> Flow:
    """Return the part of a flow over the window of its frame."""
    return Flow(place(flow.motion, canvas, window), place(flow.mismatch, canvas, window))
