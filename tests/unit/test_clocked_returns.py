"""Returns of what slots really show: offline those of `outcomes`, and one interval by hand."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.policy.outcomes import clocked_returns, path_returns, slot_quality

SHOWN = np.array(
    [
        [20, 40, 30],  # S1: F, E(F), E(F) again
        [20, 40, 31],  # S2: F, E(F), W(E(F))
        [30, 25, 22],  # S3: W(F), and again: E(F) is late, and E(P1) finds the engine busy
        [30, 25, 28],  # S4: W(F), and again, W
        [30, 29, 24],  # S5: W, W, and again: E(P1) is late
        [30, 29, 28],  # S6: W, W, W
    ],
    np.float64,
)
"""PSNR of slots 1 to 3 where E takes two slots."""

DROPPED = [2, 1, 2, 1, 1, 0]


@pytest.mark.parametrize("seed", range(3))
def test_offline_they_are_those_of_the_decision_tree(seed):
    outcomes = np.random.default_rng(seed).uniform(15, 45, (5, 2, 2))
    offline = [2, 1, 0, 0, 0, 0]
    np.testing.assert_allclose(
        clocked_returns(slot_quality(outcomes), offline), path_returns(outcomes)
    )


def test_late_frames_cost_alpha_and_quality():
    found = clocked_returns(np.stack([SHOWN, 0 * SHOWN], axis=-1), DROPPED)
    expected = [
        (20 - 30) + (30 - 31) - 0.2,
        (20 - 30) + (31 - 30) - 0.1,
        (30 - 20) + (25 - 29) + (22 - 28) - 0.2,
        (30 - 20) + (25 - 29) + (28 - 22) - 0.1,
        (30 - 20) + (29 - 25) + (24 - 28) - 0.1,
        (30 - 20) + (29 - 25) + (28 - 24),
    ]
    assert found.tolist() == pytest.approx(expected)
