"""What channels without a layer of their own are taken for, by the part that they lie in."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.io.channels import Layout, Role
from exwarp_cli.io.frames import read_raw
from exwarp_cli.io.shot import open_shot
from tests.unit.exr_files import plane, write_parts


def layout_of(folder: Path, parts: Mapping[str, str]) -> Layout:
    """Recognise a file with these parts; the channels of each are parted by spaces."""
    planes = {name: {c: plane(2, 3, 1) for c in text.split()} for name, text in parts.items()}
    write_parts(folder / "a.0001.exr", {name: (held, {}) for name, held in planes.items()})
    return open_shot(str(folder)).layout


def roles_of(layout: Layout) -> dict[str, str]:
    """Return the channels of every role, parted by spaces."""
    return {role.value: " ".join(r.name for r in refs) for role, refs in layout.roles.items()}


PICTURE = "R G B A"


@pytest.mark.parametrize("name", ["rgba", "beauty", "part0", "subimage00", "rgba_main"])
@pytest.mark.parametrize("order", [1, -1])
def test_z_beside_the_picture_is_the_depth(tmp_path, name, order):
    parts = [(name, f"{PICTURE} Z"), ("forward", "forward.u forward.v")]
    roles = roles_of(layout_of(tmp_path, dict(parts[::order])))
    assert roles == {
        "colour": " ".join(f"{name}.{c}" for c in "RGBA"),
        "depth": f"{name}.Z",
        "motion": "forward.u forward.v",
    }


def test_z_beside_another_picture_is_not_the_depth_of_the_beauty(tmp_path):
    parts = {"diffuse": f"{PICTURE} Z", "rgba": f"{PICTURE} Z", "depth": "Z"}
    assert roles_of(layout_of(tmp_path / "a", parts))["depth"] == "rgba.Z"
    parts["rgba"] = PICTURE
    assert roles_of(layout_of(tmp_path / "b", parts))["depth"] == "depth.Z"


@pytest.fixture(autouse=True)
def folders(tmp_path):
    for name in "ab":
        (tmp_path / name).mkdir()


def test_channels_named_as_their_part(tmp_path):
    parts = {"RGBA": PICTURE, "hitPz": "hitPz", "ID": "ID", "N": "X Y Z"}
    layout = layout_of(tmp_path, parts)
    assert roles_of(layout) == {
        "colour": "RGBA.R RGBA.G RGBA.B RGBA.A",
        "depth": "hitPz.hitPz",
        "normal": "N.X N.Y N.Z",
        "stencil": "ID.ID",
    }
    raw = read_raw(open_shot(str(tmp_path)), 1)
    assert raw.gbuffer.stencil is not None and (raw.gbuffer.stencil == 1).all()
    assert raw.gbuffer.depth is not None and (raw.gbuffer.depth == 1).all()


def test_words_in_a_part_of_another_name(tmp_path):
    parts = {"rgba": f"{PICTURE} depth", "masks": "id"}
    roles = roles_of(layout_of(tmp_path, parts))
    assert (roles["depth"], roles["stencil"]) == ("rgba.depth", "masks.id")


@pytest.mark.parametrize("name", ["rgba_main", "part0", "subimage00", "Untitled"])
def test_the_picture_is_r_g_b_without_a_layer(tmp_path, name):
    parts = {
        name: PICTURE,
        "depth_main": "depth.Z",
        "diffuse_main": "diffuse.R diffuse.G diffuse.B",
        "forward_main": "forward.u forward.v",
    }
    roles = roles_of(layout_of(tmp_path, parts))
    assert roles == {
        "colour": " ".join(f"{name}.{c}" for c in "RGBA"),
        "depth": "depth.Z",
        "motion": "forward.u forward.v",
    }


def test_parts_without_a_meaning(tmp_path):
    parts = {"part0": PICTURE, "part1": "Z", "part2": "forward.u forward.v", "part3": "X Y Z"}
    assert roles_of(layout_of(tmp_path, parts)) == {
        "colour": "part0.R part0.G part0.B part0.A",
        "depth": "part1.Z",
        "motion": "forward.u forward.v",
    }


@pytest.mark.parametrize(
    ("before", "after"), [("custom", ""), ("", "_main"), ("shot_", "_v2"), ("sh010 ", "")]
)
def test_words_that_all_parts_share_say_nothing(tmp_path, before, after):
    inner = {"Rgb": "R G B", "Rgba": PICTURE, "Depth": "Z", "MotionVectors": "X Y"}
    parts = {f"{before}{name}{after}": held for name, held in inner.items()}
    roles = roles_of(layout_of(tmp_path, parts))
    whole = {name: f"{before}{name}{after}" for name in inner}
    assert roles == {
        "colour": " ".join(f"{whole['Rgba']}.{c}" for c in "RGBA"),
        "depth": f"{whole['Depth']}.Z",
        "motion": " ".join(f"{whole['MotionVectors']}.{c}" for c in "XY"),
    }


@pytest.mark.parametrize(
    ("parts", "roles"),
    [
        ({"camera_normal": "X Y Z", "camera_position": "X Y Z"}, {}),
        ({"key_depth": "Z", "fill_depth": "Z"}, {"depth": "key_depth.Z"}),
        (
            {"Diffuse Color": "R G B", "Glossy Color": "R G B"},
            {
                "albedo": "Diffuse Color.R Diffuse Color.G Diffuse Color.B",
                "specular": "Glossy Color.R Glossy Color.G Glossy Color.B",
            },
        ),
        ({"HitPz": "Z", "HitN": "X Y Z"}, {"depth": "HitPz.Z", "normal": "HitN.X HitN.Y HitN.Z"}),
    ],
)
def test_words_with_a_meaning_are_not_left_out(tmp_path, parts, roles):
    assert roles_of(layout_of(tmp_path, parts)) == roles


def test_data_in_a_part_is_no_beauty_though_no_other_picture_is_bare(tmp_path):
    parts = {"view_normal": "R G B", "lights": "key.R key.G key.B"}
    assert roles_of(layout_of(tmp_path, parts)) == {}


def test_pictures_of_which_none_is_the_beauty(tmp_path):
    parts = {"diffuse": "R G B", "specular": "R G B"}
    assert roles_of(layout_of(tmp_path, parts)) == {}


def test_ids_named_as_their_part_keep_apart(tmp_path):
    ids = np.array([[0, 2**24 + 1, 7]], np.uint32)
    picture = {c: plane(1, 3, 0.5) for c in "RGBA"}
    write_parts(tmp_path / "a.0001.exr", {"RGBA": (picture, {}), "ID": ({"ID": ids}, {})})
    raw = read_raw(open_shot(str(tmp_path)), 1)
    assert Role.STENCIL in open_shot(str(tmp_path)).layout
    assert raw.gbuffer.stencil is not None and raw.gbuffer.stencil.tolist() == ids.tolist()
