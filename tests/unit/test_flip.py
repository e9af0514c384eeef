"""FLIP: a float64 twin, the authors' own package, and cases that are known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exwarp_cli.domain.colour import encode_display
from exwarp_cli.io.frames import read_image
from exwarp_cli.kernels._compile import kernel
from exwarp_cli.kernels.picture_errors import power
from exwarp_cli.metrics import registry
from tests.reference import flip as naive

Pair = tuple[np.ndarray, np.ndarray]
Size = tuple[int, int]

MARKET = Path(__file__).parents[2] / "examples" / "market"

SIZES = [(40, 60), (1, 1), (3, 200), (200, 3), (1, 30), (21, 20)]


def shown(size: Size, seed: int = 0, noise: float = 30.0) -> Pair:
    rng = np.random.default_rng(seed)
    reference = rng.random((*size, 3)) * 255
    test = np.clip(reference + rng.normal(0, noise, reference.shape), 0, 255)
    return reference.astype(np.float32), test.astype(np.float32)


def linear(size: Size, seed: int = 0) -> Pair:
    """Up to about 1000, a third of the channels exactly 0."""
    rng = np.random.default_rng(seed)
    reference = np.minimum(rng.lognormal(0, 2, (*size, 3)), 1000)
    reference[rng.random(reference.shape) < 0.3] = 0
    test = reference * rng.lognormal(0, 0.2, reference.shape)
    return reference.astype(np.float32), test.astype(np.float32)


def spots(reference: np.ndarray, row: int, column: int, colour: tuple[int, ...]) -> np.ndarray:
    test = reference.copy()
    test[row, column] = colour
    return test


def judge(found: np.ndarray, expected: np.ndarray, atol: float = 1e-4, mean: float = 1e-5) -> None:
    apart = np.abs(found - expected)
    assert found.shape == expected.shape
    assert apart.max() <= atol
    assert apart.mean() <= mean


def package(reference: np.ndarray, test: np.ndarray, kind: str) -> np.ndarray:
    from flip_evaluator import evaluate

    scale = np.float32(1 / 255 if kind == "LDR" else 1)
    pair = reference * scale, test * scale
    return evaluate(*pair, kind, applyMagma=False, computeMeanError=False, parameters={})[0][..., 0]


def by_package(kind: str) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    return lambda reference, test: package(reference, test, kind)


LDR = pytest.mark.parametrize(
    "oracle", [naive.ldr_flip, by_package("LDR")], ids=["twin", "authors"]
)
HDR = pytest.mark.parametrize(
    "oracle", [naive.hdr_flip, by_package("HDR")], ids=["twin", "authors"]
)


@LDR
@pytest.mark.parametrize("size", SIZES)
def test_ldr_flip_of_noise(size: Size, oracle) -> None:
    pair = shown(size)
    judge(
        registry.measure_flip(*pair).per_pixel, oracle(*pair), mean=1e-5 if min(size) > 1 else 1e-4
    )


@HDR
@pytest.mark.parametrize("size", SIZES)
def test_hdr_flip_of_values_to_1000_and_zeros(size: Size, oracle) -> None:
    pair = linear(size)
    judge(
        registry.measure_hdr_flip(*pair).per_pixel,
        oracle(*pair),
        mean=1e-5 if min(size) > 1 else 1e-4,
    )


def test_rendered_frames() -> None:
    images = [read_image(path).pixels for path in sorted(MARKET.glob("keys/*.exr"))[:2]]
    pair = [image[..., :3].astype(np.float32) for image in images]
    judge(
        registry.measure_hdr_flip(*pair).per_pixel,
        package(*map(registry.hdr_flip_colour, pair), "HDR"),
    )
    encoded = [encode_display(image) for image in pair]
    judge(registry.measure_flip(*encoded).per_pixel, package(*encoded, "LDR"))


@pytest.mark.parametrize("colour", [(255, 255, 255), (255, 0, 0), (0, 255, 0), (0, 0, 255)])
@pytest.mark.parametrize("place", [(20, 17), (0, 0), (40, 39)])
def test_one_pixel_shows_the_filters_and_what_lies_outside(colour, place) -> None:
    grey = np.full((41, 40, 3), 60, np.float32)
    test = spots(grey, *place, colour)
    judge(registry.measure_flip(grey, test).per_pixel, naive.ldr_flip(grey, test), atol=2e-4)
    # The package's own float32 is coarser where almost nothing changes.
    judge(
        registry.measure_flip(grey, test).per_pixel,
        package(grey, test, "LDR"),
        atol=1e-3,
        mean=3e-5,
    )


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [((0, 0, 0), (0, 0, 0), 0), ((7, 90, 200), (7, 90, 200), 0), ((0, 255, 0), (0, 0, 255), 1)],
)
def test_plain_colours(one, other, expected: float) -> None:
    pair = (np.full((30, 20, 3), colour, np.float32) for colour in (one, other))
    np.testing.assert_allclose(registry.measure_flip(*pair).per_pixel, expected, rtol=0, atol=1e-4)


@settings(derandomize=True, max_examples=25, deadline=None)
@given(st.tuples(st.integers(1, 40), st.integers(1, 40)), st.integers(0, 999), st.floats(0, 200))
def test_properties(size: Size, seed: int, noise: float) -> None:
    reference, test = shown(size, seed, noise)
    found = registry.measure_flip(reference, test).per_pixel
    assert found.dtype == np.float32
    assert found.min() >= 0 and found.max() <= 1
    assert not registry.measure_flip(test, test.copy()).per_pixel.any()
    np.testing.assert_array_equal(found, registry.measure_flip(test, reference).per_pixel)
    mirrored = registry.measure_flip(reference[::-1, ::-1], test[::-1, ::-1]).per_pixel[::-1, ::-1]
    np.testing.assert_allclose(mirrored, found, rtol=0, atol=2e-4)
    turned = registry.measure_flip(reference.swapaxes(0, 1), test.swapaxes(0, 1)).per_pixel.T
    np.testing.assert_allclose(turned, found, rtol=0, atol=2e-4)


def test_values_outside_are_clipped_and_alpha_is_left_out() -> None:
    reference, test = shown((20, 30), noise=150)
    outside = np.where(test >= 255, 400, np.where(test <= 0, -80, test)).astype(np.float32)
    assert (outside != test).any()
    wide = np.dstack([outside, np.full((20, 30), 9, np.float32)])
    expected = registry.measure_flip(reference, test).per_pixel
    np.testing.assert_array_equal(registry.measure_flip(reference, wide).per_pixel, expected)


@kernel
def raised(bases: np.ndarray, exponent: np.float32, out: np.ndarray) -> None:
    for i in range(bases.size):
        out[i] = power(bases[i], exponent)


@pytest.mark.parametrize("exponent", [0, 0.01, 1 / 3, 0.7, 1, 2.4])
def test_powers(exponent: float) -> None:
    rng = np.random.default_rng(0)
    bases = np.concatenate([rng.random(1000), np.exp2(rng.uniform(-50, 50, 1000)), [1, 0.5, 2]])
    bases = bases.astype(np.float32)
    out = np.empty_like(bases)
    raised(bases, np.float32(exponent), out)
    expected = bases.astype(np.float64) ** np.float64(np.float32(exponent))
    np.testing.assert_allclose(out, expected, rtol=1e-5)
    near = bases > 1e-6
    np.testing.assert_allclose(out[near & (bases <= 2)], expected[near & (bases <= 2)], rtol=4e-6)
    assert out[bases == 1].tolist() == [1]


def test_powers_of_zero_are_zero() -> None:
    out = np.ones(3, np.float32)
    raised(np.array([0, 1e-40, 1e-31], np.float32), np.float32(0.7), out)
    assert out.tolist() == [0, 0, 0]
