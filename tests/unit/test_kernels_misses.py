"""Following many displacements at once."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference import lookup as naive
from tests.unit.kernel_calls import missed_along

SHAPE = (9, 12)


def case(channels: int, seed: int = 5):
    """Samples, three displacements of each, an image with holes, what is wanted, tolerances."""
    rng = np.random.default_rng(seed)
    image = rng.lognormal(0, 2, (*SHAPE, channels)).astype(np.float32)
    image[3, 4], image[6, 2] = np.nan, np.inf
    xy = np.stack([rng.integers(0, 12, 150), rng.integers(0, 9, 150)], axis=1).astype(np.float64)
    shifts = rng.normal(0, 3, (3, 150, 2)).astype(np.float32)
    shifts[0, :40], shifts[1, :5] = 0, np.nan
    wanted, tolerance = rng.lognormal(0, 2, (150, channels)), rng.uniform(0, 9, 150)
    tolerance[50:60] = 0
    return xy, shifts, image, wanted, tolerance


@pytest.mark.parametrize("channels", [2, 3])
def test_equals_the_naive_twins_in_every_bit(channels):
    xy, shifts, image, wanted, tolerance = case(channels)
    (losses,) = missed_along(xy, shifts, image, wanted, tolerance)
    for loss, shift in zip(losses[:, 0], shifts, strict=True):
        found = naive.look_up(image, xy + shift.astype(np.float64))
        np.testing.assert_array_equal(loss, naive.misses(found, wanted, tolerance))
        assert (loss < 1).any() and (loss == 1).any()


def test_only_its_place_is_written():
    (losses,) = missed_along(*case(3), place=1, places=3)
    assert (losses[:, [0, 2]] == -1).all() and (losses[:, 1] >= 0).all()
