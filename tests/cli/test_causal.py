"""`--causal`, which keeps to past key frames; `test_gate` has the default."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli import shots
from tests.cli.conftest import run_quietly


@pytest.fixture(scope="module")
def named(shot, network, tmp_path_factory) -> Path:
    """The frames of the policy, which its name asks for; read only."""
    keys, *rest = shot["key"]
    out = tmp_path_factory.mktemp("named") / "out"
    options = ("-m", "causal", "--extrapolator", network, "--frames", "2-3")
    run_quietly("upsample", keys, "-o", out, *rest, *options)
    return out


@pytest.mark.parametrize("method", [(), ("-m", "exwarp"), ("-m", "causal")])
def test_causal_asks_for_the_policy(upsample, shot, network, named, tmp_path, method):
    keys, *rest = shot["key"]
    options = (*rest, "--extrapolator", network, "--frames", "2-3")
    upsample(keys, tmp_path / "flag", *options, "--causal", *method)
    assert shots.contents(tmp_path / "flag") == shots.contents(named)


def test_what_is_causal_anyway_stays_what_it_is(upsample, shot, tmp_path):
    keys, *rest = shot["key"]
    for name, options in (("plain", ()), ("causal", ("--causal",))):
        upsample(keys, tmp_path / name, *rest, "-m", "s6", "--frames", "2-3", *options)
    assert shots.contents(tmp_path / "plain") == shots.contents(tmp_path / "causal")


@pytest.mark.parametrize("method", ["softsplat", "lookahead", "onnx", "blend"])
def test_a_method_that_looks_ahead_is_refused(exwarp, shot, tmp_path, method):
    keys, *rest = shot["key"]
    result = exwarp("upsample", keys, "-o", tmp_path / "out", *rest, "--causal", "-m", method)
    result.refused(2, "--causal keeps to past key frames", f"--method {method}")
    assert not (tmp_path / "out").exists()
