"""Rewards, returns and the best path of a key interval, against naive twins from the paper."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from exwarp_cli.domain.decision import CHOICES, NODES, PATHS
from exwarp_cli.policy import outcomes
from tests.reference import decisions as paper

STEPS = [(node, choice) for node in NODES for choice in CHOICES]
psnr, ssim = st.floats(0, 100), st.floats(-1, 1)
random_outcomes = st.tuples(arrays(np.float64, (5, 2), elements=psnr),
                            arrays(np.float64, (5, 2), elements=ssim))  # fmt: skip


def joined(pair: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    return np.stack(pair, axis=-1)


def quality(found: np.ndarray) -> paper.Quality:
    """Outcomes as the twin takes them."""
    return {
        (node, choice): tuple(found[NODES.index(node), CHOICES.index(choice)])
        for node, choice in STEPS
    }


def many(count: int) -> np.ndarray:
    """Random outcomes float64 [count, 5, 2, 2]."""
    rng = np.random.default_rng(3)
    return np.stack([rng.uniform(15, 45, (count, 5, 2)), rng.uniform(0.3, 1, (count, 5, 2))], -1)


class TestTwins:
    def test_rewards(self):
        found = outcomes.choice_rewards(many(20))
        assert found.shape == (20, 5, 2)
        for got, given_ in zip(found, many(20), strict=True):
            expected = [paper.reward(quality(given_), *step) for step in STEPS]
            np.testing.assert_allclose(got.ravel(), expected, rtol=0, atol=1e-12)

    def test_returns(self):
        found = outcomes.path_returns(many(20))
        assert found.shape == (20, 6)
        for got, given_ in zip(found, many(20), strict=True):
            expected = [paper.total(quality(given_), path) for path in paper.PATHS]
            np.testing.assert_allclose(got, expected, rtol=0, atol=1e-12)

    def test_what_is_shown(self):
        found = outcomes.slot_quality(many(20))
        assert found.shape == (20, 6, 3, 2)
        for got, given_ in zip(found, many(20), strict=True):
            expected = [[quality(given_)[step] for step in steps] for steps in paper.SHOWN.values()]
            np.testing.assert_array_equal(got, expected)

    def test_the_best(self):
        given_ = many(200)
        by_return, by_psnr = outcomes.best_return(given_), outcomes.best_psnr(given_)
        for k, one in enumerate(given_):
            totals = [paper.total(quality(one), path) for path in paper.PATHS]
            means = [paper.mean_psnr(quality(one), path) for path in paper.PATHS]
            assert by_return[k] == np.argmax(totals) and by_psnr[k] == np.argmax(means)
        assert set(by_return) == set(by_psnr) == set(range(6))
        assert (by_return != by_psnr).any()

    def test_one_interval_alone_and_any_grid_of_them(self):
        given_ = many(12)
        grid = given_.reshape(3, 4, 5, 2, 2)
        for judge in (outcomes.best_return, outcomes.best_psnr):
            assert [int(judge(one)) for one in given_] == judge(given_).tolist()
            np.testing.assert_array_equal(judge(grid), judge(given_).reshape(3, 4))


class TestPenalty:
    def test_each_dropped_slot_counts_once(self):
        """All frames equally good: S1 drops two slots, S2 one, the others none."""
        still = np.full((5, 2, 2), 0.75)
        expected = [-0.2, -0.1, 0, 0, 0, 0]
        np.testing.assert_allclose(outcomes.path_returns(still), expected, rtol=0, atol=1e-15)

    def test_it_is_docked_for_the_choice_and_not_for_the_other(self):
        docked = outcomes.choice_rewards(np.zeros((5, 2, 2)))
        assert {step for step, r in zip(STEPS, docked.ravel(), strict=True) if r} == paper.DROPS
        assert set(docked.ravel()) == {0.0, -0.1}


def least(step_values: dict[tuple[str, str], float]) -> np.ndarray:
    """Outcomes whose PSNR is 20 except where it is given; SSIM is 0.5 throughout."""
    found = np.full((5, 2, 2), [20.0, 0.5])
    for (node, choice), value in step_values.items():
        found[NODES.index(node), CHOICES.index(choice), 0] = value
    return found


class TestTies:
    def test_nothing_to_choose_is_a_warp(self):
        for judge in (outcomes.best_return, outcomes.best_psnr):
            assert tuple(PATHS)[int(judge(np.zeros((5, 2, 2))))] == "S6"

    @pytest.mark.parametrize(
        ("better", "path"),
        [
            ([("d2", "extrapolate")], "S4"),  # S3 and S4 (and S1 and S2) tie: P3 = W(P2)
            ([("d1", "extrapolate"), ("d2", "extrapolate")], "S2"),  # S1 and S2
            ([("d5", "extrapolate"), ("d5", "warp")], "S6"),  # S5 and S6
            ([("d1", "warp"), ("d2", "extrapolate"), ("d4", "extrapolate")], "S3"),  # no tie
        ],
    )
    def test_equal_paths_go_to_warping(self, better, path):
        found = least(dict.fromkeys(better, 30.0))
        assert tuple(PATHS)[int(outcomes.best_psnr(found))] == path


class TestBest:
    @settings(deadline=None)
    @given(random_outcomes.map(joined))
    def test_no_other_path_is_better(self, found):
        totals = [paper.total(quality(found), path) for path in paper.PATHS]
        means = [paper.mean_psnr(quality(found), path) for path in paper.PATHS]
        assert totals[int(outcomes.best_return(found))] >= max(totals) - 1e-9
        assert means[int(outcomes.best_psnr(found))] >= max(means) - 1e-9

    @settings(deadline=None)
    @given(random_outcomes.map(joined), st.floats(-10, 10))
    def test_what_all_frames_share_decides_nothing(self, found, shift):
        """Only differences count, so that a harder interval is no worse a decision."""
        moved = found + np.array([shift, 0.0])
        np.testing.assert_allclose(
            outcomes.path_returns(moved), outcomes.path_returns(found), rtol=0, atol=1e-9
        )
