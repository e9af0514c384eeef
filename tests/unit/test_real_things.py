"""Real things: what is taken from packages, under which licence, and what a seed asks for."""

from __future__ import annotations

import importlib
import struct
from pathlib import Path

import numpy as np
import pytest

SCRIPTS = Path(__file__).parents[2] / "examples" / "scenes"
COPYRIGHT = """Format: https://www.debian.org/doc/packaging-manuals/copyright-format/1.0/
Upstream-Name: Furniture

Files: Chairs/*
 Stools/*
Copyright: 2010, A. Turner
 2012, B. Joiner
License: CC-BY-3.0

Files: *
Copyright: The team
License: GPL-2+
 Free software; you can redistribute it.

License: CC-BY-3.0
 Creative Commons.
"""


@pytest.fixture
def script(monkeypatch):
    """Import a module of the scenes' scripts that does without Blender."""
    monkeypatch.syspath_prepend(str(SCRIPTS))
    return importlib.import_module


def test_each_pattern_of_files_has_its_licence_and_holders(script):
    found = script("things_list").licences(COPYRIGHT)
    turned = ("CC-BY-3.0", "2010, A. Turner; 2012, B. Joiner")
    assert found == {"Chairs/*": turned, "Stools/*": turned, "*": ("GPL-2+", "The team")}


@pytest.mark.parametrize(
    ("licence", "free"),
    [
        ("CC0", True),
        ("CC-BY-3.0", True),
        ("CC-BY-3.0-USA", True),
        ("CC-BY-SA-3.0", False),
        ("CC-BY-NC-4.0", False),
        ("GPL-2+", False),
        ("", False),
    ],
)
def test_only_cc0_and_cc_by_may_be_committed(script, licence, free):
    listed = script("things_list")
    assert listed.is_free(licence) is free
    assert listed.may_be_committed([{"licence": "CC0"}, {"licence": licence}]) is free
    assert listed.may_be_committed([])


def test_a_written_list_is_read_again_and_credits_each_thing(script, tmp_path):
    listed = script("things_list")
    assert listed.read(tmp_path).things == ()
    chair = listed.Thing("a/1", "Chair", listed.SHAPE, "a/1.obj", "Ä. Turner", "CC0", "chairs")
    wall = listed.Thing("b", "wall: b", listed.TEXTURE, "b.jpg", "The team", "GPL-2+", "game")
    written = listed.ThingList(tmp_path, {"chairs": "1.2-3", "game": "0.8"}, (chair, wall))
    listed.write(written)
    assert listed.read(tmp_path) == written
    assert [thing.name for thing in written.of_kind(listed.TEXTURE)] == ["b"]
    text = (tmp_path / listed.CREDITS).read_text(encoding="utf-8")
    assert "| chairs | 1.2-3 | CC0 | 1 | 0 | 0 | 1 |" in text
    assert "| a/1 | Chair | Ä. Turner | CC0 |" in text
    assert chair.credit["author"] == "Ä. Turner" and "path" not in chair.credit


def test_a_damaged_list_is_one_sentence(script, tmp_path):
    (tmp_path / "things.json").write_text("{}", encoding="utf-8")
    with pytest.raises(SystemExit, match="write it again"):
        script("things_list").read(tmp_path)


def test_four_hundred_seeds_have_every_feature_at_its_share(script):
    plan = script("variety_plan")
    plans = [plan.Plan.draw(seed) for seed in range(1, 401)]
    for feature, (share, _) in plan.SHARES.items():
        found = sum(one.has(feature) for one in plans) / len(plans)
        assert found == pytest.approx(share, abs=0.03), feature
        half = sum(one.has(feature) for one in plans[:100]) / 100
        assert half == pytest.approx(share, abs=0.1), feature
    with pytest.raises(KeyError):
        plans[0].has("elephants")


def test_features_come_in_all_pairs(script):
    plan = script("variety_plan")
    plans = [plan.Plan.draw(seed) for seed in range(1, 401)]
    names = sorted(plan.SHARES)
    for number, first in enumerate(names):
        for second in names[number + 1 :]:
            assert any(one.has(first) and one.has(second) for one in plans), (first, second)


def model_file() -> bytes:
    """An MD3 model of two frames: one triangle, and a tag that moves up by 2."""
    low = np.array([[0, 0, 0, 0], [64, 0, 0, 0], [0, 64, 0, 0]], "<i2")
    points = np.stack([low, low + np.array([0, 0, 64, 0], "<i2")])
    shader = b"models/skin.tga".ljust(64, b"\0") + struct.pack("<i", 0)
    faces = np.array([0, 1, 2], "<i4").tobytes()
    spread = np.array([0, 0, 1, 0, 0, 1], "<f4").tobytes()
    places = np.cumsum([108, len(faces), len(shader), len(spread)]).tolist()
    end = places[-1] + points.nbytes
    head = struct.pack("<4s64s10i", b"IDP3", b"leaf", 0, 2, 1, 3, 1, places[0], places[1],
                       places[2], places[3], end)  # fmt: skip
    surface = head + faces + shader + spread + points.tobytes()
    tags = b""
    for height in (0.0, 2.0):
        axes = np.concatenate([[0, 0, height], np.eye(3).ravel()]).astype("<f4")
        tags += b"tag_head".ljust(64, b"\0") + axes.tobytes()
    start = 108
    header = struct.pack("<4si64s9i", b"IDP3", 15, b"leaf", 0, 2, 1, 1, 0, start, start,
                         start + len(tags), start + len(tags) + len(surface))  # fmt: skip
    return header + tags + surface


def test_md3_models_are_read_with_frames_and_tags(script):
    md3 = script("things_md3")
    data = model_file()
    model = md3.read(data)
    (surface,) = model.surfaces
    assert (surface.name, surface.shader) == ("leaf", "models/skin.tga")
    np.testing.assert_array_equal(surface.points[1], [[0, 0, 1], [1, 0, 1], [0, 1, 1]])
    np.testing.assert_array_equal(surface.spread, [[0, 1], [1, 1], [0, 0]])
    np.testing.assert_array_equal(surface.faces, [[2, 1, 0]])
    placed = md3.attach(surface.points, model, "tag_head", (1, 1))
    np.testing.assert_array_equal(placed - surface.points, np.full((2, 3, 3), (0, 0, 2)))
    text = md3.to_obj(model.surfaces, 1, ["skin"], "leaf.mtl").splitlines()
    assert text[0] == "mtllib leaf.mtl" and text[2] == "v 1.00000 1.00000 -0.00000"
    assert text[-2:] == ["usemtl skin", "f 3/3 2/2 1/1"]
    with pytest.raises(ValueError, match="no MD3 model"):
        md3.read(b"IDP2" + data[4:])


def test_catalogues_are_read_by_their_numbers(script):
    text = "# a comment\nid=all\nname#2=Caf\\u00e9 chair\nwidth#2=50\nname#10=Bed\n"
    assert script("things")._rows(text) == {
        2: {"name": "Café chair", "width": "50"},
        10: {"name": "Bed"},
    }
