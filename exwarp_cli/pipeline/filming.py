"""A video of frames that are written already, by whomever."""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial

from exwarp_cli.domain.frame import Image
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.io.atomic import Held, await_file
from exwarp_cli.io.footage import picture
from exwarp_cli.pipeline.job import Job
from exwarp_cli.pipeline.run import make_writer
from exwarp_cli.pipeline.scheduling import AsyncWriter


class Film(Held):
    """Appends key intervals to a job's video, in order, behind the caller; a context manager.

    The video is whole, or not there, as `VideoWriter` has it. It equals the one of a single run
    where files hold what was made, so without a compression that loses something.

    Parameters
    ----------
    job
        With frames and a video among its targets.
    """

    def __init__(self, job: Job) -> None:
        self._job = job

    def _open(self, stack: ExitStack) -> None:
        self._sink = stack.enter_context(make_writer(self._job))
        self._writer = stack.enter_context(AsyncWriter(1, len(self._job.slots)))

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a user has to know of the video; see `VideoWriter.remarks`."""
        return self._sink.remarks

    def append(self, keys: tuple[int, ...], missing: frozenset[int] = frozenset()) -> None:
        """Append the frames of some key intervals (indices).

        All are there but those that are `missing`, by their output numbers.
        """
        timeline = self._job.source.timeline
        for slot in (slot for key in keys for slot in timeline.slots_of(key)):
            there = timeline.number(slot) not in missing
            self._writer.submit(partial(self._write, slot) if there else self._sink.show_again)

    def _write(self, slot: Slot) -> None:
        self._sink.show(self._shown(slot))

    def _shown(self, slot: Slot) -> Image:
        """Read a frame: a rendered one from where it was rendered to."""
        source, frames = self._job.source, self._job.targets.frames
        if not slot.index:
            number = source.timeline.numbers[slot.key]
            return picture(source.keys.sequence, number, source.keys.view)
        assert frames is not None
        number = source.timeline.number(slot)
        await_file(frames.path(number))  # another machine wrote it just now
        return self._sink.read(number)
