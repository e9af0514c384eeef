"""Means of blocks: against the naive twin, at borders, and what does not count."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference.features import block_means
from tests.unit.kernel_calls import NO_MASK, averaged
from tests.unit.kernel_cases import field, shown


@pytest.mark.parametrize("size", [1, 4, 16, 50])
@pytest.mark.parametrize("masked", [True, False])
@pytest.mark.parametrize("serial", [True, False])
def test_it_is_the_naive_twin(size, masked, serial):
    motion, mask = field(1), shown(2) if masked else NO_MASK
    motion[:16, :4] = np.nan
    (found,) = averaged(motion, size, mask, serial)
    expected = block_means(motion, size, mask if masked else None)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
    assert np.isnan(found).any() == (size < 16)


def test_smaller_blocks_at_the_border_are_means_of_their_own():
    motion = np.zeros((5, 7, 2), np.float32)
    motion[4:] = (1, -2)
    motion[:, 6] = (3, 4)
    (found,) = averaged(motion, 2)
    assert found.shape == (3, 4, 2)
    np.testing.assert_array_equal(found[2, :3], np.tile((1, -2), (3, 1)))
    np.testing.assert_array_equal(found[:, 3], np.tile((3, 4), (3, 1)))
    np.testing.assert_array_equal(found[:2, :3], 0)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("component", [0, 1])
def test_pixels_without_a_value_do_not_count(value, component):
    motion = np.full((4, 4, 2), (2.0, 3.0), np.float32)
    motion[1, 1] = (100, 100)
    motion[1, 1, component] = value
    (found,) = averaged(motion, 4)
    np.testing.assert_array_equal(found[0, 0], (2, 3))
    motion[..., component] = value
    assert np.isnan(averaged(motion, 4)[0]).all()


def test_pixels_that_are_not_shown_do_not_count():
    motion = np.full((4, 4, 2), (2.0, 3.0), np.float32)
    motion[2:] = 50
    mask = np.ones((4, 4), bool)
    mask[2:] = False
    np.testing.assert_array_equal(averaged(motion, 4, mask)[0][0, 0], (2, 3))
    assert np.isnan(averaged(motion, 2, mask)[0][1]).all()


def test_sums_do_not_lose_small_motion():
    motion = np.full((64, 64, 2), 0.1, np.float32)
    motion[0, 0] = 2.0**24
    (found,) = averaged(motion, 64)
    exact = (2.0**24 + 4095 * np.float64(np.float32(0.1))) / 4096
    np.testing.assert_allclose(found[0, 0], exact, rtol=1e-13)


@pytest.mark.parametrize("masked", [True, False])
@pytest.mark.parametrize("serial", [True, False])
def test_sums_are_those_of_one_value_after_the_other(masked, serial):
    """Bit for bit: blocks are added up side by side, of which single ones have gaps."""
    seeded = np.random.default_rng(4)
    shape, size = (37, 150), 8  # four fours, and two blocks and a smaller one beside them
    motion = (seeded.normal(size=(*shape, 2)) * 10.0 ** seeded.integers(-9, 9, (*shape, 1))).astype(
        np.float32
    )
    mask = np.ones(shape, bool) if masked else NO_MASK
    motion[3, 5] = motion[20, 70, 0] = np.nan
    motion[9, 40, 1] = np.inf
    if masked:
        mask[25, 100:110] = False
    (found,) = averaged(motion, size, mask, serial)
    for row, column in np.ndindex(found.shape[:2]):
        where = np.s_[row * size : (row + 1) * size, column * size : (column + 1) * size]
        values = motion[where].reshape(-1, 2).astype(np.float64)
        counts = np.isfinite(values).all(axis=1) & (mask[where].ravel() if masked else True)
        total = np.zeros(2)
        for value in values[counts]:
            total += value
        np.testing.assert_array_equal(found[row, column], total / counts.sum())
