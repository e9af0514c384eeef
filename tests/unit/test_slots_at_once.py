"""Slots made at once: the same frames, in order, and not too many at once."""

from __future__ import annotations

import threading
from collections import Counter

import numba
import numpy as np
import pytest

from exwarp_cli.kernels import jit
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
    jit.set_threads(None)


def test_frames_are_those_of_one_after_the_other(warm):
    interval = Interval(warm, key_frame(2, size=(40, 60)))
    for name in ("s6", "softsplat"):
        predict = METHODS[name].predict
        expected = [predict(interval, slot).pixels for slot in (1, 2, 3)]
        interval.forget(3)
        with SlotsAtOnce(2, 3) as both:
            begun = both.begin(lambda slot, p=predict: p(interval, slot), (1, 2, 3))
            for slot in (1, 2, 3):
                found, _ = begun.take(slot)
                np.testing.assert_array_equal(found.pixels, expected[slot - 1])
                interval.forget(slot)


def test_as_many_as_there_are_threads_are_under_way():
    begun_with, gate, seen = Counter(), threading.Semaphore(0), []

    def make(slot: int) -> int:
        begun_with[slot] += 1
        gate.acquire()
        return 10 * slot

    with SlotsAtOnce(2, 3) as both:
        begun = both.begin(make, (1, 2, 3))
        assert 1 in begun and 2 in begun and 3 not in begun
        gate.release(2)
        seen.append(begun.take(1)[0])
        assert 3 in begun and 1 not in begun
        gate.release()
        seen += [begun.take(2)[0], begun.take(3)[0]]
    assert seen == [10, 20, 30]
    assert begun_with == {1: 1, 2: 1, 3: 1}


@pytest.mark.parametrize(("threads", "slots", "share"), [(2, 3, 1), (8, 3, 2), (3, 7, 1)])
def test_threads_are_shared_out(threads, slots, share, monkeypatch):
    told = []
    monkeypatch.setattr(jit, "set_threads", told.append)
    with SlotsAtOnce(threads, slots) as both:
        begun = both.begin(lambda slot: slot, range(slots))
        assert [begun.take(slot)[0] for slot in range(slots)] == list(range(slots))
    assert told and set(told) == {share}


def test_one_thread_goes_on_alone(monkeypatch):
    assert SlotsAtOnce(2, 3).pays
    assert not SlotsAtOnce(1, 3).pays
    assert not SlotsAtOnce(4, 1).pays
    monkeypatch.setattr(numba, "threading_layer", lambda: "workqueue")
    assert not SlotsAtOnce(2, 3).pays


def test_what_making_raises_is_raised_where_it_is_taken():
    def make(slot: int) -> int:
        raise ValueError(f"slot {slot}")

    with SlotsAtOnce(2, 2) as both:
        begun = both.begin(make, (1, 2))
        with pytest.raises(ValueError, match="slot 1"):
            begun.take(1)
