"""Reading ahead, slots in parallel, writing behind: in order, bounded, and errors come out."""

from __future__ import annotations

import threading
import time
from functools import partial
from typing import Any

import numpy as np
import pytest

from exwarp_cli.domain.decision import Plan
from exwarp_cli.errors import InputError
from exwarp_cli.kernels import _row_bands
from exwarp_cli.pipeline.interval_builder import PreparedInterval
from exwarp_cli.pipeline.scheduling import (
    MAX_PIXELS_AHEAD,
    AsyncWriter,
    ParallelSlots,
    fits_pool,
    prefetch,
    read_depth,
    run_with_core,
)
from exwarp_cli.runtime import cores
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import METHODS
from exwarp_cli.synthesis.motion_fields import reproject
from tests.bench.street import key_frame

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


class TestPrefetch:
    @pytest.mark.parametrize("depth", [0, 1, 3, 50])
    def test_everything_comes_in_order(self, depth):
        counter = Counter()
        tasks = (counter.task(i) for i in range(20))
        assert list(prefetch(tasks, depth)) == list(range(20))
        assert counter.begun == list(range(20))

    def test_nothing_gives_nothing(self):
        assert list(prefetch([], 2)) == []

    def test_it_never_runs_further_ahead(self):
        counter = Counter()
        for taken, value in enumerate(prefetch((counter.task(i) for i in range(20)), 2), 1):
            time.sleep(0.002)  # let the reader run as far as it may
            assert value == taken - 1
            assert len(counter.begun) <= taken + 2

    def test_it_does_run_ahead(self):
        reached = threading.Event()

        def second() -> str:
            reached.set()
            return "b"

        stream = prefetch([lambda: "a", second, lambda: "c"], 1)
        assert next(stream) == "a"
        assert reached.wait(SOON)  # before it was asked for
        assert list(stream) == ["b", "c"]

    def test_an_error_comes_where_its_result_is_due(self):
        counter = Counter()
        stream = prefetch((counter.task(i, fails=i == 3) for i in range(20)), 2)
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
            list(prefetch(tasks(), 3))

    def test_a_consumer_may_stop_early(self):
        counter = Counter()
        stream = prefetch((counter.task(i) for i in range(1000)), 2)
        assert next(stream) == 0
        stream.close()
        assert len(counter.begun) <= 4


class TestAsyncWriter:
    @pytest.mark.parametrize("threads", [1, 3])
    def test_everything_is_written(self, threads):
        written: list[int] = []
        with AsyncWriter(threads, 2) as behind:
            for i in range(30):
                behind.submit(lambda i=i: written.append(i))
        assert sorted(written) == list(range(30))
        assert threads > 1 or written == list(range(30))

    def test_at_most_so_many_are_under_way(self):
        release = threading.Event()
        submitted = []

        def submit_all() -> None:
            with AsyncWriter(2, 3) as behind:
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
        with pytest.raises(OSError, match="disk full"), AsyncWriter(1, 2) as behind:
            for _ in range(100):
                behind.submit(fail)
                count += 1
        assert count <= 3

    def test_an_error_of_the_last_write_is_not_lost(self):
        def fail() -> None:
            raise OSError("disk full")

        with pytest.raises(OSError, match="disk full"), AsyncWriter(2, 4) as behind:
            behind.submit(fail)

    def test_what_waits_is_written_where_the_input_ends_it(self):
        done, gate = [], threading.Event()
        with pytest.raises(InputError), AsyncWriter(1, 8) as writer:
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

        with pytest.raises(KeyboardInterrupt), AsyncWriter(1, 8) as behind:
            behind.submit(slow)
            for _ in range(5):
                behind.submit(never)
            assert begun.wait(SOON)
            raise KeyboardInterrupt
        assert finished[0] is True and len(finished) <= 2


@pytest.fixture(scope="module")
def key():
    """A key frame; a parallel kernel has run, as settling motion does before any slot is made."""
    frame = key_frame(1, size=(40, 60))
    reproject(frame.gbuffer, 0.5)
    return frame


class TestParallelSlots:
    @pytest.fixture(autouse=True)
    def usual_threads(self, key):
        yield
        _row_bands.set_threads(None)

    @pytest.mark.parametrize("in_pool", [False, True])
    @pytest.mark.parametrize("name", ["s6", "softsplat"])
    def test_frames_are_those_made_in_order(self, key, in_pool, name):
        interval = Interval(key, key_frame(2, size=(40, 60)))
        predict = METHODS[name].predict
        expected = [predict(interval, slot).pixels for slot in (1, 2, 3)]

        def render(slot: int) -> np.ndarray:
            interval.forget(slot)
            return predict(interval, slot).pixels

        with ParallelSlots(2, 3) as slots:
            rendered = list(slots.render(render, (1, 2, 3), in_pool))
        for pixels, other in zip(rendered, expected, strict=True):
            np.testing.assert_array_equal(pixels, other)

    def test_as_many_as_there_are_threads_are_under_way(self):
        arrived, gate, order = threading.Semaphore(0), threading.Semaphore(0), []

        def render(slot: int) -> int:
            arrived.release()
            gate.acquire()
            return 10 * slot

        with ParallelSlots(2, 3) as slots:
            stream = slots.render(render, (1, 2, 3), in_pool=True)
            taking = threading.Thread(target=lambda: order.extend(stream))
            taking.start()
            assert arrived.acquire(timeout=SOON) and arrived.acquire(timeout=SOON)
            assert not arrived.acquire(timeout=0.1)
            gate.release(3)
            taking.join(SOON)
        assert order == [10, 20, 30]

    @pytest.mark.parametrize(("threads", "slots", "share"), [(2, 3, 1), (8, 3, 2), (3, 7, 1)])
    def test_threads_are_shared_out(self, threads, slots, share, monkeypatch):
        shares: list[int] = []
        monkeypatch.setattr(_row_bands, "set_threads", shares.append)
        with ParallelSlots(threads, slots) as pool:
            rendered = pool.render(lambda slot: slot, range(slots), in_pool=True)
            assert list(rendered) == list(range(slots))
        assert shares and set(shares) == {share}

    def test_a_slot_holds_the_cores_of_its_share(self):
        """While two slots have two of four cores each, there is none for anything else."""
        cores.set_count(4, 8)
        rendering, gate, began = threading.Semaphore(0), threading.Event(), threading.Event()

        def render(slot: int) -> int:
            rendering.release()
            assert gate.wait(SOON)
            return slot

        with ParallelSlots(4, 2) as slots:
            stream = slots.render(render, (1, 2), in_pool=True)
            taking = threading.Thread(target=lambda: list(stream))
            taking.start()
            assert rendering.acquire(timeout=SOON) and rendering.acquire(timeout=SOON)
            other = threading.Thread(target=run_with_core, args=(began.set,))
            other.start()
            assert not began.wait(0.1)
            gate.set()
            assert began.wait(SOON)
            taking.join(SOON)
            other.join(SOON)

    @pytest.mark.parametrize("in_pool", [False, True])
    def test_an_error_comes_where_its_slot_is_due(self, in_pool):
        def render(slot: int) -> int:
            if slot == 2:
                raise ValueError(f"slot {slot}")
            return slot

        with ParallelSlots(2, 2) as slots:
            rendered = slots.render(render, (1, 2), in_pool)
            assert next(rendered) == 1
            with pytest.raises(ValueError, match="slot 2"):
                next(rendered)


class TestPool:
    """Slots are rendered in a pool where each is warped by itself, and memory permits."""

    SMALL = 1920 * 1080

    def fits(self, key: Any, method: str = "causal", path: str | None = None, **more: Any) -> bool:
        plan = None if path is None else Plan.fixed(path)
        slots = more.pop("slots", ())
        prepared = PreparedInterval(Interval(key, None, slots), plan, frozenset(), {}, {})
        given = {"pixels": self.SMALL, "has_layers": False, "workers": 2} | more
        return fits_pool(prepared, METHODS[method], **given)

    @pytest.mark.parametrize(
        ("method", "path"),
        [("s6", "S6"), ("blend", None), ("causal", "S6"), ("causal", None)],
    )
    def test_warps_go_to_the_pool(self, key, method, path):
        assert self.fits(key, method, path)

    @pytest.mark.parametrize(
        ("method", "path"),
        [("causal", "S1"), ("s3", "S3"), ("s5", "S5"), ("onnx", None), ("softsplat", None)],
    )
    def test_networks_optical_flow_and_other_paths_do_not(self, key, method, path):
        assert not self.fits(key, method, path)

    def test_nor_do_layers_g_buffers_of_slots_large_frames_or_a_single_thread(self, key):
        buffers = (key.gbuffer,) * 3
        for more in (
            {"has_layers": True}, {"slots": buffers}, {"workers": 1},
            {"pixels": MAX_PIXELS_AHEAD + 1},
        ):  # fmt: skip
            assert not self.fits(key, "s6", "S6", **more)

    def test_large_frames_are_not_read_ahead(self):
        assert read_depth(self.SMALL) == 1 and read_depth(3840 * 2160) == 0
