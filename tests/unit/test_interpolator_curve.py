"""What interpolation networks see of scene-linear colour: invertible, and sRGB where it can be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exwarp_cli.domain.colour import ENCODINGS, MIN_WHITE, PEAK, ShoulderCurve, encode_display
from tests.reference import curve as reference

PEAKS = (1.0, 1.0001, 1.5, 4.0, 1000.0, 65504.0, 1e30)


def ladder(peak: float) -> np.ndarray:
    """Values of all sizes and both signs, float32."""
    steps = np.concatenate([[0], np.geomspace(1e-6, 1, 200), np.geomspace(1, peak, 50)])
    steps = steps.astype(np.float32)
    return np.concatenate([-steps[::-1], steps])


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("peak", PEAKS)
class TestCurve:
    def test_it_agrees_with_its_twin(self, encoding, peak):
        values = ladder(peak)
        expected = [reference.shown(float(v), peak, encoding) for v in values]
        np.testing.assert_allclose(
            ShoulderCurve(encoding, peak).encode(values), expected, atol=1e-6
        )

    def test_there_and_back(self, encoding, peak):
        values, curve = ladder(peak), ShoulderCurve(encoding, peak)
        back = curve.decode(curve.encode(values))
        assert back.dtype == np.float32
        np.testing.assert_allclose(back, values, rtol=2e-5 * (1 + np.log(peak)), atol=1e-7)

    def test_it_rises_and_ends_at_one(self, encoding, peak):
        shown = ShoulderCurve(encoding, peak).encode(ladder(peak))
        assert (np.diff(shown) >= 0).all() and shown[-1] == pytest.approx(1)
        assert shown[0] == pytest.approx(-1)

    def test_answers_beyond_it_count_as_its_end(self, encoding, peak):
        found = ShoulderCurve(encoding, peak).decode(np.array([1.7, -3.0], np.float32))
        np.testing.assert_allclose(found, [peak, -peak], rtol=1e-5)


def test_without_highlights_it_is_plain_srgb():
    values = np.linspace(0, 1, 500, dtype=np.float32)[:, None, None].repeat(3, axis=2)
    shown = ShoulderCurve.of("srgb", values, values * 0.5).encode(values)
    np.testing.assert_allclose(shown, encode_display(values) / PEAK, atol=1e-6)


@given(st.floats(1, 1e30))
def test_a_highlight_darkens_the_rest_by_a_quarter_at_most(peak):
    grey = np.array([0.18], np.float32)
    plain, beside = (float(ShoulderCurve("srgb", p).encode(grey)[0]) for p in (1.0, peak))
    assert MIN_WHITE * plain - 1e-6 <= beside <= plain + 1e-6


@pytest.mark.parametrize("peak", [1.2, 2.0])
def test_small_highlights_join_without_a_kink(peak):
    curve, step = ShoulderCurve("srgb", peak), 1e-3
    at = np.array([1 - step, 1, 1 + step], np.float32)
    below, above = np.diff(curve.encode(at).astype(np.float64))
    assert above == pytest.approx(below, rel=0.01)


def test_the_brightest_of_both_frames_counts_either_sign():
    dim, bright = np.full((2, 2, 3), 0.5, np.float32), np.full((2, 2, 3), -7, np.float32)
    assert (
        ShoulderCurve.of("srgb", dim, bright).peak
        == ShoulderCurve.of("srgb", bright, dim).peak
        == 7
    )
    assert ShoulderCurve.of("srgb", dim, dim).peak == 1
