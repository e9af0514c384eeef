"""Reading ahead and writing behind: in order, bounded, and errors come out."""

from __future__ import annotations

import threading
import time
from functools import partial

import pytest

from exwarp_cli.errors import InputError
from exwarp_cli.pipeline.schedule import WriteBehind, read_ahead

SOON = 10.0
"""Seconds after which a wait counts as hanging; none should take a hundredth of it."""


@pytest.fixture(autouse=True)
def no_thread_is_left():
    """Whatever a test does, the pools end with it."""
    yield
    deadline = time.monotonic() + SOON
    while any(t.name.startswith("exwarp-") for t in threading.enumerate()):
        assert time.monotonic() < deadline, "a thread hangs"
        time.sleep(0.001)


class Counter:
    """Tasks that count how many were begun."""

    def __init__(self) -> None:
        self.begun: list[int] = []

    def task(self, index: int, fails: bool = False):
        def run() -> int:
            self.begun.append(index)
            if fails:
                raise ValueError(f"task {index}")
            return index

        return run


class TestReadAhead:
    @pytest.mark.parametrize("depth", [0, 1, 3, 50])
    def test_everything_comes_in_order(self, depth):
        counter = Counter()
        tasks = (counter.task(i) for i in range(20))
        assert list(read_ahead(tasks, depth)) == list(range(20))
        assert counter.begun == list(range(20))

    def test_nothing_gives_nothing(self):
        assert list(read_ahead([], 2)) == []

    def test_it_never_runs_further_ahead(self):
        counter = Counter()
        for taken, value in enumerate(read_ahead((counter.task(i) for i in range(20)), 2), 1):
            time.sleep(0.002)  # let the reader run as far as it may
            assert value == taken - 1
            assert len(counter.begun) <= taken + 2

    def test_it_does_run_ahead(self):
        reached = threading.Event()

        def second() -> str:
            reached.set()
            return "b"

        stream = read_ahead([lambda: "a", second, lambda: "c"], 1)
        assert next(stream) == "a"
        assert reached.wait(SOON)  # before it was asked for
        assert list(stream) == ["b", "c"]

    def test_an_error_comes_where_its_result_is_due(self):
        counter = Counter()
        stream = read_ahead((counter.task(i, fails=i == 3) for i in range(20)), 2)
        assert [next(stream) for _ in range(3)] == [0, 1, 2]
        with pytest.raises(ValueError, match="task 3"):
            next(stream)
        assert len(counter.begun) <= 7
        with pytest.raises(StopIteration):
            next(stream)

    def test_an_error_while_tasks_are_made_comes_too(self):
        def tasks():
            yield lambda: 1
            raise KeyError("broken")

        with pytest.raises(KeyError, match="broken"):
            list(read_ahead(tasks(), 3))

    def test_a_consumer_may_stop_early(self):
        counter = Counter()
        stream = read_ahead((counter.task(i) for i in range(1000)), 2)
        assert next(stream) == 0
        stream.close()
        assert len(counter.begun) <= 4


class TestWriteBehind:
    @pytest.mark.parametrize("threads", [1, 3])
    def test_everything_is_written(self, threads):
        written: list[int] = []
        with WriteBehind(threads, 2) as behind:
            for i in range(30):
                behind.submit(lambda i=i: written.append(i))
        assert sorted(written) == list(range(30))
        assert threads > 1 or written == list(range(30))

    def test_at_most_so_many_are_under_way(self):
        release = threading.Event()
        submitted = []

        def submit_all() -> None:
            with WriteBehind(2, 3) as behind:
                for i in range(6):
                    behind.submit(lambda: release.wait(SOON) and None)
                    submitted.append(i)

        thread = threading.Thread(target=submit_all)
        thread.start()
        deadline = time.monotonic() + SOON
        while len(submitted) < 3 and time.monotonic() < deadline:
            time.sleep(0.001)
        time.sleep(0.02)
        assert len(submitted) == 3  # the fourth waits
        release.set()
        thread.join(SOON)
        assert len(submitted) == 6 and not thread.is_alive()

    def test_the_first_error_stops_the_submitting(self):
        def fail() -> None:
            raise OSError("disk full")

        count = 0
        with pytest.raises(OSError, match="disk full"), WriteBehind(1, 2) as behind:
            for _ in range(100):
                behind.submit(fail)
                count += 1
        assert count <= 3

    def test_an_error_of_the_last_write_is_not_lost(self):
        def fail() -> None:
            raise OSError("disk full")

        with pytest.raises(OSError, match="disk full"), WriteBehind(2, 4) as behind:
            behind.submit(fail)

    def test_what_waits_is_written_where_the_input_ends_it(self):
        done, gate = [], threading.Event()
        with pytest.raises(InputError), WriteBehind(1, 8) as writer:
            writer.submit(lambda: done.append(gate.wait(SOON)))
            for number in range(5):
                writer.submit(partial(done.append, number))
            threading.Timer(0.02, gate.set).start()
            raise InputError("the next frame is damaged")
        assert done == [True, 0, 1, 2, 3, 4]

    def test_another_error_is_not_hidden_and_what_began_is_finished(self):
        begun, finished = threading.Event(), []

        def slow() -> None:
            begun.set()
            time.sleep(0.02)
            finished.append(True)

        def never() -> None:
            finished.append(False)

        with pytest.raises(KeyboardInterrupt), WriteBehind(1, 8) as behind:
            behind.submit(slow)
            for _ in range(5):
                behind.submit(never)
            assert begun.wait(SOON)
            raise KeyboardInterrupt
        assert finished[0] is True and len(finished) <= 2
