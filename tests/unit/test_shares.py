"""Turns shared out among threads: each is taken once, by whatever number of them."""

from __future__ import annotations

import itertools
from typing import Any

import numba
import numpy as np
import pytest

from exwarp_cli.compiled import builds, cache, shares
from exwarp_cli.compiled.shares import WHOLE, Share, turns
from exwarp_cli.kernels import jit


@pytest.fixture(autouse=True)
def uncached(monkeypatch) -> None:
    monkeypatch.setattr(cache.KernelCache, "load_overload", lambda *_: None)
    monkeypatch.setattr(cache.KernelCache, "save_overload", lambda *_: None)


def count_text(values: np.ndarray, pair: tuple[np.ndarray, int], share: Share = WHOLE) -> None:
    for i in turns(values.size, share):
        values[i] += pair[1]
        pair[0][i] = share[1]


@pytest.mark.parametrize("count", [0, 1, 2, 7, 100, 2**31])
@pytest.mark.parametrize("number", [1, 2, 3, 8])
def test_shares_follow_each_other_and_are_alike(count, number):
    found = [turns(count, (k, number)) for k in range(number)]
    assert found[0].start == 0 and found[-1].stop == count
    assert all(a.stop == b.start for a, b in itertools.pairwise(found))
    assert max(map(len, found)) - min(map(len, found)) <= 1


def test_compiled_turns_are_the_same():
    def ends(count: int, share: Share) -> tuple[int, int, int]:
        found = turns(count, share)
        return found.start, found.stop, found.step

    compiled = numba.njit(ends)
    for count in (0, 1, 5, 64, 2**40):
        for number in (1, 2, 3, 7):
            for k in range(number):
                assert compiled(count, (k, number)) == ends(count, (k, number))


@pytest.mark.parametrize("known", [True, False], ids=["own", "by numba's loop"])
def test_every_turn_is_taken_once(known, monkeypatch):
    monkeypatch.setattr(builds, "knows_inside", lambda: known)
    monkeypatch.setattr(builds, "_keep", lambda *_: None)
    kernel = builds.shared(count_text)
    for size in (0, 1, 5, 1000):
        values, seen = np.zeros(size, np.int64), np.zeros(size, np.int64)
        kernel(values, (seen, 3))
        assert (values == 3).all() and (seen > 0).all()


def test_there_are_as_many_shares_as_threads():
    kernel = builds.shared(count_text)
    try:
        for threads in (1, jit.threads()):
            jit.set_threads(threads)
            values, seen = np.zeros(9, np.int64), np.zeros(9, np.int64)
            kernel(values, (seen, 1))
            assert (seen == threads).all()
    finally:
        jit.set_threads(None)


def test_a_kernel_without_memory_says_so():
    def greedy(values: np.ndarray, share: Share = WHOLE) -> None:
        for i in turns(values.size, share):
            values[i] = np.empty(1 << 60, np.float64).size

    with pytest.raises(MemoryError, match="no memory for a kernel"):
        builds.shared(greedy)(np.zeros(3))


def test_names_and_words_are_those_of_the_text():
    kernel: Any = builds.shared(count_text)
    assert kernel.__name__ == "count_text" and kernel.__doc__ == count_text.__doc__
    assert shares.WHOLE == (0, 1)
