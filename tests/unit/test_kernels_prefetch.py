"""Memory that is fetched ahead: a hint to the processor, which changes nothing."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from exwarp_cli.kernels import prefetch


@numba.njit(error_model="numpy")
def fetched(values, place):
    prefetch.prefetch(values, place)


@pytest.mark.parametrize("place", [0, 7, 31])
def test_it_changes_nothing(place):
    values = np.arange(32, dtype=np.float32)
    assert fetched(values, place) is None
    assert prefetch.prefetch(values, place) is None
    assert (values == np.arange(32)).all()


def test_it_is_the_processors_own():
    fetched(np.zeros(8, np.float32), 3)
    (made,) = fetched.inspect_llvm().values()
    assert "@llvm.prefetch" in made
