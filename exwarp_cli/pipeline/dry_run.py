"""What a run would do, found out without doing it: nothing is written, no folder is made."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from exwarp_cli.domain.joining import Outcome
from exwarp_cli.domain.results import FrameKind, RunSummary
from exwarp_cli.domain.timeline import Cut, Slot
from exwarp_cli.io.atomic import is_there, output_error
from exwarp_cli.pipeline.frame_writer import FrameWriter
from exwarp_cli.pipeline.interval_inputs import IntervalInputs, SkippedInterval
from exwarp_cli.pipeline.job import Job
from exwarp_cli.pipeline.recipes import key_recipe
from exwarp_cli.pipeline.run import make_reader, make_writer
from exwarp_cli.pipeline.without_vectors import is_kept, note_of


class Fate(Enum):
    """What would become of a frame's file."""

    WRITE = "write"
    """There is none, and one would be written."""

    REPLACE = "replace"
    """There is one, and another would take its place."""

    KEEP = "keep"
    """There is one that an earlier run wrote as this one would."""


@dataclass(frozen=True)
class ForeseenFrame:
    """One frame that a run would give.

    Attributes
    ----------
    number
        Of the output.
    kind
        A key frame or a rendered one, which pass through; else it is generated.
    fate
        Of its file, and of its hole mask if masks are written.
    """

    number: int
    kind: FrameKind
    fate: Fate


@dataclass(frozen=True)
class DryRun:
    """What a run would do.

    Attributes
    ----------
    head
        The run's summary, without frames.
    frames
        What it would write, ascending.
    output, holes, video
        Where: patterns of frames and masks, and the video; None for what is not written.
    cuts_looked_for, cuts
        Whether cuts are looked for, and those that are known: given by hand, and met while frames
        that are there were compared.
    chunks
        Input numbers of each chunk's key frames; () where the work is not spread.
    spread
        Over what, in words; None where it is not.
    report
        Folder of the report; None without.
    """

    head: RunSummary
    frames: tuple[ForeseenFrame, ...]
    output: Path | None
    holes: Path | None
    video: Path | None
    cuts_looked_for: bool
    cuts: tuple[Cut, ...]
    chunks: tuple[tuple[int, ...], ...] = ()
    spread: str | None = None
    report: Path | None = None


def foresee(job: Job) -> DryRun:
    """Find out what a job would write, and refuse what it would refuse.

    Raises
    ------
    OutputExistsError
        When frames are in the way.
    OutputError
        When a folder could not be made or written to.
    """
    targets = job.targets
    job.refuse()
    require_writable(targets.folders)
    try:
        frames, met = _compared(job) if job.settings.skip_existing else (_plain(job), None)
    finally:
        job.close()
    wish, numbers = job.source.cuts, job.source.timeline.numbers
    given = tuple(Cut(numbers[key], "given") for key in sorted(wish.starts_in(numbers)))
    return DryRun(
        head=job.summary(Outcome(), 0.0),
        frames=frames,
        output=None if targets.frames is None else targets.frames.folder / targets.frames.name,
        holes=None if targets.holes is None else targets.holes.folder / targets.holes.name,
        video=targets.video,
        cuts_looked_for=wish.detect,
        cuts=tuple(sorted({*given, *(met or ())}, key=lambda cut: cut.number)),
    )


def require_writable(folders: Iterable[Path]) -> None:
    """Refuse folders that could not be made or written to, as far as that shows without trying.

    Raises
    ------
    OutputError
        For the first of them.
    """
    for folder in folders:
        there = next(path for path in (folder, *folder.absolute().parents) if is_there(path))
        number = 0
        if not there.is_dir():
            number = errno.EEXIST if there == folder else errno.ENOTDIR
        elif not os.access(there, os.W_OK | os.X_OK):
            number = errno.EACCES
        if number:
            raise output_error(folder, OSError(number, ""))


def _plain(job: Job) -> tuple[ForeseenFrame, ...]:
    """Foresee frames without looking into those that are there."""
    return tuple(_foreseen(job, slot, kept=False) for slot in job.slots)


def _compared(job: Job) -> tuple[tuple[ForeseenFrame, ...], tuple[Cut, ...] | None]:
    """Foresee frames where good ones are kept; return the cuts that were met, too."""
    reader = make_reader(job)
    if job.targets.frames is None:
        note = note_of(reader.leading_recipes, job.settings, job.keys, job.rendered)
        kept = is_kept(job.targets, job.settings, note)
        return tuple(_foreseen(job, slot, kept) for slot in job.slots), None
    writer = make_writer(job)
    frames = []
    for key in job.keys:
        inputs = reader.read(key, lambda *_: False)
        slots = job.source.timeline.slots_of(key)
        if not isinstance(inputs, IntervalInputs):
            slots = tuple(slot for slot in slots if inputs.passed is not None and not slot.index)
        for slot in slots:
            frames.append(_foreseen(job, slot, _is_there(job, writer, slot, inputs)))
    return tuple(frames), reader.cuts


def _is_there(
    job: Job, writer: FrameWriter, slot: Slot, inputs: IntervalInputs | SkippedInterval
) -> bool:
    """Whether a slot's files are there as this run would write them."""
    number = job.source.timeline.number(slot)
    if slot.index:
        assert isinstance(inputs, IntervalInputs)
        rendered = inputs.rendered.frames.get(slot.index)
        if rendered is not None:
            return writer.has_rendered(number, rendered.path, rendered.recipe)
        return writer.has(number, inputs.metadata.recipes[slot.index])
    keys, key_number = job.source.keys, job.source.timeline.numbers[slot.key]
    path = keys.sequence.files[key_number]
    if writer.copies(path):
        return writer.has_copy(number, path)
    return writer.has(number, key_recipe(keys, key_number, job.source.written_fps), masked=False)


def _foreseen(job: Job, slot: Slot, kept: bool) -> ForeseenFrame:
    number, targets = job.source.timeline.number(slot), job.targets
    path = targets.video if targets.frames is None else targets.frames.path(number)
    there = path is not None and is_there(path)
    fate = Fate.KEEP if kept else Fate.REPLACE if there else Fate.WRITE
    kind = FrameKind.GENERATED if slot.index else FrameKind.KEY
    if slot.index and job.rendered is not None and job.rendered.has(number):
        kind = FrameKind.RENDERED
    return ForeseenFrame(number, kind, fate)
