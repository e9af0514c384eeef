"""Medians of what counts: those of numpy, whatever the samples tell."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.kernels import frame_statistics
from exwarp_cli.kernels.frame_statistics import SAMPLES, positive_median


def numpys(values: np.ndarray, shown: np.ndarray) -> float:
    return float(np.median(values[shown & (values > 0)]))


def values_of(kind: str, shape: tuple[int, int]) -> np.ndarray:
    rng = np.random.default_rng(7)
    made = {
        "smooth": np.linspace(1, 50, shape[0] * shape[1]).reshape(shape),
        "noisy": rng.lognormal(2, 1, shape),
        "few": rng.choice([1.0, 2.0, 4.0], shape),
        "one": np.full(shape, 3.25),
        "partly negative": rng.normal(0.5, 1, shape),
        "a value apart": np.where(rng.random(shape) < 0.5, 1.0, 9.0),
    }[kind]
    return made.astype(np.float32)


@pytest.mark.parametrize("share", [0.02, 0.5, 1.0])
@pytest.mark.parametrize("shape", [(1, 1), (5, 8), (300, 211), (300, 500)])
@pytest.mark.parametrize(
    "kind", ["smooth", "noisy", "few", "one", "partly negative", "a value apart"]
)
def test_it_is_numpys(kind, shape, share):
    values = values_of(kind, shape)
    values.flat[::7] = np.nan
    values.flat[0] = 2
    shown = np.random.default_rng(1).random(shape) < share
    shown.flat[0] = True
    for size in (values.size, values.size - 1):  # an odd number of them, and an even one
        one, other = values.ravel()[:size], shown.ravel()[:size]
        if size:
            assert positive_median(one[None], other[None]) == numpys(one, other)


def test_samples_that_mislead_do_not_matter():
    """Where every value that is sampled lies far above all others, and far below."""
    values = np.random.default_rng(2).uniform(10, 20, (64, SAMPLES // 8)).astype(np.float32)
    step = values.size // SAMPLES
    assert step > 1
    everything = np.ones(values.shape, bool)
    for misleading in (1.0, 1000.0):
        values.flat[::step] = misleading
        assert positive_median(values, everything) == numpys(values, everything)


@pytest.mark.parametrize(
    "values", [np.zeros((3, 4)), np.full((3, 4), np.nan), -np.ones((200, 300))]
)
def test_where_nothing_counts_there_is_none(values):
    values = values.astype(np.float32)
    assert np.isnan(positive_median(values, np.ones(values.shape, bool)))
    assert np.isnan(positive_median(np.ones_like(values), np.zeros(values.shape, bool)))


def test_most_values_are_left_where_they_are(monkeypatch):
    counts = []
    true = frame_statistics.pick_between
    monkeypatch.setattr(
        frame_statistics, "pick_between", lambda *a: (true(*a), counts.append(a[-1]))
    )
    values = values_of("noisy", (400, 500))
    positive_median(values, np.ones(values.shape, bool))
    total, _, count = counts[0].sum(axis=0)
    assert total == values.size and count < 0.1 * total
