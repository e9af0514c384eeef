"""Cells have the mean square root of luminance of their pixels."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.synthesis.cut_detection import mean_light


def naive(pixels, rows, columns, points):
    chosen = pixels[np.maximum(rows, 0)][:, np.maximum(columns, 0), :3].astype(np.float64)
    with np.errstate(all="ignore"):
        light = np.nan_to_num(chosen @ [0.2126, 0.7152, 0.0722], nan=0, posinf=1e4, neginf=0)
    outside = (rows < 0)[:, None] | (columns < 0)[None, :]
    roots = np.sqrt(np.where(outside, 0, np.clip(light, 0, 1e4)))
    return roots.reshape(len(rows) // points, points, -1, points).mean(axis=(1, 3))


@pytest.mark.parametrize("points", [1, 2, 4])
@pytest.mark.parametrize("channels", [3, 4])
def test_cells_are_the_mean_of_their_pixels(channels, points):
    rng = np.random.default_rng(points)
    pixels = rng.exponential(2, (40, 56, channels)).astype(np.float32)
    pixels[rng.random((40, 56)) < 0.1] = np.nan
    pixels[rng.random((40, 56)) < 0.1] = np.inf
    pixels[rng.random((40, 56)) < 0.1] = -1
    rows, columns = rng.integers(-9, 40, 5 * points), rng.integers(-9, 56, 7 * points)
    found = mean_light(pixels, rows, columns, points)
    expected = naive(pixels, rows, columns, points)
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    assert np.isfinite(found).all() and found.any()
