"""Following points: against the naive twin, and in cases with a known answer."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference.follow import follow
from tests.unit.kernel_calls import followed
from tests.unit.kernel_cases import SHAPE, field, ids


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("serial", [True, False])
def test_it_is_the_naive_twin(seed, known, serial):
    step, expected, moved = field(seed), field(seed + 10), field(seed + 20)
    stencils = (ids(seed), ids(seed + 30)) if known else None
    (found,) = followed(step, expected, moved, stencils, serial)
    np.testing.assert_allclose(found, follow(step, expected, moved, stencils), atol=2e-4)


def constant(x: float, y: float) -> np.ndarray:
    return np.full((*SHAPE, 2), (x, y), np.float32)


def test_uniform_motion_is_followed_exactly():
    (found,) = followed(constant(0.75, -0.5), constant(0.75, -0.5), constant(1.25, 2.0))
    np.testing.assert_allclose(found, constant(2.0, 1.5), atol=1e-6)


def test_out_of_sight_a_point_goes_on_as_foreseen():
    far = constant(100.0, 0.0)
    (found,) = followed(constant(0.75, -0.5), constant(0.25, 0.5), far)
    np.testing.assert_allclose(found, far + constant(0.25, 0.5))
    (lost,) = followed(constant(0.75, -0.5), constant(np.nan, np.nan), far)
    assert np.isnan(lost).all()


def test_what_is_before_a_point_does_not_take_it_along():
    step = constant(0.0, 0.0)
    stencil = np.zeros(SHAPE, np.int32)
    step[10:14, 4:8] = (9.0, 9.0)
    stencil[10:14, 4:8] = 2
    own = np.zeros(SHAPE, np.int32)
    still = constant(0.0, 0.0)
    (by_id,) = followed(step, still, still, (stencil, own))
    np.testing.assert_array_equal(by_id, still)
    (by_surprise,) = followed(step, still, still)
    assert np.abs(by_surprise).max() < 0.01


def test_without_expectation_samples_alone_lead_on():
    (found,) = followed(constant(0.75, -0.5), constant(np.nan, np.nan), constant(0.5, 0.5))
    np.testing.assert_allclose(found, constant(1.25, 0.0), atol=1e-6)


def test_unknown_points_stay_unknown():
    (found,) = followed(constant(1.0, 1.0), constant(1.0, 1.0), constant(np.nan, 0.0))
    assert np.isnan(found).any(axis=-1).all()
    (held,) = followed(constant(np.nan, np.nan), constant(1.0, 1.0), constant(0.0, 0.0))
    np.testing.assert_array_equal(held, constant(1.0, 1.0))
