"""Ground truth of an interval, read with it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from exwarp_cli.domain.frame import Image, Window
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.errors import InputError, LayoutError
from exwarp_cli.io.footage import picture
from exwarp_cli.io.sequence import Sequence
from exwarp_cli.io.soundness import NonFinite, count_broken
from exwarp_cli.pipeline.source import FrameOf, Source

CHANNELS = "ground truth"
"""What the report calls the channels of its frames."""


@dataclass(frozen=True)
class IntervalTruth:
    """Ground truth of one interval, as far as there is some.

    Attributes
    ----------
    frames
        By slot, of the slots that are made.
    ends
        The rendered instants around, at slot 0 and, counted on as a slot, at the next key frame's
        instant; only for VMAF.
    unscored
        Why frames cannot be used, by slot, where the run goes on without them.
    """

    frames: dict[int, Image] = field(default_factory=dict)
    ends: dict[int, Image] = field(default_factory=dict)
    unscored: dict[int, str] = field(default_factory=dict)


@dataclass(frozen=True)
class TruthReader:
    """Reads ground truth, as far as there is some.

    Attributes
    ----------
    source
        The view that is scored.
    truth
        The sequence, and its frame for a slot; None without.
    measured
        What is measured, as in `Score`.
    tolerant
        Whether to go on without frames that cannot be used.
    nonfinite
        What was counted in its frames, by the number of the output frame.
    """

    source: Source
    truth: tuple[Sequence, FrameOf] | None
    measured: tuple[str, ...]
    tolerant: bool = False
    nonfinite: NonFinite = field(default_factory=NonFinite)

    def read(self, key: int) -> IntervalTruth:
        """Read what an interval is scored by.

        Raises
        ------
        InputError
            When a frame is damaged, holds no colour or is of another size, unless tolerant.
        """
        result = IntervalTruth()
        if self.truth is None:
            return result
        timeline = self.source.timeline
        self._read_into(result.frames, timeline.made_of(key), result.unscored)
        if "vmaf" in self.measured:
            self._read_into(result.ends, self._ends(key), result.unscored)
        return result

    def _read_into(
        self, frames: dict[int, Image], slots: Iterable[Slot], unscored: dict[int, str]
    ) -> None:
        for slot in slots:
            try:
                image = self._frame(slot)
            except InputError as error:
                if not self.tolerant:
                    raise
                unscored[slot.index] = str(error)
                continue
            if image is not None:
                frames[slot.index] = image

    def _frame(self, slot: Slot) -> Image | None:
        """Read a frame; None where the sequence has none for the slot."""
        assert self.truth is not None
        sequence, frame_of = self.truth
        number = frame_of(slot)
        if number is None:
            return None
        image, display = picture(sequence, number, self.source.keys.view), self.source.keys.display
        output = self.source.timeline.number(slot)
        if image.display_window.shape != display.shape:
            raise truth_of_another_size(output, image.display_window, display)
        self.nonfinite.note(output, {CHANNELS: count_broken((image.pixels,))})
        return image

    def _ends(self, key: int) -> tuple[Slot, ...]:
        timeline = self.source.timeline
        after = Slot(key, len(timeline.between(key)) + 1)
        last = key + 1 == len(timeline.numbers)
        return (Slot(key, 0),) if last else (Slot(key, 0), after)


def truth_of_another_size(output: int, size: Window, display: Window) -> LayoutError:
    """Build the error for the truth of an output frame that has another size than the input."""
    return LayoutError(
        f"--ground-truth for frame {output} is {size} and the input is {display}; give a sequence "
        "of the same resolution"
    )
