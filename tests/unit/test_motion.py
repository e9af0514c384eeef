"""Reading displacements from raw channels, and writing them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exwarp_cli.domain.motion import AxisMap
from tests.reference import vectors as naive_vectors

VALUES = st.floats(width=32) | st.integers(-3, 40).map(float) | st.sampled_from([0.5, -1.0, 3e38])

MAPS = {
    "plain": AxisMap(0, 1, 1.0, -1.0),
    "swapped": AxisMap(1, 0, -2.0, 0.5),
    "about the middle": AxisMap(0, 1, -1920.0, 1080.0, still=0.5),
    "direction": AxisMap(0, 1, 1.0, -1.0, length=2),
    "direction about the middle": AxisMap(0, 1, 2.0, -2.0, still=0.5, length=2),
    "premultiplied": AxisMap(0, 1, 960.0, -540.0, alpha=3),
    "premultiplied about the middle": AxisMap(0, 1, 960.0, -540.0, still=0.5, alpha=3),
}


def raw(*values: float) -> np.ndarray:
    return np.array([[values]], np.float32)


class TestApply:
    @pytest.mark.parametrize(
        ("name", "values", "expected"),
        [
            ("plain", (3, 4, 9, 9), (3, -4)),
            ("swapped", (3, 4, 9, 9), (-8, 1.5)),
            ("about the middle", (0.5, 0.5, 9, 9), (0, 0)),
            ("about the middle", (0.75, 0.25, 9, 9), (-480, -270)),
            ("direction", (0.6, 0.8, 10, 9), (6, -8)),
            ("direction", (0, 0, 0, 9), (0, 0)),
            ("direction about the middle", (1.0, 0.5, 10, 9), (10, 0)),
            ("direction about the middle", (0.5, 0.0, 10, 9), (0, 10)),
            ("premultiplied", (0.05, 0.1, 9, 0.5), (96, -108)),
            ("premultiplied", (0, 0, 9, 0), (0, 0)),
            ("premultiplied", (7, 7, 9, 0), (0, 0)),
            ("premultiplied about the middle", (0.375, 0.25, 9, 0.5), (240, 0)),
            ("premultiplied about the middle", (0, 0, 9, 0), (0, 0)),
        ],
    )
    def test_values(self, name, values, expected):
        found = MAPS[name].apply(raw(*values))
        assert found.dtype == np.float32 and found.shape == (1, 1, 2)
        np.testing.assert_allclose(found[0, 0], expected, atol=1e-3)

    @pytest.mark.parametrize("value", [0.0, 1.0, -0.5, 1.5])
    def test_clipped_values_are_unknown(self, value):
        for values in ((value, 0.6, 0, 1), (0.6, value, 0, 1)):
            assert np.isnan(MAPS["about the middle"].apply(raw(*values))).all()

    def test_values_about_another_one_are_not_clipped(self):
        # A writer's bias, or whole numbers about their middle, reach to both sides as far as any.
        for still in (0.001, -1.0, 32768.0):
            found = AxisMap(0, 1, 2.0, 2.0, still).apply(raw(still + 5, still - 7))
            np.testing.assert_allclose(found[0, 0], (10, -14), rtol=1e-3)

    def test_a_middle_of_8_bits_is_clipped_too(self):
        for still in (127 / 255, 128 / 255):
            found = AxisMap(0, 1, 9.0, 9.0, still)
            assert np.isnan(found.apply(raw(1.0, 0.6))).all()
            assert np.isfinite(found.apply(raw(0.999, 0.001))).all()

    @pytest.mark.parametrize("name", MAPS)
    def test_what_is_not_finite_is_unknown(self, name):
        for bad in (np.nan, np.inf, -np.inf):
            for index in (0, 1):
                values = [0.3, 0.3, 1.0, 1.0]
                values[index] = bad
                assert np.isnan(MAPS[name].apply(raw(*values))).all()

    @given(
        st.lists(st.tuples(VALUES, VALUES, VALUES, VALUES), min_size=1, max_size=20),
        st.sampled_from([(0, 1), (1, 2), (2, 3), (3, 2), (0, 2), (1, 1)]),
        st.tuples(st.sampled_from([1.0, -1.0, 960.0]), st.sampled_from([1.0, -540.0])),
    )
    def test_plain_vectors_are_those_of_the_twin(self, rows, channels, scales):
        values = np.array(rows, np.float32)
        found = AxisMap(*channels, *scales).apply(values)
        np.testing.assert_array_equal(found, naive_vectors.scale_vectors(values, channels, scales))


@pytest.mark.parametrize("name", MAPS)
def test_what_is_written_reads_back(name):
    rng = np.random.default_rng(3)
    wanted = rng.uniform(-90, 90, (6, 5, 2)).astype(np.float32)
    wanted[0, 0] = 0
    before = rng.uniform(0.2, 1, (6, 5, 5)).astype(np.float32)
    made = MAPS[name].write(wanted, before)
    np.testing.assert_allclose(MAPS[name].apply(made), wanted, atol=0.01)
    others = sorted(set(range(5)) - {*MAPS[name].channels} | {3})
    np.testing.assert_array_equal(made[..., others], before[..., others])


def test_a_written_direction_has_length_one():
    moved = np.array([[[3.0, -4.0]]], np.float32)
    found = MAPS["direction"].write(moved, np.zeros((1, 1, 3), np.float32))
    np.testing.assert_allclose(found[0, 0], (0.6, 0.8, 5.0), rtol=1e-6)
    mapped = MAPS["direction about the middle"].write(moved, np.zeros((1, 1, 3), np.float32))
    np.testing.assert_allclose(mapped[0, 0], (0.8, 0.9, 5.0), rtol=1e-6)
