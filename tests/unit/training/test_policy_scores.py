"""Scores of policies, against a twin that goes interval by interval."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exwarp_cli.domain.decision import PATHS
from exwarp_cli.policy.outcomes import best_psnr, best_return
from exwarp_cli.research.training.policy_training import (
    NAMES,
    greedy_paths,
    score_paths,
)
from tests.reference import scores as naive
from tests.unit.training.policy_tables import random_table

TABLE = random_table(60, 4)
EVERY = np.ones(len(TABLE), np.bool_)
SOME = np.arange(len(TABLE)) % 3 == 1


def fixed(name: str) -> np.ndarray:
    """One path throughout."""
    return np.full(len(TABLE), NAMES.index(name))


def same(found: dict[str, Any], wanted: dict[str, float]) -> None:
    assert {name: found[name] for name in wanted} == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize("rows", [EVERY, SOME], ids=["all", "some"])
@pytest.mark.parametrize("seed", range(3))
def test_scores_of_paths_are_the_twin_s(rows, seed):
    paths = np.random.default_rng(seed).integers(0, 6, len(TABLE))
    found = score_paths(TABLE, paths, rows)
    shares = [{NAMES[k]: 1.0} for k in paths[rows]]
    same(found, naive.score(TABLE.outcomes[rows], shares))
    assert found["intervals"] == rows.sum() == sum(found["paths"])
    assert found["paths"] == [int((paths[rows] == k).sum()) for k in range(6)]


@pytest.mark.parametrize("name", NAMES)
def test_a_fixed_path_is_a_column_of_the_paper_s_table(name):
    found = score_paths(TABLE, fixed(name), EVERY)
    same(found, naive.score(TABLE.outcomes, [{name: 1.0}] * len(TABLE)))
    wanted = {
        "S1": (1, 0.0),
        "S2": (2, 0.5),
        "S3": (3, 1 / 3),
        "S4": (3, 2 / 3),
        "S5": (3, 2 / 3),
        "S6": (3, 1.0),
    }
    assert (found["new_frames"], found["warp_share"]) == pytest.approx(wanted[name])
    assert found["paths"] == [len(TABLE) * (name == other) for other in PATHS]


def test_effective_frame_rates_are_the_paper_s():
    """30 fps become 60 by extrapolation alone, 90 by S2, and 120 by every other path."""
    rates = [30 * (1 + score_paths(TABLE, fixed(n), EVERY)["new_frames"]) for n in NAMES]
    assert rates == [60, 90, 120, 120, 120, 120]


def test_warps_are_counted_by_decision_not_by_interval():
    """One S2 (1 of 2) and one S3 (1 of 3): 2 of 5, not the mean of a half and a third."""
    paths = np.array([1, 2])
    found = score_paths(random_table(2), paths, np.ones(2, np.bool_))
    assert found["warp_share"] == pytest.approx(0.4)


@pytest.mark.parametrize("rows", [EVERY, SOME], ids=["all", "some"])
def test_tossing_coins_is_the_mean_of_all_that_can_be_tossed(rows):
    odds = naive.coin()
    assert odds == {"S1": 0.25, "S2": 0.25, "S3": 0.125, "S4": 0.125, "S5": 0.125, "S6": 0.125}
    found = score_paths(TABLE, None, rows)
    same(found, naive.score(TABLE.outcomes[rows], [odds] * int(rows.sum())))
    assert found["paths"] == [] and found["intervals"] == rows.sum()


def test_random_paths_tend_to_what_coins_come_to():
    rng = np.random.default_rng(0)
    tosses = [score_paths(TABLE, greedy_paths(rng.random((60, 5, 2))), EVERY) for _ in range(150)]
    exact = score_paths(TABLE, None, EVERY)
    for name, scale in (("reward", 2.0), ("psnr_db", 0.5), ("new_frames", 0.05)):
        mean = np.mean([toss[name] for toss in tosses])
        assert abs(mean - exact[name]) < scale


@given(st.lists(st.integers(-1, 1), min_size=10, max_size=10))
def test_what_is_taken_is_the_twin_s_way_down_the_tree(values):
    """Of three values, so that ties are frequent."""
    found = np.array(values, np.float64).reshape(1, 5, 2)
    assert [NAMES[k] for k in greedy_paths(found)] == [naive.chosen_path(found[0])]


def test_a_tie_is_to_warp():
    assert greedy_paths(np.zeros((3, 5, 2))).tolist() == [NAMES.index("S6")] * 3
    values = np.zeros((2, 5, 2))
    values[0, 0, 1] = values[1, 1, 1] = 1e-9
    assert [NAMES[k] for k in greedy_paths(values)] == ["S2", "S4"]


def test_no_policy_beats_the_oracles():
    outcomes = TABLE.outcomes
    best = {"oracle": best_psnr(outcomes), "oracle-return": best_return(outcomes)}
    scores = {name: score_paths(TABLE, paths, EVERY) for name, paths in best.items()}
    assert (best["oracle"] != best["oracle-return"]).any()
    for row in range(len(TABLE)):
        rows = np.arange(len(TABLE)) == row
        every = [score_paths(TABLE, fixed(name), rows) for name in NAMES]
        most = max(score["psnr_db"] for score in every), max(score["reward"] for score in every)
        own = (
            score_paths(TABLE, best["oracle"], rows)["psnr_db"],
            score_paths(TABLE, best["oracle-return"], rows)["reward"],
        )
        assert own == pytest.approx(most)
    assert scores["oracle"]["psnr_db"] >= scores["oracle-return"]["psnr_db"]
    assert scores["oracle-return"]["reward"] >= scores["oracle"]["reward"]
