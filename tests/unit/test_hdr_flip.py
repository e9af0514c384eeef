"""HDR-FLIP: the package's own numbers, and what it would end the process on."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exwarp_cli.metrics.registry import (
    MAX_COLOUR,
    hdr_flip_colour,
    hdr_flip_exposures,
    measure_hdr_flip,
    score_frame,
)


def pair(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    reference = rng.random((40, 56, 3), dtype=np.float32) * 8
    return reference, reference * rng.normal(1, 0.1, reference.shape).astype(np.float32)


def test_it_is_the_evaluators_own_mean_with_its_own_exposures() -> None:
    from flip_evaluator import evaluate

    reference, test = pair()
    test = np.maximum(test, 0)
    fault, mean, used = evaluate(reference, test, "HDR", applyMagma=False, parameters={})
    assert used["numExposures"] > 1
    measured = measure_hdr_flip(reference, test)
    assert measured.value() == pytest.approx(mean, abs=1e-6)
    mask = np.zeros((40, 56), bool)
    mask[10:20, 30:50] = True
    assert measured.value(mask) == pytest.approx(fault[..., 0][mask].mean(), abs=1e-6)


@pytest.mark.parametrize("level", [0.3, 1.0, 100.0])
@pytest.mark.parametrize("stops", [0, 1, 2, 3, 5, 6, 7])
def test_exposures_are_the_evaluators_own_also_whole_stops_apart(level: float, stops: int) -> None:
    from flip_evaluator import evaluate

    image = np.full((1, 3, 3), level, np.float32)
    image[0, 0] *= np.float32(2**stops)
    used = evaluate(image, image, "HDR", applyMagma=False, parameters={})[2]
    found = hdr_flip_exposures(image)
    assert len(found) == (used["numExposures"] if stops else 1)
    assert found[0] == pytest.approx(used["startExposure"], abs=1e-6)
    assert found[-1] == pytest.approx(used["stopExposure"], abs=1e-6)


@pytest.mark.parametrize("size", [(1, 1), (1, 2), (4, 4), (5, 5)])
def test_exposures_end_at_the_upper_median_or_the_least_that_counts(size: tuple[int, int]) -> None:
    from flip_evaluator import evaluate

    image = np.random.default_rng(1).lognormal(0, 2, (*size, 3)).astype(np.float32)
    mostly_black = np.where(np.arange(image.size).reshape(image.shape) < 3, image, 0)
    for reference in (image, mostly_black.astype(np.float32)):
        used = evaluate(reference, reference, "HDR", applyMagma=False, parameters={})[2]
        assert hdr_flip_exposures(reference)[-1] == pytest.approx(used["stopExposure"], abs=1e-6)


def test_errors_above_white_count_though_a_display_clips_them() -> None:
    reference = np.full((24, 24, 3), 4, np.float32)
    reference[:12] = 1.5
    test = reference.copy()
    test[:6] = 3
    whole, _ = score_frame(reference, test, None, ("flip", "hdr_flip"))
    assert whole.flip == 0
    assert whole.hdr_flip is not None and whole.hdr_flip > 0.05
    assert (whole.psnr_db, whole.ssim, whole.vmaf) == (None, None, None)


def test_what_is_not_finite_or_negative_is_replaced() -> None:
    values = [np.nan, np.inf, -np.inf, -3, 1e30, 0.25]
    found = hdr_flip_colour(np.array(values, np.float32).reshape(1, 2, 3))
    assert found.ravel().tolist() == [0, MAX_COLOUR, 0, 0, MAX_COLOUR, 0.25]


@pytest.mark.parametrize("level", [0, 1e-30, 1e-8])
def test_a_black_reference_is_measured_as_it_stands(level: float) -> None:
    """The package's own search ends the process here."""
    black = np.full((20, 20, 4), level, np.float32)
    assert measure_hdr_flip(black, black).value() == 0
    assert measure_hdr_flip(black, black + np.float32(0.5)).value() > 0.3


@settings(derandomize=True, max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.tuples(st.integers(1, 20), st.integers(1, 20)))
def test_no_pixel_makes_it_nan(seed: int, size: tuple[int, int]) -> None:
    rng = np.random.default_rng(seed)
    values = np.array([np.nan, np.inf, -np.inf, 1e30, -1, 65504, 0, 1e-7, 0.5], np.float32)
    reference, test = (rng.choice(values, (*size, 3)) for _ in range(2))
    assert 0 <= measure_hdr_flip(reference, test).value() <= 1
