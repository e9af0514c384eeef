"""Turns shared out among threads: each is taken once, by whatever number of them."""

from __future__ import annotations

import itertools
import multiprocessing
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np
import pytest

from exwarp_cli.kernels import _compile, _row_bands
from exwarp_cli.kernels._row_bands import ALL, MIN_BANDS, Band, band_range
from tests.unit.all_kernel_cases import CASES


def count(values: np.ndarray, seen: np.ndarray, share: Band = ALL) -> None:
    for i in band_range(values.size, share):
        values[i] += 1
        seen[i] = share[1]


@pytest.mark.parametrize("many", [0, 1, 2, 7, 100, 2**31])
@pytest.mark.parametrize("number", [1, 2, 3, 8])
def test_shares_follow_each_other_and_are_alike(many, number):
    found = [band_range(many, (k, number)) for k in range(number)]
    assert found[0].start == 0 and found[-1].stop == many
    assert all(a.stop == b.start for a, b in itertools.pairwise(found))
    assert max(map(len, found)) - min(map(len, found)) <= 1


def test_compiled_turns_are_the_same():
    def ends(count: int, share: Band) -> tuple[int, int, int]:
        found = band_range(count, share)
        return found.start, found.stop, found.step

    compiled = numba.njit(ends)
    for many in (0, 1, 5, 64, 2**40):
        for number in (1, 2, 3, 7):
            for k in range(number):
                assert compiled(many, (k, number)) == ends(many, (k, number))


@pytest.mark.parametrize("number", [1, 2, 3, 50])
@pytest.mark.parametrize("size", [0, 1, 5, 1000])
def test_every_turn_is_taken_once(number, size):
    values, seen = np.zeros(size), np.zeros(size)
    _row_bands.run_bands(count, (values, seen), number)
    assert (values == 1).all()
    assert (seen == (1 if number == 1 else max(number, MIN_BANDS))).all()


@pytest.mark.parametrize("size", [5, 1000])
def test_small_arrays_are_one_turn(size, monkeypatch):
    monkeypatch.setattr(_row_bands, "SMALL", 1000)
    values, seen = np.zeros(size), np.zeros(size)
    _row_bands.run_bands(lambda pair, band: count(*pair, band), ((values, seen),), 2)
    assert (values == 1).all() and (seen == (1 if size < 1000 else MIN_BANDS)).all()


@pytest.mark.parametrize("name", CASES)
def test_kernels_give_the_same_in_any_number_of_shares(name, monkeypatch):
    expected = CASES[name](True)
    for number in (2, 5, MIN_BANDS):
        monkeypatch.setattr(_row_bands, "threads", lambda number=number: number)
        monkeypatch.setattr(_row_bands, "MIN_BANDS", number)
        for one, other in zip(expected, CASES[name](False), strict=True):
            assert one.tobytes() == other.tobytes()


class TestThreads:
    """Who takes which share, and what happens where one fails."""

    def test_the_caller_takes_what_no_worker_takes(self, monkeypatch):
        takers: list[int] = []
        with ThreadPoolExecutor(1) as busy:
            released = threading.Event()
            busy.submit(released.wait)
            monkeypatch.setattr(_row_bands, "_pool", lambda: busy)
            _row_bands.run_bands(lambda share: takers.append(threading.get_ident()), (), 4)
            released.set()
        assert takers == [threading.get_ident()] * MIN_BANDS

    @pytest.mark.parametrize("bad", [0, 1, 2])
    def test_an_error_is_raised_once_no_thread_works_any_more(self, bad):
        ended: list[int] = []

        def fail(share: Band) -> None:
            if share[0] == bad:
                raise MemoryError
            threading.Event().wait(0.02)
            ended.append(share[0])

        with pytest.raises(MemoryError):
            _row_bands.run_bands(fail, (), 3)
        seen = list(ended)
        assert len(seen) < MIN_BANDS - 1  # no thread took another after that
        threading.Event().wait(0.06)
        assert ended == seen

    def test_an_interruption_waits_for_the_others(self, monkeypatch):
        begun, ended = threading.Event(), threading.Event()
        real: Callable[..., object] = _row_bands.wait

        def interrupted(futures: object) -> object:
            monkeypatch.setattr(_row_bands, "wait", real)
            raise KeyboardInterrupt

        def work(share: Band) -> None:
            if share[0]:
                begun.set()
                threading.Event().wait(0.05)
                ended.set()
            else:
                begun.wait()

        monkeypatch.setattr(_row_bands, "wait", interrupted)
        with pytest.raises(KeyboardInterrupt):
            _row_bands.run_bands(work, (), 2)
        assert ended.is_set()

    def test_kernels_of_several_threads_at_once(self):
        kernel = _compile.ParallelKernel(count)

        def work(_: int) -> bool:
            _row_bands.set_threads(None)
            values, seen = np.zeros(10_000), np.zeros(10_000)
            for _ in range(20):
                kernel(values, seen)
            return bool((values == 20).all())

        with ThreadPoolExecutor(4) as pool:
            assert all(pool.map(work, range(8)))

    @pytest.mark.skipif(not hasattr(_row_bands.os, "fork"), reason="this system does not fork")
    def test_a_child_has_threads_of_its_own(self):
        _row_bands.run_bands(count, (np.zeros(9), np.zeros(9)), 3)
        child = multiprocessing.get_context("fork").Process(target=_count_in_shares)
        child.start()
        child.join(30)
        assert child.exitcode == 0


def test_each_thread_has_its_number_of_threads():
    _row_bands.set_threads(1)
    try:
        with ThreadPoolExecutor(1) as other:
            assert _row_bands.threads() == 1
            assert other.submit(_row_bands.threads).result() == numba.config.NUMBA_NUM_THREADS
    finally:
        _row_bands.set_threads(None)


def _count_in_shares() -> None:
    values = np.zeros(9)
    _row_bands.run_bands(count, (values, np.zeros(9)), 3)
    assert (values == 1).all()
