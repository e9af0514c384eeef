"""What is NaN or infinite in the frames that were read."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from exwarp_cli.domain.results import BrokenPixels
from exwarp_cli.domain.timeline import Slot

if TYPE_CHECKING:
    from exwarp_cli.io.soundness import NonFinite
    from exwarp_cli.pipeline.job import Job
    from exwarp_cli.pipeline.source import Source


def broken_pixels_of(job: Job, truth: NonFinite) -> tuple[BrokenPixels, ...]:
    """Return what was found in the selected key frames, and in what the slots after them have.

    Frames around that were read as well are told of by the chunks that they belong to.

    Parameters
    ----------
    job
        All of whose frames were read.
    truth
        What was found in ground truth, by output frame.
    """
    return tuple(
        one
        for key in job.keys
        for source in job.sources
        for one in _in_interval(source, key, truth if source is job.source else None)
    )


def _in_interval(source: Source, key: int, truth: NonFinite | None) -> Iterator[BrokenPixels]:
    """Yield what was found in one view of a key interval."""
    timeline, view = source.timeline, source.keys.view
    number = timeline.numbers[key]
    for channels, pixels in source.keys.nonfinite.of(number):
        yield BrokenPixels(number, 0, view, channels, pixels)
    for slot in (Slot(key, 0), *timeline.between(key)):
        instant = None if source.slots is None else source.slot_number(slot)
        if instant is not None and source.slots is not None:
            for channels, pixels in source.slots.nonfinite.of(instant):
                yield BrokenPixels(number, slot.index, view, channels, pixels)
        if truth is not None:
            for channels, pixels in truth.of(timeline.number(slot)):
                yield BrokenPixels(number, slot.index, view, channels, pixels)
