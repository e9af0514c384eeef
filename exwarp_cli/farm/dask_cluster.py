"""One job on many processes: its chunks are tasks of the workers of a Dask cluster.

The coordinator opens the job, refuses what it has to, and makes the folders. Workers open the same
files and write frames where a single run would, so frames do not travel. Any division into chunks
gives the same bytes: frames, video and report are those of a single run.
"""

from __future__ import annotations

import asyncio
import logging
import math
import os
import queue
import signal
import sys
import time
import uuid
import warnings
from collections import Counter, deque
from collections.abc import Collection, Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from multiprocessing import resource_tracker
from typing import Any, NamedTuple

from exwarp_cli.domain.results import RunOutcome, RunSummary
from exwarp_cli.domain.settings import DEFAULT_CHUNK_SIZE, ClusterSettings
from exwarp_cli.domain.timeline import Slot, ranges
from exwarp_cli.domain.wording import first_line, pluralise
from exwarp_cli.errors import ClusterError, MissingExtraError, UsageError
from exwarp_cli.farm.dask_worker import (
    Chunk,
    ChunkResult,
    SharedWatcher,
    WorkerRequirements,
    check_worker,
    render_chunk,
)
from exwarp_cli.farm.farm_job import absolute, inputs_of, split
from exwarp_cli.io.files import ResourceOwner, await_file, marker_file, remove_leftovers
from exwarp_cli.io.footage import read_sequence_picture
from exwarp_cli.pipeline.dry_run import DryRun
from exwarp_cli.pipeline.frame_writer import verify_video
from exwarp_cli.pipeline.job import Job
from exwarp_cli.pipeline.messages import announce_skipped
from exwarp_cli.pipeline.progress import ANY, Progress, kind_of
from exwarp_cli.pipeline.run import make_writer
from exwarp_cli.pipeline.scheduling import AsyncWriter
from exwarp_cli.runtime import stop
from exwarp_cli.runtime.machine import processors

CONNECT_S = 10.0  # seconds that a scheduler has to answer
STOP_S = 6.0  # seconds that processes have to end before they are killed
LOOPBACK = "127.0.0.1"

# Chunks for each worker: the last one keeps the others waiting for a third of its share at most.
ROUNDS = 3
POLL_S = 0.5  # seconds between two looks at which workers the cluster has
ANSWER_S = 10.0  # seconds without a chunk begun, after which a message says that workers are busy
PATIENCE_S = 180.0  # seconds to wait for a first worker: batch systems take minutes to start one
ATTEMPTS = 4  # a chunk that ends its worker every time would end them all
RESULT_S = 60.0  # seconds that the records of a finished chunk may take to arrive
CANCEL_S = 10.0  # seconds to wait for cancelled chunks, which stop at their next frame

VIDEO_ALONE = (
    "-o {} is a video alone, and workers write frames; name a folder in -o and the video in "
    "--video, or leave out --workers and --cluster"
)

DASK_SETTINGS = {
    "distributed.comm.timeouts.connect": f"{CONNECT_S}s",
    # Processes of this machine need no web pages.
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}


def require_dask() -> Any:
    """Return the module `distributed`; MissingExtraError where it is not installed."""
    try:
        import distributed
    except ImportError as error:
        raise MissingExtraError(
            "--workers and --cluster need Dask, which is not installed; install it with pip "
            'install "exwarp[cluster]"'
        ) from error
    return distributed


def threads_per_worker(workers: int, threads: int | None) -> int:
    """Divide threads, or all cores, among worker processes of this machine."""
    return max(1, (threads or processors().allowed) // workers)


@contextmanager
def connected(where: ClusterSettings, threads: int | None) -> Iterator[Any]:
    """Yield a `distributed.Client`; processes on this machine live as long as the block.

    The processes share `threads`, or all cores for None.

    ClusterError: the scheduler does not answer, or processes do not start. MissingExtraError: Dask
    is not installed.
    """
    distributed = require_dask()
    import dask

    with ExitStack() as stack:
        # Hide Dask's log and warnings: what matters becomes a message of ExWarp. Its loggers have
        # levels of their own, and one handler. It stays silent after the block, because processes
        # that do not end in time are killed, which Dask logs later.
        for handler in logging.getLogger("distributed").handlers:
            handler.setLevel(logging.CRITICAL + 1)
        stack.enter_context(dask.config.set(DASK_SETTINGS))
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("ignore")
        address = where.address
        if address is None:
            address = stack.enter_context(_local_cluster(distributed, where.workers or 1, threads))
        try:
            if where.address is not None:
                # Ask first: a client that fails half way keeps its event loop.
                asyncio.run(asyncio.wait_for(_require_scheduler(distributed, address), CONNECT_S))
            # Not as the default, which Dask would use for everything else in this process.
            client = distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
        except Exception as error:  # servers of other kinds cause errors of any kind
            if isinstance(error, TimeoutError):
                reason = f"no answer for {CONNECT_S:g} seconds"
            elif isinstance(error, MemoryError):  # Dask reads bytes of other protocols as a size
                reason = "what listens there does not speak Dask's language"
            else:
                reason = first_line(error)
            raise ClusterError(
                f"cannot reach a Dask scheduler at {address} ({reason}); check the "
                "address, which is like tcp://host:8786, and that 'dask scheduler' runs there"
            ) from error
        stack.callback(_close, client)
        yield client


async def _require_scheduler(distributed: Any, address: str) -> None:
    connection_args = distributed.Security().get_connection_args("client")
    async with distributed.rpc(address, connection_args=connection_args) as server:
        kind = (await server.identity())["type"]
    if kind != "Scheduler":
        raise ValueError(f"a {kind.lower()} of a cluster listens there")


@contextmanager
def _local_cluster(distributed: Any, workers: int, threads: int | None) -> Iterator[Any]:
    """Start processes that end with the block, or with this process, however it ends."""
    import dask

    if sys.platform != "win32":
        # It would unblock SIGINT below where the first process starts it.
        resource_tracker.ensure_running()
    with ExitStack() as stack:
        folder = str(stack.enter_context(stop.scratch_folder()))
        # Some parts of Dask otherwise make a folder for all runs, which is never removed.
        stack.enter_context(dask.config.set({"temporary-directory": folder}))
        try:
            with stop.block_signals(signal.SIGINT):  # this process ends its workers itself
                cluster = distributed.LocalCluster(
                    n_workers=workers,
                    threads_per_worker=threads_per_worker(workers, threads),
                    processes=True,
                    host=LOOPBACK,
                    scheduler_kwargs={"dashboard": False, "dashboard_address": f"{LOOPBACK}:0"},
                    memory_limit=None,
                    silence_logs=logging.CRITICAL,
                    local_directory=folder,
                    preload=["exwarp_cli.farm.dask_worker"],
                )
        except (OSError, RuntimeError) as error:
            raise ClusterError(
                f"cannot start {workers} worker processes on this machine ({first_line(error)}); "
                "use fewer --workers, or none"
            ) from error
        # Listed now: a cluster that is being closed lists them no more.
        stack.enter_context(stop.clean_up_after(partial(_kill, tuple(cluster.workers.values()))))
        stack.callback(_close, cluster)
        yield cluster


def _close(connection: Any) -> None:
    """Close a client or a local cluster. Processes that do not end are killed afterwards."""
    stop.note_progress()
    with suppress(OSError, RuntimeError):
        connection.close(timeout=STOP_S)


def _kill(nannies: Iterable[Any]) -> None:
    """End a local cluster's processes. Nothing is lost: files appear only when complete."""
    for nanny in nannies:
        if nanny.pid:
            with suppress(OSError):  # ended meanwhile
                os.kill(nanny.pid, signal.SIGTERM if os.name == "nt" else signal.SIGKILL)


def run_on_cluster(
    job: Job, where: ClusterSettings, progress: Progress, watcher: SharedWatcher | None = None
) -> RunSummary:
    """Do an open job on the workers of a cluster; return the summary of a single run but for times.

    The watcher is shown the frames that it wants, by parts of it in the workers.

    ClusterError: the cluster cannot be reached, cannot do the work, or loses its workers.
    ExwarpError: as `pipeline.run.upsample` raises; frames written until then are complete.
    """
    if job.targets.frames is None:
        raise UsageError(VIDEO_ALONE.format(job.settings.output))
    job.refuse()
    with ExitStack() as stack:
        for folder in job.targets.folders:  # of lost workers, once the others have ended
            stack.callback(remove_leftovers, folder)
        client = stack.enter_context(connected(where, job.settings.threads))
        job.targets.make_folders()
        with ExitStack() as work:
            work.callback(job.close)  # whose rendered frames the video shows
            marks = [work.enter_context(marker_file(folder)) for folder in job.targets.folders]
            paths = tuple(str(mark.absolute()) for mark in marks)
            requirements = WorkerRequirements(inputs_of(job), paths)
            dispatcher = ChunkDispatcher(client, requirements, progress)
            workers = dispatcher.await_workers()
            divided = chunks_of(job.keys, where, workers)
            job.announce(progress)
            spread = _spread(where, workers, job.settings.threads)
            progress.message(f"{pluralise(len(divided), 'chunk')} for {spread}")
            begin = time.perf_counter()
            kinds = Counter(kind_of(slot.index) for slot in job.slots)
            progress.start(len(job.slots), kinds, workers)
            work.callback(progress.finish)
            if watcher is not None:
                watcher.plan(job.groups)
            video = None
            if job.targets.video is not None:
                video = work.enter_context(VideoFromFrames(job))
                for text in video.remarks:
                    progress.message(text)
            # The coordinator chooses the key frames, makes the video, and has looked for existing
            # frames. A worker of this machine was started with its share of threads.
            settings = replace(absolute(job.settings), frames=None, video=None)
            if where.address is None:
                settings = replace(settings, threads=None)
            run, timeline, chunks = f"exwarp-{uuid.uuid4().hex}", job.source.timeline, []
            for index, keys in enumerate(divided):
                slots = [slot for key in keys for slot in timeline.slots_of(key)]
                frames = ranges([timeline.number(slot) for slot in slots])
                shared = None if watcher is None else watcher.share()
                chunks.append(Chunk(run, index, settings, keys, frames, shared, job.reported))
            outcomes = _collect(dispatcher, chunks, progress, watcher, video)
        seconds = time.perf_counter() - begin
        outcome = RunOutcome.joined(outcomes)
        if job.targets.video is not None and job.settings.verify:
            verify_video(job.targets.video, outcome.shown)
        return job.summary(outcome, seconds)


def _collect(
    dispatcher: ChunkDispatcher,
    chunks: Sequence[Chunk],
    progress: Progress,
    watcher: SharedWatcher | None,
    video: VideoFromFrames | None,
) -> list[RunOutcome]:
    """Have all chunks done; return their outcomes in the chunks' order."""
    outcomes: dict[int, RunOutcome] = {}
    filmed = 0
    with closing(dispatcher.render(chunks)) as finished:
        for chunk, (outcome, part) in finished:
            outcomes[chunk.index] = outcome
            for skipped in outcome.left_out:
                announce_skipped(progress, skipped)
            if watcher is not None and part is not None:
                watcher.adopt(part)
            while video is not None and filmed in outcomes:  # in order, as far as complete
                skips = outcomes[filmed].left_out
                video.append(chunks[filmed].keys, [n for skip in skips for n in skip.frames])
                filmed += 1
    return [outcomes[chunk.index] for chunk in chunks]


def foresee_on_cluster(job: Job, where: ClusterSettings, dry_run: DryRun) -> DryRun:
    """Add to a dry run how its key frames would be divided among workers.

    ClusterError: the cluster cannot be reached, or cannot do the work.
    """
    if job.targets.frames is None:
        raise UsageError(VIDEO_ALONE.format(job.settings.output))
    require_dask()
    if where.address is None:
        workers = where.workers or 1
    else:
        with connected(where, job.settings.threads) as client:
            requirements = WorkerRequirements(inputs_of(job))
            workers = ChunkDispatcher(client, requirements, Progress()).await_workers()
    chunks = chunks_of(job.key_numbers, where, workers)
    return replace(dry_run, chunks=chunks, spread=_spread(where, workers, job.settings.threads))


def chunks_of(
    keys: tuple[int, ...], where: ClusterSettings, workers: int
) -> tuple[tuple[int, ...], ...]:
    """Divide key frames into chunks, of the size that the user asks for or of a usual one.

    The usual size gives each worker some chunks in turn, so that a lost worker costs little; it is
    `DEFAULT_CHUNK_SIZE` at most. Each chunk reads key frames of its neighbours again, so smaller is
    not better.
    """
    usual = min(DEFAULT_CHUNK_SIZE, max(1, math.ceil(len(keys) / (ROUNDS * workers))))
    return split(keys, where.chunk_size or usual)


def _spread(where: ClusterSettings, workers: int, threads: int | None) -> str:
    if where.address is not None:
        return f"{pluralise(workers, 'worker')} of {where.address}"
    each = pluralise(threads_per_worker(workers, threads), "thread")
    return f"{pluralise(workers, 'worker')} on this machine, {each} each"


@dataclass(eq=False)
class VideoFromFrames(ResourceOwner):
    """Appends finished key intervals to a job's video, in order, on a thread of its own.

    The video is complete, or absent. It equals that of a single run unless the frames' compression
    loses something. The job must have frames and a video among its outputs.
    """

    job: Job

    def _open(self, stack: ExitStack) -> None:
        self._frames = stack.enter_context(make_writer(self.job))
        self.remarks = self._frames.remarks  # what a user has to know about the video
        self._writer = stack.enter_context(AsyncWriter(1, len(self.job.slots)))

    def append(self, keys: Iterable[int], missing: Collection[int] = ()) -> None:
        """Append the frames of key intervals; of `missing` output numbers, the frame before."""
        timeline = self.job.source.timeline
        for slot in (slot for key in keys for slot in timeline.slots_of(key)):
            self._writer.submit(partial(self._show, slot, timeline.number(slot) in missing))

    def _show(self, slot: Slot, is_missing: bool) -> None:
        source, frames = self.job.source, self.job.targets.frames
        assert frames is not None
        if is_missing:
            self._frames.show(None)
        elif slot.index:
            number = source.timeline.number(slot)
            await_file(frames.path(number))  # another machine has just written it
            self._frames.show(self._frames.read(number))
        else:  # the rendered file itself
            number = source.timeline.numbers[slot.key]
            self._frames.show(read_sequence_picture(source.keys.sequence, number, source.keys.view))


class _Task(NamedTuple):
    chunk: Chunk
    future: Any
    worker: str


@dataclass(eq=False)
class ChunkDispatcher:
    """Gives one chunk at a time to each worker that can do the job; repeats those of lost workers.

    A task is pinned to its worker. Dask alone would also give it to workers that cannot do the job,
    such as one that joins later with another version. The client is a connected
    `distributed.Client`; the progress receives each frame once, and messages.
    """

    client: Any
    requirements: WorkerRequirements
    progress: Progress
    _fit: set[str] = field(default_factory=set)
    _unfit: dict[str, str] = field(default_factory=dict)
    _waiting: deque[Chunk] = field(default_factory=deque)
    _tasks: dict[str, _Task] = field(default_factory=dict)  # by worker
    _begun: set[int] = field(default_factory=set)  # chunks that workers are at
    _losses: Counter[int] = field(default_factory=Counter)  # by chunk
    _frames: set[int] = field(default_factory=set)
    # Futures that are done, and events: pairs of their time and content
    _news: queue.SimpleQueue[Any] = field(default_factory=queue.SimpleQueue)
    _looked_at: float = -math.inf
    _unfit_since: float = math.inf  # since when no worker can do the job
    _busy_from: float = math.inf

    def await_workers(self) -> int:
        """Wait until there are workers that can do the job, and return how many.

        ClusterError: no worker comes, or all that are there cannot do the job.
        """
        while not self._fit:
            stop.check_stop()
            self._look()
            if self._unfit and not self._fit:
                worker, reason = min(self._unfit.items())
                raise ClusterError(f"no worker can do this: {worker} {reason}")
            if not self._fit:
                time.sleep(POLL_S)
        return len(self._fit)

    def render(self, chunks: Iterable[Chunk]) -> Generator[tuple[Chunk, ChunkResult], None, None]:
        """Yield chunks with their results, in the order in which they end.

        ClusterError: the scheduler goes away, or a chunk loses its worker again and again.
        ExwarpError: the first error of a chunk.
        """
        self._waiting.extend(chunks)
        self._busy_from = time.monotonic() + ANSWER_S
        for run in {chunk.run for chunk in self._waiting}:
            self._call("subscribe_topic", run, self._news.put)
        try:
            while self._waiting or self._tasks:
                stop.check_stop()
                self._look()
                for worker in sorted(self._fit - self._tasks.keys())[: len(self._waiting)]:
                    chunk = self._waiting.popleft()
                    key = f"{chunk.run}-{chunk.index}-{self._losses[chunk.index]}"
                    future = self._call(
                        "submit", render_chunk, chunk, key=key, workers=[worker], pure=False
                    )
                    self._tasks[worker] = _Task(chunk, future, worker)
                    future.add_done_callback(self._news.put)  # called in another thread
                timeout = POLL_S  # for the first news; then those that are there are taken in
                with suppress(queue.Empty):
                    while True:
                        news = self._news.get(timeout=timeout)
                        timeout = 0.0
                        task = next((t for t in self._tasks.values() if t.future is news), None)
                        if isinstance(news, tuple):
                            self._note(news[1])
                        elif task is not None and (result := self._result_of(task)) is not None:
                            yield task.chunk, result
        finally:
            self._cancel_all()

    def _call(self, method: str, *args: Any, **kwargs: Any) -> Any:
        """Call a method of the client; ClusterError where there is no scheduler any more."""
        try:
            return getattr(self.client, method)(*args, **kwargs)
        except Exception as error:
            # How a closed client fails differs between methods and versions of Dask.
            if not isinstance(error, OSError) and self.client.status == "running":
                raise
            raise ClusterError(
                "the Dask scheduler went away; frames written so far are whole, and "
                "--skip-existing goes on from there"
            ) from error

    def _look(self) -> None:
        """Check new workers, and take back the chunks of lost ones.

        ClusterError where no worker has been fit for too long.
        """
        now = time.monotonic()
        if now - self._looked_at < POLL_S:
            return
        self._looked_at = now
        workers = set(self._call("nthreads"))
        self._fit &= workers
        self._unfit = {w: reason for w, reason in self._unfit.items() if w in workers}
        if new := sorted(workers - self._fit - self._unfit.keys()):
            self._check(new)
        for worker in [worker for worker in self._tasks if worker not in workers]:
            self._repeat(self._tasks.pop(worker))
        if self._fit:
            self._unfit_since = math.inf
        elif self._unfit_since == math.inf:
            self._unfit_since = now
            if not workers and not self._losses:
                self.progress.message("waiting for a worker to join the cluster")
        elif now - self._unfit_since > PATIENCE_S:
            raise ClusterError(
                f"the cluster has had no worker that can do this for {PATIENCE_S:g} seconds; start "
                "some with 'dask worker ADDRESS', and go on with --skip-existing"
            )
        if now > self._busy_from:
            self._busy_from = math.inf
            self.progress.message("waiting for a worker to be free: none has answered yet")

    def _check(self, workers: list[str]) -> None:
        # Not as a task: the answer of a busy worker would have to wait for a free thread.
        answers = self._call(
            "run", check_worker, self.requirements, workers=workers, on_error="return"
        )
        unfit = {}
        for worker, answer in answers.items():
            if answer is None:
                self._fit.add(worker)
            elif isinstance(answer, str):
                unfit[worker] = answer
            elif not isinstance(answer, OSError):  # else it is asked again
                unfit[worker] = (
                    f"cannot run ExWarp {self.requirements.version} ({answer}); install the same "
                    "on all"
                )
        self._unfit |= unfit
        if self._fit:
            for worker, reason in sorted(unfit.items()):
                self.progress.message(f"worker {worker} is left out: it {reason}")

    def _note(self, event: dict[str, Any]) -> None:
        if "frame" in event:
            self._count(event["frame"], event["note"], event["kind"], event["made"])
        elif "begin" in event:
            self._begun.add(event["chunk"])
            self._busy_from = math.inf
        else:
            self._begun.discard(event["chunk"])

    def _count(self, frame: int, note: str | None, kind: str, made: bool) -> None:
        if frame not in self._frames:
            self._frames.add(frame)
            self.progress.advance(frame, note, kind, made)

    def _result_of(self, task: _Task) -> ChunkResult | None:
        """Return what a task came to; None if its worker was lost."""
        from distributed import CancelledError, KilledWorker

        del self._tasks[task.worker]
        try:
            result: ChunkResult | BaseException = task.future.result(timeout=RESULT_S)
        except (CancelledError, KilledWorker, OSError):  # also a time-out, or a closed connection
            self._repeat(task)
            return None
        task.future.release()
        if isinstance(result, BaseException):
            raise result
        outcome, _ = result
        for record in outcome.frames:  # events may come later than the result
            self._count(record.number, record.method, kind_of(record.slot), made=False)
        for number in (number for skip in outcome.left_out for number in skip.frames):
            self._count(number, "left out", ANY, made=False)
        return result

    def _repeat(self, task: _Task) -> None:
        """Put back the chunk of a lost worker; ClusterError after several losses."""
        chunk, frames = task.chunk, task.chunk.frames
        self._begun.discard(chunk.index)
        self._losses[chunk.index] += 1
        if self._losses[chunk.index] >= ATTEMPTS:
            raise ClusterError(
                f"frames {frames} lost their worker {ATTEMPTS} times, so it may be they that "
                "end it; try --frames with a part of them alone, fewer workers, or more memory "
                "for each"
            )
        self.progress.message(f"worker {task.worker} was lost; frames {frames} are done again")
        self._waiting.appendleft(chunk)
        # Again, as a restarted scheduler has forgotten it.
        self._call("subscribe_topic", chunk.run, self._news.put)
        self._call("cancel", [task.future])

    def _cancel_all(self) -> None:
        """Cancel all tasks, and wait until no worker writes any more."""
        futures = [task.future for task in self._tasks.values()]
        begun = self._begun & {task.chunk.index for task in self._tasks.values()}
        self._tasks.clear()
        if not futures:
            return
        try:
            self._call("cancel", futures)
        except ClusterError:  # workers notice by themselves that their client is gone
            return
        deadline = time.monotonic() + CANCEL_S
        while begun and time.monotonic() < deadline:
            stop.note_progress()
            with suppress(queue.Empty):
                news = self._news.get(timeout=POLL_S)
                if isinstance(news, tuple) and "end" in news[1]:
                    begun.discard(news[1]["chunk"])
