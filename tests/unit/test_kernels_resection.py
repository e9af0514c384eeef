"""The equations of a camera's fit are their naive twin to the last bit, as cameras go by them."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.kernels import point_motion
from tests.reference import resection as naive

COUNT = 300


def points(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(0, 3, (COUNT, 4)), rng.normal(0, 500, (COUNT, 2))


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_equations_are_those_of_points_with_weight(share):
    rng = np.random.default_rng(1)
    where, seen = points(1)
    weights = np.where(rng.random(COUNT) < share, rng.random(COUNT), 0)
    scaled, rows = np.full(4 * COUNT, np.nan), np.full(24 * COUNT, np.nan)
    count = point_motion.write_equations(where, seen, weights, scaled, rows)
    expected = naive.equations(where, seen, weights)
    assert count == np.count_nonzero(weights)
    assert scaled[: 4 * count].tobytes() == expected[0].tobytes()
    assert rows[: 24 * count].tobytes() == expected[1].tobytes()
