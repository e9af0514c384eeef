"""How well many displacements explain what samples of a frame show."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.synthesis.calibration_samples import Observable, Probe
from tests.reference import lookup as naive

SHAPE = (9, 12)


def case(channels: int, seed: int = 5):
    """Samples, three displacements of each, an image with holes, what is wanted, tolerances."""
    rng = np.random.default_rng(seed)
    image = rng.lognormal(0, 2, (*SHAPE, channels)).astype(np.float32)
    image[3, 4], image[6, 2] = np.nan, np.inf
    xy = np.stack([rng.integers(0, 12, 150), rng.integers(0, 9, 150)], axis=1).astype(np.float64)
    shifts = rng.normal(0, 3, (3, 150, 2)).astype(np.float32)
    shifts[0, :40], shifts[1, :5] = 0, np.nan
    wanted, tolerance = rng.lognormal(0, 2, (150, channels)), rng.uniform(0, 9, 150)
    tolerance[50:60] = 0
    return xy, shifts, image, wanted, tolerance


@pytest.mark.parametrize("channels", [1, 2, 3])
def test_errors_equal_the_naive_twins_in_every_bit(channels):
    xy, shifts, image, wanted, tolerance = case(channels)
    observable = Observable(wanted, image, tolerance, 1.0)
    errors = Probe(xy, np.zeros((150, 2), np.float32), (observable,), resting=True).errors(shifts)
    for error, shift in zip(errors, shifts, strict=True):
        found = naive.look_up(image, xy + shift.astype(np.float64))
        losses = naive.misses(found, wanted, tolerance)
        assert error == losses.mean() and (losses < 1).any() and (losses == 1).any()


def test_observables_count_by_their_weight():
    xy, shifts, image, wanted, tolerance = case(3)
    parts = Observable(wanted, image, tolerance, 1.0), Observable(wanted + 1, image, tolerance, 3.0)
    raw = np.zeros((150, 2), np.float32)
    first, second = (Probe(xy, raw, (part,)).errors(shifts) for part in parts)
    both = Probe(xy, raw, parts).errors(shifts)
    np.testing.assert_allclose(both, (first + 3 * second) / 4)
    assert (first != second).any()
