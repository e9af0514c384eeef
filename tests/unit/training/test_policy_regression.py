"""The linear regression that a policy has to beat."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from exwarp_cli.domain.decision import NODES
from exwarp_cli.policy.outcomes import PENALTIES, choice_rewards
from exwarp_cli.research.training import policy_training
from exwarp_cli.research.training.outcome_tables import PolicyTable
from exwarp_cli.research.training.policy_training import predict_rewards
from tests.unit.training.policy_tables import random_table


@pytest.fixture
def unhindered(monkeypatch):
    """Coefficients cost next to nothing."""
    monkeypatch.setattr(policy_training, "RIDGE", 1e-10)


def linear(table: PolicyTable, seed: int = 0) -> PolicyTable:
    """The table with gains that are linear in the states, at each node by other coefficients."""
    rng = np.random.default_rng(seed)
    slopes, offsets = rng.normal(0, 3, (len(NODES), 44)), rng.normal(0, 5, len(NODES))
    gain = np.einsum("nki,ki->nk", table.states, slopes) + offsets
    outcomes = np.full((len(table), 5, 2, 2), 30.0)
    outcomes[..., 1, 0] += 0.75 * gain
    outcomes[..., 1, 1] += 0.25 * gain  # PSNR and SSIM add up to the gain
    return replace(table, outcomes=outcomes)


def test_linear_rewards_are_found_node_by_node(unhindered):
    known, unseen = linear(random_table(300, 1)), linear(random_table(50, 2))
    wanted = choice_rewards(unseen.outcomes)
    assert wanted.std() > 2
    np.testing.assert_allclose(predict_rewards([known], unseen), wanted, atol=1e-4)


def test_each_node_has_coefficients_of_its_own(unhindered):
    known = linear(random_table(300, 1))
    changed = known.outcomes.copy()
    changed[:, 2] = changed[:, 2, ::-1]
    unseen = random_table(50, 2)
    one = predict_rewards([known], unseen)
    other = predict_rewards([replace(known, outcomes=changed)], unseen)
    for node in range(5):
        assert np.allclose(one[:, node], other[:, node], atol=1e-5) == (node != 2)


def test_the_ridge_draws_predictions_towards_0(monkeypatch):
    known = linear(random_table(300, 1))
    sizes = []
    for ridge in (1e-6, policy_training.RIDGE, 1e4):
        monkeypatch.setattr(policy_training, "RIDGE", ridge)
        sizes.append(float(np.square(predict_rewards([known], known)).sum()))
    assert sizes[0] > sizes[1] > 100 * sizes[2]


def test_a_constant_is_learned_of_states_that_tell_nothing(unhindered):
    table = random_table(200, 3)
    outcomes = np.full((200, 5, 2, 2), 30.0)
    outcomes[:, :, 1, 0] += 2.0
    found = predict_rewards([replace(table, outcomes=outcomes)], random_table(10, 4))
    np.testing.assert_allclose(
        found, np.array([-2.0, 2.0]) + PENALTIES + np.zeros((10, 1, 1)), atol=1e-4
    )


def lonely(table: PolicyTable, rows: np.ndarray) -> PolicyTable:
    """Some rows of a table, each a group of its own: without history, copies have equal states."""
    return replace(
        table,
        groups=tuple(f"key {k}" for k in range(len(rows))),
        group=np.arange(len(rows), dtype=np.int16),
        features=table.features[rows],
        outcomes=table.outcomes[rows],
    )


def test_scenes_count_alike_whatever_their_size():
    """Every row five times is no other scene, only a larger one."""
    one, other = random_table(40, 5), random_table(40, 6)
    once, often = np.arange(40), np.tile(np.arange(40), 5)
    unseen = random_table(50, 7)
    found = predict_rewards([lonely(one, often), lonely(other, once)], unseen)
    wanted = predict_rewards([lonely(one, once), lonely(other, once)], unseen)
    np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-8)
    assert not np.allclose(wanted, predict_rewards([lonely(one, once)], unseen), atol=0.1)
