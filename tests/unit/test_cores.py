"""Cores that threads of a command share: never too many at work, and no thread waits for ever."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import pytest

from exwarp_cli.runtime import cores
from exwarp_cli.runtime.cores import hold_cores, release_cores

SOON = 10.0
"""Seconds after which a wait counts as hanging; none should take a hundredth of it."""


class Busy:
    """Counts who is in a block at the same time."""

    def __init__(self) -> None:
        self._lock, self._now, self.most = threading.Lock(), 0, 0

    def work(self, many: int = 1, seconds: float = 0.002) -> None:
        with self._lock:
            self._now += many
            self.most = max(self.most, self._now)
        time.sleep(seconds)
        with self._lock:
            self._now -= many


def side_by_side(count: int, work: Callable[[], None]) -> None:
    """Do something in so many threads, three times in each."""
    with ThreadPoolExecutor(count) as pool:
        done = [pool.submit(work) for _ in range(3 * count)]
        for each in done:
            each.result(SOON)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_no_more_work_than_there_are_cores_for(count):
    cores.set_count(count, 8)
    busy = Busy()

    def work() -> None:
        with hold_cores():
            busy.work()

    side_by_side(6, work)
    assert (cores.count(), busy.most) == (count, count)


def test_without_a_bound_no_thread_waits():
    cores.set_count(None, 8)
    meeting = threading.Barrier(6)

    def work() -> None:
        with hold_cores(), release_cores():
            meeting.wait(SOON)

    side_by_side(6, work)


def test_cores_are_given_to_others_for_as_long_as_their_owner_waits():
    cores.set_count(1, 8)
    order = []

    def work() -> None:
        with hold_cores():
            order.append("other")

    with ThreadPoolExecutor(1) as pool, hold_cores():
        other = pool.submit(work)
        time.sleep(0.02)
        order.append("before")
        with release_cores():
            other.result(SOON)
        order.append("after")
    assert order == ["before", "other", "after"]


def test_some_take_several_and_all_is_the_most():
    cores.set_count(3, 8)
    busy = Busy()

    def work(many: int) -> Callable[[], None]:
        def run() -> None:
            with hold_cores(many):
                busy.work(min(many, 3))

        return run

    with ThreadPoolExecutor(6) as pool:
        done = [pool.submit(work(many)) for many in (1, 2, 3, 9, 1, 2, 1, 3)]
        for each in done:
            each.result(SOON)
    assert busy.most == 3


def test_within_a_block_a_thread_takes_no_more():
    cores.set_count(1, 8)
    busy = Busy()

    def work() -> None:
        with hold_cores(), hold_cores():
            busy.work()
            with release_cores(), release_cores():
                time.sleep(0.002)
            busy.work()

    side_by_side(4, work)
    assert busy.most == 1


def test_what_fails_gives_its_cores_back():
    cores.set_count(1, 8)
    for _ in range(2):
        with pytest.raises(OSError, match="full"), hold_cores():
            raise OSError("full")
        with pytest.raises(OSError, match="gone"), hold_cores(), release_cores():
            raise OSError("gone")


class TestOfTheProcess:
    @pytest.mark.parametrize(("asked", "count"), [(None, 4), (4, 4), (9, 9)])
    def test_all_cores_are_bound_enough_by_themselves(self, asked, count):
        cores.set_count(asked, 4)
        meeting = threading.Barrier(10)

        def work() -> None:
            with hold_cores():
                meeting.wait(SOON)

        with ThreadPoolExecutor(10) as pool:
            for each in [pool.submit(work) for _ in range(10)]:
                each.result(SOON)
        assert cores.count() == count

    def test_the_same_again_keeps_what_is_taken(self):
        cores.set_count(1, 8)

        def work() -> None:
            with hold_cores():
                pass

        with ThreadPoolExecutor(1) as pool, hold_cores():
            cores.set_count(1, 8)
            other = pool.submit(work)
            time.sleep(0.02)
            assert not other.done()
            with release_cores():
                other.result(SOON)


def test_who_waits_meanwhile_goes_on_with_fewer_cores():
    cores.set_count(4, 8)
    with hold_cores(4), release_cores():
        cores.set_count(2, 8)
    with hold_cores(2), release_cores():
        cores.set_count(None, 8)
    with hold_cores(), release_cores():
        assert cores.count() == 8
