"""Following points: against the naive twin, and in cases with a known answer."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference.follow import follow
from tests.unit.kernel_calls import followed
from tests.unit.kernel_cases import SHAPE, depth, field, ids


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("serial", [True, False])
def test_it_is_the_naive_twin(seed, known, serial):
    step, expected, moved = field(seed), field(seed + 10), field(seed + 20)
    stencils = (ids(seed), ids(seed + 30)) if known else None
    (found,) = followed(step, expected, moved, stencils, serial)
    np.testing.assert_allclose(found, follow(step, expected, moved, stencils), atol=2e-4)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("rounded", [(0.0, 0.0), (0.5, 0.0), (0.0, 0.02)])
def test_with_depths_it_is_the_naive_twin(seed, known, rounded):
    step, expected, moved = field(seed), field(seed + 10), field(seed + 20)
    stencils = (ids(seed), ids(seed + 30)) if known else None
    depths = depth(seed), depth(seed + 40)
    (found,) = followed(step, expected, moved, stencils, depths=depths, rounded=rounded)
    twin = follow(step, expected, moved, stencils, depths=depths, rounded=rounded)
    np.testing.assert_allclose(found, twin, atol=2e-4)


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
    own = np.full(SHAPE, 10, np.float32)
    before = own.copy()
    before[10:14, 4:8] = 5
    (by_depth,) = followed(step, still, still, depths=(before, own))
    np.testing.assert_array_equal(by_depth, still)


def test_vectors_that_agree_are_followed_whatever_was_expected():
    (found,) = followed(constant(2.0, 0.0), constant(3.0, 0.0), constant(0.5, 0.5))
    np.testing.assert_allclose(found[:-1, :-1], constant(2.5, 0.5)[:-1, :-1], atol=1e-6)


def test_where_vectors_differ_the_expected_one_chooses():
    step = constant(0.0, 0.0)
    step[:, ::2] = (4.0, 0.0)
    (found,) = followed(step, constant(3.8, 0.0), constant(0.5, 0.0))
    np.testing.assert_allclose(found[:, :-1], constant(4.5, 0.0)[:, :-1], atol=0.01)


@pytest.mark.parametrize(("rounded", "way"), [((0, 0), 3.0), ((2, 0), 2.0), ((0, 0.2), 2.0)])
def test_rounded_depths_are_no_other_surface(rounded, way):
    depths = np.full(SHAPE, 3, np.float32), np.full(SHAPE, 5, np.float32)
    still = constant(0.0, 0.0)
    (found,) = followed(
        constant(2.0, 0.0), constant(3.0, 0.0), still, depths=depths, rounded=rounded
    )
    np.testing.assert_allclose(found, constant(way, 0.0))


@pytest.mark.parametrize(("nearer", "way"), [(0.01, 2.0), (0.05, 3.0), (0.2, 3.0)])
def test_at_another_depth_a_surprising_vector_is_another_surface(nearer, way):
    own = np.full(SHAPE, 5, np.float32)
    depths, still = (own * np.float32(1 - nearer), own), constant(0.0, 0.0)
    (found,) = followed(constant(2.0, 0.0), constant(3.0, 0.0), still, depths=depths)
    np.testing.assert_allclose(found, constant(way, 0.0))


@pytest.mark.parametrize(("nearer", "way"), [(0.05, 2.9), (0.2, 3.0)])
def test_what_comes_nearer_as_expected_is_followed(nearer, way):
    own = np.full(SHAPE, 5, np.float32)
    depths, still = (own * np.float32(1 - nearer), own), constant(0.0, 0.0)
    (found,) = followed(constant(2.9, 0.0), constant(3.0, 0.0), still, depths=depths)
    np.testing.assert_allclose(found, constant(way, 0.0))


@pytest.mark.parametrize(("speed", "way"), [(2.9, 2.9), (2.0, 3.0)])
def test_what_has_an_id_may_come_nearer_as_expected(speed, way):
    depths = np.full(SHAPE, 3, np.float32), np.full(SHAPE, 5, np.float32)
    ball = np.ones(SHAPE, np.int32)
    still = constant(0.0, 0.0)
    (found,) = followed(
        constant(speed, 0.0), constant(3.0, 0.0), still, (ball, ball), depths=depths
    )
    np.testing.assert_allclose(found, constant(way, 0.0))


def test_the_expected_vector_stands_in_for_samples_of_others():
    """A point on the outline, half way between its own surface and another one."""
    stencil, own = np.zeros(SHAPE, np.int32), np.ones(SHAPE, np.int32)
    stencil[:, :8] = 1
    (found,) = followed(constant(2.0, 0.0), constant(2.2, 0.0), constant(0.5, 0.0), (stencil, own))
    trust = 1 / (1 + (0.2 / 0.25) ** 2) ** 2
    np.testing.assert_allclose(found[:, 6], constant(2.5, 0.0)[:, 6], atol=1e-6)
    middle = 0.5 + (0.5 * trust * 2.0 + 0.5 * trust * 2.2) / trust
    np.testing.assert_allclose(found[:, 7], constant(middle, 0.0)[:, 7], atol=1e-5)
    np.testing.assert_allclose(found[:, 8], constant(2.7, 0.0)[:, 8], atol=1e-6)


def test_without_expectation_samples_alone_lead_on():
    (found,) = followed(constant(0.75, -0.5), constant(np.nan, np.nan), constant(0.5, 0.5))
    np.testing.assert_allclose(found, constant(1.25, 0.0), atol=1e-6)


def test_unknown_points_stay_unknown():
    (found,) = followed(constant(1.0, 1.0), constant(1.0, 1.0), constant(np.nan, 0.0))
    assert np.isnan(found).any(axis=-1).all()
    (held,) = followed(constant(np.nan, np.nan), constant(1.0, 1.0), constant(0.0, 0.0))
    np.testing.assert_array_equal(held, constant(1.0, 1.0))
