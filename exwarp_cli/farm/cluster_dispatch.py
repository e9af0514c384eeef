"""Giving chunks to workers, one at a time each, and giving them again where a worker is lost.

Every task is pinned to one worker. So a worker that cannot do the job, be it one that joins late,
is never asked; and who is lost, and how often a chunk was begun, is known here and not only in a
scheduler that others configured.
"""

from __future__ import annotations

import queue
import time
import uuid
from collections import Counter, deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from distributed import CancelledError, KilledWorker

from exwarp_cli.errors import ClusterError
from exwarp_cli.farm.cluster_work import Chunk, Done, Needs, unfit, work
from exwarp_cli.pipeline.progress import ANY, kind_of
from exwarp_cli.runtime.stop import check_stop, note_progress

POLL_S = 0.5
"""Seconds between two looks at who is there."""

PATIENCE_S = 180.0
"""Seconds to wait for a worker when there is none: batch systems take minutes to start some."""

ATTEMPTS = 4
"""How often a chunk may be begun: one that ends its worker every time would end them all."""

RESULT_S = 60.0
"""Seconds that a finished chunk's records may take to arrive."""

CALL_OFF_S = 10.0
"""Seconds to wait for chunks that are called off: they stop at their next frame."""

ANSWER_S = 10.0
"""Seconds that workers have to say whether they are fit, once one has; the rest join later."""

_GONE = (OSError, TimeoutError)
"""What Dask raises when no answer comes; its CommClosedError is an OSError."""


@dataclass
class _Task:
    """A chunk that a worker has, and whether it is at it."""

    chunk: Chunk
    future: Any
    worker: str
    is_begun: bool = False


@dataclass
class Dispatch:
    """Chunks of one run on one cluster.

    Attributes
    ----------
    client
        Connected.
    needs
        What a worker must have.
    on_frame
        Called once for every frame, as `Progress.advance` is.
    on_chunk
        Called for every chunk when it is done, in the order in which they are.
    say
        Tells the user something.
    name_of
        Names a chunk's frames.
    """

    client: Any
    needs: Needs
    on_frame: Callable[[int, str | None, str, bool], None]
    on_chunk: Callable[[Chunk, Done], None]
    say: Callable[[str], None]
    name_of: Callable[[Chunk], str]
    _asked: dict[str, Any] = field(default_factory=dict)
    _fit: set[str] = field(default_factory=set)
    _left_out: dict[str, str] = field(default_factory=dict)
    _tasks: dict[str, _Task] = field(default_factory=dict)
    _waiting: deque[Chunk] = field(default_factory=deque)
    _losses: Counter[int] = field(default_factory=Counter)
    _news: queue.SimpleQueue[tuple[Any, ...]] = field(default_factory=queue.SimpleQueue)
    _topics: set[str] = field(default_factory=set)
    _counted: set[int] = field(default_factory=set)
    _looked_at: float = -float("inf")
    _alone_since: float | None = None
    _unanswered_since: float | None = None
    _said_busy: bool = False
    _mustered: bool = False

    def muster(self) -> int:
        """Wait for workers that can do the job, and return how many there are.

        Raises
        ------
        ClusterError
            When none comes, or all that are there cannot do it.
        """
        deadline = float("inf")
        while not self._fit or (self._asked and time.monotonic() < deadline):
            self._look()
            self._hear()
            if self._fit:
                deadline = min(deadline, time.monotonic() + ANSWER_S)
            elif self._left_out and not self._asked:
                worker, answer = min(self._left_out.items())
                raise ClusterError(f"no worker can do this: {worker} {answer}")
        for worker, answer in sorted(self._left_out.items()):
            self._say_left_out(worker, answer)
        self._mustered = True
        return len(self._fit)

    def run(self, chunks: Iterable[Chunk]) -> None:
        """Have all chunks done.

        Raises
        ------
        ClusterError
            When the cluster goes away, or a chunk loses its worker again and again.
        ExwarpError
            As the first chunk raised it that failed.
        """
        self._waiting.extend(chunks)
        self._topics.update(chunk.topic for chunk in self._waiting)
        self._listen()
        try:
            while self._waiting or self._tasks:
                self._look()
                self._assign()
                self._hear()
        finally:
            self._call_off()

    def _listen(self) -> None:
        """Hear what workers tell: what was subscribed to ends with the client, or a scheduler."""
        for topic in self._topics:
            self._ask("subscribe_topic", topic, lambda event: self._news.put(("event", event[1])))

    def _ask(self, what: str, *about: Any, **more: Any) -> Any:
        """Call a method of the client; raises ClusterError where there is no scheduler any more."""
        try:
            return getattr(self.client, what)(*about, **more)
        except Exception as error:
            # How a client fails that has given up differs between methods and versions of Dask.
            if not isinstance(error, _GONE) and self.client.status == "running":
                raise
            raise ClusterError(
                "the Dask scheduler went away; frames written so far are whole, and "
                "--skip-existing goes on from there"
            ) from error

    def _look(self) -> None:
        """See who is there: find fit workers among new ones, and chunks of lost ones."""
        now = time.monotonic()
        if now - self._looked_at < POLL_S:
            return
        self._looked_at = now
        there = set(self._ask("nthreads"))
        self._left_out = {w: answer for w, answer in self._left_out.items() if w in there}
        self._asked = {worker: asked for worker, asked in self._asked.items() if worker in there}
        for worker in sorted(there - self._fit - set(self._left_out) - set(self._asked)):
            future = self._submit(unfit, self.needs, worker)
            self._asked[worker] = future
            future.add_done_callback(partial(self._note, "answer", worker))
        self._fit &= there
        for worker in [worker for worker in self._tasks if worker not in there]:
            self._lost(self._tasks.pop(worker), again=True)
        self._wait_for_some(now, bool(there))

    def _submit(self, function: Callable[..., Any], argument: object, worker: str) -> Any:
        """Have something done by one worker and no other."""
        key = f"exwarp-{function.__name__}-{uuid.uuid4().hex}"
        return self._ask("submit", function, argument, key=key, workers=[worker], pure=False)

    def _note(self, kind: str, worker: str, future: Any) -> None:
        """Take down that a task has come to an end, from whichever thread tells."""
        self._news.put((kind, (worker, future)))

    def _answered(self, worker: str, future: Any) -> None:
        """Take in whether a worker is fit; one that was lost meanwhile is asked again."""
        if self._asked.get(worker) != future:
            return
        del self._asked[worker]
        answer: str | None
        try:
            answer = future.result(timeout=RESULT_S)
        except (CancelledError, KilledWorker, *_GONE):
            return
        except Exception as error:  # whatever comes of code that is not there, or another
            answer = f"cannot run ExWarp {self.needs.version} ({error}); install the same on all"
        if answer is None:
            self._fit.add(worker)
            return
        self._left_out[worker] = answer
        if self._mustered:
            self._say_left_out(worker, answer)

    def _say_left_out(self, worker: str, answer: str) -> None:
        self.say(f"worker {worker} is left out: it {answer}")

    def _wait_for_some(self, now: float, any_there: bool) -> None:
        """Be patient while no worker takes work; raises ClusterError when none is there for long.

        Those that are there and do not answer are busy with other things, however long these take;
        the scheduler itself gives up dead ones.
        """
        unanswered = not self._fit and bool(self._asked)
        alone = not self._fit and not self._asked
        self._unanswered_since = (self._unanswered_since or now) if unanswered else None
        self._alone_since = (self._alone_since or now) if alone else None
        if now - (self._unanswered_since or now) > ANSWER_S and not self._said_busy:
            self._said_busy = True
            self.say("waiting for a worker to be free: none has answered yet")
        if self._alone_since == now and not any_there and not self._losses:
            self.say("waiting for a worker to join the cluster")
        elif now - (self._alone_since or now) > PATIENCE_S:
            raise ClusterError(
                f"the cluster has had no worker that can do this for {PATIENCE_S:g} seconds; start "
                "some with 'dask worker ADDRESS', and go on with --skip-existing"
            )

    def _assign(self) -> None:
        """Give a chunk to every worker that has none."""
        for worker in sorted(self._fit - set(self._tasks)):
            if not self._waiting:
                return
            chunk = self._waiting.popleft()
            chunk = replace(chunk, attempt=self._losses[chunk.index])
            future = self._submit(work, chunk, worker)
            self._tasks[worker] = _Task(chunk, future, worker)
            future.add_done_callback(partial(self._note, "done", worker))

    def _hear(self) -> None:
        """Take in what happened, and wait a little where nothing did."""
        check_stop()
        try:
            kind, what = self._news.get(timeout=POLL_S)
            while True:
                if kind == "event":
                    self._event(what)
                elif kind == "answer":
                    self._answered(*what)
                else:
                    self._finished(*what)
                kind, what = self._news.get_nowait()
        except queue.Empty:
            return

    def _event(self, event: dict[str, Any]) -> None:
        """Take in what a worker tells: that it begins or ends a chunk, or has done a frame."""
        if "frame" in event:
            self._count(event["frame"], event["note"], event["kind"], event["made"])
            return
        for task in self._tasks.values():
            if (task.chunk.index, task.chunk.attempt) != (event["chunk"], event["attempt"]):
                continue
            if task.is_begun and "begin" in event:  # its worker came back under the same address
                self._lost(task, again=False)
            task.is_begun = "begin" in event

    def _count(self, frame: int, note: str | None, kind: str, made: bool) -> None:
        if frame not in self._counted:
            self._counted.add(frame)
            self.on_frame(frame, note, kind, made)

    def _finished(self, worker: str, future: Any) -> None:
        """Take over what a chunk came to."""
        task = self._tasks.get(worker)
        if task is None or task.future is not future:
            return  # given to another one meanwhile
        del self._tasks[worker]
        try:
            result = future.result(timeout=RESULT_S)
        except (CancelledError, KilledWorker, *_GONE):  # by Dask, or by others
            self._lost(task, again=True)
            return
        future.release()
        if isinstance(result, BaseException):
            raise result
        for record in result.outcome.frames:
            self._count(record.number, record.method, kind_of(record.slot), made=False)
        for number in (number for one in result.outcome.left_out for number in one.frames):
            self._count(number, "left out", ANY, made=False)
        self.on_chunk(task.chunk, result)

    def _lost(self, task: _Task, again: bool) -> None:
        """Note that a chunk lost its worker; have it done again unless Dask does."""
        index, name = task.chunk.index, self.name_of(task.chunk)
        self._losses[index] += 1
        if self._losses[index] >= ATTEMPTS:
            raise ClusterError(
                f"frames {name} lost their worker {ATTEMPTS} times, so it may be they that end it; "
                "try --frames with a part of them alone, fewer workers, or more memory for each"
            )
        self.say(f"worker {task.worker} was lost; frames {name} are done again")
        if again:
            # A scheduler that was started anew knows neither the chunk nor who listens.
            self._listen()
            self._ask("cancel", [task.future])
            self._waiting.appendleft(task.chunk)

    def _call_off(self) -> None:
        """Stop what is under way, and wait until it has: then no worker writes any more."""
        under_way = {task.chunk.index for task in self._tasks.values() if task.is_begun}
        futures = [task.future for task in self._tasks.values()]
        self._tasks.clear()
        if not futures:
            return
        try:
            self._ask("cancel", futures)
        except ClusterError:  # workers notice themselves that no client waits for them
            return
        deadline = time.monotonic() + CALL_OFF_S
        while under_way and (left := deadline - time.monotonic()) > 0:
            note_progress()
            with suppress(queue.Empty):
                kind, what = self._news.get(timeout=min(left, POLL_S))
                if kind == "event" and "end" in what:
                    under_way.discard(what["chunk"])
