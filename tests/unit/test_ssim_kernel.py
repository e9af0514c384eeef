"""The SSIM map against scikit-image, a naive twin, itself in other builds, and known cases."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exwarp_cli.kernels._row_bands import set_threads
from exwarp_cli.kernels.picture_errors import ssim_map
from tests.reference import quality, scikit

ROOT = Path(__file__).parents[2]


def random_pair(
    shape: tuple[int, ...], seed: int = 0, noise: float = 20.0
) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    reference = rng.random(shape) * 255
    test = np.clip(reference + rng.normal(0, noise, shape), 0, 255)
    return reference.astype(np.float32), test.astype(np.float32)


@pytest.mark.parametrize("shape", [(11, 11, 3), (11, 40, 1), (37, 16, 3), (64, 81, 4)])
def test_equals_scikit_image(shape: tuple[int, ...]) -> None:
    reference, test = random_pair(shape)
    np.testing.assert_allclose(
        ssim_map(reference, test), scikit.ssim(reference, test)[1], rtol=0, atol=1e-6
    )


def test_equals_scikit_image_where_variances_cancel() -> None:
    # Bright and nearly flat: a window's variance is the small difference of large numbers.
    rng = np.random.default_rng(3)
    reference = (250 + rng.random((40, 40, 3))).astype(np.float32)
    test = (250 + rng.random((40, 40, 3))).astype(np.float32)
    np.testing.assert_allclose(
        ssim_map(reference, test), scikit.ssim(reference, test)[1], rtol=0, atol=1e-6
    )


@pytest.mark.parametrize("shape", [(1, 1, 3), (1, 20, 1), (3, 2, 3), (6, 11, 3), (15, 14, 2)])
def test_equals_naive_twin(shape: tuple[int, ...]) -> None:
    reference, test = random_pair(shape, seed=1)
    np.testing.assert_allclose(
        ssim_map(reference, test), quality.ssim_map(reference, test), rtol=0, atol=1e-6
    )


@pytest.mark.parametrize("height", [1, 15, 16, 17, 50])
def test_serial_and_parallel_agree(height: int) -> None:
    reference, test = random_pair((height, 23, 3), seed=2)
    set_threads(1)
    try:
        serial = ssim_map(reference, test)
    finally:
        set_threads(None)
    assert np.array_equal(serial, ssim_map(reference, test))


def test_interpreted_and_compiled_agree(tmp_path: Path) -> None:
    reference, test = random_pair((18, 13, 3), seed=4)
    source, target = tmp_path / "pair.npy", tmp_path / "map.npy"
    np.save(source, np.stack([reference, test]))
    code = (
        "import sys, numpy as np\n"
        "from exwarp_cli.kernels.picture_errors import ssim_map\n"
        "pair = np.load(sys.argv[1])\n"
        "np.save(sys.argv[2], ssim_map(pair[0], pair[1]))\n"
    )
    subprocess.run(
        [sys.executable, "-W", "error", "-c", code, str(source), str(target)],
        check=True,
        cwd=ROOT,
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
    )
    assert np.array_equal(np.load(target), ssim_map(reference, test))


def test_views_are_taken() -> None:
    reference, test = random_pair((30, 20, 4), seed=5)
    plain = ssim_map(np.ascontiguousarray(reference[..., :3]), np.ascontiguousarray(test[..., :3]))
    assert np.array_equal(ssim_map(reference[..., :3], test[..., :3]), plain)


@settings(derandomize=True, max_examples=40)
@given(
    st.tuples(st.integers(1, 30), st.integers(1, 30), st.integers(1, 4)),
    st.integers(0, 1000),
    st.floats(0, 200),
)
def test_properties(shape: tuple[int, int, int], seed: int, noise: float) -> None:
    reference, test = random_pair(shape, seed, noise)
    found = ssim_map(reference, test)
    assert found.dtype == np.float32
    assert found.shape == shape
    assert np.isfinite(found).all()
    assert found.max() <= 1 + 1e-6
    assert found.min() >= -1 - 1e-6
    assert (ssim_map(reference, reference) == 1).all()
    np.testing.assert_allclose(found, ssim_map(test, reference), rtol=0, atol=1e-7)
    np.testing.assert_allclose(
        ssim_map(reference[::-1, ::-1], test[::-1, ::-1])[::-1, ::-1], found, rtol=0, atol=1e-6
    )


@pytest.mark.parametrize(("a", "b"), [(0, 0), (0, 255), (255, 255), (100, 150)])
def test_constant_images(a: float, b: float) -> None:
    # Without variance only the luminance term is left.
    c1 = (0.01 * 255) ** 2
    expected = (2 * a * b + c1) / (a * a + b * b + c1)
    found = ssim_map(np.full((20, 20, 3), a, np.float32), np.full((20, 20, 3), b, np.float32))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
