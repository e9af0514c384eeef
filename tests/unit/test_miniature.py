"""The loader and the survey on a small real render."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from exwarp_cli.io.channels import Role
from exwarp_cli.io.dataset import TRAINING, find_scenes
from exwarp_cli.io.frames import read_raw
from exwarp_cli.pipeline.motion_convention import find_motion, motion_names, parse_motion
from exwarp_cli.research.training.augmentation import Variant
from exwarp_cli.research.training.scene_clip import SceneClip
from tests.matrix import combinations, spread
from tests.unit.analytic_scene import write_scene

MINIATURE = Path(__file__).parents[1] / "data" / "miniature"
SCRIPTS = Path(__file__).parents[2] / "examples" / "scenes"


@pytest.fixture(scope="module")
def scene():
    (found,) = find_scenes(MINIATURE, TRAINING)
    return found


def test_it_is_whole_and_small(scene):
    scene.require_complete()
    assert scene.manifest.renderer.startswith("Blender")
    assert set(scene.instants.layout.roles) == set(scene.keys.layout.roles) == set(Role)
    assert sum(path.stat().st_size for path in MINIATURE.rglob("*")) < 2e6


def test_the_manifest_names_every_object(scene):
    seen = set()
    for number in scene.manifest.instants.numbers:
        raw = read_raw(scene.instants, number, (Role.STENCIL,))
        seen |= set(np.unique(raw.gbuffer.stencil))
    assert len(seen) > 10 and seen - {0, -1} <= set(scene.manifest.dynamic)


def test_the_manifest_says_what_the_channel_names_say(scene):
    for shot in (scene.keys, scene.instants):
        size = (shot.display.width, shot.display.height)
        stated = parse_motion(scene.manifest.motion, motion_names(shot), size)
        assert find_motion(shot, None).convention == stated


def test_key_frames_show_their_instants(scene):
    for k, number in enumerate(scene.manifest.keys.numbers):
        key, instant = read_raw(scene.keys, number), read_raw(scene.instants, 1 + 4 * k)
        np.testing.assert_array_equal(key.image.pixels, instant.image.pixels)
        np.testing.assert_array_equal(key.gbuffer.position, instant.gbuffer.position)


def test_motion_over_a_key_interval_is_that_of_the_true_key_frames(scene):
    """Vectors followed over four instants, beside those that a 30 fps render has."""
    footage = SceneClip(scene)
    for k in footage.intervals:
        for index, frame, side in ((4 * k, k, "to_next"), (4 * k + 4, k + 1, "to_previous")):
            gbuffer = footage.key(frame).gbuffer
            found = footage._spanned(index, 4, 1 if side == "to_next" else -1)
            gap = np.linalg.norm(found - getattr(gbuffer, side), axis=-1)
            still, moving = gap[gbuffer.stencil == 0], gap[gbuffer.stencil != 0]
            assert np.percentile(still, 95) < 0.02
            assert np.median(moving) < 0.3 and np.percentile(moving, 90) < 0.5


VARIANTS = [
    Variant(phase, backwards, speed)
    for phase, backwards, speed in combinations((0, 3), (True, False), (1, 2))
]


@pytest.mark.parametrize("variant", VARIANTS, ids=str)
def test_every_variant_is_whole(scene, variant):
    footage = SceneClip(scene, variant)
    for k in spread(footage.intervals, 2):
        for setting in ("key", "slot"):
            interval = footage.interval(k, setting)
            assert interval.back(2).field.shape == (36, 64, 2)
        frame = footage.slot(k, 2)
        for name in ("albedo", "specular", "roughness", "metallic", "normal", "position"):
            array = getattr(frame.gbuffer, name)
            assert np.isfinite(array).all() and array.shape[:2] == (36, 64)
        assert np.isfinite(footage.truth(k, 1).pixels).all()


def test_played_backwards_the_last_frame_comes_first(scene):
    forward, reverse = SceneClip(scene), SceneClip(scene, Variant(backwards=True))
    np.testing.assert_array_equal(forward.truth(0, 1).pixels, reverse.truth(2, 3).pixels)
    np.testing.assert_array_equal(
        forward.key(1).gbuffer.to_next, reverse.key(2).gbuffer.to_previous
    )


@pytest.fixture
def survey(monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    import survey

    return survey


def test_the_survey_measures_a_scene(survey, tmp_path, capsys):
    """As far as its first two key frames."""
    shutil.copytree(MINIATURE / "variety-0074", tmp_path / "data" / "variety-0074")
    path = tmp_path / "data" / "variety-0074" / "manifest.json"
    facts = json.loads(path.read_text())
    facts["instants"]["count"], facts["keys"]["count"] = 5, 2
    path.write_text(json.dumps(facts | {"role": "benchmark"}))
    for kind, count in (("instants", 5), ("keys", 2)):
        for late in sorted((path.parent / kind).iterdir())[count:]:
            late.unlink()
    survey.main(["--data", str(tmp_path / "data"), "--out", str(tmp_path / "out")])
    row = json.loads((tmp_path / "out" / "statistics.json").read_text())["scenes"]["variety-0074"]
    assert (row["instants"], row["samples"], row["seed"]) == (5, 32, 74)
    assert row["dynamic_objects"] == 20 and 0.2 < row["moving_share"] < 0.6
    assert 0.5 < row["motion_median_px"] < 5 < row["motion_p95_px"] < 20
    assert 0 < row["seconds_per_instant"] < 60
    for setting in ("key", "slot"):
        holes = row["holes"][setting]
        assert 0.05 < holes["slot1"] < holes["slot3"] < 0.4
        assert sum(holes["histogram"].values()) == 3
        for method in ("s6", "softsplat"):
            quality = row["quality"][setting][method]
            assert quality["frames"] == 3 and 15 < quality["psnr_db"] < 30
    printed = capsys.readouterr().out
    assert printed.strip() == (tmp_path / "out" / "STATISTICS.md").read_text().strip()
    assert "| variety-0074 | slot | softsplat |" in printed
    sheet = oiio.ImageInput.open(str(tmp_path / "out" / "variety-0074.jpg"))
    assert (sheet.spec().width, sheet.spec().height) == (960, 270)
    sheet.close()


def test_the_survey_counts_training_shots(survey, tmp_path, capsys):
    out = str(tmp_path)
    survey.main(["--training", "--data", str(MINIATURE), "--out", out])
    row = json.loads((tmp_path / "statistics.json").read_text())["training"]
    assert (row["shots"], row["instants"], row["sizes"]) == (1, 13, {"64x36": 1})
    assert row["motion_median_px"]["least"] == row["motion_median_px"]["most"] > 0
    assert 0.1 < row["hole_share"]["median"] < 0.4
    assert "Training shots: 1 of 13 instants (1 at 64x36)" in capsys.readouterr().out


def test_the_survey_refuses_a_benchmark_scene_with_other_key_frames(survey, tmp_path):
    write_scene(tmp_path / "data" / "analytic", instants=9, key_step=2)
    with pytest.raises(SystemExit, match=r"key frames at every 2 instants.*--key-step 4"):
        survey.main(["--data", str(tmp_path / "data"), "--out", str(tmp_path)])
    assert not (tmp_path / "statistics.json").exists()


def test_the_survey_says_what_is_missing(survey, tmp_path):
    with pytest.raises(SystemExit, match="holds no benchmark scene"):
        survey.main(["--data", str(MINIATURE), "--out", str(tmp_path)])
