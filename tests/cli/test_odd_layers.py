"""Layers of files that are not as they usually are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR

from tests.blender_layers import HALF, layer
from tests.cli import shots
from tests.cli.street import Street


def test_a_vector_of_which_some_channels_are_read(upsample, tmp_path):
    """The others of its layer go along, from the same source."""

    def velocity(path: Path, street: Street, time: float) -> None:
        forward = street.geometry(time)["following"] * [1, -1]
        ids = street.geometry(time)["id"] + 7.0
        vectors = layer("velocity", "RGB", np.dstack([forward, ids]))
        shots.write(path, {"": shots.colour_planes(street, time) | vectors})

    keys = shots.sequence(tmp_path / "keys", velocity, (1, 2), shots.SMALL)
    channel_map = tmp_path / "map.toml"
    channel_map.write_text(
        'schema = "exwarp.channel-map/1"\nmotion = "next=R,-G"\n'
        '[channels]\nmotion = ["velocity.R", "velocity.G"]\n'
    )
    more = ("--layers", "all", "--no-tail", "--channel-map", channel_map)
    upsample(keys, tmp_path / "out", "-m", "softsplat", *more)
    _, planes = shots.read(tmp_path / "out" / "shot.0003.exr")
    assert set(np.unique(planes["velocity.B"])) == {7, 8}


def test_ids_whose_type_changes(upsample, tmp_path):
    """A later frame's NaN is no whole number; the run neither fails nor grumbles."""

    def typed(path: Path, street: Street, time: float) -> None:
        ids = street.geometry(time)["id"]
        later = np.where(ids > 0, np.nan, 5).astype(np.float32)
        of_time = {"oid.X": np.full(ids.shape, 5, np.uint32) if time < 1 else later}
        shots.write(path, {"": shots.plain_planes(street, time) | of_time})

    keys = shots.sequence(tmp_path / "keys", typed, (1, 2), shots.SMALL)
    more = ("--layers", "oid", "--no-tail", *shots.FORWARD)
    upsample(keys, tmp_path / "out", "-m", "softsplat", *more)
    _, planes = shots.read(tmp_path / "out" / "shot.0002.exr")
    assert planes["oid.X"].dtype == np.uint32 and (planes["oid.X"] == 5).mean() > 0.5


def test_frames_of_ours_are_upsampled_again(upsample, tmp_path):
    """What they tell of how they were made is not taken for the new frames', nor resumed."""

    def old(path: Path, street: Street, time: float) -> None:
        attributes = {"exwarp:path": "S3", "exwarp:decision": "x", "exwarp:holeFraction": 0.5}
        shots.write(path, {"": shots.plain_planes(street, time)}, shots.header(**attributes))

    keys = shots.sequence(tmp_path / "keys", old, (1, 2), shots.SMALL)
    for more in ((), ("--skip-existing",)):
        upsample(keys, tmp_path / "out", "-m", "hold", "--no-tail", *more)
    header, _ = shots.read(tmp_path / "out" / "shot.0003.exr")
    assert "exwarp:path" not in header and "exwarp:decision" not in header


def test_layers_of_one_name_in_two_parts(upsample, tmp_path):
    def twice(path: Path, street: Street, time: float) -> None:
        light = street.colour(time)[..., :3]
        lights = {n: layer("diff", "RGB", light * s, HALF) for n, s in (("a", 1), ("b", 0.5))}
        shots.write(path, {"rgba": shots.plain_planes(street, time), **lights})

    keys = shots.sequence(tmp_path / "keys", twice, (1, 2), shots.SMALL)
    more = ("--layers", "*diff", "--no-tail", *shots.FORWARD)
    upsample(keys, tmp_path / "out", "-m", "softsplat", *more)
    with OpenEXR.File(str(tmp_path / "out" / "shot.0003.exr"), separate_channels=True) as file:
        beauty, *lights = ({n: c.pixels for n, c in p.channels.items()} for p in file.parts)
    assert len(lights) == 2
    for found, share in zip(lights, (1, 0.5), strict=True):
        for c in "RGB":
            wanted = beauty[c].astype(np.float32) * share
            assert np.abs(found[f"diff.{c}"] - wanted).max() < 2e-3


def test_slots_have_one_of_two_layers_of_one_name(upsample, tmp_path):
    """The one with its components is taken from there, the other from the key frame."""

    def key(path: Path, street: Street, time: float) -> None:
        ids = street.geometry(time)["id"].astype(np.float32)
        planes = shots.colour_planes(street, time) | shots.slot_planes(street, time)
        shots.write(path, {"rgba": planes, "a": {"id.X": ids}, "b": {"id.Y": ids + 1}})

    def slot(path: Path, street: Street, time: float) -> None:
        ids = {"id.Y": street.geometry(time)["id"].astype(np.float32) + 10}
        shots.write(path, {"": shots.slot_planes(street, time) | ids})

    keys = shots.sequence(tmp_path / "keys", key, (1, 2), shots.SMALL)
    slots = shots.sequence(tmp_path / "slots", slot, range(1, 6), shots.SMALL, 0.25)
    more = ("--gbuffers", slots, "--layers", "id", "--no-tail", *shots.VECTORS)
    upsample(keys, tmp_path / "out", "-m", "s6", *more)
    with OpenEXR.File(str(tmp_path / "out" / "shot.0003.exr"), separate_channels=True) as file:
        _, a, b = ({n: c.pixels for n, c in p.channels.items()} for p in file.parts)
    assert set(np.unique(a["id.X"])) == {0, 1} and set(np.unique(b["id.Y"])) == {10, 11}


def test_a_layer_that_ends_at_a_cut(exwarp, tmp_path):
    def ending(path: Path, street: Street, time: float) -> None:
        light = layer("diff", "RGB", street.colour(time)[..., :3], HALF) if time < 1 else {}
        shots.write(path, {"": shots.plain_planes(street, time) | light})

    keys = shots.sequence(tmp_path / "keys", ending, (1, 2), shots.SMALL)
    more = ("--layers", "diff", "--cuts", "2", *shots.FORWARD, "--progress", "none")
    result = exwarp("upsample", keys, "-o", tmp_path / "out", "-m", "softsplat", *more)
    errors = [line for line in result.err.splitlines() if "error:" in line]
    assert result.code == 3 and len(errors) == 1
    assert "shot.0002.exr has no channel 'diff." in errors[0] and "--layers" in errors[0]
