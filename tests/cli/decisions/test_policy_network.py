"""A policy was trained for one network: that another extrapolates is said."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from exwarp_cli.models.policy_files import SHIPPED_TILE_POLICY, load_policy, save_network
from exwarp_cli.policy.state import STATE_VERSION
from tests.cli.decisions.conftest import take
from tests.unit import tiny_policies

NOTE = "was trained for the extrapolator with sha256"
SHIPPED = Path(__file__).parents[3] / "models" / "extrapolator.onnx"


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.fixture
def trained_for(tmp_path):
    """Make a policy that states networks as its metadata."""

    def make(stated: object) -> Path:
        path = tmp_path / "mine.npz"
        metadata = {"state": STATE_VERSION, "extrapolator": stated}
        save_network(path, tiny_policies.taking("S3"), metadata)
        return path

    return make


@pytest.fixture
def start(exwarp, uneven, tmp_path):
    """Return what a run says at its start."""

    def say(*options: object) -> str:
        keys, *rest = uneven["key"]
        line = ("upsample", keys, "-o", tmp_path / "out", *rest, "--causal", "--dry-run", *options)
        result = exwarp(*line)
        assert result.code == 0, result.err
        return result.err

    return say


def test_another_network_under_the_shipped_policy(start, network):
    said = start("--extrapolator", network)
    (line,) = (line for line in said.splitlines() if NOTE in line)
    (known,) = load_policy(None, SHIPPED_TILE_POLICY).trained_for
    assert f"tile-policy.npz {NOTE} {known[:8]}" in line
    assert f"{network.name} has {digest(network)[:8]}" in line
    assert "exwarp train tile-policy" in line


def test_a_policy_for_another_network(start, trained_for):
    said = start("--policy", trained_for(["0123456789abcdef" * 4]))
    assert f"mine.npz {NOTE} 01234567, and extrapolator.onnx has {digest(SHIPPED)[:8]}" in said


def test_of_the_shipped_network_and_policy_nothing_is_said(start):
    assert NOTE not in start()


def test_where_both_fit_nothing_is_said(start, network, trained_for):
    both = ["0" * 64, digest(network)]
    assert NOTE not in start("--extrapolator", network, "--policy", trained_for(both))


@pytest.mark.parametrize("stated", [None, 7, {}])
def test_a_policy_that_does_not_say(start, network, trained_for, stated):
    assert NOTE not in start("--extrapolator", network, "--policy", trained_for(stated))


def test_the_report_says_it_too(uneven, network, trained_for, tmp_path):
    given = ("--causal", "--extrapolator", network, "--policy", trained_for(["ab" * 32]))
    given += ("--frames", 1)
    policy = take(uneven["key"], tmp_path / "out", *given).report["policy"]
    assert policy["trained_for"] == ["ab" * 32] and f"{NOTE} abababab" in policy["note"]
    assert NOTE in (tmp_path / "out-report" / "report.html").read_text()


def test_a_benchmark_says_it_too(exwarp, uneven, truth, network, tmp_path):
    line = ("bench", *uneven["key"], "--ground-truth", truth, "-o", tmp_path / "bench")
    how = ("--systems", "exwarp", "--metrics", "psnr", "--frames", 1, "--jobs", 1)
    result = exwarp(*line, *how, "--extrapolator", network)
    assert result.code == 0 and result.err.count(NOTE) == 1
    assert NOTE in (tmp_path / "bench" / "bench.json").read_text()
