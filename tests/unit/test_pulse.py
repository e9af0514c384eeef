"""Pulse: against its naive twin, and where it is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exwarp_cli.domain.colour import PEAK
from exwarp_cli.metrics.registry import score_frame
from exwarp_cli.metrics.temporal import (
    MAX_PULSE,
    ROWS_AT_ONCE,
    mean_gradient,
    pulse,
)
from tests.reference import pulse as naive


def frame(seed: int, *shape: int) -> np.ndarray:
    """Scene-linear colour with values that no display can show."""
    return np.random.default_rng(seed).uniform(-0.2, 1.3, shape).astype(np.float32)


def measure_pulse(truth: np.ndarray, test: np.ndarray) -> float:
    found = score_frame(truth, test, None, ("pulse",))[0].pulse
    assert found is not None
    return found


def constant(value: float) -> np.ndarray:
    return np.full((9, 12, 3), value, np.float32)


def bars(low: float, high: float) -> np.ndarray:
    """Columns of grey, every second one dark."""
    found = constant(high)
    found[:, ::2] = low
    return found


def blurred(pixels: np.ndarray) -> np.ndarray:
    return (np.roll(pixels, 1, 1) + 2 * pixels + np.roll(pixels, -1, 1)) / 4


@settings(derandomize=True, max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 12), st.integers(1, 12), st.integers(3, 4))
def test_the_gradient_is_that_of_the_definition(seed, height, width, channels) -> None:
    pixels = frame(seed, height, width, channels)
    assert mean_gradient(pixels) == pytest.approx(naive.mean_gradient(pixels), rel=1e-5, abs=1e-4)


@pytest.mark.parametrize(
    "height", [ROWS_AT_ONCE - 1, ROWS_AT_ONCE, ROWS_AT_ONCE + 1, 2 * ROWS_AT_ONCE + 3]
)
def test_bands_of_rows_leave_no_seam(height: int) -> None:
    pixels = frame(height, height, 5, 3)
    assert mean_gradient(pixels) == pytest.approx(naive.mean_gradient(pixels), rel=1e-5)


def test_pulse_is_that_of_the_definition() -> None:
    truth, test = frame(1, 20, 30, 3), frame(2, 20, 30, 3) * np.float32(0.7)
    assert measure_pulse(truth, test) == pytest.approx(naive.pulse(test, truth), abs=1e-3)
    assert score_frame(truth, test, None)[0].pulse is not None, "by default"


def test_the_gradient_of_bars_is_their_contrast() -> None:
    assert mean_gradient(bars(0, 1)) == pytest.approx(PEAK, rel=1e-6)
    assert mean_gradient(np.swapaxes(bars(0, 1), 0, 1)) == pytest.approx(PEAK, rel=1e-6)
    assert mean_gradient(bars(-3, 7)) == mean_gradient(bars(0, 1)), "clipped as displayed"


def test_green_counts_more_than_blue() -> None:
    green, blue = (bars(0, 1) * np.eye(3, dtype=np.float32)[i] for i in (1, 2))
    assert mean_gradient(green) == pytest.approx(0.7152 * PEAK, rel=1e-5)
    assert mean_gradient(blue) == pytest.approx(0.0722 * PEAK, rel=1e-5)


def test_a_soft_frame_is_negative_and_a_sharp_one_positive() -> None:
    truth = blurred(frame(3, 40, 50, 3).clip(0, 1))
    assert measure_pulse(truth, truth) == 0
    assert measure_pulse(truth, blurred(truth)) < -5
    assert measure_pulse(truth, 2 * truth - blurred(truth)) > 5
    assert measure_pulse(truth, truth[:, ::-1]) == pytest.approx(0, abs=1e-9)


def test_a_flat_frame_has_lost_everything() -> None:
    assert measure_pulse(bars(0, 1), constant(0.5)) == -100


def test_constant_frames_do_not_pulse() -> None:
    assert mean_gradient(constant(0.3)) == 0
    assert measure_pulse(constant(0.1), constant(0.8)) == 0


def test_no_pulse_is_infinite() -> None:
    assert measure_pulse(constant(0.1), bars(0, 1)) == MAX_PULSE
    assert pulse(1.0, 1e-300) == MAX_PULSE


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_broken_pixels_leave_it_finite(value: float) -> None:
    truth = frame(5, 9, 12, 3)
    broken = truth.copy()
    broken[4, 4] = value
    assert np.isfinite(measure_pulse(truth, broken)) and np.isfinite(measure_pulse(broken, truth))


def test_alpha_and_holes_do_not_count() -> None:
    truth, test = frame(6, 9, 12, 4), frame(7, 9, 12, 4)
    assert measure_pulse(truth, test) == measure_pulse(truth[..., :3], test[..., :3])
    _, inside = score_frame(truth, test, np.ones((9, 12), bool))
    assert inside is not None and inside.pulse is None
