"""Ground truth of an interval, read with it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from exwarp_cli.domain.frame import Image
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.io.footage import picture
from exwarp_cli.io.sequence import Sequence
from exwarp_cli.pipeline.source import FrameOf, Source


@dataclass(frozen=True)
class TruthFrames:
    """Reads ground truth, as far as there is some.

    Attributes
    ----------
    source
        The view that is scored.
    truth
        The sequence, and its frame for a slot; None without.
    measured
        What is measured, as in `Score`.
    """

    source: Source
    truth: tuple[Sequence, FrameOf] | None
    measured: tuple[str, ...]

    def of(self, slots: Iterable[Slot]) -> dict[int, Image]:
        """Read ground truth by the slots' index."""
        if self.truth is None:
            return {}
        sequence, frame_of = self.truth
        found = {}
        for slot in slots:
            number = frame_of(slot)
            if number is not None:
                found[slot.index] = picture(sequence, number, self.source.keys.view)
        return found

    def ends(self, key: int) -> dict[int, Image]:
        """Read the rendered instants around an interval, for what scores it as a video."""
        if "vmaf" not in self.measured:
            return {}
        timeline = self.source.timeline
        after = Slot(key, len(timeline.between(key)) + 1)
        last = key + 1 == len(timeline.numbers)
        return self.of((Slot(key, 0),) if last else (Slot(key, 0), after))
