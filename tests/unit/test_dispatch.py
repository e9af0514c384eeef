"""Who gets which chunk, with workers that come, go and refuse: a cluster made of plain objects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import pytest

from exwarp_cli.domain.results import RunOutcome
from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.errors import ClusterError, OutputError
from exwarp_cli.farm import cluster_dispatch
from exwarp_cli.farm.cluster_dispatch import ATTEMPTS, Dispatch
from exwarp_cli.farm.cluster_work import Chunk, Done, Needs, unfit, work


class Future:
    """A task's result that is there at once, later, or never."""

    def __init__(self) -> None:
        self.status, self._value = "pending", None
        self._call: Callable[[Future], None] | None = None

    def add_done_callback(self, call: Callable[[Future], None]) -> None:
        self._call = call
        if self.status != "pending":
            call(self)

    def finish(self, value: Any, status: str = "finished") -> None:
        self.status, self._value = status, value
        if self._call is not None:
            self._call(self)

    def result(self, timeout: float) -> Any:
        if self.status == "error":
            raise self._value
        return self._value

    def cancel(self) -> None:
        self.status = "cancelled"

    release = cancel


@dataclass
class Cluster:
    """A client of workers that do what `does` says: return what a chunk comes to, or None."""

    workers: list[str]
    does: Callable[[str, Chunk], Any]
    fits: Callable[[str], str | Exception | None] = lambda _: None
    given: list[tuple[str, int]] = field(default_factory=list)
    cancelled: list[Future] = field(default_factory=list)
    handler: Any = None

    def nthreads(self) -> dict[str, int]:
        return dict.fromkeys(self.workers, 1)

    def submit(self, function: Any, argument: Any, key: str, workers: list[str], **_: Any) -> Any:
        future, (worker,) = Future(), workers
        if function is unfit:
            answer = self.fits(worker)
            future.finish(answer, "error" if isinstance(answer, Exception) else "finished")
            return future
        assert function is work
        self.given.append((worker, argument.index))
        self.handler((0.0, {"chunk": argument.index, "attempt": argument.attempt, "begin": True}))
        result = self.does(worker, argument)
        if result is not None:
            future.finish(result)
        return future

    def cancel(self, futures: list[Future]) -> None:
        self.cancelled += futures

    def subscribe_topic(self, topic: str, handler: Any) -> None:
        self.handler = handler

    def unsubscribe_topic(self, topic: str) -> None:
        pass


DONE = Done(RunOutcome(), None)


@pytest.fixture(autouse=True)
def quick(monkeypatch) -> None:
    monkeypatch.setattr(cluster_dispatch, "POLL_S", 0.01)
    monkeypatch.setattr(cluster_dispatch, "CALL_OFF_S", 0.05)


@dataclass
class Reports:
    done: list[int] = field(default_factory=list)
    frames: list[int] = field(default_factory=list)
    said: list[str] = field(default_factory=list)


def dispatch(cluster: Cluster) -> tuple[Dispatch, Reports]:
    reports = Reports()
    made = Dispatch(
        cluster,
        Needs("1", ()),
        lambda frame, *_: reports.frames.append(frame),
        lambda chunk, _: reports.done.append(chunk.index),
        reports.said.append,
        lambda chunk: f"of chunk {chunk.index}",
    )
    return made, reports


def chunks(count: int) -> list[Chunk]:
    settings = UpsampleSettings(SourceSettings("in"), "out")
    return [Chunk("run", "topic", index, 0, settings, (index,), None) for index in range(count)]


class TestWork:
    def test_everybody_gets_some(self):
        cluster = Cluster(["a", "b"], lambda *_: DONE)
        made, reports = dispatch(cluster)
        assert made.muster() == 2
        made.run(chunks(5))
        assert sorted(reports.done) == [0, 1, 2, 3, 4]
        assert {worker for worker, _ in cluster.given} == {"a", "b"} and reports.said == []

    def test_who_comes_late_is_used(self):
        cluster = Cluster(["a"], lambda worker, chunk: DONE if worker == "b" else None)
        made, reports = dispatch(cluster)
        made.muster()
        cluster.workers.append("b")

        def give_back(chunk: Chunk, _: Done) -> None:
            reports.done.append(chunk.index)
            if len(reports.done) == 2:
                cluster.workers.remove("a")  # which never comes to an end

        made.on_chunk = give_back
        made.run(chunks(3))
        assert sorted(reports.done) == [0, 1, 2]
        assert reports.said == ["worker a was lost; frames of chunk 0 are done again"]

    def test_the_first_error_ends_it_and_calls_off_the_others(self):
        error = OutputError("cannot write it")
        cluster = Cluster(["a", "b"], lambda _, chunk: error if chunk.index == 1 else None)
        made, reports = dispatch(cluster)
        made.muster()
        with pytest.raises(OutputError, match="cannot write it"):
            made.run(chunks(4))
        assert len(cluster.cancelled) == 1 and reports.done == []
        assert [index for _, index in cluster.given] == [0, 1]

    def test_frames_count_once(self):
        def does(worker: str, chunk: Chunk) -> Any:
            for frame in (1, 2, 1):
                event = {"frame": frame, "note": None, "kind": "key", "made": True}
                cluster.handler((0.0, {"chunk": 0, "attempt": 0} | event))
            return DONE

        cluster = Cluster(["a"], does)
        made, reports = dispatch(cluster)
        made.muster()
        made.run(chunks(1))
        assert reports.frames == [1, 2]


class TestLosses:
    def test_a_chunk_that_ends_its_worker_again_and_again(self):
        def does(worker: str, chunk: Chunk) -> Any:
            if chunk.index != 1:
                return DONE
            cluster.workers[cluster.workers.index(worker)] = f"{worker}'"
            return None

        cluster = Cluster(["a", "b"], does)
        made, reports = dispatch(cluster)
        made.muster()
        with pytest.raises(ClusterError, match=f"of chunk 1 lost their worker {ATTEMPTS} times"):
            made.run(chunks(3))
        assert [index for _, index in cluster.given].count(1) == ATTEMPTS
        assert len(reports.said) == ATTEMPTS - 1 and sorted(reports.done) == [0, 2]

    def test_a_worker_that_comes_back_under_its_address(self):
        """Dask gives it its task again by itself, which shows by a second beginning."""

        def does(worker: str, chunk: Chunk) -> Any:
            cluster.handler((0.0, {"chunk": 0, "attempt": 0, "begin": True}))
            cluster.handler((0.0, {"chunk": 0, "attempt": 0, "end": True}))
            return DONE

        cluster = Cluster(["a"], does)
        made, reports = dispatch(cluster)
        made.muster()
        made.run(chunks(1))
        assert reports.done == [0] and len(cluster.given) == 1
        assert reports.said == ["worker a was lost; frames of chunk 0 are done again"]

    def test_a_cluster_without_workers(self, monkeypatch):
        monkeypatch.setattr(cluster_dispatch, "PATIENCE_S", 0.05)
        made, reports = dispatch(Cluster([], lambda *_: DONE))
        with pytest.raises(ClusterError, match="no worker that can do this for"):
            made.muster()
        assert reports.said == ["waiting for a worker to join the cluster"]

    def test_a_scheduler_that_goes_away(self):
        cluster = Cluster(["a"], lambda *_: None)
        made, _ = dispatch(cluster)
        made.muster()

        def gone() -> dict[str, int]:
            raise OSError("closed")

        cluster.nthreads = gone  # type: ignore[method-assign]
        with pytest.raises(ClusterError, match="scheduler went away"):
            made.run(chunks(1))


class TestUnfit:
    def test_all_of_them(self):
        made, _ = dispatch(Cluster(["a", "b"], lambda *_: DONE, lambda _: "is of wood"))
        with pytest.raises(ClusterError, match="no worker can do this: a is of wood"):
            made.muster()

    def test_one_of_them(self):
        answers = {"a": ModuleNotFoundError("No module named 'exwarp_cli'"), "b": None}
        cluster = Cluster(["a", "b"], lambda *_: DONE, answers.get)
        made, reports = dispatch(cluster)
        assert made.muster() == 1
        made.run(chunks(2))
        assert {worker for worker, _ in cluster.given} == {"b"}
        (said,) = reports.said
        assert "worker a is left out" in said and "No module named" in said
