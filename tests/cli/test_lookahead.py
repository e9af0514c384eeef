"""`exwarp upsample --method lookahead`, on files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from tests.blender_layers import HALF, layer, multipart
from tests.cli import shots
from tests.cli.shots import VECTORS
from tests.cli.street import Street
from tests.unit import tiny_lookahead, tiny_models

MARKET = Path(__file__).parents[2] / "examples" / "market"

COUNT = 3
BRIGHT = 8.0
"""Exposure of the street: most of it is brighter than white."""

DIRECT = 0.25
"""Share of the light that the first of two passes holds."""


class Bright(Street):
    """The street in sunlight, beyond what a screen shows."""

    def colour(self, time: float) -> np.ndarray:
        return np.asarray(super().colour(time) * [BRIGHT, BRIGHT, BRIGHT, 1])


STREET = Bright(speed=0.3)


def lit(path: Path, street: Street, time: float) -> None:
    """Write Blender's passes, and two light passes that add up to the beauty."""
    colour = street.colour(time)[..., :3]
    groups = [
        *shots.blender_passes(street, time),
        layer("Diffuse Direct", "RGB", DIRECT * colour, HALF),
        layer("Diffuse Indirect", "RGB", (1 - DIRECT) * colour, HALF),
    ]
    shots.write(path, multipart(groups), shots.header())


@pytest.fixture(scope="module")
def keys(tmp_path_factory) -> Path:
    """Key frames of bright light in two passes; read only."""
    return shots.sequence(
        tmp_path_factory.mktemp("bright") / "keys", lit, range(1, COUNT + 1), STREET
    )


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Path:
    """A network of random weights; read only."""
    path = tmp_path_factory.mktemp("net") / "tiny.onnx"
    return tiny_lookahead.save(path, tiny_lookahead.nearer_side())


@pytest.fixture
def look_ahead(upsample, keys, model, tmp_path) -> Callable[..., Path]:
    """Upsample the key frames by the tiny network; return the folder."""

    def run(name: str, *options: object) -> Path:
        asked = ("-m", "lookahead", "--interpolator", model, *VECTORS, *options)
        upsample(keys, tmp_path / name, *asked)
        return tmp_path / name

    return run


def test_frames_and_report_name_the_network(look_ahead, model, tmp_path):
    out = look_ahead("out", "--report", tmp_path / "report")
    document = json.loads((tmp_path / "report" / "report.json").read_text())
    assert (document["method"], document["lookahead"]) == ("lookahead", True)
    digest = hashlib.sha256(model.read_bytes()).hexdigest()
    assert document["interpolator"]["sha256"] == digest
    header, _ = shots.read(out / "shot.0002.exr")
    assert header["exwarp:method"] == "lookahead"
    assert header["exwarp:madeBy"] == "lookahead"
    assert header["exwarp:sources"] == "1,2"


def layers_of(path: Path) -> dict[str, np.ndarray]:
    """Return the colour of each layer, float64 [H, W, 3], by the last word of its name."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        planes = {
            tuple(name.split(".")[-2:]): channel.pixels.astype(np.float64)
            for part in file.parts
            for name, channel in part.channels.items()
        }
    return {
        name: np.stack([planes[name, component] for component in "RGB"], -1)
        for name, component in planes
        if component == "R"
    }


def test_light_passes_add_up_and_highlights_stay(look_ahead, keys):
    out = look_ahead("out", "--layers", "all")
    brightest = max(shots.colour_of(path)[..., :3].max() for path in keys.iterdir())
    for number in (2, 3, 4):
        layers = layers_of(out / f"shot.{number:04d}.exr")
        passes, beauty = layers["Diffuse Direct"] + layers["Diffuse Indirect"], layers["Combined"]
        np.testing.assert_allclose(passes, beauty, rtol=5e-3, atol=5e-3)
        assert np.median(beauty) > 2 and beauty.max() <= brightest


def test_threads_and_tiles_and_chunks_change_nothing(look_ahead, monkeypatch):
    whole = shots.contents(look_ahead("one", "--threads", 1))
    for chunk in ("2-3", "1"):
        look_ahead("parts", "--frames", chunk, "--threads", 3)
    assert shots.contents(look_ahead("parts", "--skip-existing")) == whole
    monkeypatch.setattr("exwarp_cli.models.picture_network.MAX_PIXELS", 600)
    assert shots.contents(look_ahead("tiled")) == whole


def test_another_kind_of_network_is_refused(exwarp, keys, tmp_path):
    path = tiny_models.save(tmp_path / "other.onnx", tiny_models.filled_warp())
    asked = ("-m", "lookahead", "--interpolator", path, *VECTORS)
    result = exwarp("upsample", keys, "-o", tmp_path / "out", "--progress", "none", *asked)
    result.refused(3, "other.onnx")
    assert not (tmp_path / "out").exists()


def test_motion_may_be_estimated(upsample, tmp_path, model):
    keys = shots.sequence(tmp_path / "keys", shots.colour_only, range(1, 3), STREET)
    upsample(keys, tmp_path / "out", "-m", "lookahead", "--interpolator", model)
    header, _ = shots.read(tmp_path / "out" / "shot.0002.exr")
    assert header["exwarp:method"] == "lookahead"


def test_the_shipped_network_is_better_than_softsplat(upsample, tmp_path):
    """On a scene that it was not trained on."""
    found = {}
    for method in ("softsplat", "lookahead"):
        truth = ("--ground-truth", MARKET / "truth", "--metrics", "psnr", "--json")
        asked = ("-m", method, "--frames", "3", *truth)
        document = json.loads(upsample(MARKET / "keys", tmp_path / method, *asked).out)
        found[method] = document["quality"]["all"]["psnr_db"]
    assert found["lookahead"] > found["softsplat"] + 0.05
