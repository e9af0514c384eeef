"""Ground truth of an interval, read with it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from exwarp_cli.domain.frame import Image, Window
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.errors import InputError, LayoutError
from exwarp_cli.io.footage import picture
from exwarp_cli.io.nonfinite import NonFinite, count_broken
from exwarp_cli.io.sequence import Sequence
from exwarp_cli.pipeline.source import FrameOf, Source

CALLED = "ground truth"
"""What the report calls the channels of its frames."""

Frames = dict[int, Image]
"""Ground truth by the slots' index."""


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
    bearable
        Whether to go on without frames that cannot be used.
    nonfinite
        What was found in its frames, by the number of the output frame.
    """

    source: Source
    truth: tuple[Sequence, FrameOf] | None
    measured: tuple[str, ...]
    bearable: bool = False
    nonfinite: NonFinite = field(default_factory=NonFinite)

    def around(self, key: int) -> tuple[Frames, Frames, dict[int, str]]:
        """Read what an interval is scored by.

        Returns
        -------
        truth
            Of the slots that are made.
        ends
            The rendered instants around, for what scores the interval as a video.
        lost
            Why frames among them cannot be used, by slot, as far as that is bearable.

        Raises
        ------
        InputError
            When one is damaged, holds no colour or is of another size, and that is not bearable.
        """
        if self.truth is None:
            return {}, {}, {}
        lost: dict[int, str] = {}
        truth = self._of(self.source.timeline.made_of(key), lost)
        return truth, self._of(self._ends(key), lost), lost

    def _of(self, slots: Iterable[Slot], lost: dict[int, str]) -> Frames:
        found = {}
        for slot in slots:
            try:
                image = self._frame(slot)
            except InputError as error:
                if not self.bearable:
                    raise
                lost[slot.index] = str(error)
                continue
            if image is not None:
                found[slot.index] = image
        return found

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
        self.nonfinite.note(output, {CALLED: count_broken((image.pixels,))})
        return image

    def _ends(self, key: int) -> tuple[Slot, ...]:
        """Return the instants around an interval that are wanted."""
        if "vmaf" not in self.measured:
            return ()
        timeline = self.source.timeline
        after = Slot(key, len(timeline.between(key)) + 1)
        last = key + 1 == len(timeline.numbers)
        return (Slot(key, 0),) if last else (Slot(key, 0), after)


def truth_of_another_size(output: int, found: Window, display: Window) -> LayoutError:
    """Build the error for the truth of an output frame that has another size than the input."""
    return LayoutError(
        f"--ground-truth for frame {output} is {found} and the input is {display}; give a sequence "
        "of the same resolution"
    )
