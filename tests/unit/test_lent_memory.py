"""Memory that is lent again: never while somebody holds it."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import numpy as np
import pytest

from exwarp_cli.domain import lent_memory
from exwarp_cli.domain.lent_memory import LEAST, forget, lent, let_go
from exwarp_cli.io.frames import joined

SHAPE = (600, 300, 4)


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
    assert not lent_memory._returned
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
    assert not lent_memory._returned
    del kept


def test_what_is_forgotten_is_gone():
    lent(SHAPE, np.float32)
    assert lent_memory._returned
    forget()
    assert not lent_memory._returned


def test_what_nobody_wanted_for_an_interval_is_gone():
    wanted, other = lent(SHAPE, np.float32), lent((700, 300, 4), np.float32)
    place = where(wanted)
    del wanted, other
    let_go()
    assert where(lent(SHAPE, np.float32)) == place
    let_go()
    assert [memory.nbytes for _, memory in lent_memory._returned] == [4 * np.prod(SHAPE)]
    let_go()
    assert not lent_memory._returned


def test_little_memory_is_not_kept():
    lent((10, 10), np.float32)
    assert not lent_memory._returned
