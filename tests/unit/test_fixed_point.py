"""Fixed-point numbers: what is rounded where, against exact fractions."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exwarp_cli.accelerator.mlp import (
    MAX_MULTIPLIER,
    MAX_SHIFT,
    ONE,
    requantise_half_up,
    to_fixed,
)

LEAST, MOST = -(2**31), 2**31 - 1
INT32 = st.integers(LEAST, MOST)


def half_up(value: Fraction) -> int:
    return math.floor(value + Fraction(1, 2))


class TestToFixed:
    @pytest.mark.parametrize(
        ("value", "fixed"),
        [
            *((0.0, 0), (1.0, ONE), (-1.0, -ONE), (0.5, ONE // 2), (1 / 3, 21845)),
            *((0.5 / ONE, 1), (-0.5 / ONE, 0), (1.5 / ONE, 2), (-1.5 / ONE, -1)),
            *((np.nextafter(0.5, 0) / ONE, 0), (np.nextafter(-0.5, -1) / ONE, -1), (-1e-300, 0)),
            *((32767.99999, MOST - 0), (32768.0, MOST), (1e300, MOST), (np.inf, MOST)),
            *((-32768.0, LEAST), (-32769.0, LEAST), (-np.inf, LEAST), (np.nan, 0)),
        ],
    )
    def test_known_values(self, value, fixed):
        found = to_fixed(value)
        assert found.dtype == np.int32 and int(found) == fixed

    @given(st.floats(-40000, 40000))
    def test_it_rounds_half_up_exactly(self, value):
        assert int(to_fixed(value)) == min(max(half_up(Fraction(value) * ONE), LEAST), MOST)

    @given(INT32)
    def test_what_it_stands_for_comes_back(self, fixed):
        assert int(to_fixed(np.int32(fixed) / ONE)) == fixed

    def test_shapes_are_kept(self):
        assert to_fixed(np.zeros((3, 0, 2))).shape == (3, 0, 2)


class TestRequantise:
    @given(INT32, st.integers(1, MAX_MULTIPLIER), st.integers(0, MAX_SHIFT))
    def test_it_rounds_half_up_exactly(self, value, multiplier, shift):
        exact = Fraction(value * multiplier, 2**shift)
        assert int(requantise_half_up(value, multiplier, shift)) == half_up(exact)

    @pytest.mark.parametrize("value", [LEAST, LEAST + 1, -1, 0, 1, MOST])
    @pytest.mark.parametrize("shift", [0, 1, 31, 61, 62])
    def test_nothing_overflows(self, value, shift):
        exact = Fraction(value * MAX_MULTIPLIER, 2**shift)
        assert int(requantise_half_up(value, MAX_MULTIPLIER, shift)) == half_up(exact)

    def test_halves_go_up_on_both_sides_of_zero(self):
        found = requantise_half_up([-3, -2, -1, 0, 1, 2, 3], 1, 1)
        assert found.tolist() == [-1, -1, 0, 0, 1, 1, 2]

    def test_each_value_may_have_its_own_factor(self):
        found = requantise_half_up(np.full((2, 3), 10, np.int32), np.int32([1, 2, 3]), [0, 1, 2])
        assert found.tolist() == [[10, 10, 8]] * 2 and found.dtype == np.int64
