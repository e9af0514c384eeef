"""Renders whose vectors are not recognised: an error that names them, and names that are known."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests.blender_layers import layer
from tests.cli import shots
from tests.cli.shots import SMALL


def renamed(names: dict[str, str]):
    """Return a frame writer: `shots.plain` with other names of layers, and without the rest."""

    def frame(path, street, time):
        planes = shots.plain_planes(street, time)
        out = {n: p for n, p in planes.items() if "." not in n and n != "Z"}
        for old, new in names.items():
            out[new] = planes[old]
        shots.write(path, {"": out})

    return frame


UNKNOWN = renamed({"Z": "Depth.Z", "forward.u": "wobble.R", "forward.v": "wobble.G"})


def vray(path, street, time):
    """Write a frame with V-Ray for 3ds Max's names: three components each, blue of vectors 0."""
    planes = shots.plain_planes(street, time)
    beauty = {n: p for n, p in planes.items() if n in "RGBA"}
    vectors = np.stack([planes["forward.u"], planes["forward.v"], 0 * planes["Z"]], -1)
    depth = np.repeat(planes["Z"][..., None], 3, -1)
    out = beauty | layer("VRayVelocity", "RGB", vectors) | layer("VRayZDepth", "RGB", depth)
    shots.write(path, {"": out})


class TestAnError:
    def test_names_what_is_not_recognised_and_what_is_likeliest(self, exwarp, tmp_path):
        keys = shots.sequence(tmp_path / "keys", UNKNOWN, street=SMALL)
        result = exwarp("upsample", keys, "-o", tmp_path / "out", "--progress", "none")
        words = ("not recognised: wobble.{R,G}", "likeliest: wobble", ":wobble.R,wobble.G")
        result.refused(3, "no motion vectors", *words, "--estimate-motion", "hold or blend")
        assert not (tmp_path / "out").exists()

    def test_what_it_proposes_works(self, exwarp, upsample, tmp_path):
        keys = shots.sequence(tmp_path / "keys", UNKNOWN, street=SMALL)
        said = exwarp("upsample", keys, "-o", tmp_path / "out").err
        aov = said.split("as in ")[1].split(";")[0].split()
        upsample(keys, tmp_path / "out", *aov, "-m", "s6")

    @pytest.mark.parametrize("passes", [{"Z": "Depth.Z"}, {"Z": "lights.Y"}])
    def test_any_pass_makes_it_a_render(self, exwarp, tmp_path, passes):
        keys = shots.sequence(tmp_path / "keys", renamed(passes), street=SMALL)
        result = exwarp("upsample", keys, "-o", tmp_path / "out", "-m", "softsplat")
        result.refused(3, "no motion vectors", "--estimate-motion")

    def test_a_file_of_vectors_beside_it_too(self, exwarp, tmp_path):
        keys = shots.sequence(tmp_path / "keys", shots.colour_only, street=SMALL)
        for number in (1, 2, 3):
            (keys / f"shot.wobblevec_vec.{number:04d}.exr").touch()
        result = exwarp("upsample", keys / "shot.####.exr", "-o", tmp_path / "out")
        result.refused(3, "no motion vectors", "shot.wobblevec_vec.####.exr", "--aov motion=")

    @pytest.mark.parametrize("method", ["blend", "hold"])
    def test_methods_without_motion_do_not_mind(self, upsample, tmp_path, method):
        keys = shots.sequence(tmp_path / "keys", UNKNOWN, street=SMALL)
        upsample(keys, tmp_path / "out", "-m", method)

    def test_a_farm_carries_the_leave(self, exwarp, tmp_path):
        keys = shots.sequence(tmp_path / "keys", renamed({"Z": "Depth.Z"}), street=SMALL)
        job = ("farm", "commands", keys, "-o", tmp_path / "out", "--estimate-motion")
        assert "--estimate-motion" in exwarp(*job).out

    def test_dry_run_and_inspect_say_so(self, exwarp, tmp_path):
        keys = shots.sequence(tmp_path / "keys", renamed({"Z": "Depth.Z"}), street=SMALL)
        exwarp("upsample", keys, "-o", tmp_path / "o", "--dry-run").refused(3, "no motion vectors")
        assert "has no motion vectors" in exwarp("inspect", keys).out


class TestEstimating:
    @pytest.mark.parametrize("method", [(), ("-m", "s6")])
    def test_it_has_to_be_allowed(self, upsample, tmp_path, method):
        pytest.importorskip("cv2")
        keys = shots.sequence(tmp_path / "keys", renamed({"Z": "Depth.Z"}), street=SMALL)
        run = upsample(keys, tmp_path / "out", "--estimate-motion", *method, "--json")
        document = json.loads(run.out)
        assert document["input"]["motion"]["source"] == "estimated"

    def test_vectors_that_are_there_are_used(self, exwarp, tmp_path):
        keys = shots.sequence(tmp_path / "keys")
        options = ("-o", tmp_path / "out", "-m", "s6", "--estimate-motion", "--dry-run")
        assert "motion calibrated" in exwarp("upsample", keys, *options).err

    def test_vectors_that_explain_nothing_are_left_out_and_it_is_said(self, exwarp, tmp_path):
        pytest.importorskip("cv2")
        chance = np.random.default_rng(3)

        def frame(path, street, time):
            planes = shots.plain_planes(street, time)
            for name in ("forward.u", "forward.v"):
                planes[name] = chance.normal(0, 20, planes[name].shape).astype(np.float32)
            shots.write(path, {"": planes})

        keys = shots.sequence(tmp_path / "keys", frame)
        options = ("upsample", keys, "-o", tmp_path / "out", "-m", "s6", "--dry-run")
        exwarp(*options).refused(4)
        said = exwarp(*options, "--estimate-motion")
        assert said.code == 0 and "vectors are not used: no reading" in said.err


class TestNames:
    def test_those_of_vray_for_max(self, exwarp, tmp_path):
        found = json.loads(exwarp("inspect", shots.sequence(tmp_path, vray), "--json").out)
        assert found["producer"] == "V-Ray"
        assert found["roles"]["depth"] == ["VRayZDepth.R"]
        assert found["motion"]["convention"] == "next=R,-G"
        assert found["motion"]["source"] == "calibrated"

    @pytest.mark.parametrize(
        "name", ["MV", "Speed", "camera_MV", "MotionVectorsRaw", "fx.motion_pass", "Velocity_v2"]
    )
    def test_others(self, exwarp, tmp_path, name):
        names = {"Z": "Z", "forward.u": f"{name}.R", "forward.v": f"{name}.G"}
        found = json.loads(
            exwarp("inspect", shots.sequence(tmp_path, renamed(names)), "--json").out
        )
        assert found["roles"]["motion"] == [f"{name}.R", f"{name}.G"]
        assert found["motion"]["convention"] == "next=R,-G"

    def test_a_word_before_that_makes_it_another_thing(self, exwarp, tmp_path):
        names = {"Z": "ShadowDepth.Z", "forward.u": "forward.u", "forward.v": "forward.v"}
        found = json.loads(
            exwarp("inspect", shots.sequence(tmp_path, renamed(names)), "--json").out
        )
        assert "depth" not in found["roles"]


class TestSequenceAPass:
    def write(self, folder, street, numbers=(1, 2, 3), vectors="MotionVectors", extra=True):
        """Write shot.####.exr with vectors, depth and light in sequences of their own."""
        for i, number in enumerate(numbers):
            planes = shots.plain_planes(street, i)
            colour = {n: p for n, p in planes.items() if n in "RGBA"}
            shots.write(folder / f"shot.{number:04d}.exr", {"": colour})
            vector = {"R": planes["forward.u"], "G": planes["forward.v"], "B": 0 * planes["Z"]}
            shots.write(folder / f"shot.{vectors}.{number:04d}.exr", {"": vector})
            shots.write(folder / f"shot.Z.{number:04d}.exr", {"": {"Z": planes["Z"]}})
            if extra:
                shots.write(folder / f"shot.GI.{number:04d}.exr", {"": colour})
        return folder

    @pytest.mark.parametrize("spec", ["", "shot.####.exr"])
    def test_its_frames_are_those_of_one_file(self, upsample, tmp_path, spec):
        keys = self.write(tmp_path / "keys", SMALL)
        one = shots.sequence(tmp_path / "one", shots.plain, street=SMALL)
        upsample(keys / spec, tmp_path / "a", "-m", "s6", "--motion", "next=R,-G")
        upsample(one, tmp_path / "b", "-m", "s6", *shots.FORWARD)
        assert shots.names(tmp_path / "a") == shots.names(tmp_path / "b")
        for number in (2, 3, 4, 6):
            name = f"shot.{number:04d}.exr"
            assert (shots.colour_of(tmp_path / "a" / name) == shots.colour_of(
                tmp_path / "b" / name)).all()  # fmt: skip

    def test_vectors_by_another_name_are_an_error(self, exwarp, tmp_path):
        keys = self.write(tmp_path / "keys", SMALL, vectors="wobblevec_vec")
        result = exwarp("upsample", keys, "-o", tmp_path / "out")
        result.refused(3, "wobblevec_vec:R", "likeliest: wobblevec_vec", "--aov motion=")

    def test_a_frame_that_a_pass_lacks_is_named(self, exwarp, tmp_path):
        keys = self.write(tmp_path / "keys", SMALL)
        (keys / "shot.MotionVectors.0002.exr").unlink()
        exwarp("inspect", keys).refused(3, "frame 2 of the AOV MotionVectors is missing")

    def test_a_render_that_holds_its_vectors_needs_no_other_files(self, exwarp, tmp_path):
        keys = shots.sequence(tmp_path / "keys")
        shots.write(keys / "shot.Z.0001.exr", {"": {"Z": np.ones((27, 48), np.float32)}})
        found = json.loads(exwarp("inspect", keys, "--json").out)
        assert found["aovs"] == {} and found["roles"]["depth"] == ["Z"]
