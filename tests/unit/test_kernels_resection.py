"""The passes of fitting a camera are their naive twins to the last bit, as cameras go by them."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.kernels import projection
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
    count = projection.write_equations(where, seen, weights, scaled, rows)
    expected = naive.equations(where, seen, weights)
    assert count == np.count_nonzero(weights)
    assert scaled[: 4 * count].tobytes() == expected[0].tobytes()
    assert rows[: 24 * count].tobytes() == expected[1].tobytes()


def test_errors_are_infinite_where_they_tell_nothing():
    image, seen = points(2)[0][:, :3].copy(), points(3)[1]
    image[:9, 2] = 0, -0.0, np.nan, np.inf, -1, 1, 1, 1e-320, 5
    image[5, 0], image[6, 1] = np.nan, np.inf
    found = np.full(COUNT, np.nan)
    projection.write_projection_errors(image, seen, found)
    assert found.tobytes() == naive.errors(image, seen).tobytes()
    assert np.isinf(found[[0, 1, 2, 4, 5, 6]]).all() and np.isfinite(found[8])


def test_inliers_reach_up_to_the_limit():
    errors, inliers = np.array([1.0, 2, 3, np.inf]), np.ones(4, np.bool_)
    assert projection.mark_inliers(errors, 2.0, inliers) == (2, False)
    np.testing.assert_array_equal(inliers, [True, True, False, False])
    assert projection.mark_inliers(errors, 2.5, inliers) == (2, True)
    assert projection.mark_inliers(errors[::-1].copy(), 2.0, inliers) == (2, False)


def test_weights_are_geman_and_mcclures():
    rng = np.random.default_rng(4)
    errors, depths = rng.exponential(2, COUNT), rng.normal(0, 1, COUNT)
    depths[:3] = 0, 1e-12, -1e-12
    inliers = errors < 4
    found = np.full(COUNT, np.nan)
    projection.write_inlier_weights(errors, inliers, depths, 0.7, found)
    assert found.tobytes() == naive.weights(errors, inliers, depths, 0.7).tobytes()
