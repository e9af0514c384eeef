"""How a run shows its frames to somebody, pixel by pixel, while they are at hand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.domain.results import Score


class Watcher(Protocol):
    """Somebody who wants to see some of the frames.

    Reading a frame back costs time, so that a run asks first. Frames come in their order, from the
    thread that computes; one whose score is known late may come again at the end.
    """

    def plan(self, groups: Sequence[Sequence[int]]) -> None:
        """Hear, before the work, the numbers of all frames that will come.

        Parameters
        ----------
        groups
            Frames that are best seen together: the slots of a key interval, or single frames.
        """

    def wants(self, number: int, score: Score | None) -> bool:
        """Whether the frame of this number, with this score, is to be shown."""

    def frame(
        self, number: int, shown: Float32, truth: Float32 | None, mask: Bool | None, is_key: bool
    ) -> None:
        """Show a frame.

        Parameters
        ----------
        number
            Its output number.
        shown
            float32 [H, W, 3] or more, scene-linear, on the display window.
        truth
            What it ought to be, as `shown`; None without ground truth. A key frame is the truth.
        mask
            bool [H, W], its holes; None where nothing tells.
        is_key
            Whether it is a rendered frame.
        """
