"""The range of colour around places: against the naive twin, and by its definition."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference import extremes as naive
from tests.unit import kernel_cases as cases
from tests.unit import slot_kernel_calls as calls


@pytest.mark.parametrize("clear", [False, True])
def test_bounds_are_those_of_the_naive_twin(clear):
    pixels = cases.image(5)
    pixels[::2, ::3, 3] = 0
    field, wanted = cases.field(6, 4.0), calls.seen(7)
    expected = naive.bounds(pixels, field, wanted, clear)
    for sign, bound in zip((-1, 1), expected, strict=True):
        (found,) = calls.bounds_raised(pixels, field, wanted, clear, sign)
        np.testing.assert_array_equal(np.where(np.isneginf(found), np.nan, sign * found), bound)


def test_the_window_lies_at_the_end_of_the_motion():
    pixels = np.arange(81, dtype=np.float32).reshape(9, 9, 1)
    field = np.full((9, 9, 2), 1.2, np.float32)
    (found,) = calls.bounds_raised(pixels, field, np.ones((9, 9), np.bool_), False, 1)
    assert found[2, 3, 0] == pixels[5, 6, 0]
    assert found[8, 8, 0] == pixels[8, 8, 0], "beyond the frame its edge counts"


def test_a_frame_is_held_where_it_is_wanted():
    frame = np.array([[[1, 5], [5, 5], [-3, 0]]], np.float32)
    bound = np.array([[[2, 2], [2, -np.inf], [2, 2]]], np.float32)
    wanted = np.array([[True, True, False]])
    (below,) = calls.held(bound, wanted, 1, 2, frame)
    np.testing.assert_array_equal(below, [[[1, 2], [2, 0], [-3, 0]]])
    (above,) = calls.held(bound, np.ones((1, 3), np.bool_), -1, 1, frame)
    np.testing.assert_array_equal(above, [[[1, 5], [5, 5], [-2, 0]]])
