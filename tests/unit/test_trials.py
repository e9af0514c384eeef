"""What the gate decides by: a trial as text, and errors of tiles."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.domain.decision import Trial
from exwarp_cli.pipeline.gate import mean_tile_psnr

HEIGHT, WIDTH = 144, 256


@pytest.mark.parametrize(
    "trial", [Trial(), Trial.measured(1005, 34.20114, 34.3), Trial.measured(-3, 0.0, 100.0)]
)
def test_a_trial_is_read_as_it_was_written(trial: Trial) -> None:
    assert Trial.parsed(trial.text) == trial


@pytest.mark.parametrize("text", ["", "1005", "1005 34.2", "a 34.2 34.3", "1005 nan 34.3"])
def test_other_text_is_refused(text: str) -> None:
    with pytest.raises(ValueError):
        Trial.parsed(text)


def test_a_network_pays_where_it_is_better_as_written() -> None:
    assert Trial.measured(2, 30.0, 30.1).pays
    assert not Trial.measured(2, 30.0, 30.00004).pays
    assert not Trial.measured(2, 30.1, 30.0).pays
    assert not Trial().pays


def test_every_tile_counts_alike() -> None:
    """One that is mended does not make up for all others that are harmed."""
    warped = np.full((HEIGHT, WIDTH), 4.0)
    warped[:8, :8] = 10_000.0
    network = np.full((HEIGHT, WIDTH), 6.0)
    assert network.mean() < warped.mean()
    assert mean_tile_psnr(network) < mean_tile_psnr(warped)


def test_of_even_errors_it_is_the_psnr_of_the_frame() -> None:
    expected = 10 * np.log10(255**2 / (24.0 + 1.0))
    for shape in ((HEIGHT, WIDTH), (37, 61), (5, 3)):
        assert mean_tile_psnr(np.full(shape, 24.0)) == pytest.approx(expected)
