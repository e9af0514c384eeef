"""Training the policy with every scene left out once: what is written, and what is reported."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import onnxruntime
import pytest

from exwarp_cli.accelerator.mlp import PAPER_SIZES, QuantisedMlp, infer_reference, to_fixed
from exwarp_cli.accelerator.mlp_kernel import MlpKernel
from exwarp_cli.domain.decision import NODES, PATHS
from exwarp_cli.errors import InputError, UsageError
from exwarp_cli.models.policy_files import load_policy
from exwarp_cli.policy.outcomes import best_psnr, best_return
from exwarp_cli.policy.state import STATE_VERSION
from exwarp_cli.research.training.onnx_export import STATE
from exwarp_cli.research.training.outcome_tables import PolicyTable
from exwarp_cli.research.training.policy_training import (
    ALL,
    COLUMNS,
    FLOAT_MODEL,
    INTEGER_MODEL,
    REPORT,
    SCHEMA,
    greedy_paths,
    policy_card,
    predict_rewards,
    score_paths,
    train_policy,
)
from exwarp_cli.research.training.q_learning import (
    Layers,
    integer_values,
    q_values,
    quantise,
    train_decisions,
)
from exwarp_cli.research.training.training_settings import PolicySettings, require_sane_policy
from tests.unit.training.policy_tables import NETWORK, random_table, tempting

GROUPS = ("key-phase0-speed1 64x36", "slot-phase0-speed1 64x36", "slot-phase0-speed1 32x18")
SETTINGS = PolicySettings(steps=20, batch=32, rate=2e-3, lag=5, seed=2)
SCENES = ("hall", "lab", "town")
WITHOUT = tuple(f"policy-without-{scene}.npz" for scene in SCENES)
PARTS = {"all", "key 64x36", "slot 64x36", "slot 32x18"}


def dealt(table: PolicyTable) -> PolicyTable:
    """The table with its rows in three groups."""
    return replace(
        table, groups=GROUPS, group=np.arange(len(table), dtype=np.int16) * 3 // len(table)
    )


def parts_of(table: PolicyTable) -> dict[str, np.ndarray]:
    """The rows of each part of a table that was dealt."""
    names = {"key 64x36": 0, "slot 64x36": 1, "slot 32x18": 2}
    parts = {name: table.group == group for name, group in names.items()}
    return {ALL: np.ones(len(table), bool)} | parts


def learn(
    tables: list[PolicyTable], settings: PolicySettings, rounded=quantise
) -> tuple[Layers, QuantisedMlp]:
    """A network as it was trained on some scenes, and in integers."""
    floats = train_decisions(tables, settings)
    return floats, rounded(floats, np.concatenate([t.states.reshape(-1, 44) for t in tables]))


@pytest.fixture(scope="module")
def tables() -> list[PolicyTable]:
    """The second has neither rhyme nor reason, so that who learned from it differs."""
    makers = (tempting, random_table, tempting)
    return [dealt(make(30 + 9 * k, k, SCENES[k])) for k, make in enumerate(makers)]


@pytest.fixture(scope="module")
def trained(tables, tmp_path_factory) -> tuple[Path, dict, list[str]]:
    """The folder, what was returned, and what was said."""
    folder, said = tmp_path_factory.mktemp("policy") / "out", []
    folder.mkdir()
    (folder / "checksums.json").write_text('{"extrapolator.onnx": "e", "policy.npz": "old"}')
    return folder, train_policy(tables, folder, SETTINGS, said.append), said


class TestFiles:
    def test_which_there_are(self, trained):
        folder, _, _ = trained
        models = {"policy.npz", FLOAT_MODEL, INTEGER_MODEL, *WITHOUT}
        assert {path.name for path in folder.iterdir()} == models | {REPORT, "checksums.json"}
        known = json.loads((folder / "checksums.json").read_bytes())
        assert known.pop("extrapolator.onnx") == "e"
        wanted = {n: hashlib.sha256((folder / n).read_bytes()).hexdigest() for n in models}
        assert known == wanted

    def test_what_a_policy_tells_of_itself(self, trained):
        folder, _, _ = trained
        for name, left_out in zip((*WITHOUT, "policy.npz"), (*SCENES, None), strict=True):
            metadata = load_policy(folder / name).metadata
            assert metadata["scenes"] == [scene for scene in SCENES if scene != left_out]
            assert metadata["state"] == STATE_VERSION and metadata["settings"] == asdict(SETTINGS)
            assert metadata["extrapolator"] == [NETWORK]

    def test_only_the_final_policy_keeps_its_floats(self, trained):
        folder, _, _ = trained
        assert [len(load_policy(folder / n).floats) for n in (*WITHOUT, "policy.npz")] == [
            0,
            0,
            0,
            4,
        ]

    def test_what_is_read_back_decides_alike(self, trained, tables):
        folder, _, _ = trained
        floats, network = learn(tables, SETTINGS)
        kept = load_policy(folder / "policy.npz")
        assert kept.network.sizes == PAPER_SIZES
        for table in tables:
            states = to_fixed(table.states.reshape(-1, 44))
            outputs = infer_reference(kept.network, states).outputs.reshape(-1, 5, 2)
            np.testing.assert_array_equal(outputs, integer_values(network, table.states))
            np.testing.assert_allclose(
                q_values(kept.floats, table), q_values(floats, table), rtol=1e-6
            )
        for (weights, biases), (w, b) in zip(kept.floats, floats, strict=True):
            np.testing.assert_array_equal(weights, w)
            np.testing.assert_array_equal(biases, b)

    def test_the_onnx_models_are_the_same_network(self, trained, tables):
        folder, _, _ = trained
        states = tables[0].states.reshape(-1, 44)
        kept = load_policy(folder / "policy.npz")
        for name, given in ((INTEGER_MODEL, to_fixed(states)), (FLOAT_MODEL, np.float32(states))):
            session = onnxruntime.InferenceSession(
                folder / name, providers=["CPUExecutionProvider"]
            )
            (found,) = session.run(None, {STATE: given})
            if name == INTEGER_MODEL:
                np.testing.assert_array_equal(found, MlpKernel(kept.network).decide_many(given)[0])
            else:
                wanted = q_values(kept.floats, tables[0]).reshape(-1, 2)
                np.testing.assert_allclose(found, wanted, atol=1e-5)

    def test_a_fold_never_saw_its_scene(self, trained, tables, tmp_path):
        """With other outcomes of one scene its fold stays the same, and all others change."""
        folder, _, _ = trained
        changed = [tables[0], dealt(random_table(40, 8, "lab")), tables[2]]
        train_policy(changed, tmp_path, SETTINGS, lambda line: None)
        same = [(folder / n).read_bytes() == (tmp_path / n).read_bytes() for n in WITHOUT]
        assert same == [False, True, False]
        assert (folder / "policy.npz").read_bytes() != (tmp_path / "policy.npz").read_bytes()

    def test_the_same_tables_give_the_same_bytes(self, trained, tables, tmp_path):
        folder, _, _ = trained
        train_policy(tables, tmp_path, SETTINGS, lambda line: None)
        for name in ("policy.npz", FLOAT_MODEL, INTEGER_MODEL, REPORT, *WITHOUT):
            assert (folder / name).read_bytes() == (tmp_path / name).read_bytes(), name


class TestReport:
    def test_what_is_returned_is_what_is_written(self, trained, tables):
        folder, report, _ = trained
        assert json.loads((folder / REPORT).read_bytes()) == json.loads(json.dumps(report))
        assert set(report) == {"schema", "settings", "tables", "left_out"}
        assert report["schema"] == SCHEMA and report["settings"] == asdict(SETTINGS)
        assert list(report["tables"]) == list(report["left_out"]) == list(SCENES)
        for table in tables:
            entry = report["tables"][table.scene]
            assert entry["intervals"] == len(table) and entry["points"] == 5 * len(table)
            assert entry["groups"] == {name: len(table) // 3 for name in GROUPS}
            assert entry["extrapolator"] == NETWORK

    def test_scores_are_those_of_the_left_out_scene(self, trained, tables):
        folder, report, _ = trained
        for k, (table, name) in enumerate(zip(tables, WITHOUT, strict=True)):
            own = load_policy(folder / name)
            states = to_fixed(table.states.reshape(-1, 44))
            whole = infer_reference(own.network, states).outputs.reshape(-1, 5, 2)
            others = [other for i, other in enumerate(tables) if i != k]
            paths = {
                "exwarp": greedy_paths(whole.astype(float)),
                "regressor": greedy_paths(predict_rewards(others, table)),
                "oracle": best_psnr(table.outcomes),
                "oracle-return": best_return(table.outcomes),
                **{path: np.full(len(table), index) for index, path in enumerate(PATHS)},
            }
            found = report["left_out"][table.scene]
            assert set(found) == PARTS
            for part, rows in parts_of(table).items():
                scores = found[part]["scores"]
                assert set(scores) == {*paths, "float", "random"}
                assert scores["random"] == score_paths(table, None, rows)
                for policy, taken_by in paths.items():
                    assert scores[policy] == score_paths(table, taken_by, rows), policy

    def test_integers_and_floats_are_distinguished(self, tables, tmp_path, monkeypatch):
        """Weights are rounded to sixteenths first, as honest integers decide alike in all rows."""

        def crude(floats, states):
            return quantise(tuple((np.round(16 * w) / 16, b) for w, b in floats), states)

        monkeypatch.setattr("exwarp_cli.research.training.q_learning.quantise", crude)
        settings = replace(SETTINGS, steps=30, seed=5)
        report = train_policy(tables, tmp_path, settings, lambda line: None)
        shares = set()
        for k, table in enumerate(tables):
            floats, network = learn([t for i, t in enumerate(tables) if i != k], settings, crude)
            whole, real = integer_values(network, table.states), q_values(floats, table)
            same = (whole[..., 1] > whole[..., 0]) == (real[..., 1] > real[..., 0])
            met = np.zeros(same.shape, bool)
            for row, path in enumerate(greedy_paths(whole)):
                met[row] = [node in tuple(PATHS.values())[path].choices for node in NODES]
            for part, rows in parts_of(table).items():
                entry = report["left_out"][table.scene][part]
                assert entry["agreement"] == pytest.approx(same[rows].mean())
                assert entry["agreement_met"] == pytest.approx(same[rows][met[rows]].mean())
                for name, outputs in (("exwarp", whole), ("float", real)):
                    wanted = score_paths(table, greedy_paths(outputs), rows)
                    assert entry["scores"][name] == wanted
                shares |= {entry["agreement"], entry["agreement_met"]}
        assert len(shares) > 4 and 0.2 < min(shares) < 1

    def test_honest_integers_agree(self, trained):
        _, report, _ = trained
        for parts in report["left_out"].values():
            for part in parts.values():
                assert 0.9 < part["agreement"] <= 1 and 0.9 < part["agreement_met"] <= 1

    def test_parts(self, tmp_path):
        """A part has all views of a setting at a size."""
        groups = (*GROUPS, "slot-phase4-speed2 64x36")
        tables = [random_table(12, seed, scene, groups) for seed, scene in enumerate(SCENES[:2])]
        report = train_policy(tables, tmp_path, replace(SETTINGS, steps=1), lambda line: None)
        parts = report["left_out"]["lab"]
        sizes = {part: found["scores"]["random"]["intervals"] for part, found in parts.items()}
        assert sizes == {ALL: 12, "key 64x36": 3, "slot 64x36": 6, "slot 32x18": 3}
        rows = np.array([0] * 3 + [1] * 3 + [0] * 3 + [1] * 3, bool)
        assert parts["slot 64x36"]["scores"]["random"] == score_paths(tables[1], None, rows)

    def test_what_is_said(self, trained):
        _, report, said = trained
        assert said[0] == "without hall: training on lab, town"
        assert said[-1] == "training on all 3 scenes" and len(said) == 7
        best = report["left_out"]["town"][ALL]["scores"]["oracle"]["psnr_db"]
        assert said[5].startswith("without town: return ") and f"oracle {best:.3f}" in said[5]


def test_the_card_has_every_scene_and_part(trained):
    _, report, _ = trained
    text = policy_card(json.loads(json.dumps(report)))
    blocks = [block.splitlines() for block in text.split("\n\n")]
    assert len(blocks) == 3
    for block, extra in zip(blocks, (0, 1, 0), strict=True):
        assert len(block) == 2 + 3 * 3 + extra
        assert len({line.count("|") for line in block}) == 1
        rows = [tuple(cell.strip() for cell in line.split("|")[1:3]) for line in block[2:11]]
        parts = sorted(PARTS - {ALL})
        assert rows == [(scene, part) for scene in SCENES for part in parts]
    found = report["left_out"]["lab"]["slot 64x36"]
    row = next(line for line in blocks[0] if line.startswith("| lab | slot 64x36 |"))
    for name in COLUMNS:
        score = found["scores"][name]
        assert f"{score['psnr_db']:.2f} / {score['ssim']:.3f}" in row
    best = max(PATHS, key=lambda name: found["scores"][name]["psnr_db"])
    assert f"**{found['scores'][best]['psnr_db']:.2f} /" in row
    own = found["scores"]["exwarp"]
    row = next(line for line in blocks[2] if line.startswith("| lab | slot 64x36 |"))
    assert f"| {30 * (1 + own['new_frames']):.1f} |" in row and f"{own['warp_share']:.1%}" in row


def test_a_scene_of_one_part_is_listed_once(tables, tmp_path):
    plain = [replace(t, groups=GROUPS[:1], group=t.group * 0) for t in tables[:2]]
    report = train_policy(plain, tmp_path, replace(SETTINGS, steps=1), lambda line: None)
    assert set(report["left_out"]["hall"]) == {ALL, "key 64x36"}
    assert [len(block.splitlines()) for block in policy_card(report).split("\n\n")] == [4, 5, 4]


def test_int8_decides_as_floats_do_once_trained():
    table, unseen = tempting(200, 1), tempting(150, 2)
    floats, network = learn([table], replace(SETTINGS, steps=200, rate=3e-3, batch=64))
    real, whole = q_values(floats, unseen), integer_values(network, unseen.states)
    same = (real[..., 1] > real[..., 0]) == (whole[..., 1] > whole[..., 0])
    assert same.mean() > 0.99 and 0.3 < (real[..., 1] > real[..., 0]).mean() < 0.7


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_scenes_are_refused(tables, tmp_path, count):
    with pytest.raises(InputError, match="and there is"):
        train_policy(tables[:count], tmp_path / "out", SETTINGS, print)
    assert not (tmp_path / "out").exists()


def test_two_tables_of_a_scene_are_refused(tables, tmp_path):
    with pytest.raises(InputError, match="two tables are of the scene lab; keep one"):
        train_policy([*tables, tables[1]], tmp_path / "out", SETTINGS, print)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("rate", [0.0, -1.0, 1.0, float("nan"), float("inf")])
def test_rates_that_teach_nothing_are_refused(rate):
    with pytest.raises(UsageError, match=r"--rate .* is not between 0 and 1"):
        require_sane_policy(replace(SETTINGS, rate=rate))
    require_sane_policy(SETTINGS)
