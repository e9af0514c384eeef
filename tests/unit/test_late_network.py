"""The shipped network, which a run by a policy opens when it is first asked for."""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.domain.extrapolator import INPUTS, NetworkInputs
from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.errors import DamagedFileError, InputError, MissingExtraError
from exwarp_cli.io import model_files, models
from exwarp_cli.io.models import CHECKSUMS, SHIPPED, OnnxExtrapolator, load_extrapolator
from exwarp_cli.pipeline import late_network
from exwarp_cli.pipeline.finding import find_network
from exwarp_cli.pipeline.late_network import LateNetwork
from exwarp_cli.synthesis.methods import METHODS
from tests.unit.tiny_models import filled_warp, save


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """Where another network lies that came with ExWarp."""
    path = save(tmp_path / SHIPPED, filled_warp())
    sums = {SHIPPED: hashlib.sha256(path.read_bytes()).hexdigest()}
    (tmp_path / CHECKSUMS).write_text(json.dumps(sums))
    monkeypatch.setattr(model_files, "shipped_folder", lambda: tmp_path)
    return tmp_path


def found(method: str = "exwarp", network: Path | None = None) -> object:
    path = None if network is None else str(network)
    settings = UpsampleSettings(SourceSettings("."), ".", threads=1, extrapolator=path)
    return find_network(settings, METHODS[method])


def inputs() -> NetworkInputs:
    seeded = np.random.default_rng(0)
    planes = {name: seeded.random((n, 24, 40), np.float32) for name, n in INPUTS.items()}
    return NetworkInputs(**planes, time=0.5)


def test_it_is_opened_once_it_is_asked(folder, monkeypatch):
    opened = []

    def counted(*arguments: object) -> OnnxExtrapolator:
        opened.append(arguments)
        return OnnxExtrapolator(*arguments)

    monkeypatch.setattr(late_network, "OnnxExtrapolator", counted)
    network = found()
    assert isinstance(network, LateNetwork)
    assert not opened
    expected = load_extrapolator(None, 1, "cpu")
    told = (network.path, network.checksum, network.device)
    assert told == (expected.path, expected.checksum, expected.device)
    for _ in range(2):
        np.testing.assert_array_equal(network(inputs()), expected(inputs()))
    assert len(opened) == 1


def test_where_no_policy_decides_it_is_open_at_once(folder):
    assert isinstance(found("s1"), OnnxExtrapolator)
    assert found("s6") is None


def test_one_that_the_user_names_is_tried_at_once(folder):
    assert isinstance(found(network=folder / SHIPPED), OnnxExtrapolator)
    (folder / "text.onnx").write_text("no model")
    with pytest.raises(DamagedFileError, match=r"text\.onnx is no ONNX model"):
        found(network=folder / "text.onnx")


def test_a_damaged_one_is_refused_before_the_run(folder):
    (folder / SHIPPED).write_bytes((folder / SHIPPED).read_bytes()[:-1])
    with pytest.raises(DamagedFileError, match="checksum differs; install ExWarp again"):
        found()


def test_one_that_is_gone_is_refused_before_the_run(folder):
    (folder / SHIPPED).unlink()
    with pytest.raises(InputError, match="is missing or has no checksum"):
        found()


def test_without_onnxruntime_there_is_no_run(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(MissingExtraError, match="pip install onnxruntime") as refused:
        found()
    with pytest.raises(MissingExtraError) as before:
        models.load_extrapolator(None, 1, "cpu")
    assert str(refused.value) == str(before.value)
