"""The network's 44 inputs: where everything stands, how it is scaled, and where it saturates."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exwarp_cli.domain.decision import FEATURES, NODES, Features
from exwarp_cli.policy.state import (
    INPUTS,
    OLDER_KEYS,
    SCALES,
    STATE_COUNT,
    STATE_SIZE,
    StateHistory,
    state,
)
from tests.reference import decisions as paper

SEEN = Features(7, 0.0213830293, 0.2451086720, 2.81838e-3, 0.012, 1000, 500, 8.0)

numbers = st.floats(0, 1e30, allow_nan=False)
anything = st.builds(
    Features,
    st.integers(0, 10**9), numbers, numbers, numbers, numbers,
    st.integers(1, 40000), st.integers(1, 40000), numbers,
)  # fmt: skip


def seen(number: int) -> Features:
    """Features that differ from instant to instant."""
    x = 0.01 * (number + 1)
    return Features(number, x, 2 * x, 40 * x, 30 * x, 640, 360, 5.0 + number)


def named(features: Features) -> dict[str, float]:
    """Features as the twin takes them."""
    found = dict(zip(FEATURES, features.values, strict=True))
    return found | {"width": features.width, "distance": features.distance}


def scale_features(features: Features) -> np.ndarray:
    return state(features, "d1")[: len(FEATURES)]


NOW, BEFORE = (seen(0), seen(1), seen(2)), (seen(3), seen(4), seen(5))


class TestScaling:
    def test_an_example_by_hand(self):
        """Three lie halfway: log2 8 of log2 64; 0.001 (sqrt 501 - 1), 0.001 (sqrt 1001 - 1) x 8."""
        found = scale_features(SEEN)
        np.testing.assert_allclose(found[:3], 0.5, atol=1e-8)
        # Var_x / 1000^2 / 1e-7 = 0.0281838: ln 1.0281838 / ln 100001; Var_y: ln 1.12 / ln 100001
        np.testing.assert_allclose(found[3:5], [0.00241414927, 0.00984359598], atol=1e-8)
        # half a megapixel: ln 11 / ln 665
        assert found[5] == pytest.approx(0.36891905, abs=1e-8)

    @settings(deadline=None)
    @given(anything)
    def test_it_is_the_naive_twin(self, features):
        np.testing.assert_allclose(
            scale_features(features), paper.scaled(named(features)), atol=1e-12
        )

    @settings(deadline=None)
    @given(anything)
    def test_it_lies_within_0_and_1(self, features):
        found = scale_features(features)
        assert found.shape == (6,) and found.dtype == np.float64
        assert ((found >= 0) & (found <= 1)).all()

    def test_it_saturates_where_it_says(self):
        tops = Features(63, 0.5, 8.0, 1e4, 1e4, 1000, 33200, 8.0)
        np.testing.assert_allclose(scale_features(tops), 1, rtol=1e-12)
        beyond = Features(9999, 5.0, 99.0, 1e9, 1e9, 1000, 99999, 8.0)
        assert scale_features(beyond).tolist() == [1.0] * 6
        under = Features(62, 0.49, 7.9, 9.9e3, 9.9e3, 1000, 33000, 8.0)
        assert (scale_features(under) < 1).all()

    def test_nothing_is_nothing(self):
        assert scale_features(Features(0, 0.0, 0.0, 0.0, 0.0, 1, 1, 0.0))[:5].tolist() == [0] * 5

    @pytest.mark.parametrize("field", ["objects", "emd_normal", "emd_position", "var_x", "var_y"])
    def test_more_is_more_and_moves_nothing_else(self, field):
        index = ["objects", "emd_normal", "emd_position", "var_x", "var_y"].index(field)
        top = {"objects": 63, "emd_normal": 0.5, "emd_position": 8.0}.get(field, 1e4)
        steps = range(64) if field == "objects" else [top * k / 50 for k in range(51)]
        found = [scale_features(replace(SEEN, **{field: value})) for value in steps]
        for smaller, larger in pairwise(found):
            assert larger[index] > smaller[index]
            np.testing.assert_array_equal(np.delete(larger, index), np.delete(smaller, index))

    def test_positions_count_relative_to_the_distance(self):
        far = replace(SEEN, emd_position=10 * SEEN.emd_position, distance=10 * SEEN.distance)
        np.testing.assert_allclose(scale_features(far), scale_features(SEEN), rtol=1e-12)
        assert scale_features(replace(SEEN, distance=80.0))[2] < scale_features(SEEN)[2]

    def test_at_an_unknown_distance_nothing_has_moved(self):
        assert scale_features(replace(SEEN, distance=0.0))[2] == 0

    def test_variances_count_relative_to_the_width(self):
        large = replace(SEEN, width=3000, var_x=9 * SEEN.var_x, var_y=9 * SEEN.var_y)
        np.testing.assert_allclose(
            scale_features(large)[3:5], scale_features(SEEN)[3:5], rtol=1e-12
        )

    @pytest.mark.parametrize("size", [(854, 480), (1920, 1080), (3840, 2160), (7680, 4320)])
    def test_resolutions_of_film_and_video_are_distinguished(self, size):
        one, more = (
            scale_features(replace(SEEN, width=size[0] + k, height=size[1]))[5] for k in (-200, 0)
        )
        assert 0 < one < more <= 1
        assert list(SCALES) == list(FEATURES)


def parts(inputs: np.ndarray) -> list[tuple[np.ndarray, str]]:
    """Take 44 numbers apart: the features and the node of each state."""
    assert inputs.shape == (44,)
    found = []
    for one in inputs.reshape(4, 11):
        assert sorted(one[6:]) == [0, 0, 0, 0, 1]
        found.append((one[:6], NODES[int(np.argmax(one[6:]))]))
    return found


ORDER = {
    "d1": [("d1", 0), ("d1", 3), ("d1", 4), ("d1", 5)],
    "d2": [("d2", 1), ("d1", 0), ("d1", 3), ("d1", 4)],
    "d3": [("d3", 2), ("d1", 0), ("d1", 3), ("d1", 4)],
    "d4": [("d4", 2), ("d2", 1), ("d1", 0), ("d1", 3)],
    "d5": [("d5", 2), ("d2", 1), ("d1", 0), ("d1", 3)],
}
"""Node and instant of the four states at each node: t, t + 1/4, t + 1/2, F_k-1, F_k-2, F_k-3."""


class TestInputs:
    def test_sizes(self):
        assert (STATE_COUNT, STATE_SIZE, INPUTS, OLDER_KEYS) == (4, 11, 44, 3)

    @pytest.mark.parametrize("node", NODES)
    def test_which_instants_and_nodes_stand_where(self, node):
        found = parts(StateHistory(NOW, BEFORE).inputs(node))
        for (features, at), (expected, instant) in zip(found, ORDER[node], strict=True):
            assert at == expected
            np.testing.assert_array_equal(features, scale_features(seen(instant)))

    @pytest.mark.parametrize("keys", [0, 1, 2, 3])
    @pytest.mark.parametrize("node", NODES)
    def test_the_oldest_is_repeated_where_there_are_fewer(self, node, keys):
        known = [pair for pair in ORDER[node] if pair[1] < 3 + keys]
        expected = (known + [known[-1]] * 4)[:4]
        found = parts(StateHistory(NOW, BEFORE[:keys]).inputs(node))
        assert [at for _, at in found] == [at for at, _ in expected]
        for (features, _), (_, instant) in zip(found, expected, strict=True):
            np.testing.assert_array_equal(features, scale_features(seen(instant)))

    @pytest.mark.parametrize("keys", [0, 2, 3])
    @pytest.mark.parametrize("node", NODES)
    def test_they_are_the_naive_twin_s(self, node, keys):
        history = [(named(seen(i)), at) for at, i in ORDER[node] if i < 3 + keys]
        found = StateHistory(NOW, BEFORE[:keys]).inputs(node)
        np.testing.assert_allclose(found, paper.inputs(history), atol=1e-12)

    def test_a_state_is_its_features_and_its_node(self):
        assert state(SEEN, "d3").tolist() == [*scale_features(SEEN), 0, 0, 1, 0, 0]
