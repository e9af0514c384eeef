"""The policy that comes with ExWarp: what is said of it holds, recomputed from the tables."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest

from exwarp_cli.accelerator.mlp import ONE, PAPER_SIZES, to_fixed
from exwarp_cli.accelerator.mlp_kernel import MlpKernel
from exwarp_cli.domain.decision import NODES, PATHS
from exwarp_cli.models.model_file import shipped_folder
from exwarp_cli.models.policy_files import load_policy
from exwarp_cli.policy.state import INPUTS, STATE_VERSION
from exwarp_cli.research.training.outcome_tables import TABLES, PolicyTable
from exwarp_cli.research.training.policy_training import (
    ALL,
    REPORT,
    greedy_paths,
    policy_card,
    score_paths,
)

MODELS = shipped_folder()
SCENES = ("lab", "slum", "town", "tropical", "village")


@pytest.fixture(scope="module")
def report() -> dict[str, Any]:
    return json.loads((MODELS / REPORT).read_text(encoding="utf-8"))


def test_the_card_has_the_scores(report):
    assert policy_card(report) in (MODELS / "README.md").read_text(encoding="utf-8")


def test_it_was_judged_on_scenes_that_it_never_saw(report):
    assert tuple(report["left_out"]) == SCENES
    for scene in SCENES:
        metadata = load_policy(MODELS / f"policy-without-{scene}.npz").metadata
        assert metadata["scenes"] == [other for other in SCENES if other != scene]
        assert metadata["settings"] == report["settings"]
    assert load_policy(None).metadata["scenes"] == list(SCENES)


def test_it_is_as_good_as_the_best_fixed_path_of_every_scene(report):
    for parts in report["left_out"].values():
        scores = parts[ALL]["scores"]
        best = max(scores[name]["psnr_db"] for name in PATHS)
        own, oracle = scores["exwarp"]["psnr_db"], scores["oracle"]["psnr_db"]
        assert own >= best - 0.05
        if oracle - best >= 0.1:
            assert own >= best + (oracle - best) / 2


def test_its_return_is_at_least_every_fixed_path_s(report):
    def mean(name: str) -> float:
        parts = report["left_out"].values()
        return float(np.mean([part[ALL]["scores"][name]["reward"] for part in parts]))

    assert all(mean("exwarp") >= mean(path) for path in PATHS)
    assert mean("exwarp") > mean("random")


def test_integers_decide_as_floats_do(report):
    for parts in report["left_out"].values():
        assert parts[ALL]["agreement"] >= 0.99
        scores = parts[ALL]["scores"]
        assert abs(scores["exwarp"]["psnr_db"] - scores["float"]["psnr_db"]) <= 0.02


@pytest.mark.parametrize("scene", SCENES)
def test_the_scores_come_from_the_files_beside_them(report, scene):
    table = PolicyTable.load(MODELS / TABLES / f"{scene}.npz")
    states = to_fixed(table.states.reshape(-1, INPUTS))
    policy = load_policy(MODELS / f"policy-without-{scene}.npz")
    outputs, _ = MlpKernel(policy.network).decide_many(states)
    paths = greedy_paths(outputs.astype(float).reshape(-1, len(NODES), 2))
    found = score_paths(table, paths, np.ones(len(table), np.bool_))
    scores = report["left_out"][scene][ALL]["scores"]["exwarp"]
    assert found["psnr_db"] == pytest.approx(scores["psnr_db"], abs=1e-6)
    assert found["reward"] == pytest.approx(scores["reward"], abs=1e-6)
    assert found["paths"] == scores["paths"]


def test_all_forms_of_it_agree():
    policy = load_policy(None)
    assert policy.network.sizes == PAPER_SIZES and policy.metadata["state"] == STATE_VERSION
    states = PolicyTable.load(MODELS / TABLES / "town.npz").states.reshape(-1, INPUTS)
    fixed = to_fixed(states)
    outputs, _ = MlpKernel(policy.network).decide_many(fixed)
    np.testing.assert_array_equal(answer(MODELS / "policy-int8.onnx", fixed), outputs)
    values = (fixed / ONE).astype(np.float32)
    expected = values.astype(np.float64)
    for number, (weights, biases) in enumerate(policy.floats):
        last = number == len(policy.floats) - 1
        expected = expected @ weights.T + biases
        expected = expected if last else np.maximum(expected, 0)
    np.testing.assert_allclose(answer(MODELS / "policy.onnx", values), expected, atol=1e-4)
    same = (expected[:, 1] > expected[:, 0]) == (outputs[:, 1] > outputs[:, 0])
    assert same.mean() >= 0.99


def answer(path: Path, states: np.ndarray) -> np.ndarray:
    """What an ONNX model answers."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    (found,) = session.run(None, {session.get_inputs()[0].name: states})
    return np.asarray(found)


def test_nothing_that_is_shipped_is_large():
    assert all(path.stat().st_size < 5e6 for path in MODELS.rglob("*") if path.is_file())
