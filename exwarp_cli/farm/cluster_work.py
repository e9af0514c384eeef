"""What happens in the workers of a cluster: whether one is fit for a job, and a chunk's work.

Functions here are called by name from the coordinator's process, so that both must run the same
ExWarp; `unfit` says so before any work.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from distributed import get_worker

from exwarp_cli import __version__
from exwarp_cli.domain.joining import Outcome
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.errors import OutputError
from exwarp_cli.io.files import POLL_S, is_visible, make_folder
from exwarp_cli.pipeline.job import Job, open_job
from exwarp_cli.pipeline.progress import ANY, FrameListener
from exwarp_cli.pipeline.run import write_intervals

MARK_S = 2.0
"""Seconds for which a worker looks for the marks: it has not looked before, so that they should
show at once."""

KEPT_S = 300.0
"""Seconds that a job stays open, with its networks loaded, while no chunk of it comes."""

_alone = threading.Lock()
"""Chunks of one process would only take cores and memory from each other."""


class SharedWatcher(FrameListener, Protocol):
    """A watcher whose parts see parts of a run, in other processes."""

    def share(self) -> SharedWatcher:
        """Return an empty one, which can be pickled, with the plan of the whole run."""

    def adopt(self, part: Any) -> None:
        """Take over what a part has seen; parts come in any order."""


@dataclass(frozen=True)
class Needs:
    """What a worker must have.

    Attributes
    ----------
    version
        Of ExWarp.
    inputs
        Files that it reads, with their sizes in bytes.
    marks
        Files that the coordinator has put into the folders that are written to.
    """

    version: str
    inputs: tuple[tuple[str, int], ...]
    marks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Chunk:
    """Key frames that one worker does.

    Attributes
    ----------
    run
        Names the run, one of its kind.
    topic
        Where progress is reported.
    index
        Of the chunk in the run.
    attempt
        How often it was given out before.
    settings
        Of the run, with absolute paths and without what the coordinator does itself.
    keys
        Indices of the key frames.
    watcher
        Sees the frames; None where no frame is shown.
    reported
        As in `Job`.
    """

    run: str
    topic: str
    index: int
    attempt: int
    settings: UpsampleSettings
    keys: tuple[int, ...]
    watcher: SharedWatcher | None
    reported: bool = False


@dataclass(frozen=True)
class Done:
    """What became of a chunk.

    Attributes
    ----------
    outcome
        Of its key frames.
    watcher
        The chunk's own, with what it has seen.
    """

    outcome: Outcome
    watcher: SharedWatcher | None


class CalledOff(Exception):
    """The coordinator does not want the chunk any more."""


class Telling:
    """Tells the coordinator of frames, and stops when it does not want them: a `Progress`."""

    def __init__(self, chunk: Chunk) -> None:
        self._chunk = chunk
        self._worker: Any = get_worker()
        self._task = self._worker.get_current_task()

    def begin(self) -> None:
        """Tell that the work begins; if this comes twice, a worker was lost on the way."""
        self.require_wanted()
        self._tell(begin=True)

    def end(self) -> None:
        """Tell that nothing is written any more, whatever the chunk came to."""
        self._tell(end=True)

    def start(self, total: int, kinds: Mapping[str, int] | None = None, at_once: int = 1) -> None:
        """Say nothing: the coordinator knows."""

    def advance(
        self, frame: int, note: str | None = None, kind: str = ANY, made: bool = True
    ) -> None:
        """Tell of a frame."""
        self._tell(frame=frame, note=note, kind=kind, made=made)
        self.require_wanted()

    def message(self, text: str) -> None:
        """Say nothing: messages are of the input, and the coordinator has read it too."""

    def finish(self) -> None:
        """Say nothing."""

    def fail(self, text: str, exit_code: int) -> None:
        """Say nothing: the error itself goes to the coordinator."""

    def require_wanted(self) -> None:
        """Stop if the task was cancelled, as it is when the coordinator is no more.

        Dask never breaks off a thread, but it does note that no client waits for its result.
        """
        task = self._worker.state.tasks.get(self._task)
        if task is None or task.state != "executing":
            raise CalledOff

    def _tell(self, **more: object) -> None:
        known = {"chunk": self._chunk.index, "attempt": self._chunk.attempt}
        self._worker.log_event(self._chunk.topic, known | more)


_opened: tuple[str, Job] | None = None
_closing: threading.Timer | None = None


def work(chunk: Chunk) -> Done | BaseException:
    """Do a chunk; errors are returned, as Dask would log those that are raised."""
    telling = Telling(chunk)
    with _alone, _kept_a_while():
        try:
            telling.begin()
            job = replace(_job(chunk).of(chunk.keys), reported=chunk.reported)
            return Done(write_intervals(job, telling, chunk.watcher), chunk.watcher)
        except Exception as error:
            return error
        finally:
            telling.end()


@contextmanager
def _kept_a_while() -> Iterator[None]:
    """Let the job be open for the next chunk, but not in a worker that has other things to do."""
    global _closing
    if _closing is not None:
        _closing.cancel()
    try:
        yield
    finally:
        _closing = threading.Timer(KEPT_S, _close)
        _closing.daemon = True
        _closing.start()


def _close() -> None:
    """Forget the job unless a chunk has begun meanwhile."""
    global _opened
    if _alone.acquire(blocking=False):
        _opened = None
        _alone.release()


def _job(chunk: Chunk) -> Job:
    """Open the job, once for all chunks of a run: vectors are measured and networks loaded."""
    global _opened
    if _opened is None or _opened[0] != chunk.run:
        _opened = None
        threads = chunk.settings.threads or int(get_worker().state.nthreads)
        _opened = chunk.run, open_job(replace(chunk.settings, threads=threads))
    return _opened[1]


async def unfit(needs: Needs) -> str | None:
    """Say what this worker lacks to do a job; None where it lacks nothing."""
    if needs.version != __version__:
        return f"runs ExWarp {__version__}, and this is {needs.version}; install the same on all"
    for path, size in needs.inputs:
        if not _has_size(path, size):
            return f"does not see {path} as it is here; use a folder that all machines share"
    deadline = time.monotonic() + MARK_S
    while hidden := [mark for mark in needs.marks if not is_visible(Path(mark))]:
        if time.monotonic() > deadline:
            folder = Path(hidden[0]).parent
            return f"does not see the folder {folder}; write to one that all machines share"
        await asyncio.sleep(POLL_S)
    try:
        for mark in needs.marks:
            make_folder(Path(mark).parent)  # it is there: whether this machine may write to it
    except OutputError as error:
        return str(error)
    return None


def _has_size(path: str, size: int) -> bool:
    try:
        return Path(path).stat().st_size == size
    except OSError:
        return False
