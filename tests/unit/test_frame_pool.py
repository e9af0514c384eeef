"""Buffers of frame arrays serve later arrays of the same size; large frames leave memory."""

from __future__ import annotations

import errno
import mmap
import os
import re
import sys
import threading
import weakref
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.runtime.frame_pool import IN_MEMORY, MIN_BYTES, FramePool, ScratchFrames

linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="others do not tell")

SHAPE = (600, 300, 4)
BYTES = 4 * 600 * 300 * 4


@pytest.fixture
def pool() -> FramePool:
    return FramePool()


def buffer_of(array: np.ndarray) -> object:
    """The mapped memory that an array lies in; None for memory of numpy's own."""
    base: object = array
    while isinstance(base, np.ndarray):
        base = base.base
    return base.obj if isinstance(base, memoryview) else base


@pytest.mark.parametrize("dtype", [np.float32, np.uint16, np.bool_])
@pytest.mark.parametrize("shape", [SHAPE, (5, 7), (0, 4), (1800, 1024)])
def test_arrays_have_the_shape_and_type_that_was_asked_for(pool, shape, dtype):
    array = pool.empty(shape, dtype)
    assert array.shape == shape and array.dtype == dtype
    assert array.flags.c_contiguous and array.flags.writeable
    array[...] = 1
    assert (array == 1).all()


def test_arrays_in_use_share_no_memory(pool):
    held = [pool.empty(SHAPE, np.float32) for _ in range(6)]
    for value, array in enumerate(held):
        array[...] = value
    assert all((array == value).all() for value, array in enumerate(held))
    assert len({id(buffer_of(array)) for array in held}) == 6


def test_a_free_buffer_serves_the_next_array_of_its_size(pool):
    buffer = buffer_of(pool.empty(SHAPE, np.float32))
    assert isinstance(buffer, mmap.mmap) and len(buffer) == BYTES
    for _ in range(4):
        assert buffer_of(pool.empty((2, *SHAPE), np.uint16)) is buffer
    assert buffer_of(pool.empty((3, *SHAPE), np.uint16)) is not buffer


def test_a_buffer_is_in_use_while_a_view_is_there(pool):
    row = pool.empty(SHAPE, np.float32)[3].reshape(-1).view(np.uint8)[5:]
    buffer = buffer_of(row)
    assert buffer_of(pool.empty(SHAPE, np.float32)) is not buffer
    del row
    assert buffer_of(pool.empty(SHAPE, np.float32)) is buffer


def test_a_copy_has_the_values_and_its_own_memory(pool):
    given = np.arange(np.prod(SHAPE), dtype=np.float32).reshape(SHAPE)[:, ::2]
    copy = pool.copy(given)
    np.testing.assert_array_equal(copy, given)
    assert copy.flags.c_contiguous and not np.shares_memory(copy, given)


def test_free_buffers_are_bounded():
    pool = FramePool(max_free=3 * BYTES)
    held = [pool.empty(SHAPE, np.float32) for _ in range(5)]
    buffers = [weakref.ref(buffer_of(array)) for array in held]
    while held:
        del held[0]
    pool.empty(SHAPE, np.float32)
    is_kept = [buffer() is not None for buffer in buffers]
    assert is_kept == [False, False, True, True, True], "those that are free for longest go"


def test_clearing_frees_all_but_what_is_in_use(pool):
    held, free = (pool.empty(SHAPE, np.float32) for _ in range(2))
    buffers = [weakref.ref(buffer_of(array)) for array in (held, free)]
    del free
    pool.clear()
    assert [buffer() is not None for buffer in buffers] == [True, False]
    del held
    assert buffer_of(pool.empty(SHAPE, np.float32)) is buffers[0]()


def test_small_arrays_are_left_to_numpy(pool):
    assert buffer_of(pool.empty((MIN_BYTES - 1,), np.uint8)) is None
    assert buffer_of(pool.empty((MIN_BYTES,), np.uint8)) is not None


def test_threads_never_share_a_buffer(pool):
    """Each fills its arrays with its number, and finds no other."""
    wrong = []

    def work(number: int) -> None:
        held = [pool.empty((0,), np.float32)]
        for turn in range(300):
            array = pool.empty((MIN_BYTES + 4096 * (turn % 3),), np.uint8)
            array[::4096] = number
            held = [*held[-2:], array]
            if any((one[::4096] != number).any() for one in held):
                wrong.append(number)
            if turn % 50 == 0:
                pool.clear()

    threads = [threading.Thread(target=work, args=(number,)) for number in range(1, 6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


PIXELS = 600 * 300
LARGE = np.arange(601 * 300 * 2, dtype=np.float32).reshape(601, 300, 2)
SMALL = np.ones((600, 300, 4), np.float32)


@dataclass(frozen=True)
class Picture:
    number: int
    pixels: np.ndarray
    planes: tuple[np.ndarray | None, ...] = ()


@pytest.fixture
def scratch() -> ScratchFrames:
    return ScratchFrames(PIXELS)


def resident(array: np.ndarray) -> int:
    """Bytes of the mapping that an array begins in which are in this process's memory."""
    place, inside = array.__array_interface__["data"][0], False
    for line in Path("/proc/self/smaps").read_text().splitlines():
        if re.match(r"[0-9a-f]+-[0-9a-f]+ ", line):
            first, end = (int(edge, 16) for edge in line.split()[0].split("-"))
            inside = first <= place < end
        elif inside and line.startswith("Rss:"):
            return 1024 * int(line.split()[1])
    raise AssertionError("no such mapping")


def mapped_files() -> int:
    """Count the scratch files that this process has."""
    return Path("/proc/self/maps").read_text().count("(deleted)")


@linux
def test_a_large_frame_leaves_memory_and_comes_back(scratch):
    array = scratch.store(LARGE)
    assert array is not LARGE and resident(array) == 0
    np.testing.assert_array_equal(array, LARGE)
    assert resident(array) >= array.nbytes
    array[3, 5] = -1
    scratch.page_out()
    assert resident(array) == 0
    assert (array[3, 5] == -1).all()


def test_every_large_array_of_a_value_is_stored(scratch):
    picture = Picture(7, LARGE, (None, SMALL, LARGE[..., 0]))
    stored = scratch.store(picture)
    assert stored.number == 7 and stored.planes[0] is None and stored.planes[1] is SMALL
    assert not np.shares_memory(stored.pixels, LARGE)
    assert not np.shares_memory(stored.planes[2], LARGE)
    np.testing.assert_array_equal(stored.pixels, LARGE)
    np.testing.assert_array_equal(stored.planes[2], LARGE[..., 0])


def test_what_is_stored_is_not_stored_again(scratch):
    stored = scratch.store(Picture(7, LARGE))
    assert scratch.store(stored) is stored
    view = stored.pixels[:, ::-1]
    assert scratch.store(view) is view


def test_what_has_no_large_array_stays_as_it_is(scratch):
    picture = Picture(7, SMALL)
    assert scratch.store(picture) is picture
    assert IN_MEMORY.store(LARGE) is LARGE


def test_on_a_full_disk_arrays_stay_in_memory(scratch, monkeypatch):
    def full(*_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full, raising=False)
    picture = Picture(7, LARGE)
    assert scratch.store(picture) is picture


@linux
def test_a_file_goes_with_the_last_array_on_it(scratch):
    before = mapped_files()
    row = scratch.store(LARGE)[3]
    assert mapped_files() == before + 1
    scratch.page_out()
    np.testing.assert_array_equal(row, LARGE[3])
    del row
    assert mapped_files() == before


@linux
def test_a_scratch_file_has_no_name(scratch, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    array = scratch.store(LARGE)
    np.testing.assert_array_equal(array, LARGE)
    assert not list(tmp_path.iterdir())
