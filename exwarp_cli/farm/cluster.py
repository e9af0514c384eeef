"""One job on many processes: chunks of it on the workers of a Dask cluster.

The coordinator opens the job, refuses what it has to, makes the folders, and gives chunks to
workers, which open the same files. Frames do not travel: workers write them where a single run
would. Any split gives the same bytes, so that the frames, the video and the report are those of a
single run.
"""

from __future__ import annotations

import math
import time
import uuid
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exwarp_cli import __version__
from exwarp_cli.domain.frame import Image
from exwarp_cli.domain.joining import Outcome
from exwarp_cli.domain.results import RunSummary
from exwarp_cli.domain.settings import ClusterSettings
from exwarp_cli.domain.timeline import Slot, ranges
from exwarp_cli.domain.wording import pluralise
from exwarp_cli.errors import UsageError
from exwarp_cli.farm.calls import DEFAULT_SIZE, split
from exwarp_cli.farm.cluster_client import connected, require_cluster, threads_each
from exwarp_cli.farm.places import absolute, inputs_of
from exwarp_cli.io.atomic import Held, await_file, marked, remove_leftovers
from exwarp_cli.io.footage import picture
from exwarp_cli.pipeline.announcing import tell_left_out
from exwarp_cli.pipeline.dry_run import DryRun
from exwarp_cli.pipeline.job import Job
from exwarp_cli.pipeline.progress import NoProgress, Progress, kinds_of
from exwarp_cli.pipeline.run import make_writer
from exwarp_cli.pipeline.scheduling import AsyncWriter
from exwarp_cli.pipeline.verifying import verify_video

if TYPE_CHECKING:  # they import Dask, which may not be there
    from exwarp_cli.farm.cluster_dispatch import Dispatch
    from exwarp_cli.farm.cluster_work import Chunk, Done, SharedWatcher


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


ROUNDS = 3
"""Chunks for each worker, where there are not so many key frames that the largest ones are more:
the last to finish keeps the others waiting for a third of its share at most."""


def run_on_cluster(
    job: Job, where: ClusterSettings, progress: Progress, watcher: SharedWatcher | None = None
) -> RunSummary:
    """Do a job that is open on the workers of a cluster.

    Parameters
    ----------
    job
        What is done.
    where
        Which cluster.
    progress
        Receives every frame.
    watcher
        Shown frames that it wants to see, by parts of it in the workers; None where no frame is
        shown.

    Returns
    -------
    RunSummary
        That of a single run, times excepted.

    Raises
    ------
    ClusterError
        When the cluster cannot be reached, cannot do the work, or loses its workers.
    ExwarpError
        As `pipeline.run.upsample` raises; frames written until then are whole.
    """
    _require_frames(job)
    job.refuse()
    with ExitStack() as stack:
        for folder in job.targets.folders:  # of workers that were lost, once the others have ended
            stack.callback(remove_leftovers, folder)
        client = stack.enter_context(connected(where, job.settings.threads))
        return _Coordinator(job, where, progress, watcher).run(client)


def foresee_on_cluster(job: Job, where: ClusterSettings, found: DryRun) -> DryRun:
    """Add to what a run would do how it would be spread.

    Raises
    ------
    ClusterError
        When the cluster cannot be reached, or cannot do the work.
    """
    _require_frames(job)
    require_cluster()
    if where.address is None:
        workers = where.workers or 1
    else:
        with connected(where, job.settings.threads) as client:
            workers = _Coordinator(job, where, NoProgress()).dispatch(client, ()).muster()
    chunks = chunks_of(job.key_numbers, where, workers)
    return replace(found, chunks=chunks, spread=_spread(where, workers, job.settings.threads))


def chunks_of(
    keys: tuple[int, ...], where: ClusterSettings, workers: int
) -> tuple[tuple[int, ...], ...]:
    """Cut key frames into chunks.

    Without a wish they are so small that each worker gets some of them in turn, so that a lost one
    costs little, and of `DEFAULT_SIZE` key frames at most; each chunk reads what it has in common
    with the one before anew, so that they are no smaller than that needs.
    """
    usual = min(DEFAULT_SIZE, max(1, math.ceil(len(keys) / (ROUNDS * workers))))
    return split(keys, where.chunk_size or usual)


def _spread(where: ClusterSettings, workers: int, threads: int | None) -> str:
    """Say over what the work is spread."""
    many = pluralise(workers, "worker")
    if where.address is not None:
        return f"{many} of {where.address}"
    each = pluralise(threads_each(workers, threads), "thread")
    return f"{many} on this machine, {each} each"


def _require_frames(job: Job) -> None:
    """Refuse a video alone, whose frames would be nowhere."""
    if job.targets.frames is None:
        raise UsageError(
            f"-o {job.settings.output} is a video alone, and workers write frames; name a folder "
            "in -o and the video in --video, or leave out --workers and --cluster"
        )


class _Coordinator:
    """Does one job on a cluster; see `run_on_cluster`."""

    def __init__(
        self,
        job: Job,
        where: ClusterSettings,
        progress: Progress,
        watcher: SharedWatcher | None = None,
    ) -> None:
        self._job, self._where = job, where
        self._progress, self._watcher = progress, watcher
        self._chunks: tuple[Chunk, ...] = ()
        self._film: Film | None = None
        self._filmed = 0
        self._done: dict[int, Done] = {}

    def run(self, client: Any) -> RunSummary:
        """Do the job by a client that is connected."""
        job = self._job
        job.targets.make_folders()
        with ExitStack() as stack:
            stack.callback(job.close)  # of which the video shows the rendered frames
            marks = tuple(stack.enter_context(marked(f)) for f in job.targets.folders)
            dispatch = self.dispatch(client, marks)
            workers = dispatch.muster()
            self._chunks = self._cut(workers)
            job.announce(self._progress)
            self._say_spread(workers)
            begin = time.perf_counter()
            self._progress.start(len(job.slots), kinds_of(job.slots), workers)
            stack.callback(self._progress.finish)
            if self._watcher is not None:
                self._watcher.plan(job.groups)
            if job.targets.video is not None:
                self._film = stack.enter_context(Film(job))
                for text in self._film.remarks:
                    self._progress.message(text)
            dispatch.run(self._with_watchers())
        return self._summary(time.perf_counter() - begin)

    def dispatch(self, client: Any, marks: tuple[Path, ...]) -> Dispatch:
        """Return what gives chunks to workers that see the files of the job."""
        from exwarp_cli.farm.cluster_dispatch import Dispatch
        from exwarp_cli.farm.cluster_work import Needs

        needs = Needs(__version__, inputs_of(self._job), tuple(str(m.absolute()) for m in marks))
        say, advance = self._progress.message, self._progress.advance
        return Dispatch(client, needs, advance, self._take, say, self._name)

    def _cut(self, workers: int) -> tuple[Chunk, ...]:
        """Make the chunks."""
        from exwarp_cli.farm.cluster_work import Chunk

        run, job = uuid.uuid4().hex, self._job
        # What the coordinator sees to itself: which key frames, the video, and what is in the way.
        settings = replace(absolute(job.settings), frames=None, video=None)
        if self._where.address is None:
            settings = replace(settings, threads=None)  # the worker was started with its share
        return tuple(
            Chunk(run, f"exwarp-{run}", index, 0, settings, keys, None, job.reported)
            for index, keys in enumerate(chunks_of(job.keys, self._where, workers))
        )

    def _with_watchers(self) -> list[Chunk]:
        if self._watcher is None:
            return list(self._chunks)
        return [replace(chunk, watcher=self._watcher.share()) for chunk in self._chunks]

    def _say_spread(self, workers: int) -> None:
        spread = _spread(self._where, workers, self._job.settings.threads)
        self._progress.message(f"{pluralise(len(self._chunks), 'chunk')} for {spread}")

    def _name(self, chunk: Chunk) -> str:
        """Name a chunk by its frames."""
        timeline = self._job.source.timeline
        slots = (slot for key in chunk.keys for slot in timeline.slots_of(key))
        return ranges([timeline.number(slot) for slot in slots])

    def _take(self, chunk: Chunk, done: Done) -> None:
        """Take over what a chunk came to, and film what is complete from the beginning on."""
        self._done[chunk.index] = done
        for one in done.outcome.left_out:
            tell_left_out(self._progress, one)
        if self._watcher is not None and done.watcher is not None:
            self._watcher.adopt(done.watcher)
            self._done[chunk.index] = replace(done, watcher=None)
        while self._film is not None and self._filmed in self._done:
            left_out = self._done[self._filmed].outcome.left_out
            missing = frozenset(number for one in left_out for number in one.frames)
            self._film.append(self._chunks[self._filmed].keys, missing)
            self._filmed += 1

    def _summary(self, seconds: float) -> RunSummary:
        """Join what the chunks found out: as a single run would have, in order."""
        made = Outcome.joined([self._done[chunk.index].outcome for chunk in self._chunks])
        video = self._job.targets.video
        if video is not None and self._job.settings.verify:
            verify_video(video, made.shown)
        return self._job.summary(made, seconds)
