"""Slot G-buffers without colour, with coarse depth: the key frames' colour tells their vectors."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.blender_layers import FLOAT, HALF, layer
from tests.cli import shots
from tests.cli.street import Street

pytestmark = pytest.mark.usefixtures("unpainted_plots")

STREET = Street(96, 54)
KEYS, LEVELS = 3, 106


def coarse(depth: np.ndarray) -> np.ndarray:
    """Round depth to levels that lie closer near the camera; 0 for the sky."""
    least, most = np.log(1.0), np.log(14.0)
    level = np.rint((np.log(np.minimum(depth, 14.0)) - least) / (most - least) * (LEVELS - 1))
    return np.where(np.isinf(depth), 0, np.exp(least + level / (LEVELS - 1) * (most - least)))


def slot(folder: Path, number: int, time: float, sign: float = 1.0) -> None:
    """One file a pass, as ExtraNet dumps them: half vectors, depth, normals and a mask."""
    g = STREET.geometry(time)
    sky = np.isinf(g["depth"])
    passes = {
        "MotionVector": (sign * g["slot_previous"] * [-1, 1], HALF),
        "SceneDepth": (coarse(g["depth"])[..., None], FLOAT),
        "WorldNormal": (np.where(sky[..., None], -1, g["normal"]), HALF),
        "MyStencil": (g["id"][..., None], HALF),
    }
    for name, (image, kind) in passes.items():
        planes = layer("", "RGB"[: image.shape[-1]], image, kind)
        shots.write(folder / f"Street{name}.{number:04d}.exr", {"": planes})


def in_8_bits(colour: np.ndarray) -> np.ndarray:
    """Colours as an 8-bit file holds them, by a square root."""
    return (np.rint(np.sqrt(np.clip(colour, 0, 1)) * 255) / 255) ** 2


def written(folder: Path, sign: float = 1.0) -> tuple[Path, Path]:
    """Key frames of colour alone, and the slots."""
    for order in range(4 * KEYS - 3):
        slot(folder / "slots", 1 + order, order / 4, sign)
        if order % 4 == 0:
            planes = layer("", "RGB", in_8_bits(STREET.colour(order / 4)[..., :3]), HALF)
            shots.write(folder / "keys" / f"shot.{1 + order:04d}.exr", {"": planes})
    return folder / "keys", folder / "slots"


@pytest.fixture(scope="module")
def shot(tmp_path_factory) -> tuple[Path, Path]:
    return written(tmp_path_factory.mktemp("coarse"))


def motion_of(report: Path) -> dict:
    return json.loads((report / "report.json").read_text())["input"]["motion"]


def test_it_runs_without_a_flag_and_as_with_one(upsample, shot, tmp_path):
    keys, slots = shot
    common = ("-m", "s6", "--gbuffers", slots, "--frames", "1,5", "--report")
    upsample(keys, tmp_path / "plain", *common, tmp_path / "a")
    upsample(keys, tmp_path / "given", *common, tmp_path / "b", "--motion", "unreal")
    motion = motion_of(tmp_path / "a")
    assert motion["source"] == "calibrated"
    assert motion["evidence"].startswith("previous=-R,G measured on frames 1-2")
    assert "the colour of key frames 1-5, 5-9" in motion["evidence"]
    assert motion_of(tmp_path / "b")["evidence"] == "previous=-R,G given by --motion"
    for number in (2, 3, 4, 6):
        name = f"shot.{number:04d}.exr"
        plain, given = (shots.colour_of(tmp_path / folder / name) for folder in ("plain", "given"))
        np.testing.assert_array_equal(plain, given)


def test_names_that_are_wrong_are_still_overruled(upsample, tmp_path):
    keys, slots = written(tmp_path, sign=-1.0)
    report = tmp_path / "report"
    options = ("--gbuffers", slots, "--frames", "1", "--report", report)
    upsample(keys, tmp_path / "out", "-m", "s6", *options)
    motion = motion_of(report)
    assert motion["source"] == "corrected"
    assert motion["evidence"].startswith("previous=R,-G measured")
    assert "the names say previous=-R,G" in motion["evidence"]
