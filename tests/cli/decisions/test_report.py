"""What a run tells of its decisions: paths, nodes, effective fps, quality, features, inputs."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from statistics import mean

import numpy as np
import pytest

from exwarp_cli.accelerator.mlp import infer_reference
from exwarp_cli.models.policy_files import SHIPPED_TILE_POLICY, load_policy
from tests.cli import shots
from tests.cli.decisions.conftest import KEYS, SETTINGS, Done, take
from tests.reference.decisions import DROPS, NEW, NODES_OF, PATHS, SHOWN, E, W

FEATURES = ("N_d", "EMD_Wn", "EMD_Wp", "Var_x", "Var_y", "R")


@pytest.fixture(params=SETTINGS)
def done(request, judged) -> Done:
    """A run whose decisions differ from interval to interval."""
    return judged("watching", request.param)


def decided(done: Done) -> list[dict[str, str]]:
    return [row for row in done.rows if row["node"]]


def test_the_run_is_worth_looking_at(judged):
    """Both choices at most nodes, or the tests below would show little."""
    taken = [set(judged("watching", setting).paths) for setting in SETTINGS]
    assert all(len(paths) >= 3 for paths in taken)
    assert len(taken[0] | taken[1]) >= 5


def test_every_slot_has_its_node_and_choice(done):
    assert len(done.paths) == KEYS
    for k, path in enumerate(done.paths):
        frames = done.rows[4 * k : 4 * k + 4]
        assert [row["path"] for row in frames] == ["", path, path, path]
        assert [row["node"] for row in frames[1:]] == NODES_OF[path]
        assert {r["node"]: r["choice"] for r in frames if r["node"]} == PATHS[path]
        for row, step in zip(frames[1:], SHOWN[path], strict=True):
            assert row["made_by"] == ("hold" if step in DROPS else step[1])
            assert row["kind"] == ("dropped" if step in DROPS else "generated")
            assert row["method"] == "causal"
        assert frames[0]["made_by"] == frames[0]["node"] == ""


def test_cells_are_filled_where_something_was_decided(done):
    for row in done.rows:
        cells = [row[name] for name in ("output_warp", "output_extrapolate", "inputs", *FEATURES)]
        assert all(cells) if row["node"] else not any(cells)
    assert {row["R"] for row in decided(done)} == {str(32 * 18)}


def test_the_inputs_give_the_outputs_again(done, policies):
    network = load_policy(policies("watching")).network
    states = np.array([row["inputs"].split() for row in decided(done)], dtype=np.int32)
    assert states.shape[1] == 44 and states.min() >= 0 and states.max() <= 65536
    found = infer_reference(network, states)
    for row, outputs, choice in zip(decided(done), found.outputs, found.choices, strict=True):
        assert [int(row["output_warp"]), int(row["output_extrapolate"])] == outputs.tolist()
        assert row["choice"] == (W, E)[choice]
    nodes = [f"d{np.argmax(state[6:11]) + 1}" for state in states]
    assert nodes == [row["node"] for row in decided(done)]


def test_nodes_and_paths_are_counted(done):
    found = done.report["decisions"]
    taken = Counter(done.paths)
    assert found["paths"] == {path: taken[path] for path in PATHS}
    steps = Counter((row["node"], row["choice"]) for row in decided(done))
    assert found["nodes"] == {
        f"d{i}": {choice: steps[f"d{i}", choice] for choice in (W, E)} for i in range(1, 6)
    }
    warps = sum(count for (_, choice), count in steps.items() if choice == W)
    assert found["warp_share"] == pytest.approx(warps / steps.total())
    assert 0 < found["warp_share"] < 1


def test_effective_fps(done):
    new = mean(NEW[path] for path in done.paths)
    assert done.report["fps"]["effective"] == pytest.approx(30 * (1 + new))
    repeats = sum(row["kind"] == "dropped" for row in done.rows)
    assert repeats == sum(3 - NEW[path] for path in done.paths) > 0
    assert done.report["frames"]["dropped"] == repeats
    assert done.report["frames"]["generated"] == 3 * KEYS - repeats


def test_quality_by_what_was_decided(done):
    found = done.report["quality"]
    parts = {
        "hold": found["dropped"],
        "warp": found["by_decision"]["warp"],
        "extrapolate": found["by_decision"]["extrapolate"],
    }
    for maker, part in parts.items():
        rows = [row for row in done.rows if row["made_by"] == maker and row["psnr_db"]]
        assert part["frames"] == len(rows) > 0
        for name in ("psnr_db", "ssim", "flip"):
            assert part[name] == pytest.approx(mean(float(row[name]) for row in rows))
    assert found["all"]["frames"] == sum(part["frames"] for part in parts.values())


def test_who_decided(done, policies):
    file = policies("watching")
    assert done.report["method"] == "causal" and done.report["lookahead"] is False
    assert done.report["policy"] == {
        "file": str(file),
        "sha256": hashlib.sha256(file.read_bytes()).hexdigest(),
        "objects_from": "ids",
        "missing": [],
        "trained_for": [],
        "note": None,
    }
    assert done.report["extrapolator"]["file"].endswith("tiny.onnx")


def test_time_is_booked_on_features_and_decisions(done, judged):
    for row in done.rows:
        assert bool(row["features_ms"]) is bool(row["decide_ms"]) is (row["slot"] != "0")
    timing = judged("s3").report["timing_ms"]
    assert timing["features"] is timing["decide"] is None


def test_headers_hold_the_decision(done):
    for row in done.rows:
        header, _ = shots.read(done.out / row["file"])
        assert header.get("exwarp:path", "") == row["path"]
        assert header.get("exwarp:madeBy", "") == row["made_by"]
        found = json.loads(header.get("exwarp:decision", "{}"))
        assert [found.get("node", ""), found.get("choice", "")] == [row["node"], row["choice"]]
        assert " ".join(map(str, found.get("inputs", []))) == row["inputs"]


def test_fixed_paths_tell_their_nodes_too(judged):
    done = judged("s4")
    assert set(done.paths) == {"S4"} and done.report["policy"] is None
    slots = [row for row in done.rows if row["slot"] != "0"]
    assert [(row["node"], row["choice"]) for row in slots] == [*PATHS["S4"].items()] * KEYS
    assert not any(row["output_warp"] or row["inputs"] or row["R"] for row in slots)


def test_what_comes_with_exwarp_decides_by_default(uneven, exwarp, tmp_path):
    keys, *rest = uneven["key"]
    options = ("--causal", "--frames", "2", "--progress", "none", "--threads", 1)
    options += ("--report", tmp_path / "report")
    result = exwarp("upsample", keys, "-o", tmp_path / "out", *rest, *options)
    assert result.code == 0, result.err
    report = json.loads((tmp_path / "report" / "report.json").read_text())
    assert report["method"] == "causal" and report["policy"]["file"].endswith("tile-policy.npz")
    shipped = load_policy(None, SHIPPED_TILE_POLICY)
    assert report["policy"]["sha256"] == shipped.checksum
    sentence = f"decisions by tile-policy.npz (sha256 {shipped.checksum[:8]}), 8-bit integers\n"
    assert sentence in result.err
    assert "paths of the tiles: " in result.out


class TestMissing:
    """AOVs that features come from."""

    def run(self, exwarp, network, policies, tmp_path, frame, motion):
        keys = shots.sequence(tmp_path / "keys", frame, (1, 2), shots.SMALL)
        options = (
            "--causal",
            "--policy",
            policies("watching"),
            "--extrapolator",
            network,
            "--threads",
            1,
        )
        options += ("--frames", 1, "--motion", motion, "--progress", "none")
        options += ("--report", tmp_path / "report")
        result = exwarp("upsample", keys, "-o", tmp_path / "out", *options)
        assert result.code == 0, result.err
        report = json.loads((tmp_path / "report" / "report.json").read_text())
        return result.err, report["policy"]

    def test_nothing(self, exwarp, network, policies, tmp_path):
        err, policy = self.run(
            exwarp, network, policies, tmp_path, shots.blender4, "previous=X,-Y next=-Z,W"
        )
        assert "the policy sees 0" not in err and "object" not in err
        assert (policy["objects_from"], policy["missing"]) == ("ids", [])

    def test_ids_normals_and_positions(self, exwarp, network, policies, tmp_path):
        err, policy = self.run(exwarp, network, policies, tmp_path, shots.plain, "next=u,-v")
        assert "exwarp: no object ids: what moves otherwise than the camera counts as" in err
        assert "exwarp: the policy sees 0 for EMD_Wn, EMD_Wp, as the AOVs" in err
        assert (policy["objects_from"], policy["missing"]) == ("motion", ["EMD_Wn", "EMD_Wp"])

    def test_all_but_motion(self, exwarp, network, policies, tmp_path):
        def frame(path, street, time):
            planes = shots.plain_planes(street, time)
            shots.write(path, {"": {name: v for name, v in planes.items() if name != "Z"}})

        err, policy = self.run(exwarp, network, policies, tmp_path, frame, "next=u,-v")
        assert "no object ids" not in err
        assert "exwarp: the policy sees 0 for N_d, EMD_Wn, EMD_Wp, as the AOVs" in err
        missing = ["N_d", "EMD_Wn", "EMD_Wp"]
        assert (policy["objects_from"], policy["missing"]) == (None, missing)


def test_in_the_slot_setting_the_slots_aovs_count(uneven, policies, network, tmp_path, capfd):
    """The key frames hold colour alone there, and nothing is missing."""
    options = (
        "--causal",
        "--policy",
        policies("watching"),
        "--extrapolator",
        network,
        "--frames",
        "1",
    )
    done = take(uneven["slot"], tmp_path / "out", *options)
    assert done.report["policy"]["missing"] == []
    assert "the policy sees 0" not in capfd.readouterr().err
