"""What a run would do, without writing a file or making a folder."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from exwarp_cli.domain.results import FrameKind, RunOutcome, RunSummary
from exwarp_cli.domain.timeline import Cut, Slot
from exwarp_cli.io.files import output_error, path_exists
from exwarp_cli.pipeline.fingerprint import key_fingerprint
from exwarp_cli.pipeline.interval_inputs import IntervalInputs
from exwarp_cli.pipeline.job import Job
from exwarp_cli.pipeline.output_plan import is_video_kept, video_fingerprint
from exwarp_cli.pipeline.run import make_reader, make_writer


class Fate(Enum):
    """What would become of a frame's file."""

    WRITE = "write"  # there is none, and one would be written
    REPLACE = "replace"  # there is one, and another would take its place
    KEEP = "keep"  # there is one, equal to what this run would write


@dataclass(frozen=True)
class ForeseenFrame:
    """One frame that a run would give."""

    number: int  # of the output
    kind: FrameKind  # a key frame or a rendered one, which pass through; else it is generated
    fate: Fate  # of its file, and of its hole mask if masks are written


@dataclass(frozen=True)
class DryRun:
    """What a run would do."""

    head: RunSummary  # the run's summary, without frames
    frames: tuple[ForeseenFrame, ...]  # what it would write, ascending
    # output, holes, video: where: patterns of frames and masks, and the video; None for what is
    # not written
    output: Path | None
    holes: Path | None
    video: Path | None
    # cuts_looked_for, cuts: whether cuts are detected, and those known: given by hand, and
    # detected while existing frames were compared
    cuts_looked_for: bool
    cuts: tuple[Cut, ...]
    # Input numbers of each chunk's key frames; () where the work is not divided
    chunks: tuple[tuple[int, ...], ...] = ()
    spread: str | None = None  # the workers, in words; None where the work is not divided
    report: Path | None = None  # folder of the report; None without


def foresee(job: Job) -> DryRun:
    """Return what a job would write, and refuse what it would refuse.

    Raises OutputExistsError when frames are in the way; OutputError when a folder could not be made
    or written to.
    """
    targets = job.targets
    job.refuse()
    require_writable(targets.folders)
    try:
        kept, detected = dict.fromkeys(job.slots, False), None
        if job.settings.skip_existing:
            kept, detected = _compare_existing(job)
    finally:
        job.close()
    frames = []
    for slot, is_kept in kept.items():
        number = job.source.timeline.number(slot)
        path = targets.video if targets.frames is None else targets.frames.path(number)
        exists = path is not None and path_exists(path)
        fate = Fate.KEEP if is_kept else Fate.REPLACE if exists else Fate.WRITE
        kind = FrameKind.GENERATED if slot.index else FrameKind.KEY
        if slot.index and job.rendered is not None and number in job.rendered.sequence.files:
            kind = FrameKind.RENDERED
        frames.append(ForeseenFrame(number, kind, fate))
    cuts, numbers = job.source.cuts, job.source.timeline.numbers
    by_hand = tuple(Cut(numbers[key], "given") for key in sorted(cuts.starts_in(numbers)))
    return DryRun(
        head=job.summary(RunOutcome(), 0.0),
        frames=tuple(frames),
        output=None if targets.frames is None else Path(targets.frames.pattern),
        holes=None if targets.holes is None else Path(targets.holes.pattern),
        video=targets.video,
        cuts_looked_for=cuts.detect,
        cuts=tuple(sorted({*by_hand, *(detected or ())}, key=lambda cut: cut.number)),
    )


def require_writable(folders: Iterable[Path]) -> None:
    """Refuse folders that could not be made or written to, as far as permissions show it.

    Raises OutputError for the first of them.
    """
    for folder in folders:
        parent = next(path for path in (folder, *folder.absolute().parents) if path_exists(path))
        number = 0
        if not parent.is_dir():
            number = errno.EEXIST if parent == folder else errno.ENOTDIR
        elif not os.access(parent, os.W_OK | os.X_OK):
            number = errno.EACCES
        if number:
            raise output_error(folder, OSError(number, ""))


def _compare_existing(job: Job) -> tuple[dict[Slot, bool], tuple[Cut, ...] | None]:
    """Return whether each slot's frame is kept, without skipped slots, and the cuts detected."""
    reader = make_reader(job)
    leader = reader.leader
    if job.targets.frames is None:
        note = video_fingerprint(leader.fingerprinter, job.settings, job.keys, job.rendered)
        return dict.fromkeys(job.slots, is_video_kept(job.targets, job.settings, note)), None
    writer, kept = make_writer(job), dict[Slot, bool]()
    keys, timeline = job.source.keys, job.source.timeline
    for key in job.keys:
        inputs = reader.read(key, lambda *_: False)
        slots = timeline.slots_of(key)
        if isinstance(inputs, IntervalInputs):
            rendered, recipes = inputs.rendered.frames, inputs.recipes
        else:
            rendered, recipes = {}, {}
            slots = tuple(slot for slot in slots if inputs.passed is not None and not slot.index)
        for slot in slots:
            number, path = timeline.number(slot), keys.sequence.files[timeline.numbers[key]]
            if slot.index in rendered:
                frame = rendered[slot.index]
                kept[slot] = writer.has_rendered(number, frame.path, frame.recipe)
            elif slot.index:
                kept[slot] = writer.has(number, recipes[slot.index])
            elif writer.copies(path):
                kept[slot] = writer.has_copy(number, path)
            else:
                recipe = key_fingerprint(keys, timeline.numbers[key], job.source.written_fps)
                kept[slot] = writer.has(number, recipe, masked=False)
    return kept, leader.shots.cuts
