"""The gate: a network makes frames only where it predicts the shot's own key frames better."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli import shots
from tests.cli.shots import VECTORS
from tests.cli.street import Dimmed, Street
from tests.matrix import spread
from tests.unit import tiny_lookahead, tiny_models

SMALL = Street(48, 27, speed=0.3)
KEYS = 10
"""Two blocks of key intervals."""


def keys_of(folder: Path, street: Street, count: int = KEYS) -> Path:
    return shots.sequence(folder / "keys", shots.blender5, range(1, count + 1), street)


@pytest.fixture(scope="module")
def dimmed(tmp_path_factory) -> Path:
    """Key frames of which the third is darker: the second looks as the first does; read only."""
    return keys_of(tmp_path_factory.mktemp("dimmed"), Dimmed(48, 27, speed=0.3))


@pytest.fixture(scope="module")
def steady(tmp_path_factory) -> Path:
    """Key frames in steady light; read only."""
    return keys_of(tmp_path_factory.mktemp("steady"), SMALL)


@pytest.fixture(scope="module")
def nets(tmp_path_factory) -> Mapping[str, Path]:
    """Networks that show the key frame before, and the key frame after; read only."""
    folder = tmp_path_factory.mktemp("nets")
    return {
        name: tiny_lookahead.save(folder / f"{name}.onnx", tiny_lookahead.one_candidate(index))
        for name, index in (("before", 1), ("after", 2))
    }


@pytest.fixture
def gate(upsample, tmp_path) -> Callable[..., tuple[Path, dict[str, Any]]]:
    """Upsample with a network; return the folder, and what is reported."""

    def run(keys: Path, name: str, *options: object) -> tuple[Path, dict[str, Any]]:
        out = tmp_path / name
        named = "--estimate-motion" in options or "--motion" in options
        vectors = () if named else VECTORS
        return out, json.loads(upsample(keys, out, *vectors, "--json", *options).out)

    return run


def assert_same_colour(folder: Path, other: Path) -> None:
    assert shots.names(folder) == shots.names(other) != []
    for name in shots.names(folder):
        expected = shots.colour_of(other / name)
        np.testing.assert_array_equal(shots.colour_of(folder / name), expected, err_msg=name)


def test_a_network_that_predicts_key_frames_better_makes_the_frames(gate, dimmed, nets):
    net = ("--interpolator", nets["before"])
    out, document = gate(dimmed, "gated", *net, "--frames", "1-8", "--no-tail", "--effort", 1)
    alone, _ = gate(dimmed, "alone", *net, "--frames", "1-8", "-m", "lookahead", "--no-tail")
    assert_same_colour(out, alone)
    (trial,) = document["decisions"]["gate"]
    assert trial["frame"] == 2 and trial["used"] == "lookahead"
    assert trial["lookahead_db"] > trial["softsplat_db"] + 3
    assert trial["keys"] == list(range(1, 9))
    assert document["decisions"]["look_ahead"] == {"cheap": 0, "dear": 24}


@pytest.mark.parametrize("shot", spread(["dimmed", "steady"], 1))
def test_a_network_that_predicts_them_worse_makes_none(gate, nets, request, shot):
    keys = request.getfixturevalue(shot)
    out, document = gate(keys, "gated", "--interpolator", nets["after"], "--no-tail")
    alone, _ = gate(keys, "alone", "-m", "softsplat", "--no-tail")
    assert_same_colour(out, alone)
    trials = document["decisions"]["gate"]
    assert [(trial["frame"], trial["used"]) for trial in trials] == [
        (2, "softsplat"),
        (9, "softsplat"),
    ]
    assert [len(trial["keys"]) for trial in trials] == [8, 1]
    assert document["decisions"]["look_ahead"] == {"cheap": 27, "dear": 0}


def test_without_the_gate_the_network_makes_all_frames(gate, steady, nets):
    net = ("--interpolator", nets["after"], "--frames", "1-3")
    out, document = gate(steady, "open", *net, "--no-gate", "--effort", 1)
    alone, _ = gate(steady, "alone", *net, "-m", "lookahead")
    assert_same_colour(out, alone)
    assert document["decisions"]["gate"] is None


def test_chunks_agree_with_the_whole(gate, dimmed, nets):
    net = ("--interpolator", nets["before"])
    whole, document = gate(dimmed, "whole", *net)
    for chunk in ("9-10", "4-8", "1-3"):
        parts, _ = gate(dimmed, "parts", *net, "--frames", chunk, "--overwrite")
    assert shots.contents(parts) == shots.contents(whole)
    used = [trial["used"] for trial in document["decisions"]["gate"]]
    assert used == ["lookahead", "softsplat", "extrapolate"]  # the last has no next key frame


@pytest.mark.parametrize("setting", ["key", "slot"])
def test_so_do_causal_ones(gate, shot, network, setting):
    keys, *rest = shot[setting]
    options = (*rest, "--causal", "--extrapolator", network)
    whole, _ = gate(keys, "whole", *options)
    for chunk in ("4-5", 2, 1, 3):
        parts, _ = gate(keys, "parts", *options, "--frames", chunk, "--overwrite")
    assert shots.contents(parts) == shots.contents(whole)


def test_a_resumed_run_reports_the_same(gate, dimmed, nets):
    net = ("--interpolator", nets["before"])
    _, first = gate(dimmed, "out", *net)
    _, again = gate(dimmed, "out", *net, "--skip-existing")
    assert again["frames"]["resumed"] == again["frames"]["written"]
    assert again["decisions"] == first["decisions"]


def test_frames_depend_on_the_key_frames_that_were_tried(gate, steady, nets, tmp_path):
    keys = keys_of(tmp_path, SMALL)
    net = ("--interpolator", nets["before"], "--frames", "5-6", "--no-tail")
    _, first = gate(keys, "out", *net)
    assert first["decisions"]["gate"][0]["used"] == "softsplat"
    for number in (1, 2, 3):
        shots.blender5(keys / f"shot.{number:04d}.exr", Dimmed(48, 27, speed=0.3), number - 1)
    _, second = gate(keys, "out", *net, "--skip-existing")
    assert second["frames"]["resumed"] == 2  # the key frames
    assert second["decisions"]["gate"][0]["used"] == "lookahead"


def test_two_key_frames_leave_none_to_predict(gate, upsample, nets, tmp_path):
    keys = keys_of(tmp_path, SMALL, 2)
    net = ("--interpolator", nets["before"])
    _, document = gate(keys, "out", *net, "--no-tail")
    (trial,) = document["decisions"]["gate"]
    assert trial == {
        "frame": None, "softsplat_db": None, "lookahead_db": None, "used": "softsplat", "keys": [1],
    }  # fmt: skip
    said = upsample(keys, tmp_path / "again", *VECTORS, *net, "--no-tail").out
    assert "softsplat in 1 interval; 1 of these without a key frame to try it on" in said


def test_no_key_frame_is_predicted_across_a_cut(gate, dimmed, nets):
    net = ("--interpolator", nets["before"], "--cuts", "3", "--no-tail")
    _, document = gate(dimmed, "out", *net)
    trials = {trial["frame"]: trial["keys"] for trial in document["decisions"]["gate"]}
    assert trials == {None: [1], 2: [2], 4: [3, 4, 5, 6, 7, 8], 9: [9]}  # 2: by the first alone


@pytest.mark.parametrize("convention", ["previous=X,-Y", "next=-Z,W"])
def test_vectors_may_lead_one_way_alone(upsample, dimmed, nets, tmp_path, convention):
    for name, used in (("before", "lookahead"), ("after", "softsplat")):
        net = ("--interpolator", nets[name], "--frames", "1-8", "--no-tail")
        said = upsample(dimmed, tmp_path / name, "--motion", convention, *net).out
        assert f"network tried on the shot's own key frames: {used} in 8 intervals" in said


def test_slots_with_g_buffers_are_followed_across_both_intervals(gate, nets, tmp_path):
    street = Dimmed(48, 27, speed=0.3)
    keys = shots.sequence(tmp_path / "keys", shots.colour_only, range(1, 6), street)
    slots = shots.sequence(tmp_path / "slots", shots.slot_gbuffer, range(1, 18), street, step=0.25)
    for name in ("before", "after"):
        net = ("--gbuffers", slots, "--interpolator", nets[name], "--no-tail")
        _, document = gate(keys, name, *net)
        (trial,) = document["decisions"]["gate"]
        assert trial["frame"] == 2
        assert trial["used"] == ("lookahead" if name == "before" else "softsplat")


def test_stills_are_tried_by_estimated_motion(gate, nets, tmp_path):
    keys = shots.sequence(
        tmp_path / "keys", shots.colour_only, range(1, 6), Dimmed(48, 27, speed=0.3)
    )
    for name in ("before", "after"):
        _, document = gate(
            keys, name, "--interpolator", nets[name], "--no-tail", "--estimate-motion"
        )
        (trial,) = document["decisions"]["gate"]
        assert trial["used"] == ("lookahead" if name == "before" else "softsplat")


@pytest.mark.parametrize("setting", ["key", "slot"])
def test_causal_extrapolates_where_that_predicts_key_frames_better(gate, setting, tmp_path):
    """The fourth key frame is darker, and so is all that the network makes."""
    street = Dimmed(48, 27, speed=0.3, last_bright=2)
    model = tiny_models.save(tmp_path / "dark.onnx", tiny_models.filled_warp(0.8))
    options: tuple[object, ...] = ("--causal", "--policy", "paper", "--extrapolator", model)
    if setting == "key":
        keys = keys_of(tmp_path, street, 6)
    else:
        keys = shots.sequence(tmp_path / "keys", shots.colour_only, range(1, 7), street)
        slots = shots.sequence(
            tmp_path / "slots", shots.slot_gbuffer, range(1, 22), street, step=0.25
        )
        options = (*options, "--gbuffers", slots)
    _, document = gate(keys, "out", *options)
    trials = document["decisions"]["gate"]
    assert [(trial["frame"], trial["used"]) for trial in trials] == [
        (None, "warp"), (2, "warp"), (3, "warp"), (4, "extrapolate"),
    ]  # fmt: skip
    assert [trial["keys"] for trial in trials] == [[1], [2], [3], [4, 5, 6]]
    _, alone = gate(keys, "alone", *options, "--no-gate")
    paths, ungated = document["decisions"]["paths"], alone["decisions"]["paths"]
    assert paths["S6"] == 3 + (ungated["S6"] == 6) * 3


def test_causal_trials_use_past_key_frames_alone(gate, network, tmp_path):
    """Frames up to a key frame stay as they are when the ones after it change."""
    short, long = keys_of(tmp_path / "a", SMALL, 6), keys_of(tmp_path / "b", SMALL, 6)
    for number in (5, 6):
        shots.blender5(long / f"shot.{number:04d}.exr", Dimmed(48, 27, speed=0.3), number - 1)
    options = ("--causal", "--extrapolator", network, "--frames", "1-4", "--cuts", "none")
    first, _ = gate(short, "first", *options)
    second, _ = gate(long, "second", *options)
    assert shots.contents(first) == shots.contents(second)


@pytest.mark.parametrize("method", ["s6", "softsplat", "lookahead"])
def test_methods_without_a_gate_refuse_the_option(exwarp, steady, tmp_path, method):
    result = exwarp("upsample", steady, "-o", tmp_path / "out", "-m", method, "--no-gate")
    result.refused(2, "--no-gate is for exwarp and --causal", f"--method {method}")
