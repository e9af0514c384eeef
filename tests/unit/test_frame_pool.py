"""Buffers of frame arrays serve later arrays of the same size."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from exwarp_cli.runtime.frame_pool import MIN_BYTES, FramePool

SHAPE = (600, 300, 4)
BYTES = 4 * 600 * 300 * 4


@pytest.fixture
def pool() -> FramePool:
    return FramePool()


def address(array: np.ndarray) -> int:
    return int(array.__array_interface__["data"][0])


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
    assert pool.free_bytes == 0


def test_a_free_buffer_serves_the_next_array_of_its_size(pool):
    array = pool.empty(SHAPE, np.float32)
    place = address(array)
    del array
    assert pool.free_bytes == BYTES
    assert address(pool.empty((2, *SHAPE), np.uint16)) == place


def test_a_buffer_is_in_use_while_a_view_is_there(pool):
    row = pool.empty(SHAPE, np.float32)[3].reshape(-1).view(np.uint8)[5:]
    assert pool.free_bytes == 0
    del row
    assert pool.free_bytes == BYTES


def test_a_copy_has_the_values_and_its_own_memory(pool):
    given = np.arange(np.prod(SHAPE), dtype=np.float32).reshape(SHAPE)[:, ::2]
    copy = pool.copy(given)
    np.testing.assert_array_equal(copy, given)
    assert copy.flags.c_contiguous and not np.shares_memory(copy, given)


def test_what_a_whole_interval_did_not_use_is_freed(pool):
    pool.empty(SHAPE, np.float32)
    pool.trim()
    assert pool.free_bytes == BYTES  # the interval that used it has just ended
    pool.trim()
    assert pool.free_bytes == 0


def test_what_every_interval_uses_stays(pool):
    for _ in range(4):
        pool.empty(SHAPE, np.float32)
        pool.trim()
    assert pool.free_bytes == BYTES


def test_clearing_frees_all_but_what_is_in_use(pool):
    held = pool.empty(SHAPE, np.float32)
    pool.empty(SHAPE, np.float32)
    pool.clear()
    assert pool.free_bytes == 0
    del held
    assert pool.free_bytes == BYTES


def test_small_arrays_are_left_to_numpy(pool):
    pool.empty((MIN_BYTES - 1,), np.uint8)
    assert pool.free_bytes == 0


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
                pool.trim()

    threads = [threading.Thread(target=work, args=(number,)) for number in range(1, 6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong
