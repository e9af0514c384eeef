"""Deep Q-learning on tables whose best choices are known."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
import torch

from exwarp_cli.accelerator.mlp import PAPER_SIZES
from exwarp_cli.domain.decision import CHOICES, EXTRAPOLATE, NODES, PATHS, WARP
from exwarp_cli.policy.outcomes import best_return, choice_rewards, path_returns
from exwarp_cli.policy.state import INPUTS
from exwarp_cli.research.training.outcome_tables import PolicyTable
from exwarp_cli.research.training.policy_training import (
    greedy_paths,
    predict_rewards,
)
from exwarp_cli.research.training.q_learning import (
    AFTER,
    Layers,
    compress_gain,
    expand_value,
    make_network,
    q_values,
    train_decisions,
)
from exwarp_cli.research.training.training_settings import PolicySettings
from tests.unit.training.policy_tables import tempting

SETTINGS = PolicySettings(steps=250, batch=96, rate=3e-3, lag=25, seed=3)
KNOWN, UNSEEN = tempting(300, 1), tempting(200, 2)


@functools.cache
def learned(**changes: object) -> Layers:
    return train_decisions([KNOWN], replace(SETTINGS, **changes))


def mean_return(found: np.ndarray, table: PolicyTable = UNSEEN) -> float:
    """Mean return of the paths that values [N, 5, 2] lead to."""
    return float(path_returns(table.outcomes)[np.arange(len(table)), greedy_paths(found)].mean())


def part_of(table: PolicyTable, rows: list[int]) -> PolicyTable:
    return replace(
        table,
        group=table.group[rows],
        features=table.features[rows],
        outcomes=table.outcomes[rows],
    )


def bounds(table: PolicyTable = UNSEEN) -> tuple[float, float]:
    """Mean return of the best path throughout, and of the best path of every interval."""
    every = path_returns(table.outcomes)
    return float(every.mean(axis=0).max()), float(every.max(axis=1).mean())


def test_it_closes_the_gap_between_a_fixed_path_and_the_oracle():
    fixed, oracle = bounds()
    assert oracle - fixed > 1  # else there were nothing to learn
    found = mean_return(q_values(learned(), UNSEEN))
    assert found > fixed + 0.9 * (oracle - fixed)


def test_it_takes_the_first_step_that_looks_worse():
    first = q_values(learned(), UNSEEN)[:, NODES.index("d1")]
    leads = path_returns(UNSEEN.outcomes).max(axis=1) > 2
    assert 0.3 < leads.mean() < 0.7
    assert ((first[:, 0] > first[:, 1]) == leads).mean() > 0.97


def test_looking_at_the_next_reward_only_fails():
    """The reward at d1 speaks for E in every row, and so does a policy that looks no further."""
    fixed, oracle = bounds()
    greedy = q_values(learned(discount=0.0), UNSEEN)
    for found in (predict_rewards([KNOWN], UNSEEN), greedy):
        assert (found[:, 0, 1] > found[:, 0, 0]).all()
        assert mean_return(found) < fixed + 0.1 * (oracle - fixed)
    # What comes next does not matter to it; what each choice earns at once, it does know.
    gain = torch.from_numpy(choice_rewards(UNSEEN.outcomes))
    wanted = compress_gain(gain).numpy()
    assert np.abs(greedy - wanted).mean() < 0.15


def test_without_a_fresh_target_nothing_is_foreseen():
    """A target that is never copied tells of fresh weights: values of the future near 0."""
    stale = q_values(learned(lag=10**6), UNSEEN)
    fresh = q_values(learned(), UNSEEN)
    leads = path_returns(UNSEEN.outcomes).max(axis=1) > 2
    warping = stale[leads, 0, 0].mean(), fresh[leads, 0, 0].mean()
    assert warping[0] < 0 < 1 < warping[1]
    assert mean_return(stale) < mean_return(fresh) - 1


def test_values_are_discounted_returns():
    found = expand_value(torch.from_numpy(q_values(learned(), UNSEEN))).numpy()
    gain = choice_rewards(UNSEEN.outcomes)
    exact = np.zeros_like(gain)
    for n in reversed(range(len(NODES))):
        for c in range(len(CHOICES)):
            after = int(AFTER[n, c])
            ahead = exact[:, after].max(axis=-1) if after >= 0 else 0.0
            exact[:, n, c] = gain[:, n, c] + SETTINGS.discount * ahead
    assert exact[:, 0].max() == pytest.approx(-1 + 0.95 * (3 + 0.95 * 3))
    gap = np.abs(found - exact)
    assert gap.mean() < 0.35 and np.median(gap) < 0.2


def test_the_same_seed_gives_the_same_weights():
    short = replace(SETTINGS, steps=8, lag=3)
    one, two = train_decisions([KNOWN], short), train_decisions([KNOWN], short)
    other, longer = (
        train_decisions([KNOWN], replace(short, seed=4)),
        train_decisions([KNOWN], replace(short, steps=9)),
    )
    for k, (weights, biases) in enumerate(one):
        assert weights.shape == PAPER_SIZES[k : k + 2][::-1]
        assert biases.shape == (PAPER_SIZES[k + 1],)
        assert weights.dtype == biases.dtype == np.float64
        np.testing.assert_array_equal(weights, two[k][0])
        np.testing.assert_array_equal(biases, two[k][1])
        for different in (other, longer):
            assert (weights != different[k][0]).mean() > 0.9
    assert len(one) == 4


def test_the_number_of_threads_is_left_alone():
    threads = torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        found = train_decisions([KNOWN], replace(SETTINGS, steps=2))
        assert torch.get_num_threads() == 3
        torch.set_num_threads(1)
        np.testing.assert_array_equal(
            train_decisions([KNOWN], replace(SETTINGS, steps=2))[1][0], found[1][0]
        )
    finally:
        torch.set_num_threads(threads)


def test_how_often_the_target_is_copied_matters():
    short = replace(SETTINGS, steps=6)
    often, seldom = (train_decisions([KNOWN], replace(short, lag=lag)) for lag in (1, 5))
    never = train_decisions([KNOWN], replace(short, lag=6))
    assert not np.array_equal(often[0][0], seldom[0][0])
    assert not np.array_equal(seldom[0][0], never[0][0])
    np.testing.assert_array_equal(
        never[0][0], train_decisions([KNOWN], replace(short, lag=60))[0][0]
    )


def test_scenes_count_alike_whatever_their_size():
    """A row that contradicts four hundred, as a scene of its own, is half of what is seen."""
    row = int(np.argmax(path_returns(KNOWN.outcomes).max(axis=1)))
    many = part_of(KNOWN, [row] * 400)
    turned = part_of(KNOWN, [row])
    turned = replace(turned, outcomes=turned.outcomes[:, :, ::-1])
    found = q_values(
        train_decisions([many, turned], replace(SETTINGS, steps=60, discount=0.0)), turned
    )
    one, other = (
        compress_gain(torch.from_numpy(choice_rewards(scene.outcomes[:1]))).numpy()
        for scene in (many, turned)
    )
    assert np.abs(one - other).max() > 2.5
    np.testing.assert_allclose(found, (one + other) / 2, atol=0.3)


def test_what_comes_after_a_choice_is_the_tree():
    for path in PATHS.values():
        steps = list(path.choices.items())
        for (node, choice), following in zip(steps, [*steps[1:], None], strict=True):
            found = int(AFTER[NODES.index(node), CHOICES.index(choice)])
            assert found == (-1 if following is None else NODES.index(following[0]))
    assert AFTER.tolist() == [[1, 2], [4, 3], [-1, -1], [-1, -1], [-1, -1]]
    assert CHOICES == (WARP, EXTRAPOLATE)


def test_compression_keeps_order_and_is_undone():
    gains = torch.linspace(-40, 40, 4001, dtype=torch.float64)
    small = compress_gain(gains)
    assert (small.diff() > 0).all()
    torch.testing.assert_close(expand_value(small), gains)
    torch.testing.assert_close(compress_gain(expand_value(small)), small)
    torch.testing.assert_close(compress_gain(-gains), -small)
    assert float(compress_gain(torch.tensor(np.e - 1))) == pytest.approx(1)
    assert float(compress_gain(torch.tensor(0.0))) == float(expand_value(torch.tensor(0.0))) == 0
    assert float(small[-1]) < 4


def test_the_network_is_the_paper_s():
    network = make_network()
    sizes = [tuple(p.shape) for p in network.parameters() if p.ndim == 2]
    assert sizes == [(128, 44), (256, 128), (128, 256), (2, 128)] and PAPER_SIZES[0] == INPUTS == 44
    kinds = [type(layer).__name__ for layer in network]
    assert kinds == ["Linear", "ReLU"] * 3 + ["Linear"]


def test_values_are_the_trained_network_s():
    torch.manual_seed(0)
    network = make_network()
    with torch.no_grad():  # so that every ReLU has something to do
        for layer in network[::2]:
            layer.weight *= 4
    linear = [layer for layer in network if isinstance(layer, torch.nn.Linear)]
    layers = [
        (k.weight.detach().double().numpy(), k.bias.detach().double().numpy()) for k in linear
    ]
    part = tempting(20, 5)
    with torch.no_grad():
        wanted = network(torch.from_numpy(part.states).float()).numpy()
    np.testing.assert_allclose(q_values(tuple(layers), part), wanted, rtol=1e-4, atol=1e-4)
    assert wanted.shape == (20, 5, 2) and wanted.std() > 0.01


def test_the_oracle_of_these_tables_is_what_they_were_made_for():
    names = tuple(PATHS)
    best = {names[k] for k in best_return(UNSEEN.outcomes)}
    assert best == {"S2", "S3", "S6"}
    assert sorted({round(float(x), 6) for x in path_returns(UNSEEN.outcomes).max(axis=1)}) == [
        0.9,
        5.0,
    ]
