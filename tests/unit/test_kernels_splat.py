"""Forward splatting: coverage, exactness, the depth test."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exwarp_cli.kernels.splat import OVERLAP, REACH_SPAN, ROWS_PER_STRIP, SAME_SURFACE
from tests.reference import splat as naive
from tests.unit.kernel_calls import reached, splatted

SHAPE = (24, 29)
OPEN = np.ones(SHAPE, np.float32)


def grid(shape: tuple[int, int] = SHAPE) -> np.ndarray:
    rows, columns = np.mgrid[0 : shape[0], 0 : shape[1]]
    return np.stack([columns, rows], axis=-1).astype(np.float64)


def uniform(x: float, y: float, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    return np.broadcast_to(np.array([x, y], np.float32), (*shape, 2)).copy()


def linear(matrix: list[list[float]], shape: tuple[int, int] = SHAPE) -> np.ndarray:
    """Displacement of a linear map about the centre."""
    centre = (np.array(shape[::-1]) - 1) / 2
    moved = (grid(shape) - centre) @ np.array(matrix).T + centre
    return (moved - grid(shape)).astype(np.float32)


def smooth(seed: int, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    """A wavy displacement of a few pixels."""
    rng = np.random.default_rng(seed)
    out = np.zeros((*shape, 2))
    for _ in range(4):
        wave = rng.uniform(-0.25, 0.25, 2)
        phase = rng.uniform(0, 6, 2)
        out += np.sin((grid(shape) @ wave)[..., None] + phase) * rng.uniform(-1, 1, 2)
    return (out + rng.uniform(-3, 3, 2)).astype(np.float32)


def random_depth(seed: int, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    return np.random.default_rng(seed).uniform(1, 9, shape).astype(np.float32)


def assert_equals_twin(displacement: np.ndarray, depth: np.ndarray) -> None:
    field, near = splatted(displacement, depth)
    expected, expected_near = naive.splat(displacement, depth, SAME_SURFACE, OVERLAP)
    np.testing.assert_array_equal(near, expected_near)
    np.testing.assert_array_equal(field, expected)


class TestAgainstTheTwin:
    @pytest.mark.parametrize("seed", [0, 1])
    def test_wavy_motion(self, seed):
        assert_equals_twin(smooth(seed), random_depth(seed))

    def test_wild_motion(self):
        rng = np.random.default_rng(2)
        displacement = rng.normal(0, 1.5, (*SHAPE, 2)).astype(np.float32)
        displacement[rng.random(SHAPE) < 0.1] = np.nan
        depth = np.round(random_depth(2))  # many ties
        depth[depth > 7] = np.inf
        assert_equals_twin(displacement, depth)

    @pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2 * ROWS_PER_STRIP + 3, 6)])
    def test_odd_sizes_and_several_bands(self, shape):
        displacement = smooth(3, shape)
        displacement[..., 1] *= 5
        assert_equals_twin(displacement, random_depth(3, shape))

    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 3e9])
    @pytest.mark.parametrize("at", [(0, 0), (0, -1), (-1, 0), (-1, -1), (9, 9)])
    def test_one_value_astray(self, bad, at):
        for c in range(2):
            displacement = smooth(4)
            displacement[(*at, c)] = bad
            assert_equals_twin(displacement, random_depth(4))

    @pytest.mark.parametrize("shift", [-1, 0, 1])
    def test_across_the_bands(self, shift):
        shape = (3 * ROWS_PER_STRIP + shift, 5)
        displacement = smooth(6, shape)
        displacement[..., 1] += np.float32(ROWS_PER_STRIP)
        assert_equals_twin(displacement, random_depth(6, shape))

    def test_rows_reach_at_least_as_far_as_they_land(self):
        displacement = smooth(5)
        displacement[4] = np.nan
        displacement[7, 3] = np.nan
        (reach,) = reached(displacement)
        low, high = naive.row_span(displacement)
        margin = OVERLAP * (1 + 2 * SAME_SURFACE)  # half a patch at its greatest stretch
        whole, known = reach[:, -1], np.arange(len(low)) != 4
        assert (whole[known, 0] <= low[known] - margin).all()
        assert (whole[known, 1] >= high[known] + margin).all()
        assert whole[4, 0] > whole[4, 1]  # nothing at all: no band visits it

    def test_spans_reach_as_far_as_their_pixels_land(self):
        displacement = smooth(5, (7, 2 * REACH_SPAN + 3))
        displacement[..., 1] *= 9
        displacement[2, REACH_SPAN : 2 * REACH_SPAN] = np.nan
        (reach,) = reached(displacement)
        assert reach.shape == (7, 4, 2)
        for span in range(3):
            low, high = naive.row_span(displacement[:, span * REACH_SPAN : (span + 1) * REACH_SPAN])
            np.testing.assert_array_equal(reach[:, span], np.stack([low - 2, high + 2], axis=-1))
        np.testing.assert_array_equal(reach[:, 3, 0], reach[:, :3, 0].min(axis=1))
        np.testing.assert_array_equal(reach[:, 3, 1], reach[:, :3, 1].max(axis=1))

    def test_spans_that_fly_apart(self):
        shape = (ROWS_PER_STRIP + 5, 3 * REACH_SPAN + 7)
        displacement = smooth(6, shape)
        displacement[:, REACH_SPAN : 2 * REACH_SPAN, 1] += np.float32(ROWS_PER_STRIP)
        displacement[:, 3 * REACH_SPAN :, 1] -= np.float32(20)
        assert_equals_twin(displacement, np.round(random_depth(6, shape)))

    def test_a_row_of_nothing_is_passed_over(self):
        displacement = uniform(0, 0)
        displacement[4] = np.nan
        _, near = splatted(displacement, OPEN)
        assert np.isnan(near[4]).all() and np.isfinite(np.delete(near, 4, 0)).all()


class TestExactness:
    def test_no_motion_gives_no_motion(self):
        depth = random_depth(1)
        field, near = splatted(uniform(0, 0), depth)
        # A patch overlaps its neighbours' centres nowhere, so every pixel keeps its own depth.
        np.testing.assert_array_equal(near, depth)
        np.testing.assert_array_equal(field, 0)

    @pytest.mark.parametrize(("x", "y"), [(3, 0), (-4, 2), (0, -7)])
    def test_whole_pixels(self, x, y):
        depth = random_depth(2)
        field, near = splatted(uniform(x, y), depth)
        rows, columns = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]]
        landed = (
            (rows - y >= 0) & (rows - y < SHAPE[0]) & (columns - x >= 0) & (columns - x < SHAPE[1])
        )
        np.testing.assert_array_equal(np.isfinite(near), landed)
        np.testing.assert_array_equal(
            near[landed], depth[(rows - y)[landed], (columns - x)[landed]]
        )
        assert (field[landed] == (-x, -y)).all()
        assert np.isnan(field[~landed]).all()

    @pytest.mark.parametrize(
        "matrix",
        [
            [[1.45, 0], [0, 1.45]],
            [[1.3, 0], [0, 0.8]],
            [[0.6, 0], [0, 0.6]],
            [[0.96, -0.28], [0.28, 0.96]],
            [[0.92, 0.4], [-0.4, 0.92]],
            [[1.2, 0.3], [-0.25, 1.1]],
            [[1, 0.45], [0, 1]],
        ],
    )
    def test_linear_maps_are_inverted_and_leave_no_cracks(self, matrix):
        field, near = splatted(linear(matrix), OPEN)
        centre = (np.array(SHAPE[::-1]) - 1) / 2
        source = (grid() - centre) @ np.linalg.inv(np.array(matrix)).T + centre
        inside = (source >= 0).all(axis=-1) & (source <= np.array(SHAPE[::-1]) - 1).all(axis=-1)
        assert inside.sum() > 150
        assert np.isfinite(near[inside]).all(), "cracks"
        # Every patch is exact, its displacement being linear.
        np.testing.assert_allclose(field[inside], (source - grid())[inside], rtol=0, atol=2e-5)

    def test_motion_inverted_twice_returns(self):
        displacement = smooth(7)
        field, _ = splatted(displacement, OPEN)
        back, _ = splatted(field, OPEN)
        known = np.isfinite(back).all(axis=-1)
        known[:2] = known[-2:] = False
        known[:, :2] = known[:, -2:] = False
        assert known.sum() > 200
        gap = np.linalg.norm((back - displacement)[known], axis=-1)
        assert np.median(gap) < 0.02 and gap.max() < 0.2  # curvature within a pixel is left out

    @settings(derandomize=True, max_examples=20)
    @given(st.floats(-8, 8, width=32), st.floats(-8, 8, width=32))
    def test_a_uniform_shift_is_its_own_inverse(self, x, y):
        field, near = splatted(uniform(x, y), OPEN)
        landed = np.isfinite(near)
        np.testing.assert_allclose(field[landed], -uniform(x, y)[landed], rtol=0, atol=2e-6)
        rows, columns = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]]
        # All of the moved frame is covered; outside it, at most the patches' overlap.
        inside = (columns - x >= 0) & (columns - x <= SHAPE[1] - 1)
        inside &= (rows - y >= 0) & (rows - y <= SHAPE[0] - 1)
        assert landed[inside].all()


class TestDepth:
    def two_layers(self, front: tuple[float, float], front_depth: float = 1.0):
        """A background that stays and a square that moves."""
        displacement, depth = uniform(0, 0), np.full(SHAPE, 5, np.float32)
        displacement[8:14, 5:11] = front
        depth[8:14, 5:11] = front_depth
        return displacement, depth

    def test_the_nearer_surface_hides_the_other(self):
        field, near = splatted(*self.two_layers((6, 0)))
        assert (near[8:14, 11:17] == 1).all() and (field[8:14, 11:17] == (-6, 0)).all()
        assert np.isnan(near[8:14, 5:11]).all()
        assert (near[:8] == 5).all() and (near[14:] == 5).all()

    def test_the_farther_one_passes_behind(self):
        field, near = splatted(*self.two_layers((6, 0), front_depth=9))
        assert (near[8:14, 11:17] == 5).all() and (field[8:14, 11:17] == 0).all()

    def test_everything_hides_the_background(self):
        displacement, depth = self.two_layers((6, 0))
        depth[depth == 5] = np.inf
        _, near = splatted(displacement, depth)
        assert (near[8:14, 11:17] == 1).all()
        assert np.isinf(near[:8]).all()

    def test_background_lands_where_nothing_else_does(self):
        _, near = splatted(uniform(1, 0), np.full(SHAPE, np.inf, np.float32))
        assert np.isinf(near[:, 1:]).all() and np.isnan(near[:, 0]).all()

    def test_equal_depth_is_settled_the_same_in_either_build(self):
        displacement = np.random.default_rng(8).normal(0, 4, (*SHAPE, 2)).astype(np.float32)
        first, second = splatted(displacement, OPEN), splatted(displacement, OPEN, serial=True)
        assert first[0].tobytes() == second[0].tobytes()

    def test_a_surface_seen_edge_on_shows_nothing(self):
        matrix = [[0.52, 0.48], [0.48, 0.52]]  # all but flat on the diagonal
        assert np.isnan(splatted(linear(matrix), OPEN)[1]).all()


class TestWithoutValue:
    @pytest.mark.parametrize("bad", [(np.nan, np.nan), (0, np.nan), (np.nan, 0)])
    def test_unknown_motion_lands_nowhere(self, bad):
        displacement = uniform(0, 0)
        displacement[9, 9] = bad
        field, near = splatted(displacement, OPEN)
        assert np.argwhere(np.isnan(near)).tolist() == [[9, 9]]
        assert (np.delete(field.reshape(-1, 2), 9 * SHAPE[1] + 9, 0) == 0).all()

    def test_nothing_known_gives_nothing(self):
        field, near = splatted(uniform(np.nan, np.nan), OPEN)
        assert np.isnan(field).all() and np.isnan(near).all()

    @pytest.mark.parametrize("far", [1e4, -1e4, 3e9, -3e9, np.inf, -np.inf])
    def test_motion_far_out_of_the_frame_lands_nowhere(self, far):
        for x, y in ((far, 0), (0, far), (far, far)):
            assert np.isnan(splatted(uniform(x, y), OPEN)[1]).all()
