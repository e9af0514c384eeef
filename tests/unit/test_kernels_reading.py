"""Ids out of raw channels: the kernel against its twin."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.reference import ids as naive_ids
from tests.unit.kernel_calls import rounded

VALUES = st.floats(width=32) | st.integers(-3, 40).map(float) | st.sampled_from(
    [0.5, 1.5, 2.5, 0.98, 1.02, -0.5, -1.0, 2.0**24, 2.0**31, -(2.0**31), 3e38]
)  # fmt: skip


@given(st.lists(VALUES, min_size=1, max_size=30))
def test_ids_are_those_of_the_twin(values):
    ids = np.array(values, np.float32)
    (found,) = rounded(ids)
    assert found.tolist() == naive_ids.whole_ids(ids).tolist()


def test_ids_near_whole_numbers_are_whole_and_others_mixed():
    ids = np.array([0, 7.01, 6.99, 7.03, 6.97, 0.5, -1, np.nan, np.inf, 2**24], np.float32)
    assert rounded(ids)[0].tolist() == [0, 7, 7, -1, -1, -1, -1, -1, -1, 2**24]
