"""Policies that cannot be used: one sentence, and no frame."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.accelerator.mlp import QuantisedLayer, QuantisedMlp, Requantisation
from exwarp_cli.models.policy_files import save_network
from exwarp_cli.policy.state import STATE_VERSION
from tests.cli import shots
from tests.unit.tiny_policies import always, save


@pytest.fixture
def refused(exwarp, uneven, network, tmp_path):
    """Run and judge the refusal."""

    def run(code: int, *words: str, options: tuple[object, ...], model: bool = True) -> None:
        keys, *rest = uneven["key"]
        more = ("--extrapolator", network) if model else ()
        line = ("upsample", keys, "-o", tmp_path / "out", *rest, *more, "--progress", "none")
        exwarp(*line, *options).refused(code, *words)
        assert not (tmp_path / "out").exists()

    return run


@pytest.mark.parametrize("method", ["s6", "s3", "oracle", "softsplat", "hold"])
def test_a_policy_for_a_method_that_asks_none(refused, policies, truth, method):
    options = ("-m", method, "--policy", policies("watching"), "--ground-truth", truth)
    words = ("--policy is for --causal", f"--method {method} asks no policy")
    refused(2, *words, options=options, model=method in ("s3", "oracle"))


@pytest.mark.parametrize("version", [0, STATE_VERSION + 1, None, "1"])
def test_a_policy_for_other_states(refused, tmp_path, version):
    path = save(tmp_path / "old.npz", always("warp"), state=version)
    words = ("old.npz", f"44 inputs of version {version!r}", f"of version {STATE_VERSION}")
    refused(3, *words, "train the policy again", options=("--causal", "--policy", path))


def test_a_policy_that_says_nothing_of_states(refused, tmp_path):
    save_network(tmp_path / "p.npz", always("warp"), {})
    refused(3, "p.npz", "version None", options=("--causal", "--policy", tmp_path / "p.npz"))


def test_a_policy_of_another_size(refused, tmp_path):
    scale = Requantisation(np.ones(11, np.int32), np.zeros(11, np.uint8))
    layer = QuantisedLayer(np.zeros((2, 11), np.int8), np.zeros(2, np.int32), None)
    path = save(tmp_path / "one.npz", QuantisedMlp(scale, (layer,)))
    refused(3, "one.npz takes 11 inputs", "a state has 44", options=("--causal", "--policy", path))


@pytest.mark.parametrize("content", [None, b"", b"text" * 99])
def test_no_policy_at_all(refused, tmp_path, content):
    if content is not None:
        (tmp_path / "p.npz").write_bytes(content)
    refused(3, "p.npz", "check the path", options=("--causal", "--policy", tmp_path / "p.npz"))


def test_no_motion(exwarp, policies, network, tmp_path):
    keys = shots.sequence(tmp_path / "keys", shots.colour_only, street=shots.SMALL)
    options = (
        "--causal",
        "--policy",
        policies("warp"),
        "--extrapolator",
        network,
        "--progress",
        "none",
    )
    result = exwarp("upsample", keys, "-o", tmp_path / "out", *options)
    result.refused(3, "no motion vectors", "softsplat, for which it is estimated")
    assert not (tmp_path / "out").exists()
