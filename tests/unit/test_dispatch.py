"""Which worker gets which chunk, with workers that come, go and refuse: a simulated cluster."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import pytest

from exwarp_cli.domain.results import RunOutcome
from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.errors import ClusterError, OutputError
from exwarp_cli.farm import dask_cluster
from exwarp_cli.farm.dask_cluster import ATTEMPTS, ChunkDispatcher
from exwarp_cli.farm.dask_worker import (
    Chunk,
    WorkerRequirements,
    check_worker,
    render_chunk,
)
from exwarp_cli.pipeline.progress import Progress as Reporter


class Future:
    """A task's result, which is there at once, later, or never."""

    def __init__(self) -> None:
        self.value: Any = None
        self.on_done: Callable[[Future], None] | None = None

    def add_done_callback(self, call: Callable[[Future], None]) -> None:
        self.on_done = call
        if self.value is not None:
            call(self)

    def result(self, timeout: float) -> Any:
        return self.value

    def release(self) -> None:
        pass


@dataclass
class Cluster:
    """A client of workers. `does` returns what a chunk comes to, or None for a task under way."""

    workers: list[str]
    does: Callable[[str, Chunk], Any]
    fits: Callable[[str], str | Exception | None] = lambda _: None
    submitted: list[tuple[str, int]] = field(default_factory=list)
    cancelled: list[Future] = field(default_factory=list)
    handler: Any = None
    topics: list[str] = field(default_factory=list)
    status: str = "running"

    def nthreads(self) -> dict[str, int]:
        return dict.fromkeys(self.workers, 1)

    def run(self, function: Any, _: Any, workers: list[str], on_error: str) -> dict[str, Any]:
        assert function is check_worker and on_error == "return"
        return {worker: self.fits(worker) for worker in workers}

    def submit(self, function: Any, chunk: Chunk, key: str, workers: list[str], **_: Any) -> Future:
        assert function is render_chunk
        (worker,) = workers
        self.submitted.append((worker, chunk.index))
        self.tell(chunk.index, begin=True)
        future = Future()
        future.value = self.does(worker, chunk)
        return future

    def tell(self, chunk: int, **event: Any) -> None:
        self.handler((0.0, {"chunk": chunk, **event}))

    def cancel(self, futures: list[Future]) -> None:
        self.cancelled += futures

    def subscribe_topic(self, topic: str, handler: Any) -> None:
        self.handler = handler
        self.topics.append(topic)


class Progress(Reporter):
    def __init__(self) -> None:
        super().__init__()
        self.frames: list[int] = []
        self.messages: list[str] = []

    def advance(self, frame: int, *_: Any, **__: Any) -> None:
        self.frames.append(frame)

    def message(self, text: str) -> None:
        self.messages.append(text)


DONE = (RunOutcome(), None)


@pytest.fixture(autouse=True)
def quick(monkeypatch) -> None:
    monkeypatch.setattr(dask_cluster, "POLL_S", 0.01)
    monkeypatch.setattr(dask_cluster, "CANCEL_S", 0.05)


def dispatcher_of(cluster: Cluster) -> tuple[ChunkDispatcher, Progress]:
    progress = Progress()
    return ChunkDispatcher(cluster, WorkerRequirements((), version="1"), progress), progress


def chunks(count: int) -> list[Chunk]:
    settings = UpsampleSettings(SourceSettings("in"), "out")
    return [Chunk("run", i, settings, (i,), f"of chunk {i}") for i in range(count)]


def render(dispatcher: ChunkDispatcher, count: int) -> list[int]:
    """Do chunks; return their indices in the order in which they end."""
    return [chunk.index for chunk, _ in dispatcher.render(chunks(count))]


class TestWork:
    def test_each_worker_gets_some(self):
        cluster = Cluster(["a", "b"], lambda *_: DONE)
        dispatcher, progress = dispatcher_of(cluster)
        assert dispatcher.await_workers() == 2
        assert sorted(render(dispatcher, 5)) == [0, 1, 2, 3, 4]
        assert {worker for worker, _ in cluster.submitted} == {"a", "b"}
        assert progress.messages == []

    def test_late_workers_are_used(self):
        cluster = Cluster(["a"], lambda worker, chunk: DONE if worker == "b" else None)
        dispatcher, progress = dispatcher_of(cluster)
        dispatcher.await_workers()
        cluster.workers.append("b")
        indices = []
        for chunk, _ in dispatcher.render(chunks(3)):
            indices.append(chunk.index)
            if len(indices) == 2:
                cluster.workers.remove("a")  # whose task never ends
        assert sorted(indices) == [0, 1, 2]
        assert progress.messages == ["worker a was lost; frames of chunk 0 are done again"]
        assert cluster.topics == ["run", "run"], "a restarted scheduler has forgotten the first"

    def test_the_first_error_cancels_the_others(self):
        error = OutputError("cannot write it")
        cluster = Cluster(["a", "b"], lambda _, chunk: error if chunk.index == 1 else None)
        dispatcher, _ = dispatcher_of(cluster)
        dispatcher.await_workers()
        with pytest.raises(OutputError, match="cannot write it"):
            render(dispatcher, 4)
        assert len(cluster.cancelled) == 1
        assert [index for _, index in cluster.submitted] == [0, 1]

    def test_frames_count_once(self):
        def does(worker: str, chunk: Chunk) -> Any:
            for frame in (1, 2, 1):
                cluster.tell(0, frame=frame, note=None, kind="key", made=True)
            return DONE

        cluster = Cluster(["a"], does)
        dispatcher, progress = dispatcher_of(cluster)
        dispatcher.await_workers()
        render(dispatcher, 1)
        assert progress.frames == [1, 2]


class TestLosses:
    def test_a_chunk_that_ends_its_worker_again_and_again(self):
        def does(worker: str, chunk: Chunk) -> Any:
            if chunk.index != 1:
                return DONE
            cluster.workers[cluster.workers.index(worker)] = f"{worker}'"
            return None

        cluster = Cluster(["a", "b"], does)
        dispatcher, progress = dispatcher_of(cluster)
        dispatcher.await_workers()
        indices = []
        with pytest.raises(ClusterError, match=f"of chunk 1 lost their worker {ATTEMPTS} times"):
            for chunk, _ in dispatcher.render(chunks(3)):
                indices.append(chunk.index)
        assert [index for _, index in cluster.submitted].count(1) == ATTEMPTS
        assert len(progress.messages) == ATTEMPTS - 1 and sorted(indices) == [0, 2]

    def test_a_cluster_without_workers(self, monkeypatch):
        monkeypatch.setattr(dask_cluster, "PATIENCE_S", 0.05)
        dispatcher, progress = dispatcher_of(Cluster([], lambda *_: DONE))
        with pytest.raises(ClusterError, match="no worker that can do this for"):
            dispatcher.await_workers()
        assert progress.messages == ["waiting for a worker to join the cluster"]

    @pytest.mark.parametrize("error", [OSError("closed"), RuntimeError("loop is closed")])
    def test_a_scheduler_that_goes_away(self, error):
        cluster = Cluster(["a"], lambda *_: None)
        dispatcher, _ = dispatcher_of(cluster)
        dispatcher.await_workers()

        def gone() -> dict[str, int]:
            cluster.status = "closed"
            raise error

        cluster.nthreads = gone  # type: ignore[method-assign]
        with pytest.raises(ClusterError, match="scheduler went away"):
            render(dispatcher, 1)


class TestUnfitWorkers:
    def test_all_of_them(self):
        dispatcher, _ = dispatcher_of(Cluster(["a", "b"], lambda *_: DONE, lambda _: "is of wood"))
        with pytest.raises(ClusterError, match="no worker can do this: a is of wood"):
            dispatcher.await_workers()

    def test_one_of_them(self):
        answers = {"a": ModuleNotFoundError("No module named 'exwarp_cli'"), "b": None}
        cluster = Cluster(["a", "b"], lambda *_: DONE, answers.get)
        dispatcher, progress = dispatcher_of(cluster)
        assert dispatcher.await_workers() == 1
        render(dispatcher, 2)
        assert {worker for worker, _ in cluster.submitted} == {"b"}
        (message,) = progress.messages
        assert "worker a is left out" in message and "No module named" in message

    def test_one_that_did_not_answer_is_asked_again(self):
        answers = [OSError("timed out"), None]
        dispatcher, progress = dispatcher_of(
            Cluster(["a"], lambda *_: DONE, lambda _: answers.pop(0))
        )
        assert dispatcher.await_workers() == 1 and progress.messages == []
