"""Real renders, tiny: what the scenes' scripts write is what the loader and ExWarp take."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.io.channels import Role
from exwarp_cli.io.dataset import (
    BENCHMARK,
    TRAINING,
    RenderedScene,
    find_scenes,
    open_scene,
)
from exwarp_cli.io.frames import read_image, read_raw
from exwarp_cli.metrics.registry import score_frame
from exwarp_cli.pipeline.run import upsample
from exwarp_cli.research.training.augmentation import Variant
from exwarp_cli.research.training.scene_clip import SceneClip

SCENES = ("lab", "tropical", "village", "town", "slum")
SIZE = ("--resolution", "64x36", "--samples", 2)
SHOT, NAME = 8, "variety-0008"
RASTER_SCENES = ("arena", "courtyard")
RASTER_SIZE = ("--resolution", "64x36", "--samples", 1)
RASTER_SHOT = 7
"""A seed that EEVEE renders."""
REAL_SHOT = 20
"""A seed that wants real shapes and textures."""
PANE_SHOT, PANE_NAME = 21, "variety-0021"
"""A seed with moving things behind a pane of glass."""


@pytest.fixture(scope="module")
def data(script, tmp_path_factory) -> Path:
    """A training shot, rendered in full; read only."""
    folder = tmp_path_factory.mktemp("data")
    done = script("variety", SHOT, "--data", folder, *SIZE)
    assert done.returncode == 0, done.stderr
    assert f"{NAME}: 26 of 26 files to render at 64x36 with 2 samples, about" in done.stdout
    return folder


def test_a_shot_is_complete_and_of_training(data):
    (scene,) = find_scenes(data, TRAINING)
    scene.require_complete()
    manifest = scene.manifest
    assert (manifest.scene, manifest.seed, manifest.width, manifest.height) == (NAME, SHOT, 64, 36)
    assert manifest.renderer.startswith("Blender 5") and manifest.samples == 2
    roles = set(Role)
    assert set(scene.instants.layout.roles) == roles == set(scene.keys.layout.roles)
    leftovers = [p.name for p in data.rglob(".*")]
    assert leftovers == []


def test_what_is_there_and_whole_is_kept(data, script):
    files = sorted(data.rglob("*.exr"))
    before = {path: path.read_bytes() for path in files}
    broken = files[3]
    broken.write_bytes(before[broken][:5000])
    again = script("variety", SHOT, "--data", data, *SIZE)
    assert again.returncode == 0, again.stderr
    assert "1 of 26 files to render" in again.stdout
    assert len(broken.read_bytes()) > 5000
    assert all(path.read_bytes() == before[path] for path in files if path != broken)
    third = script("variety", SHOT, "--data", data, *SIZE)
    assert "all 26 files are there and whole" in third.stdout


def test_another_rendering_is_not_mixed_in(data, script):
    refused = script("variety", SHOT, "--data", data, "--resolution", "64x36", "--samples", 3)
    assert refused.returncode == 1
    assert "holds another rendering (samples is 2, not 3)" in refused.stderr
    assert "Traceback" not in refused.stderr


def test_key_frames_are_instants_with_longer_vectors(data):
    scene = open_scene(data / NAME)
    for number in scene.manifest.keys.numbers:
        key, instant = read_raw(scene.keys, number), read_raw(scene.instants, number)
        np.testing.assert_array_equal(key.image.pixels, instant.image.pixels)
        np.testing.assert_array_equal(key.gbuffer.depth, instant.gbuffer.depth)
        np.testing.assert_array_equal(key.gbuffer.position, instant.gbuffer.position)
        assert not np.array_equal(key.motion, instant.motion)


def composition_gaps(scene: RenderedScene) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield how far motion composed over four instants is from a key frame's vectors, and ids.

    Both [H, W], the gap in pixels; for each of nine key frames both ways.
    """
    composed = SceneClip(scene)
    for index in range(9):
        rendered = SceneClip(scene, Variant(index % 4))
        k = index // 4
        after = composed._spanned(index, 4, 1)
        before = composed._spanned(index + 4, 4, -1)
        for found, frame, name in (
            (after, rendered.key(k), "to_next"),
            (before, rendered.key(k + 1), "to_previous"),
        ):
            gap = np.linalg.norm(found - getattr(frame.gbuffer, name), axis=-1)
            yield gap, frame.gbuffer.stencil


def test_composed_motion_is_that_of_a_true_low_rate_render(data):
    for gap, stencil in composition_gaps(open_scene(data / NAME)):
        still = stencil == 0
        assert np.median(gap[still]) < 0.01 and np.percentile(gap[still], 95) < 0.1
        assert np.percentile(gap, 90) < 0.5


def test_key_frames_have_the_vectors_of_what_is_behind_glass(script, tmp_path):
    done = script("variety", PANE_SHOT, "--data", tmp_path, *SIZE)
    assert done.returncode == 0, done.stderr
    for gap, _ in composition_gaps(open_scene(tmp_path / PANE_NAME)):
        assert np.percentile(gap, 90) < 0.5


def test_a_backward_shot_is_warped_as_well_as_a_forward_one(data):
    scene = open_scene(data / NAME)
    for variant in (Variant(), Variant(backwards=True)):
        interval = SceneClip(scene, variant).interval(1, "key")
        assert interval.back(2).hole.mean() < 0.5


def test_exwarp_takes_the_files_as_they_are(data, tmp_path):
    scene = open_scene(data / NAME)
    keys, instants = tmp_path / "keys", str(data / NAME / "instants")
    keys.mkdir()
    for number in scene.manifest.instants.numbers[::4]:
        shutil.copy(scene.path(scene.manifest.keys, number), keys)
    # From instant to instant so small a picture moves too little to measure what vectors mean.
    source = SourceSettings(str(keys), instants, scene.manifest.motion, tail=False)
    summary = upsample(UpsampleSettings(source, str(tmp_path / "out"), ground_truth=instants))
    assert len(summary.frames) == scene.manifest.instants.count
    assert all(record.score is not None for record in summary.frames if record.slot)


def test_real_things_are_shown_and_named(script, tmp_path):
    """A list of one shape and one texture: a shot shows them, and its manifest names both."""
    things, seed = tmp_path / "things", REAL_SHOT
    (things / "a").mkdir(parents=True)
    corners = [(x, y, z) for x in (0, 1) for y in (0, 2) for z in (0, 1)]
    sides = ("1 3 4 2", "5 6 8 7", "1 2 6 5", "3 7 8 4", "1 5 7 3", "2 4 8 6")
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {side}" for side in sides]
    (things / "a" / "box.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
    paint = np.random.default_rng(1).random((64, 64, 3), np.float32)
    oiio.ImageBuf(paint).write(str(things / "a" / "wall.png"), "uint8")
    row = {"author": "A. Turner", "licence": "CC0", "package": "chairs"}
    listed = [
        {"name": "box", "title": "Box", "kind": "shape", "path": "a/box.obj"} | row,
        {"name": "wall", "title": "wall: w", "kind": "texture", "path": "a/wall.png"} | row,
        {"name": "floor", "title": "floor: w", "kind": "texture", "path": "a/wall.png"} | row,
    ]
    content = {"packages": {"chairs": "1.2"}, "things": listed}
    (things / "things.json").write_text(json.dumps(content), encoding="utf-8")
    part = ("--frames", 1, "--what", "instants", *SIZE)
    done = script("variety", seed, "--data", tmp_path / "real", "--things", things, *part)
    assert done.returncode == 0, done.stderr
    folder = f"variety-{seed:04d}"
    said = json.loads((tmp_path / "real" / folder / "manifest.json").read_text(encoding="utf-8"))
    assert {thing["name"] for thing in said["things"]} == {"box", "floor", "wall"}
    assert said["things"][0]["author"] == "A. Turner" and said["packages"] == {"chairs": "1.2"}
    without = ("--data", tmp_path / "own", "--things", tmp_path / "none")
    done = script("variety", seed, *without, *part)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("has no real things") == 1
    said = json.loads((tmp_path / "own" / folder / "manifest.json").read_text(encoding="utf-8"))
    assert "things" not in said and "real shapes" in said["features"]
    mixed = script("variety", seed, "--data", tmp_path / "real", *without[2:], *part)
    assert mixed.returncode == 1 and "holds another rendering (packages is" in mixed.stderr


@pytest.mark.parametrize("name", SCENES)
def test_a_benchmark_scene_renders(script, tmp_path, name):
    first = 97 if name == "town" else 1
    frames = {first, first + 1, first + 24, first + 48}
    wanted = ",".join(map(str, sorted(frames)))
    done = script(name, "--data", tmp_path, "--frames", wanted, *SIZE, "--renders", 2)
    assert done.returncode == 0, done.stderr
    scene = open_scene(tmp_path / name)
    manifest = scene.manifest
    assert manifest.role == BENCHMARK
    assert manifest.instants.count == 61 and manifest.keys.count == 16
    assert set(manifest.instants.numbers) - set(scene.missing(manifest.instants)) == frames
    keys = {manifest.keys.first + step for step in (0, 6, 12)}
    assert set(manifest.keys.numbers) - set(scene.missing(manifest.keys)) == keys
    for number in frames - {first + 1}:
        again = read_image(scene.folder / "floor" / f"{name}.{number:04d}.exr")
        rendered = read_image(scene.path(manifest.instants, number))
        assert 12 < score_frame(rendered.pixels, again.pixels, None)[0].psnr_db < 60
    seen: set[int] = set()
    for number in frames - {first + 1}:
        raw = read_raw(scene.instants, number)
        assert np.isfinite(raw.image.pixels).all()
        assert 0.02 < raw.image.pixels[..., :3].mean() < 1.5
        seen |= set(np.unique(raw.gbuffer.stencil)) - {0, -1}
    assert seen and seen <= set(manifest.dynamic)


@pytest.mark.parametrize("name", RASTER_SCENES)
def test_a_raster_scene_renders(script, tmp_path, name):
    done = script(name, "--data", tmp_path, "--frames", "1,25,33,49", *RASTER_SIZE)
    assert done.returncode == 0, done.stderr
    scene = open_scene(tmp_path / name)
    manifest = scene.manifest
    assert manifest.role == BENCHMARK and manifest.renderer.endswith(" EEVEE")
    assert manifest.denoiser == ""
    assert manifest.instants.count == 61 and manifest.keys.count == 16
    assert set(scene.instants.layout.roles) == set(Role) == set(scene.keys.layout.roles)
    assert len(list((scene.folder / "floor").iterdir())) == 3
    for number in (1, 25, 33, 49):
        raw = read_raw(scene.instants, number)
        assert np.isfinite(raw.image.pixels).all()
        assert 0.02 < raw.image.pixels[..., :3].mean() < 1.5
        seen = set(np.unique(raw.gbuffer.stencil)) - {0, -1}
        assert seen and seen <= set(manifest.dynamic)
    key, instant = read_raw(scene.keys, 9), read_raw(scene.instants, 33)
    np.testing.assert_array_equal(key.image.pixels, instant.image.pixels)
    solid = np.isfinite(key.gbuffer.depth)
    longer, step = (np.linalg.norm(raw.motion[solid], axis=-1) for raw in (key, instant))
    assert np.median(longer) > 2.5 * np.median(step)


def test_a_raster_shot_has_the_channels_of_a_path_traced_one(data, script, tmp_path):
    done = script("variety", RASTER_SHOT, "--data", tmp_path, "--frames", "5-6", *RASTER_SIZE)
    assert done.returncode == 0, done.stderr
    traced, raster = open_scene(data / NAME), open_scene(tmp_path / f"variety-{RASTER_SHOT:04d}")
    assert traced.manifest.renderer.endswith(" Cycles")
    assert raster.manifest.renderer.endswith(" EEVEE")
    for kind in ("instants", "keys"):
        first, second = (getattr(scene, kind).layout.roles for scene in (traced, raster))
        assert first == second
    gbuffer = read_raw(raster.instants, 5).gbuffer
    solid = np.isfinite(gbuffer.depth)
    assert (gbuffer.stencil[solid] == np.rint(gbuffer.stencil[solid])).all()


def test_samples_that_form_no_grid_are_refused(script, tmp_path):
    refused = script("arena", "--data", tmp_path, "--frames", "1", "--samples", 2)
    assert refused.returncode == 1 and "square of another odd number" in refused.stderr
    assert "Traceback" not in refused.stderr


def test_more_renders_of_a_frame_leave_less_noise(script, tmp_path):
    floors = []
    for seeds in (1, 8):
        data = tmp_path / str(seeds)
        done = script("village", "--data", data, "--frames", "1", *SIZE, "--renders", seeds)
        assert done.returncode == 0, done.stderr
        frames = [data / "village" / kind / "village.0001.exr" for kind in ("instants", "floor")]
        one, other = (read_image(path).pixels for path in frames)
        floors.append(score_frame(one, other, None)[0].psnr_db)
    assert floors[1] > floors[0] + 5
    refused = script("village", "--data", data, "--frames", "1", *SIZE)
    assert refused.returncode == 1 and "holds another rendering (" in refused.stderr


def test_a_hurried_rendering_lies_in_a_folder_of_its_own(script, tmp_path):
    quick = ("--look", "hurried", "--frames", "1,241", "--what", "instants")
    done = script("lab", "--data", tmp_path, *quick, *SIZE)
    assert done.returncode == 0, done.stderr
    manifest = open_scene(tmp_path / "hurried" / "lab").manifest
    assert manifest.instants.count == 241 and manifest.denoiser == "OpenImageDenoise"
    assert not (tmp_path / "lab").exists()


def test_bad_options_are_one_sentence(script, tmp_path):
    beyond = script("lab", "--data", tmp_path, "--frames", "60-65", *SIZE)
    assert beyond.returncode == 1 and "frames 1 to 61, not 62" in beyond.stderr
    assert list(tmp_path.iterdir()) == []
    for option, value in (("--resolution", "4k"), ("--frames", "x"), ("--samples", "0")):
        wrong = script("lab", "--data", tmp_path, option, value)
        assert wrong.returncode == 2 and "Traceback" not in wrong.stderr
