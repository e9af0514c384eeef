"""After the last key frame of a shot the default makes frames as `--causal` does."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli import shots
from tests.cli.shots import VECTORS
from tests.cli.street import Dimmed
from tests.unit import tiny_models

COUNT = 6
TAIL = tuple(f"shot.{number:04d}.exr" for number in (22, 23, 24))

Run = Callable[..., tuple[Path, dict[str, Any]]]


# The fourth key frame is the first dark one.
STREET = Dimmed(48, 27, speed=0.3, last_bright=2)


@pytest.fixture(scope="module")
def keys(tmp_path_factory) -> Path:
    """Key frames; read only."""
    folder = tmp_path_factory.mktemp("tail") / "keys"
    return shots.sequence(folder, shots.blender5, range(1, COUNT + 1), STREET)


@pytest.fixture(scope="module")
def models(tmp_path_factory) -> dict[str, Path]:
    """Networks whose frames are darker, and brighter; read only."""
    folder = tmp_path_factory.mktemp("models")
    gains = {"dark": 0.8, "bright": 1.5}
    return {
        name: tiny_models.save(folder / f"{name}.onnx", tiny_models.filled_warp(gain))
        for name, gain in gains.items()
    }


@pytest.fixture
def run(upsample, keys, models, tmp_path) -> Run:
    """Upsample the street; return the folder, and what is reported."""

    def upsampled(name: str, model: str, *options: object) -> tuple[Path, dict[str, Any]]:
        out = tmp_path / name
        model_options = ("--extrapolator", models[model]) if model else ()
        return out, json.loads(
            upsample(keys, out, *VECTORS, "--json", *model_options, *options).out
        )

    return upsampled


def colours(folder: Path, names: tuple[str, ...] = TAIL) -> list[np.ndarray]:
    return [shots.colour_of(folder / name) for name in names]


def assert_alike(folder: Path, other: Path, names: tuple[str, ...] = TAIL) -> None:
    for made, expected in zip(colours(folder, names), colours(other, names), strict=True):
        np.testing.assert_array_equal(made, expected)


@pytest.mark.parametrize("effort", [0.5, 1])
def test_frames_after_the_last_key_frame_are_those_of_causal(run, effort):
    out, document = run("out", "dark", "--effort", effort)
    causal, past = run("causal", "dark", "--causal", "--effort", effort)
    assert_alike(out, causal)
    trial = document["decisions"]["gate"][-1]
    assert trial == past["decisions"]["gate"][-1] | {"keys": [COUNT]}
    assert (trial["frame"], trial["used"]) == (4, "extrapolate")
    warped, _ = run("warped", "", "-m", "s6", "--frames", COUNT)
    third = TAIL[-1:]
    assert not np.array_equal(colours(out, third), colours(warped, third))


def test_the_report_counts_the_tiles_and_the_area(run):
    _, document = run("out", "dark", "--effort", 1)
    decisions = document["decisions"]
    made = {path: count for path, count in decisions["paths"].items() if count}
    assert set(made) == {"S3"}
    ahead = decisions["look_ahead"]
    area = (ahead["dear"] + 2) / (3 * COUNT)  # of the last three, slots 2 and 3
    assert decisions["cost"] == pytest.approx(area)
    assert decisions["warp_share"] == pytest.approx(1 - area)


def test_a_network_that_predicts_key_frames_worse_makes_none_of_them(run):
    out, document = run("out", "bright", "--effort", 1)
    warped, _ = run("warped", "", "-m", "s6", "--frames", COUNT)
    assert_alike(out, warped)
    assert document["decisions"]["gate"][-1]["used"] == "warp"
    ungated, document = run("ungated", "bright", "--effort", 1, "--no-gate")
    assert document["decisions"]["gate"] is None
    assert np.mean(colours(ungated)[-1]) > 1.05 * np.mean(colours(out)[-1])


def test_a_cut_ends_a_shot_as_well(run):
    options = ("--cuts", "5", "--no-tail", "--effort", 1)
    out, document = run("out", "dark", *options)
    causal, _ = run("causal", "dark", "--causal", *options)
    names = tuple(f"shot.{number:04d}.exr" for number in (14, 15, 16))
    assert_alike(out, causal, names)
    used = {key: trial["used"] for trial in document["decisions"]["gate"] for key in trial["keys"]}
    assert used[4] == "extrapolate"


def test_chunks_agree_with_the_whole(run):
    whole, _ = run("whole", "dark")
    for chunk in (COUNT, f"1-{COUNT - 1}"):
        parts, _ = run("parts", "dark", "--frames", chunk, "--overwrite")
    assert shots.contents(parts) == shots.contents(whole)


def test_another_network_makes_these_frames_alone_again(run):
    run("out", "dark")
    _, again = run("out", "bright", "--skip-existing")
    assert again["frames"]["written"] - again["frames"]["resumed"] == len(TAIL)
    _, effort = run("out", "bright", "--skip-existing", "--effort", 0.9)
    assert effort["frames"]["written"] - effort["frames"]["resumed"] == 3 * COUNT


def test_no_effort_runs_no_network(run):
    out, document = run("out", "", "--effort", 0)
    plain, _ = run("plain", "", "-m", "softsplat")
    names = tuple(shots.names(plain))
    assert_alike(out, plain, names)
    assert document["extrapolator"] is None and document["interpolator"] is None


@pytest.mark.parametrize("options", [("--layers", "all"), ("--factor", 2)])
def test_where_it_cannot_the_key_frame_is_warped(upsample, keys, tmp_path, options):
    said = upsample(keys, tmp_path / "out", *VECTORS, "--frames", COUNT, *options)
    assert "exwarp falls back to s6 there" in said.err
    upsample(keys, tmp_path / "warped", *VECTORS, "--frames", COUNT, "-m", "s6", *options)
    names = tuple(shots.names(tmp_path / "out"))
    assert_alike(tmp_path / "out", tmp_path / "warped", names)


def test_frames_that_were_rendered_after_all_leave_warps_beside_them(run, tmp_path):
    rendered = tmp_path / "rendered"
    rendered.mkdir()
    shots.blender5(rendered / TAIL[1], STREET, COUNT - 1 + 0.5)
    out, document = run("out", "dark", "--effort", 1, "--rendered", rendered)
    assert document["frames"]["rendered"] == 1
    used = {key: trial["used"] for trial in document["decisions"]["gate"] for key in trial["keys"]}
    assert COUNT not in used
    assert len(colours(out)) == len(TAIL)
