"""`exwarp models`: what it writes, and what it refuses."""

from __future__ import annotations

import importlib.util
import shutil
from pathlib import Path

import pytest

from exwarp_cli.models.picture_network import load_extrapolator
from exwarp_cli.research.training import extranet_import
from tests.unit.training.extranet_checkpoint import checkpoint, state

COMMAND = ("models", "import-extranet")


@pytest.fixture
def given(tmp_path) -> Path:
    return checkpoint(tmp_path / "given.pth.tar")


def test_a_checkpoint_becomes_a_model(exwarp, given, network, tmp_path, monkeypatch):
    # Exporting takes 20 s, and `tests/unit/training/test_extranet.py` looks at what comes of it.
    monkeypatch.setattr(
        extranet_import, "export_network", lambda _, path, *__, **___: shutil.copy(network, path)
    )
    out = tmp_path / "models" / "e.onnx"
    out.parent.mkdir()
    out.write_bytes(b"another")
    exwarp(*COMMAND, given, out).refused(6, "e.onnx exists", "--overwrite")
    assert out.read_bytes() == b"another"
    result = exwarp(*COMMAND, given, out, "--overwrite")
    assert result.code == 0 and result.err == ""
    assert result.out == f"{out}: give it to exwarp upsample --extrapolator\n"
    load_extrapolator(out, 1, "cpu")
    assert list(out.parent.iterdir()) == [out]


def test_the_checkpoint_is_not_replaced(exwarp, given):
    before = given.read_bytes()
    exwarp(*COMMAND, given, given, "--overwrite").refused(2, "is the checkpoint itself")
    assert given.read_bytes() == before


class TestRefusals:
    @pytest.fixture
    def refused(self, exwarp, tmp_path):
        def run(given: Path, code: int, *words: str) -> None:
            exwarp(*COMMAND, given, tmp_path / "out.onnx").refused(code, *words)
            assert not (tmp_path / "out.onnx").exists()

        return run

    def test_no_file(self, refused, tmp_path):
        refused(tmp_path / "none.tar", 3, "cannot read", "none.tar", "check the path")

    def test_no_checkpoint(self, refused, tmp_path):
        (tmp_path / "text").write_text("not a checkpoint\n")
        refused(tmp_path / "text", 3, "text is damaged, is no PyTorch checkpoint")

    def test_a_truncated_one(self, refused, given):
        given.write_bytes(given.read_bytes()[:-1000])
        refused(given, 3, "is damaged")

    def test_another_network(self, refused, given):
        tensors = state()
        del tensors["outc.weight"]
        checkpoint(given, tensors)
        refused(given, 3, "lacks outc.weight;", "ExtraNet's release")

    def test_no_folder_to_write_to(self, exwarp, given):
        exwarp(*COMMAND, given, given / "out.onnx").refused(5, "cannot write", "in the way")

    def test_without_the_extra(self, refused, given, monkeypatch):
        found = importlib.util.find_spec

        def find_spec(name: str, package: str | None = None) -> object:
            return None if name in ("torch", "onnxscript") else found(name, package)

        monkeypatch.setattr("exwarp_cli.research.training.training_settings.find_spec", find_spec)
        refused(given, 7, "needs torch, onnxscript,", 'pip install "exwarp[train]"')


def test_alone_it_shows_its_commands(exwarp):
    result = exwarp("models")
    assert result.code == 0 and "import-extranet" in result.out


def test_help_loads_nothing_heavy(exwarp):
    result = exwarp(*COMMAND, "--help")
    assert result.code == 0 and "medieval.pth.tar" in result.out


def test_an_unknown_one(exwarp):
    exwarp("models", "import").refused(2, "import", "exwarp models --help")
