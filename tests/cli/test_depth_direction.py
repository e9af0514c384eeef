"""Depth without positions that is no distance: negative, inverse, or white where it is near."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest

from exwarp_cli.io.channels import Role
from exwarp_cli.io.depth import DepthKind
from exwarp_cli.io.frames import read_raw
from exwarp_cli.io.shot import open_shot
from exwarp_cli.pipeline.depth_and_ids import with_depth_ordered
from exwarp_cli.pipeline.motion_convention import find_motion
from tests.blender_layers import FLOAT, layer
from tests.cli import shots
from tests.cli.conftest import run_quietly
from tests.cli.shots import FORWARD
from tests.cli.street import Street
from tests.matrix import combinations

STREET = Street(160, 90)
FAR = 30.0


def negative(depth):
    return np.where(np.isinf(depth), 1e10, -depth)


def inverse(depth):
    return np.where(np.isinf(depth), 0, 1 / depth)


def white_near(depth):
    """Pictures of depth, as V-Ray for 3ds Max writes them."""
    return np.where(np.isinf(depth), 0, np.clip(1 - (depth - 1) / (FAR - 1), 0, 1))


def distance(depth):
    return np.where(np.isinf(depth), 1e10, depth)


def written(form, name="Z", frame=shots.plain_planes):
    """Return a frame writer whose depth has another form or name."""

    def write(path, street, time):
        planes = frame(street, time)
        for old in ("Z", "Depth.Z"):
            planes.pop(old, None)
        depth = form(street.geometry(time)["depth"]).astype(np.float32)
        shots.write(path, {"": planes | {name: np.ascontiguousarray(depth)}})

    return write


@pytest.fixture(scope="module")
def keys_of(tmp_path_factory):
    """Return the key frames whose depth has a form; each written once, read only."""

    @cache
    def write(form):
        folder = tmp_path_factory.mktemp(form.__name__) / "keys"
        return shots.sequence(folder, written(form), street=STREET)

    return write


@pytest.fixture(scope="module")
def made_of(tmp_path_factory, keys_of):
    """Return the frames that a method makes of these; each made once, read only."""

    @cache
    def run(form, method):
        out = tmp_path_factory.mktemp("made") / "out"
        run_quietly("upsample", keys_of(form), "-o", out, "-m", method, *FORWARD)
        return out

    return run


def colours(folder):
    return [shots.colour_of(folder / f"shot.{n:04d}.exr") for n in (2, 3, 4, 6, 7, 8)]


class TestFrames:
    @pytest.mark.parametrize(
        ("form", "method"), combinations((negative, inverse, white_near), ("s6", "softsplat"))
    )
    def test_they_are_as_with_the_distance(self, made_of, form, method):
        made, wanted = (colours(made_of(f, method)) for f in (form, distance))
        # Where softmax weighs two sides, a picture of depth is a little another distance.
        assert np.mean([shots.psnr(w, m) for w, m in zip(wanted, made, strict=True)]) > 40

    def test_a_part_of_the_sequence_reads_it_alike(self, upsample, keys_of, made_of, tmp_path):
        for number in (3, 1):
            options = ("-m", "softsplat", *FORWARD, "--frames", number)
            upsample(keys_of(inverse), tmp_path / "out", *options)
        shots.require_part(tmp_path / "out", made_of(inverse, "softsplat"), 8)


class TestSaid:
    @pytest.mark.parametrize(
        ("form", "kind", "words"),
        [
            (negative, "negative", "'Z' is negative and read as the distance |z|"),
            (inverse, "inverse", "'Z' grows towards the camera"),
            (white_near, "reversed", "'Z' grows towards the camera"),
        ],
    )
    def test_in_all_places(self, exwarp, keys_of, tmp_path, form, kind, words):
        keys, report = keys_of(form), tmp_path / "report"
        found = json.loads(exwarp("inspect", keys, *FORWARD, "--json").out)
        assert found["depth_kind"] == kind and found["depth_evidence"].startswith(words)
        assert f"depth {words}" in exwarp("inspect", keys, *FORWARD).out
        options = ("-m", "s6", *FORWARD, "--frames", 1, "--report", report)
        assert f"depth {words}" in exwarp("upsample", keys, "-o", tmp_path / "o", *options).err
        document = json.loads((report / "report.json").read_text())
        assert document["input"]["depth"].startswith(words)

    @pytest.mark.parametrize("name", ["Z", "depth.V"])
    def test_nothing_of_a_distance(self, exwarp, tmp_path, name):
        keys = shots.sequence(tmp_path, written(distance, name), street=STREET)
        found = json.loads(exwarp("inspect", keys, *FORWARD, "--json").out)
        assert (found["depth_kind"], found["depth_evidence"]) == ("unknown", None)

    def test_a_wrong_name_gives_way_to_the_vectors(self, exwarp, tmp_path):
        keys = shots.sequence(tmp_path, written(distance, "disparity.V"), street=STREET)
        found = json.loads(exwarp("inspect", keys, *FORWARD, "--json").out)
        assert found["depth_kind"] == "unknown"
        assert "as a distance, against its name" in found["depth_evidence"]

    def test_a_channel_map_is_not_questioned(self, exwarp, keys_of, tmp_path):
        (tmp_path / "map.toml").write_text('depth_kind = "axis"\n')
        options = ("--channel-map", tmp_path / "map.toml", *FORWARD, "--json")
        found = json.loads(exwarp("inspect", keys_of(inverse), *options).out)
        assert (found["depth_kind"], found["depth_evidence"]) == ("axis", None)


def test_slots_and_key_frames_are_read_alike(exwarp, tmp_path):
    keys = shots.sequence(tmp_path / "keys", written(inverse), (1, 2), STREET)
    frame = written(inverse, "Depth.Z", shots.slot_planes)
    slots = shots.sequence(tmp_path / "slots", frame, range(1, 6), STREET, 0.25)
    for path in slots.iterdir():
        _, planes = shots.read(path)
        shots.write(path, {"": {n: p for n, p in planes.items() if "Position" not in n}})
    options = ("-m", "s6", "--gbuffers", slots, "--motion", "previous=X,-Y", "--dry-run")
    said = exwarp("upsample", keys, "-o", tmp_path / "o", *options)
    assert "depth 'Depth' grows towards the camera" in said.err


class TestContradiction:
    """Squares that pass before a wall: two of a larger value than it, one of a smaller one."""

    VALUES = (9.0, 9.0, 1.0)

    def keys(self, folder, values=VALUES):
        noise = np.random.default_rng(1).random((96, 160, 3))
        for i in range(3):
            colour, depth = noise.copy(), np.full((96, 160), 5.0)
            u = np.zeros((96, 160))
            for row, value in enumerate(values):
                where = (slice(4 + 30 * row, 28 + 30 * row), slice(20 + 8 * i, 60 + 8 * i))
                colour[where], depth[where], u[where] = noise[:24, :40] + row / 3, value, 8
            planes = {
                **layer("", "RGB", colour),
                **layer("", "Z", depth[..., None], FLOAT),
                **layer("forward", "uv", np.stack([u, 0 * u], -1), FLOAT),
            }
            shots.write(folder / f"shot.{i + 1:04d}.exr", {"": planes})
        return folder

    def test_depth_that_contradicts_itself_is_left_out(self, exwarp, upsample, tmp_path):
        keys = self.keys(tmp_path / "keys")
        found = json.loads(exwarp("inspect", keys, *FORWARD, "--json").out)
        assert found["depth_kind"] is None and "depth" not in found["roles"]
        assert "'Z' is left out" in found["depth_evidence"]
        assert "'Z' contradicts the vectors" in exwarp("inspect", keys, *FORWARD).out
        # As if the pass was not there.
        upsample(keys, tmp_path / "a", "-m", "softsplat", *FORWARD, "--frames", 1)
        for path in keys.iterdir():
            header, planes = shots.read(path)
            del planes["Z"]
            shots.write(path, {"": planes}, header)
        upsample(keys, tmp_path / "b", "-m", "softsplat", *FORWARD, "--frames", 1)
        for number in (2, 3, 4):
            a, b = (shots.colour_of(tmp_path / k / f"shot.{number:04d}.exr") for k in "ab")
            assert (a == b).all()

    @pytest.mark.parametrize(
        ("values", "kind"),
        [((9.0, 1.0, 1.0), DepthKind.UNKNOWN), ((9.0, 9.0, 9.0), DepthKind.INVERSE)],
    )
    def test_a_majority_decides(self, tmp_path, values, kind):
        shot = open_shot(str(self.keys(tmp_path, values)))
        finding = find_motion(shot, "next=u,-v")
        found = with_depth_ordered(shot, finding.convention)
        assert found.depth.kind is kind
        depth = read_raw(found, 1, (Role.DEPTH,)).gbuffer.depth
        assert (depth[4:28, 20:60] < depth[0, 0]).all() == (kind is DepthKind.INVERSE)
