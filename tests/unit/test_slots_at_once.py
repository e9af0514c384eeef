"""Slots made at once: the same frames, and as many at once as there are threads."""

from __future__ import annotations

import threading

import numba
import numpy as np
import pytest

from exwarp_cli.domain import cores
from exwarp_cli.kernels import _row_bands
from exwarp_cli.pipeline.slots_at_once import SlotsAtOnce
from exwarp_cli.synthesis.geometry import reproject
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import METHODS
from tests.bench.street import key_frame


@pytest.fixture(autouse=True)
def warm():
    """One parallel build has run, as settling motion does before any slot is made."""
    key = key_frame(1, size=(40, 60))
    reproject(key.gbuffer, 0.5)
    yield key
    _row_bands.set_threads(None)


def test_frames_are_those_of_one_after_the_other(warm):
    interval = Interval(warm, key_frame(2, size=(40, 60)))
    for name in ("s6", "softsplat"):
        predict = METHODS[name].predict
        expected = [predict(interval, slot).pixels for slot in (1, 2, 3)]

        def make(slot: int, predict=predict) -> np.ndarray:
            interval.forget(slot)
            return predict(interval, slot).pixels

        with SlotsAtOnce(2, 3) as both:
            begun = both.begin(make, (1, 2, 3))
            for slot in (1, 2, 3):
                np.testing.assert_array_equal(begun.take(slot), expected[slot - 1])


def test_as_many_as_there_are_threads_are_under_way():
    arrived, gate = threading.Semaphore(0), threading.Semaphore(0)

    def make(slot: int) -> int:
        arrived.release()
        gate.acquire()
        return 10 * slot

    with SlotsAtOnce(2, 3) as both:
        begun = both.begin(make, (1, 2, 3))
        assert arrived.acquire(timeout=10) and arrived.acquire(timeout=10)
        assert not arrived.acquire(timeout=0.1)
        gate.release(3)
        assert [begun.take(slot) for slot in (1, 2, 3)] == [10, 20, 30]


def test_the_slots_of_the_next_interval_come_after():
    order = []
    with SlotsAtOnce(2, 3) as both:
        begun = [both.begin(order.append, range(first, first + 3)) for first in (0, 3)]
        for k, slots in enumerate(begun):
            for slot in range(3 * k, 3 * k + 3):
                slots.take(slot)
    assert sorted(order) == list(range(6)) and set(order[:2]) <= {0, 1, 2}


@pytest.mark.parametrize(("threads", "slots", "share"), [(2, 3, 1), (8, 3, 2), (3, 7, 1)])
def test_threads_are_shared_out(threads, slots, share, monkeypatch):
    told = []
    monkeypatch.setattr(_row_bands, "set_threads", told.append)
    with SlotsAtOnce(threads, slots) as both:
        begun = both.begin(lambda slot: slot, range(slots))
        assert [begun.take(slot) for slot in range(slots)] == list(range(slots))
    assert told and set(told) == {share}


def test_what_goes_on_beside_has_the_cores_that_are_left():
    arrived, gate = threading.Semaphore(0), threading.Semaphore(0)
    cores.share(3, 3)
    _row_bands.set_threads(cores.left)

    def make(slot: int) -> int:
        arrived.release()
        gate.acquire(timeout=10)  # where an assertion fails, nobody opens it
        return slot

    with SlotsAtOnce(2, 3) as both:
        begun = both.begin(make, (1, 2))
        assert arrived.acquire(timeout=10) and arrived.acquire(timeout=10)
        assert cores.left() == 1 and _row_bands.threads() == 1
        gate.release(2)
        assert [begun.take(slot) for slot in (1, 2)] == [1, 2]
    assert cores.left() == 3
    assert _row_bands.threads() == min(3, numba.config.NUMBA_NUM_THREADS)


def test_one_thread_goes_on_alone():
    assert SlotsAtOnce(2, 3).pays
    assert not SlotsAtOnce(1, 3).pays
    assert not SlotsAtOnce(4, 1).pays


def test_what_making_raises_is_raised_where_it_is_taken():
    def make(slot: int) -> int:
        raise ValueError(f"slot {slot}")

    with SlotsAtOnce(2, 2) as both:
        begun = both.begin(make, (1, 2))
        with pytest.raises(ValueError, match="slot 1"):
            begun.take(1)
