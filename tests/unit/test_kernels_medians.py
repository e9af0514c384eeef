"""Medians of what counts: the middle of the sorted values."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.kernels.frame_statistics import positive_median


@pytest.mark.parametrize("share", [0.02, 0.5, 1.0])
@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (5, 8), (300, 211)])
@pytest.mark.parametrize("kind", ["noisy", "few", "partly negative"])
def test_it_is_the_middle_of_the_sorted_values(kind, shape, share):
    rng = np.random.default_rng(7)
    values = {
        "noisy": rng.lognormal(2, 1, shape),
        "few": rng.choice([1.0, 2.0, 4.0], shape),
        "partly negative": rng.normal(0.5, 1, shape),
    }[kind].astype(np.float32)
    values.flat[::7] = np.nan
    values.flat[0] = 2
    counted = rng.random(shape) < share
    counted.flat[0] = True
    ranked = sorted(value for value in values[counted].tolist() if value > 0)
    middle = ranked[(len(ranked) - 1) // 2], ranked[len(ranked) // 2]
    assert positive_median(values, counted) == np.float32(sum(middle) / 2)


def test_infinity_counts():
    values = np.array([[1, np.inf, np.inf]], np.float32)
    assert positive_median(values, np.ones(values.shape, bool)) == np.inf


@pytest.mark.parametrize(
    "values", [np.zeros((3, 4)), np.full((3, 4), np.nan), -np.ones((200, 300))]
)
def test_where_nothing_counts_there_is_none(values):
    values = values.astype(np.float32)
    assert np.isnan(positive_median(values, np.ones(values.shape, bool)))
    assert np.isnan(positive_median(np.ones_like(values), np.zeros(values.shape, bool)))
