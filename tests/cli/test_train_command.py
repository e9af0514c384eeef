"""`exwarp train` as a user runs it."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path
from typing import Any

import pytest
from torch import nn

from exwarp_cli.cli import run
from exwarp_cli.domain.network_api import LOOKAHEAD_INTERFACE, NetworkInterface
from exwarp_cli.research.training import lookahead_training, resumable_training
from exwarp_cli.research.training.augmentation import PLAIN, Variant
from exwarp_cli.research.training.extrapolation_network import STRIDE
from tests.cli.documents import strict
from tests.unit import tiny_lookahead
from tests.unit.analytic_scene import write_scene

SMALL = ["--steps", "2", "--every", "1", "--batch", "2", "--patch", "32", "--side", "64"]
SMALL += ["--width", "4", "--frames", "2", "--architecture", "blend", "--threads", "1"]


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("train") / "scenes"
    for name in ("one", "two"):
        write_scene(folder / name, scene=name, role="training")
    write_scene(folder / "judged", scene="judged")
    return folder


def train(data: Path, output: Path, *more: str) -> int:
    return run(["train", "extrapolator", "--data", str(data), "-o", str(output), *more])


def test_a_network_is_trained_and_named(data, network, tmp_path, capsys, monkeypatch):
    about: list[str] = []

    # Exporting takes 20 s, and `tests/unit/training/test_networks.py` looks at what comes of it.
    def export(module: nn.Module, path: Path, *_: Any, **more: Any) -> None:
        about.append(more["about"])
        shutil.copy(network, path)

    monkeypatch.setattr(resumable_training, "export_network", export)
    assert train(data, tmp_path / "run", *SMALL) == 0
    out, err = capsys.readouterr()
    assert "extrapolator.onnx: give it to exwarp upsample" in out
    assert "preparing one, 1 of 1" in err
    assert "1 scenes, " in err
    assert "step 2 of 2: loss" in err
    assert "judged" not in err
    files = {"checkpoint.pt", "curve.csv", "extrapolator.onnx", "settings.json"}
    assert {p.name for p in (tmp_path / "run").iterdir()} == files
    assert train(data, tmp_path / "run", *SMALL, "--json") == 0
    out, err = capsys.readouterr()
    assert "going on at step 2 of 2" in err
    found = strict(out)
    scores = found.pop("scores")
    assert found == {
        "schema": "exwarp.training/1",
        "kind": "extrapolator",
        "folder": str(tmp_path / "run"),
        "model": str(tmp_path / "run" / "extrapolator.onnx"),
    }
    *_, last = csv.DictReader((tmp_path / "run" / "curve.csv").read_text().splitlines())
    assert list(scores) == list(last) and scores["step"] == 2
    assert scores["loss"] == float(last["loss"])
    assert about == ["ExWarp extrapolation network, blend, 2 steps on 1 scenes, seed 0"] * 2


@pytest.mark.parametrize(
    ("options", "code", "sentence"),
    [
        (["--scenes", "three"], 3, "has no scene to learn from"),
        (["--exclude", "one"], 3, "there is 1 scene to train on"),
        (["--architecture", "huge"], 2, "--architecture huge is not one of residual, blend"),
        (["--patch", "40"], 2, "--patch 40 is no multiple of 16"),
        (["--patch", "128"], 2, "--patch 128 is larger than --side 64"),
        (["--side", "96"], 3, "smaller than crops of 96"),
        (["--rate", "0"], 2, "--rate 0 is not between 0 and 1"),
        (["--rate", "2"], 2, "--rate 2 is not between 0 and 1"),
        (["--rate", "nan"], 2, "--rate nan is not between 0 and 1"),
        (["--side", "72"], 2, "--side 72 is no multiple of 16"),
        (["--batch", "1"], 2, "--batch 1 is too small to normalise over"),
        (["--seed", "-1"], 2, "--seed"),
    ],
)
def test_mistakes_are_one_sentence(data, tmp_path, capsys, options, code, sentence):
    assert train(data, tmp_path / "run", *SMALL, *options) == code
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith("exwarp: error: ")
    assert sentence in error


def test_a_cache_that_cannot_be_made_is_one_sentence(data, tmp_path, capsys):
    (tmp_path / "file").write_text("in the way")
    cache = tmp_path / "file" / "crops"
    assert train(data, tmp_path / "run", *SMALL, "--cache", str(cache)) == 5
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith(f"exwarp: error: cannot write {cache}: ")
    assert "; " in error


def test_a_damaged_checkpoint_is_one_sentence(data, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(
        "exwarp_cli.research.training.extrapolator_training.ExtrapolatorTraining.export",
        lambda self: "model",
    )
    assert train(data, tmp_path / "run", *SMALL) == 0
    (tmp_path / "run" / "checkpoint.pt").write_bytes(b"PK and nothing else")
    assert train(data, tmp_path / "run", *SMALL) == 3
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith(f"exwarp: error: {tmp_path / 'run' / 'checkpoint.pt'} is damaged")


def test_data_that_is_not_there(tmp_path, capsys):
    assert train(tmp_path / "none", tmp_path / "run") == 3
    assert "is no folder" in capsys.readouterr().err


def test_without_the_extra_one_sentence_tells_how_to_get_it(monkeypatch, data, tmp_path, capsys):
    monkeypatch.setattr(
        "exwarp_cli.research.training.training_settings.find_spec", lambda name: None
    )
    assert train(data, tmp_path / "run") == 7
    assert 'pip install "exwarp[train]"' in capsys.readouterr().err


def test_the_command_alone_shows_its_help(capsys):
    assert run(["train"]) == 0
    assert "extrapolator" in capsys.readouterr().out


def test_help_needs_no_torch(without_torch, capsys):
    assert run(["train", "extrapolator", "--help"]) == 0
    assert "--architecture" in capsys.readouterr().out


def test_a_network_that_looks_ahead_is_trained(data, tmp_path, capsys, monkeypatch):
    # Making the samples of all variants would take a minute.
    monkeypatch.setattr(
        lookahead_training, "variants_of", lambda name, seed: [(Variant(speed=2), PLAIN)]
    )
    exported: list[dict[str, Any]] = []

    # Exporting takes 15 s; what comes of it is looked at in tests/unit/training.
    def export(module: nn.Module, path: Path, interface: NetworkInterface, **more: Any) -> None:
        assert interface == LOOKAHEAD_INTERFACE
        exported.append(more)
        tiny_lookahead.save(path, tiny_lookahead.nearer_side())

    monkeypatch.setattr(resumable_training, "export_network", export)
    asked = ["train", "lookahead", "--data", str(data), "-o", str(tmp_path / "run")]
    asked += ["--cache", str(tmp_path / "crops"), "--steps", "2", "--every", "1", "--batch", "2"]
    asked += ["--width", "4", "--threads", "1"]
    assert run(asked) == 0
    out, err = capsys.readouterr()
    assert "lookahead.onnx: give it to exwarp upsample --method lookahead" in out
    assert "step 2 of 2: loss" in err and "dB over softsplat" in err
    assert "judged" not in err
    files = {"checkpoint.pt", "curve.csv", "lookahead.onnx", "settings.json"}
    assert {p.name for p in (tmp_path / "run").iterdir()} == files
    assert run([*asked, "--json"]) == 0
    out, err = capsys.readouterr()
    assert "going on at step 2 of 2" in err
    assert strict(out)["kind"] == "lookahead"
    about = "ExWarp look-ahead network, 4 channels, 2 steps on 1 scenes, seed 0"
    assert exported == [{"stride": STRIDE, "about": about}] * 2
