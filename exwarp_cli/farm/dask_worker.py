"""What runs in the workers of a Dask cluster: the check of a worker, and the work of a chunk.

Functions of this module are called by name from the coordinator's process, so both must run the
same version of ExWarp. `check_worker` refuses another one before any work.
"""

from __future__ import annotations

import asyncio
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from exwarp_cli import __version__
from exwarp_cli.domain.results import RunOutcome
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.errors import OutputError
from exwarp_cli.io.files import POLL_S, is_visible, make_folder
from exwarp_cli.pipeline.job import Job, open_job
from exwarp_cli.pipeline.progress import ANY, FrameListener, Progress
from exwarp_cli.pipeline.run import write_intervals

MARK_S = 2.0  # seconds for the marks to show: a worker looks for the first time, so no cache is old
KEPT_S = 300.0  # seconds that a job stays open, with its networks, while no chunk of it comes


class SharedWatcher(FrameListener, Protocol):
    """A listener whose parts are shown parts of a run, in other processes."""

    def share(self) -> SharedWatcher:
        """Return an empty listener, which can be pickled, with the plan of the whole run."""

    def adopt(self, part: Any) -> None:
        """Take over what a part was shown; parts come in any order."""


@dataclass(frozen=True)
class WorkerRequirements:
    """What a worker must have."""

    inputs: tuple[tuple[str, int], ...]  # files that the job reads, with their sizes in bytes
    marks: tuple[str, ...] = ()  # files that the coordinator has put into the output folders
    version: str = __version__


@dataclass(frozen=True)
class Chunk:
    """Key frames that one worker does."""

    run: str  # unique name of the run; also the topic of its events
    index: int  # index of the chunk in the run
    # Settings of the run, with absolute paths and without what the coordinator does itself
    settings: UpsampleSettings
    keys: tuple[int, ...]  # indices of the key frames
    frames: str = ""  # range of the output frames, for messages
    watcher: SharedWatcher | None = None  # is shown the frames; None where no frame is shown
    reported: bool = False  # as in `Job`


# The outcome of a chunk, and its watcher with what it was shown
ChunkResult = tuple[RunOutcome, SharedWatcher | None]


class ChunkCancelled(Exception):
    """The coordinator does not want the chunk any more."""


class ChunkProgress(Progress):
    """Sends the progress of a chunk to the coordinator as Dask events.

    Messages are not sent: they are about the input, which the coordinator has read too.
    """

    def __init__(self, chunk: Chunk) -> None:
        from distributed import get_worker  # an optional dependency of the coordinator

        super().__init__()
        self._chunk = chunk
        self._worker: Any = get_worker()
        self._task = self._worker.get_current_task()
        self.threads: int = self._worker.state.nthreads

    def send(self, **event: object) -> None:
        """Send an event of this chunk."""
        self._worker.log_event(self._chunk.run, {"chunk": self._chunk.index, **event})

    def require_wanted(self) -> None:
        """Raise ChunkCancelled if the task was cancelled, as it is when its client has ended."""
        # Dask never interrupts a thread, but it changes the state of the task.
        task = self._worker.state.tasks.get(self._task)
        if task is None or task.state != "executing":
            raise ChunkCancelled

    def advance(
        self, frame: int, note: str | None = None, kind: str = ANY, made: bool = True
    ) -> None:
        """Send the event of a frame, and stop if the chunk is not wanted any more."""
        self.send(frame=frame, note=note, kind=kind, made=made)
        self.require_wanted()

    def message(self, text: str) -> None:
        """Do nothing."""


_lock = threading.Lock()  # two chunks in one process would compete for cores and memory
_opened: tuple[str, Job] | None = None  # the name of a run, and its job
_closing: threading.Timer | None = None


def render_chunk(chunk: Chunk) -> ChunkResult | BaseException:
    """Do a chunk. Errors are returned, because Dask logs those that are raised."""
    global _closing, _opened
    progress = ChunkProgress(chunk)
    with _lock:
        if _closing is not None:
            _closing.cancel()
        try:
            progress.require_wanted()
            progress.send(begin=True)
            if _opened is None or _opened[0] != chunk.run:
                # For the first chunk of a run only: opening measures vectors, loads networks.
                _opened = None
                threads = chunk.settings.threads or progress.threads
                _opened = chunk.run, open_job(replace(chunk.settings, threads=threads))
            job = replace(_opened[1], keys=chunk.keys, reported=chunk.reported)
            return write_intervals(job, progress, chunk.watcher), chunk.watcher
        except Exception as error:
            return error
        finally:
            progress.send(end=True)
            _closing = threading.Timer(KEPT_S, _close)
            _closing.daemon = True
            _closing.start()


def _close() -> None:
    global _opened
    if _lock.acquire(blocking=False):  # else a chunk has begun meanwhile
        _opened = None
        _lock.release()


async def check_worker(requirements: WorkerRequirements) -> str | None:
    """Return why this worker cannot do a job, or None if it can."""
    if requirements.version != __version__:
        return (
            f"runs ExWarp {__version__}, and this is {requirements.version}; install the same on "
            "all"
        )
    for path, size in requirements.inputs:
        try:
            is_same = Path(path).stat().st_size == size
        except OSError:
            is_same = False
        if not is_same:
            return f"does not see {path} as it is here; use a folder that all machines share"
    deadline = time.monotonic() + MARK_S
    while hidden := [mark for mark in requirements.marks if not is_visible(Path(mark))]:
        if time.monotonic() > deadline:
            folder = Path(hidden[0]).parent
            return f"does not see the folder {folder}; write to one that all machines share"
        await asyncio.sleep(POLL_S)
    try:
        for mark in requirements.marks:
            make_folder(Path(mark).parent)  # it exists: this tells whether it can be written to
    except OutputError as error:
        return str(error)
    return None
