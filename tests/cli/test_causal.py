"""`--causal`, which keeps to past key frames; `test_gate` has the default."""

from __future__ import annotations

import pytest

from tests.cli import shots


@pytest.mark.parametrize("method", [(), ("-m", "exwarp"), ("-m", "causal")])
def test_causal_asks_for_the_policy(upsample, shot, network, tmp_path, method):
    keys, *rest = shot["key"]
    options = (*rest, "--extrapolator", network)
    upsample(keys, tmp_path / "flag", *options, "--causal", *method)
    upsample(keys, tmp_path / "named", *options, "-m", "causal")
    assert shots.contents(tmp_path / "flag") == shots.contents(tmp_path / "named")


def test_what_is_causal_anyway_stays_what_it_is(upsample, shot, tmp_path):
    keys, *rest = shot["key"]
    for name, options in (("plain", ()), ("causal", ("--causal",))):
        upsample(keys, tmp_path / name, *rest, "-m", "s6", *options)
    assert shots.contents(tmp_path / "plain") == shots.contents(tmp_path / "causal")


@pytest.mark.parametrize("method", ["softsplat", "lookahead", "onnx", "blend"])
def test_a_method_that_looks_ahead_is_refused(exwarp, shot, tmp_path, method):
    keys, *rest = shot["key"]
    result = exwarp("upsample", keys, "-o", tmp_path / "out", *rest, "--causal", "-m", method)
    result.refused(2, "--causal keeps to past key frames", f"--method {method}")
    assert not (tmp_path / "out").exists()
