"""Folders of rendered scenes, and what is wrong with them."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path

import pytest

from exwarp_cli.errors import DamagedFileError, InputError, LayoutError, MissingFrameError
from exwarp_cli.io.dataset import BENCHMARK, TRAINING, find_scenes, open_scene
from tests.unit.analytic_scene import manifest, write_manifest, write_scene

SCRIPTS = Path(__file__).parents[2] / "examples" / "scenes"


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    return write_scene(tmp_path_factory.mktemp("data") / "analytic", instants=5)


def test_a_scene_is_what_its_manifest_says(scene):
    found = open_scene(scene)
    facts = found.manifest
    assert found.name == facts.scene == "analytic"
    assert (facts.role, facts.seed, facts.samples, facts.denoiser) == (BENCHMARK, 1, 1, "")
    assert (facts.width, facts.height, facts.fps, facts.key_fps) == (128, 80, 120, 30)
    assert facts.instants.numbers == range(1, 6) and facts.instants.step == 1
    assert facts.keys.numbers == range(1, 3) and facts.keys.step == 4
    assert facts.dynamic == {3: "box"}
    assert found.path(facts.instants, 5) == scene / "instants" / "analytic.0005.exr"
    assert found.instants.sequence.numbers == [1, 2, 3, 4, 5]
    assert found.keys.sequence.numbers == [1, 2]
    found.require_complete()


def test_scenes_are_found_by_role_and_name(tmp_path):
    for name, role in (("b", BENCHMARK), ("a", BENCHMARK), ("t", TRAINING)):
        write_manifest(tmp_path / name, manifest(name, role=role))
    (tmp_path / "other").mkdir()
    (tmp_path / "stray.txt").write_text("")
    assert [s.name for s in find_scenes(tmp_path)] == ["a", "b", "t"]
    assert [s.name for s in find_scenes(tmp_path, TRAINING)] == ["t"]
    assert [s.name for s in find_scenes(str(tmp_path), names=["t", "a"])] == ["t", "a"]
    assert [s.name for s in find_scenes(tmp_path / "b")] == ["b"]
    with pytest.raises(InputError, match="no scene 'c', but a, b, t"):
        find_scenes(tmp_path, names=["c"])
    with pytest.raises(InputError, match="no scene 't', but a, b"):
        find_scenes(tmp_path, BENCHMARK, ["t"])


def test_a_folder_without_scenes_is_refused(tmp_path):
    with pytest.raises(InputError, match="holds no training scene"):
        find_scenes(tmp_path, TRAINING)
    with pytest.raises(InputError, match="is no folder"):
        find_scenes(tmp_path / "none")
    with pytest.raises(InputError, match=r"manifest\.json is missing"):
        open_scene(tmp_path)


def test_missing_frames_are_named(tmp_path):
    folder = write_scene(tmp_path / "analytic", instants=5)
    (folder / "instants" / "analytic.0002.exr").unlink()
    (folder / "instants" / "analytic.0003.exr").unlink()
    scene = open_scene(folder)
    assert scene.missing(scene.manifest.instants) == (2, 3)
    with pytest.raises(MissingFrameError, match="lacks frames 2-3 of instants"):
        scene.require_complete()


def test_frames_of_another_size_are_refused(tmp_path):
    folder = write_scene(tmp_path / "analytic", instants=5, width=64)
    with pytest.raises(LayoutError, match=r"128x80 and .* says 64x80"):
        _ = open_scene(folder).instants


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"width": 0}, "width"),
        ({"height": "80"}, "height"),
        ({"fps": True}, "fps"),
        ({"scene": None}, "scene"),
        ({"role": "judge"}, "role"),
        ({"instants": []}, "instants"),
        ({"instants": {"pattern": "../x.#.exr", "first": 1, "count": 1}}, "pattern"),
        ({"instants": {"pattern": "/x.#.exr", "first": 1, "count": 1}}, "pattern"),
        ({"keys": {"pattern": "x.exr", "first": 1, "count": 1}}, "pattern"),
        ({"keys": {"pattern": "#x.#.exr", "first": 1, "count": 1}}, "pattern"),
        ({"keys": {"pattern": "x.#.exr", "first": 1}}, "count"),
        ({"dynamic": {"one": "box"}}, "one"),
    ],
)
def test_a_wrong_manifest_is_refused(tmp_path, change, word):
    path = write_manifest(tmp_path, manifest(**change))
    with pytest.raises(DamagedFileError, match=word) as caught:
        open_scene(tmp_path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_every_entry_of_a_manifest_is_needed(tmp_path):
    whole = manifest()
    for name in whole:
        write_manifest(tmp_path, {key: value for key, value in whole.items() if key != name})
        with pytest.raises(InputError, match=name):
            open_scene(tmp_path)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"schema": "exwarp.scene/2"}', "\udcff"])
def test_what_is_no_manifest_is_refused(tmp_path, text):
    (tmp_path / "manifest.json").write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises((DamagedFileError, LayoutError)):
        open_scene(tmp_path)


@pytest.fixture
def writer(monkeypatch):
    """The module with which the scenes' scripts write manifests."""
    spec = importlib.util.spec_from_file_location("manifest", SCRIPTS / "stage" / "manifest.py")
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "manifest", module)
    spec.loader.exec_module(module)
    return module


def described(writer, **changes):
    content = {
        "scene": "lab",
        "role": "benchmark",
        "about": "Räume.",
        "first": 1,
        "instants": 241,
        "fps": 120,
        "key_fps": 30,
        "width": 427,
        "height": 240,
        "renderer": "Blender",
        "samples": 16,
        "seeds": 1,
        "denoiser": "OpenImageDenoise",
        "sampling": "",
        "seed": 3,
        "motion": writer.BLENDER_MOTION,
        "key_step": 4,
        "dynamic": {"1": "arm"},
    }
    return writer.Manifest(**content | changes)


def test_what_the_scripts_write_is_what_is_read(writer, tmp_path):
    writer.write(tmp_path, described(writer))
    facts = open_scene(tmp_path).manifest
    for name in ("scene", "role", "about", "fps", "key_fps", "width", "height", "renderer"):
        assert getattr(facts, name) == getattr(described(writer), name)
    for name in ("samples", "denoiser", "seed", "motion"):
        assert getattr(facts, name) == getattr(described(writer), name)
    assert facts.instants.numbers == range(1, 242) and facts.keys.numbers == range(1, 62)
    assert facts.keys.step == 4 and facts.dynamic == {1: "arm"}
    assert [i for i in range(250) if facts.has_key(i)] == list(range(0, 241, 4))
    assert [path.name for path in tmp_path.iterdir()] == ["manifest.json"]


def test_key_frames_may_be_written_for_every_instant(writer, tmp_path):
    writer.write(tmp_path, described(writer, instants=13, key_step=1))
    facts = open_scene(tmp_path).manifest
    assert facts.keys.numbers == range(1, 14) and facts.keys.step == 1
    assert [i for i in range(20) if facts.has_key(i)] == list(range(13))


def test_a_piece_from_the_middle_keeps_its_numbers(writer, tmp_path):
    writer.write(tmp_path, described(writer, first=61, instants=121))
    frames = open_scene(tmp_path).manifest
    assert frames.instants.numbers == range(61, 182) and frames.keys.numbers == range(16, 47)


def test_a_measured_noise_floor_does_not_tell_renderings_apart(writer, tmp_path):
    writer.write(tmp_path, described(writer))
    writer.write_floor(tmp_path, 38.5)
    assert json.loads((tmp_path / "manifest.json").read_text())["noise_floor_psnr_db"] == 38.5
    assert writer.differences(tmp_path, described(writer)) == []
    assert open_scene(tmp_path).manifest.scene == "lab"
    writer.write_floor(tmp_path, None)
    assert "noise_floor_psnr_db" not in (tmp_path / "manifest.json").read_text()


def test_a_manifest_without_seeds_is_of_single_renders(writer, tmp_path):
    writer.write(tmp_path, described(writer))
    content = json.loads((tmp_path / "manifest.json").read_text())
    del content["seeds"], content["sampling"]
    (tmp_path / "manifest.json").write_text(json.dumps(content))
    assert writer.differences(tmp_path, described(writer)) == []
    assert writer.differences(tmp_path, described(writer, seeds=8)) == ["seeds is 1, not 8"]


def test_the_scripts_do_not_mix_renderings(writer, tmp_path):
    assert writer.differences(tmp_path, described(writer)) == []
    writer.write(tmp_path, described(writer))
    assert writer.differences(tmp_path, described(writer)) == []
    changed = writer.differences(tmp_path, described(writer, samples=64, height=480))
    assert changed == ["height is 240, not 480", "samples is 16, not 64"]
    content = json.loads((tmp_path / "manifest.json").read_text())
    (tmp_path / "manifest.json").write_text(json.dumps(content | {"more": 1}))
    assert writer.differences(tmp_path, described(writer)) == ["more is 1, not None"]
    (tmp_path / "manifest.json").write_text("{")
    assert writer.differences(tmp_path, described(writer)) == ["it is no JSON"]
