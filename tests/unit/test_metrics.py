"""Display encoding, PSNR, SSIM, FLIP and the score of a frame."""

from __future__ import annotations

import math
from dataclasses import astuple, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exwarp_cli.domain import metric as metric_names
from exwarp_cli.domain.colour import encode_display
from exwarp_cli.domain.results import Score
from exwarp_cli.metrics import registry
from exwarp_cli.metrics.registry import LINEAR_METRICS, METRICS, score_frame
from tests.reference import quality, scikit


def random_pair(shape: tuple[int, ...], seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Scene-linear pixels with values below 0 and above 1."""
    rng = np.random.default_rng(seed)
    reference = rng.random(shape) * 1.5 - 0.2
    test = reference + rng.normal(0, 0.05, shape)
    return reference.astype(np.float32), test.astype(np.float32)


def test_encode_follows_the_srgb_curve() -> None:
    values = [-1.0, 0.0, 0.001, 0.0031308, 0.0032, 0.18, 0.5, 0.999, 1.0, 7.5]
    pixels = np.array(values, np.float32).reshape(2, 5, 1).repeat(3, axis=2)
    expected = np.array([quality.srgb_255(v) for v in values]).reshape(2, 5, 1).repeat(3, axis=2)
    np.testing.assert_allclose(encode_display(pixels), expected, rtol=0, atol=1e-4)


def test_encode_reaches_both_ends_exactly_and_does_not_quantise() -> None:
    pixels = np.array([[[0, 1, 0.2]]], np.float32)
    black, white, grey = encode_display(pixels)[0, 0]
    assert (black, white) == (0, 255)
    assert grey != round(float(grey))


def test_encode_replaces_what_is_not_finite_and_drops_alpha() -> None:
    pixels = np.array([[[np.nan, np.inf, -np.inf, np.nan]]], np.float32)
    assert encode_display(pixels).tolist() == [[[0, 255, 0]]]
    assert np.isnan(pixels[0, 0, 0]), "the caller's pixels must stay as they are"


@settings(derandomize=True, max_examples=30)
@given(st.integers(0, 10_000), st.integers(1, 20), st.integers(1, 20))
def test_psnr_equals_the_formula(seed: int, height: int, width: int) -> None:
    reference, test = (encode_display(pixels) for pixels in random_pair((height, width, 3), seed))
    measured = registry.measure_psnr(reference, test)
    assert measured.value() == pytest.approx(quality.psnr_db(reference, test), abs=1e-9)
    mask = np.random.default_rng(seed).random((height, width)) < 0.5
    mask[0, 0] = True
    inside = quality.psnr_db(reference[mask], test[mask])
    assert measured.value(mask) == pytest.approx(inside, abs=1e-9)


def test_psnr_of_black_against_white_is_zero_and_of_equals_the_cap() -> None:
    black, white = np.zeros((4, 4, 3), np.float32), np.full((4, 4, 3), 255, np.float32)
    assert registry.measure_psnr(black, white).value() == pytest.approx(0)
    assert registry.measure_psnr(white, white).value() == 100
    assert registry.measure_psnr(white, white - np.float32(1e-3)).value() == 100
    assert registry.measure_psnr(white, white - np.float32(1)).value() == pytest.approx(
        48.1308, abs=1e-4
    )


@pytest.mark.parametrize("shape", [(11, 11, 3), (40, 60, 3)])
def test_ssim_equals_scikit_image(shape: tuple[int, ...]) -> None:
    reference, test = (encode_display(pixels) for pixels in random_pair(shape))
    expected, full = scikit.ssim(reference, test)
    measured = registry.measure_ssim(reference, test)
    assert measured.value() == pytest.approx(expected, abs=1e-6)
    mask = np.zeros(shape[:2], bool)
    mask[:3, :4] = True  # in the margin that the overall mean leaves out
    assert measured.value(mask) == pytest.approx(full[mask].mean(), abs=1e-6)


@pytest.mark.parametrize("shape", [(10, 30, 3), (3, 3, 3), (1, 1, 3)])
def test_ssim_of_a_small_image_is_the_mean_of_the_whole_map(shape: tuple[int, ...]) -> None:
    reference, test = (encode_display(pixels) for pixels in random_pair(shape))
    expected = quality.ssim_map(reference, test).mean()
    assert registry.measure_ssim(reference, test).value() == pytest.approx(expected, abs=1e-6)


def test_flip_is_the_evaluators_own_mean_at_67_ppd() -> None:
    from flip_evaluator import evaluate

    reference, test = (encode_display(pixels) for pixels in random_pair((48, 64, 3)))
    fault, mean, _ = evaluate(reference / 255, test / 255, "LDR", True, False, True, {"ppd": 67.02})
    measured = registry.measure_flip(reference, test)
    assert measured.value() == pytest.approx(mean, abs=1e-5)
    mask = np.zeros((48, 64), bool)
    mask[10:20, 30:50] = True
    assert measured.value(mask) == pytest.approx(fault[mask].mean(), abs=1e-5)


def test_flip_ends() -> None:
    black, white = np.zeros((32, 32, 3), np.float32), np.full((32, 32, 3), 255, np.float32)
    assert registry.measure_flip(white, white).value() == 0
    assert registry.measure_flip(black, white).value() > 0.9


def test_score_of_equal_images() -> None:
    reference, _ = random_pair((20, 20, 4))
    overall, inside = score_frame(reference, reference.copy(), np.ones((20, 20), bool))
    assert astuple(overall) == (100, 1, 0, None, None, None, 0)
    assert inside == replace(overall, pulse=None), "of whole frames only"


def test_score_in_a_mask_sees_the_mask_alone() -> None:
    reference, _ = random_pair((64, 64, 3))
    test = reference.copy()
    test[:8, :8] = 0
    mask = np.zeros((64, 64), bool)
    mask[:8, :8] = True
    overall, inside = score_frame(reference, test, mask)
    assert inside is not None
    assert inside.psnr_db < overall.psnr_db
    assert inside.ssim < overall.ssim
    assert inside.flip > overall.flip
    shown, judged = encode_display(reference), encode_display(test)
    assert inside.psnr_db == pytest.approx(quality.psnr_db(shown[:8, :8], judged[:8, :8]), abs=1e-9)
    everything = score_frame(reference, test, np.ones((64, 64), bool))[1]
    assert everything is not None
    assert everything.psnr_db == pytest.approx(overall.psnr_db, abs=1e-9)
    assert everything.flip == pytest.approx(overall.flip, abs=1e-9)


@pytest.mark.parametrize("mask", [None, np.zeros((12, 12), bool)])
def test_score_without_holes_has_no_second_part(mask: np.ndarray | None) -> None:
    reference, test = random_pair((12, 12, 3))
    assert score_frame(reference, test, mask)[1] is None


def test_score_ignores_alpha() -> None:
    reference, test = random_pair((12, 12, 4))
    assert score_frame(reference, test, None) == score_frame(
        reference[..., :3], test[..., :3], None
    )


def test_the_metrics_are_named_as_the_fields_of_a_score() -> None:
    overall, _ = score_frame(*random_pair((12, 12, 3)), None)
    known = [metric.field for metric in metric_names.METRICS]
    assert list(vars(overall)) == known
    assert {*METRICS, *LINEAR_METRICS, "pulse", "vmaf", "flicker"} == set(known)
    assert (*METRICS, "pulse") == metric_names.DEFAULT_METRICS


def test_only_what_is_named_is_measured() -> None:
    reference, test = random_pair((12, 12, 3))
    mask = np.ones((12, 12), bool)
    whole = score_frame(reference, test, mask, [metric.field for metric in metric_names.METRICS])
    for name in (*METRICS, *LINEAR_METRICS):
        for part, everything in zip(score_frame(reference, test, mask, [name]), whole, strict=True):
            known = {field: value for field, value in vars(part).items() if value is not None}
            assert known == {name: getattr(everything, name)}
    assert score_frame(reference, test, mask, []) == (Score(), Score())


@settings(derandomize=True, max_examples=30)
@given(st.integers(0, 10_000), st.tuples(st.integers(1, 24), st.integers(1, 24)))
def test_no_pixel_makes_a_score_nan(seed: int, size: tuple[int, int]) -> None:
    rng = np.random.default_rng(seed)
    broken = np.array([np.nan, np.inf, -np.inf, 1e30, -1e30, 65504, 0, 0.5, 1], np.float32)
    reference = rng.choice(broken, (*size, 4))
    test = rng.choice(broken, (*size, 4))
    for part in score_frame(reference, test, rng.random(size) < 0.3):
        if part is not None:
            values = (part.psnr_db, part.ssim, part.flip)
            assert all(math.isfinite(value) for value in values)
            assert 0 <= part.psnr_db <= 100
            assert -1.000001 <= part.ssim <= 1.000001
            assert 0 <= part.flip <= 1
