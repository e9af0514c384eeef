"""Memory that is lent again: never while somebody holds it."""

from __future__ import annotations

import errno
import gc
import mmap
import os
import random
import re
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from math import prod
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.domain import lent_memory
from exwarp_cli.domain.lent_memory import (
    HUGE,
    LARGE,
    LEAST,
    file_from,
    filed,
    forget,
    lent,
    let_go,
    let_wait,
    rest,
)
from exwarp_cli.io.frames import joined

SHAPE = (600, 300, 4)


def paged(size: int) -> int:
    return -(-size // mmap.PAGESIZE) * mmap.PAGESIZE


def where(array: np.ndarray) -> int:
    return int(array.__array_interface__["data"][0])


@pytest.fixture(autouse=True)
def _nothing_kept() -> Iterator[None]:
    gc.collect()
    forget()
    yield
    forget()


@pytest.mark.parametrize("dtype", [np.float32, np.uint32, np.int32, np.uint8])
@pytest.mark.parametrize("shape", [SHAPE, (3, 2), (LEAST,)])
def test_it_is_an_array_like_any(shape, dtype):
    array = lent(shape, dtype)
    array[...] = 3
    assert array.shape == shape and array.dtype == dtype and (array == 3).all()
    assert array.flags.c_contiguous and array.flags.writeable and array.flags.aligned


def test_what_is_held_is_not_lent_again():
    held = [lent(SHAPE, np.float32) for _ in range(6)]
    for i, array in enumerate(held):
        array[...] = i
    assert not lent_memory._store.idle
    assert all((array == i).all() for i, array in enumerate(held))


@pytest.mark.parametrize(
    "view",
    [
        lambda a: a,
        lambda a: a[..., 1],
        lambda a: a.view(np.uint32)[3:],
        lambda a: a.reshape(-1)[5:],
        lambda a: joined([a[..., i] for i in range(4)]),
        lambda a: np.asarray(memoryview(a)),
        lambda a: a.T[0].T,
    ],
    ids=["itself", "a channel", "bits", "flat", "joined", "buffer", "turned"],
)
def test_it_comes_back_with_the_last_view(view):
    array = lent(SHAPE, np.float32)
    place, held = where(array), view(array)
    del array
    other = lent(SHAPE, np.float32)
    assert where(other) != place and not np.shares_memory(other, held)
    del held
    assert where(lent(SHAPE, np.uint32)) == place


def test_other_sizes_get_other_memory():
    small, large = lent(SHAPE, np.float32), lent((700, 300, 4), np.float32)
    places = where(small), where(large)
    del small, large
    again = lent((700, 300, 4), np.float32), lent(SHAPE, np.float32)
    assert (where(again[1]), where(again[0])) == places


def test_what_waits_makes_room_for_what_is_of_another_size():
    lent(SHAPE, np.float32)
    kept = lent((100, 300, 50), np.float32)
    assert not lent_memory._store.idle
    del kept


def test_smaller_ones_get_parts_of_a_larger_one():
    half = 2**22  # a whole number of pages
    large = lent((2 * half,), np.uint8)
    place = where(large)
    del large
    parts = [lent((half,), np.uint8), lent((half,), np.uint8)]
    assert [where(part) for part in parts] == [place, place + half]
    for i, part in enumerate(parts):
        part[...] = i
    assert all((part == i).all() for i, part in enumerate(parts))
    del parts, part
    assert len(lent_memory._store.idle) == 1  # joined again
    assert where(lent((2 * half,), np.uint8)) == place


@pytest.mark.parametrize("seed", range(5))
def test_whatever_is_lent_in_any_order_is_nobody_else_s(seed):
    """As many threads as like, and pages that go back between."""
    chance = random.Random(seed)

    def work(number: int) -> None:
        held: list[np.ndarray] = []
        for turn in range(60):
            rows = chance.choice([300, 600, 900, 1800])
            array = lent((rows, 300, 4), np.uint8 if turn % 3 else np.float32)
            array[...] = (number + turn) % 250
            held.append(array)
            if chance.random() < 0.6:
                held.pop(chance.randrange(len(held)))
            if chance.random() < 0.1:
                chance.choice([let_go, forget])()
            for one in held:
                assert (one == one.flat[0]).all()

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(work, range(4)))
    gc.collect()
    forget()
    assert lent_memory._store.blocks == []


def test_a_part_that_nobody_wants_goes_back_alone():
    large = lent((1800, 300, 4), np.float32)
    del large
    kept = lent(SHAPE, np.float32)
    kept[...] = 7
    forget()
    assert lent_memory._store.idle == [] and len(lent_memory._store.blocks) == 1
    assert (kept == 7).all()
    del kept
    forget()
    assert lent_memory._store.blocks == []


def test_so_much_may_wait_while_others_take_more():
    let_wait(6 * prod(SHAPE))
    try:
        first, second = lent(SHAPE, np.float32), lent(SHAPE, np.float32)
        place = where(second)
        del first, second
        lent((2000, 300, 4), np.float32)
        assert paged(4 * prod(SHAPE)) in lent_memory._store.idle  # one of the two
        assert where(lent(SHAPE, np.float32)) == place
    finally:
        let_wait(0)


def test_what_is_forgotten_is_gone():
    lent(SHAPE, np.float32)
    assert lent_memory._store.idle
    forget()
    assert not lent_memory._store.idle


def test_what_nobody_wanted_for_an_interval_is_gone():
    wanted, other = lent(SHAPE, np.float32), lent((700, 300, 4), np.float32)
    place = where(wanted)
    del wanted, other
    let_go()
    assert where(lent(SHAPE, np.float32)) == place
    let_go()
    assert lent_memory._store.idle == [paged(4 * prod(SHAPE))]
    let_go()
    assert not lent_memory._store.idle


def test_little_memory_is_not_kept():
    lent((10, 10), np.float32)
    assert not lent_memory._store.idle


WIDE = (LARGE // 1024 + 1, 1024)


@pytest.fixture
def _in_files() -> Iterator[None]:
    file_from(LARGE)
    yield
    file_from(None)


def resident(array: np.ndarray) -> int:
    """Bytes of the mapping that an array begins in which are in this process's memory."""
    place, inside = where(array), False
    for line in Path("/proc/self/smaps").read_text().splitlines():
        if re.match(r"[0-9a-f]+-[0-9a-f]+ ", line):
            first, end = (int(edge, 16) for edge in line.split()[0].split("-"))
            inside = first <= place < end
        elif inside and line.startswith("Rss:"):
            return 1024 * int(line.split()[1])
    raise AssertionError("no such mapping")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="others do not tell")
@pytest.mark.usefixtures("_in_files")
def test_what_lies_in_files_leaves_and_comes_back():
    numbers = np.arange(WIDE[0] * WIDE[1], dtype=np.float32).reshape(WIDE)
    array = filed(numbers)
    assert array is not numbers and resident(array) >= array.nbytes
    rest()
    assert resident(array) == 0
    np.testing.assert_array_equal(array, numbers)
    array[3, 5] = -1
    rest()
    assert array[3, 5] == -1
    assert resident(array) < array.nbytes // 8


@pytest.mark.usefixtures("_in_files")
def test_small_arrays_stay_where_they_are():
    small = np.zeros((LARGE // 1024, 1024), np.float32)
    assert filed(small) is small
    before = len(lent_memory._rooms)
    lent(small.shape, np.float32)
    assert len(lent_memory._rooms) == before


@pytest.mark.usefixtures("_in_files")
def test_the_size_from_which_they_lie_there_can_change():
    file_from(HUGE)
    large = np.zeros(WIDE, np.uint8)
    assert filed(large) is large
    file_from(LARGE)
    assert filed(large) is not large


def test_without_being_told_nothing_lies_in_files():
    large = np.zeros(WIDE, np.uint8)
    assert filed(large) is large


@pytest.mark.usefixtures("_in_files")
def test_on_a_full_disk_memory_is_taken_from_the_system(monkeypatch):
    def full(*_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full, raising=False)
    before = len(lent_memory._rooms)
    assert (filed(np.full(WIDE, 7, np.uint8)) == 7).all()
    assert len(lent_memory._rooms) == before


@pytest.mark.usefixtures("_in_files")
def test_files_go_with_the_last_array():
    array = filed(np.zeros(WIDE, np.uint8))
    assert len(lent_memory._rooms) == 1
    del array
    forget()
    gc.collect()
    assert not lent_memory._rooms
