"""Looking scattered points up in an image."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference import lookup as naive
from tests.unit.kernel_calls import looked_up

SHAPE = (9, 12)


def places(seed: int) -> np.ndarray:
    """Places inside and outside, on the pixels' centres, at the corners, and unknown."""
    rng = np.random.default_rng(seed)
    height, width = SHAPE
    out = rng.uniform(-2, 14, (200, 2))
    out[:40] = np.rint(out[:40])
    out[40:44] = (0, 0), (width - 1, 0), (0, height - 1), (width - 1, height - 1)
    out[44:47] = (np.nan, 2), (2, np.inf), (width - 1 + 1e-9, 3)
    return out


@pytest.mark.parametrize("channels", [1, 3])
def test_places_equal_the_naive_twin_in_every_bit(channels):
    image = np.random.default_rng(1).lognormal(0, 3, (*SHAPE, channels)).astype(np.float32)
    image[3, 4], image[6, 2] = np.nan, np.inf
    (found,) = looked_up(image, places(2))
    expected = naive.look_up(image, places(2))
    np.testing.assert_array_equal(found, expected)
    assert 0 < np.isfinite(found).all(axis=-1).mean() < 1
