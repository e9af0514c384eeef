"""``exwarp inspect``: views, AOVs in their own files, deep and tiled parts, channel maps."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import OpenEXR
import pytest

from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.pipeline.run import upsample
from tests.cli import shots
from tests.stereo_shots import arguments, write_stereo
from tests.unit.exr_files import deep_part, flat_part, plane, rgba, write_tiled


@pytest.fixture(scope="module")
def stereo(tmp_path_factory) -> Path:
    """Two stereo frames in one part each; read only."""
    return write_stereo(tmp_path_factory.mktemp("stereo") / "single", "single", (1, 2))


@pytest.fixture(scope="module")
def split(tmp_path_factory) -> tuple[str, list[str]]:
    """Two stereo frames with a file for each role: the sequence, and options for the others."""
    folder = write_stereo(tmp_path_factory.mktemp("stereo") / "aovs", "aovs", (1, 2))
    sequence, aovs = arguments(folder, "aovs")
    return sequence, [word for text in aovs for word in ("--aov", text)]


class TestWhatIsShown:
    def test_views(self, stereo, exwarp):
        for view, options in (("left", ()), ("right", ("--view", "right"))):
            shown = exwarp("inspect", stereo, *options)
            assert f"views left, right; shown is {view}" in shown.out
            assert "motion calibrated: previous=X,-Y next=-Z,W measured" in shown.out
            found = json.loads(exwarp("inspect", stereo, *options, "--json").out)
            assert (found["views"], found["view"]) == (["left", "right"], view)
            assert found["roles"]["depth"] == ["Depth.Z"]
            assert found["parts"][0]["views"] == ["left", "right"]
        exwarp("inspect", stereo, "--view", "top").refused(3, "left and right", "'top'")

    def test_files_of_aovs(self, split, exwarp):
        sequence, options = split
        found = json.loads(exwarp("inspect", sequence, *options, "--json").out)
        assert set(found["aovs"]) == {"motion", "depth", "normal"}
        assert found["roles"]["motion"] == [f"motion:{c}" for c in "XYZW"]
        shown = exwarp("inspect", sequence, *options).out
        assert "AOV motion in " in shown
        assert next(r for r in shown.splitlines() if "motion:X" in r).split()[-1] == "float"

    @pytest.mark.parametrize(
        ("text", "code", "words"),
        [
            ("motion", 2, ("--aov 'motion'", "ROLE=PATTERN")),
            ("speed=x.exr", 2, ("'speed' is no role", "colour, depth")),
            ("depth=none/z.####.exr", 3, ("the folder none does not exist",)),
        ],
    )
    def test_bad_aovs(self, stereo, exwarp, text, code, words):
        exwarp("inspect", stereo, "--aov", text).refused(code, *words)

    def test_tiles_and_deep_parts(self, exwarp, tmp_path):
        (tmp_path / "tiled").mkdir()
        write_tiled(tmp_path / "tiled" / "a.0001.exr", rgba(9, 9), "MIPMAP_LEVELS")
        assert "the file is stored in tiles" in exwarp("inspect", tmp_path / "tiled").out
        (tmp_path / "deep").mkdir()
        made = [flat_part(rgba(4, 5), "rgba"), deep_part(4, 5, "smoke")]
        OpenEXR.File(made).write(str(tmp_path / "deep" / "a.0001.exr"))
        assert "part smoke is deep and not read" in exwarp("inspect", tmp_path / "deep").out
        found = json.loads(exwarp("inspect", tmp_path / "deep", "--json").out)
        assert [part["deep"] for part in found["parts"]] == [False, True]
        OpenEXR.File([made[1]]).write(str(tmp_path / "deep" / "a.0001.exr"))
        exwarp("inspect", tmp_path / "deep").refused(3, "a deep image", "--flatten")

    def test_cryptomattes(self, exwarp, tmp_path):
        planes = rgba(4, 5, "float32") | {
            f"crypto_object00.{c}": plane for c, plane in rgba(4, 5, "float32").items()
        }
        shots.write(tmp_path / "a.0001.exr", {"": planes})
        shown = exwarp("inspect", tmp_path).out
        assert "Cryptomatte crypto_object (object): " in shown and "no role" not in shown
        assert all(f"crypto_object00.{c}" in shown for c in "RGBA")


class TestUnrecognisedChannels:
    """Every channel is shown by the name that a channel map takes, recognised or not."""

    PLANES = ("R", "G", "B", "smoke.speed", "smoke.heat", "wetness", "crypto_asset00.r")

    @pytest.fixture
    def keys(self, tmp_path) -> Path:
        planes = {name: plane(4, 5, 0.25) for name in self.PLANES}
        further = {name: plane(4, 5, 0.5) for name in ("U", "V", "Q.X")}
        shots.write(tmp_path / "keys/a.0001.exr", {"rgb": planes, "odd": further})
        return tmp_path / "keys"

    NAMES = ("rgb.R", "rgb.wetness", "smoke.speed", "smoke.heat", "odd.U", "odd.V", "Q.X")

    def test_in_the_table_and_in_json(self, keys, exwarp):
        shown = exwarp("inspect", keys).out
        rows = [line for line in shown.splitlines() if "no role" in line]
        assert len(rows) == 5 and "smoke.heat, smoke.speed" in shown
        assert all(name in shown for name in (*self.NAMES, "crypto_asset00.r"))
        channels = json.loads(exwarp("inspect", keys, "--json").out)["channels"]
        assert len(channels) == 10 and set(self.NAMES) <= set(channels)
        assert set(channels.values()) == {"float"}

    def test_in_a_channel_map_which_takes_them(self, keys, exwarp, tmp_path):
        target = tmp_path / "m.toml"
        assert exwarp("inspect", keys, "--write-channel-map", target).code == 0
        text = target.read_text(encoding="utf-8")
        for name in self.NAMES[1:]:
            assert f'# "{name}"' in text
            role = f'# depth = []\ndepth = ["{name}"]'
            target.write_text(text.replace("# depth = []", role), encoding="utf-8")
            mapped = exwarp("inspect", keys, "--channel-map", target, "--json")
            assert json.loads(mapped.out)["roles"]["depth"] == [name]

    def test_in_errors(self, exwarp, tmp_path):
        names = [f"layer{i}.Q" for i in range(20)]
        shots.write(tmp_path / "a.0001.exr", {"": {name: plane(4, 5, 0.5) for name in names}})
        listed = ", ".join(sorted(names))
        words = ("no colour channels", f"only {listed}; name them in a channel map")
        exwarp("upsample", tmp_path, "-o", tmp_path / "out").refused(3, *words)
        exwarp("inspect", tmp_path, "--aov", f"depth={tmp_path}").refused(3, f"only {listed};")

    def test_files_of_aovs(self, split, exwarp, tmp_path):
        sequence, _ = split
        more = Path(sequence).parent / "more"
        command = ("inspect", more, "--aov", f"colour={sequence}")
        channels = json.loads(exwarp(*command, "--json").out)["channels"]
        assert {"R", "main:Normal.X", "main:Object Index.X"} <= set(channels)
        target = tmp_path / "m.toml"
        assert exwarp(*command, "--write-channel-map", target).code == 0
        assert "no role" not in target.read_text(encoding="utf-8")


class TestChannelMaps:
    def write(self, exwarp, target: Path, *options: object) -> dict:
        result = exwarp("inspect", *options, "--write-channel-map", target)
        assert result.code == 0, result.err
        return tomllib.loads(target.read_text(encoding="utf-8"))

    def test_a_map_says_what_was_found(self, stereo, exwarp, tmp_path):
        found = self.write(exwarp, tmp_path / "m.toml", stereo)
        assert found["motion"] == "previous=X,-Y next=-Z,W" and found["producer"] == "Blender"
        assert found["channels"]["colour"] == list("RGBA") and "view" not in found
        assert "albedo" not in found["channels"] and found["aovs"] == {}
        right = self.write(exwarp, tmp_path / "r.toml", stereo, "--view", "right")
        assert right["view"] == "right" and right["channels"] == found["channels"]
        again = self.write(
            exwarp, tmp_path / "s.toml", stereo, "--channel-map", tmp_path / "r.toml"
        )
        assert again == right

    def test_sequences_of_aovs_are_in_it(self, split, exwarp, tmp_path):
        sequence, options = split
        found = self.write(exwarp, tmp_path / "m.toml", sequence, *options)
        assert set(found["channels"]) == {"colour"}
        assert set(found["aovs"]) == {"motion", "depth", "normal", "position", "stencil"}
        # The same shot by the map alone.
        shown = json.loads(exwarp("inspect", sequence, *options, "--json").out)
        mapped = exwarp("inspect", sequence, "--channel-map", tmp_path / "m.toml", "--json")
        document = json.loads(mapped.out)
        for key in ("roles", "aovs", "view"):
            assert document[key] == shown[key]
        assert document["motion"]["convention"] == shown["motion"]["convention"]

    def test_a_colour_sequence_that_leads_is_in_it(self, split, exwarp, tmp_path):
        sequence, options = split
        main, colour = Path(sequence).parent / "more", ("--aov", f"colour={sequence}")
        found = self.write(exwarp, tmp_path / "m.toml", main, *colour, *options[:2])
        assert found["channels"]["stencil"] == ["Object Index.X"]
        assert set(found["aovs"]) == {"colour", "motion"}
        shown = json.loads(exwarp("inspect", main, *colour, *options[:2], "--json").out)
        by_map = exwarp("inspect", main, "--channel-map", tmp_path / "m.toml", "--json")
        assert json.loads(by_map.out)["roles"] == shown["roles"]
        assert shown["roles"]["stencil"] == ["main:Object Index.X"]

    def test_a_sequence_in_place_of_a_pass_is_in_it(self, exwarp, tmp_path):
        for number in (1, 2):
            passes = {"beauty": rgba(48, 64), "depth": {"Z": plane(48, 64, 5.0)}}
            for name, planes in passes.items():
                shots.write(tmp_path / "set" / f"shot.{name}.{number:04d}.exr", {"": planes})
            shots.write(tmp_path / f"z.{number:04d}.exr", {"": {"far.V": plane(48, 64, 6.0)}})
        depth = str(tmp_path / "z.####.exr")
        options = (tmp_path / "set", "--aov", f"depth={depth}")
        assert self.write(exwarp, tmp_path / "m.toml", *options)["aovs"] == {"depth": depth}

    def test_what_was_not_measured_is_not_in_it(self, exwarp, tmp_path):
        shots.sequence(tmp_path / "keys", shots.blender5, (1,))
        found = self.write(exwarp, tmp_path / "m.toml", tmp_path / "keys")
        assert "motion" not in found and found["channels"]["motion"][0] == "ViewLayer.Vector.X"

    def test_nothing_is_overwritten_unasked(self, stereo, exwarp, tmp_path):
        target = tmp_path / "m.toml"
        target.write_text("mine")
        options = ("inspect", stereo, "--write-channel-map", target)
        exwarp(*options).refused(6, "m.toml exists", "--overwrite")
        assert target.read_text() == "mine"
        assert exwarp(*options, "--overwrite").code == 0
        assert "schema" in target.read_text()

    @pytest.mark.parametrize(
        ("text", "code", "words"),
        [
            ("chanels = 1", 3, ("chanels in the channel map", "m.toml is unknown")),
            ('[channels]\ndepth = "Q"', 3, ("channels.depth in the channel map", "'Q'", "m.toml")),
            ('motion = "sideways"', 2, ("motion in the channel map", "m.toml", "'sideways'")),
            ('motion = "next=X,Y"\n[channels]\nmotion = []', 3, ("motion in the channel map",)),
            ('view = "top"', 3, ("left and right", "'top'")),
        ],
    )
    def test_bad_maps(self, stereo, exwarp, tmp_path, text, code, words):
        (tmp_path / "m.toml").write_text(text)
        exwarp("inspect", stereo, "--channel-map", tmp_path / "m.toml").refused(code, *words)

    @pytest.mark.parametrize("writer", [shots.blender5, shots.plain, None])
    def test_the_frames_are_the_same_by_it(self, exwarp, tmp_path, writer):
        keys = tmp_path / "keys"
        if writer is None:
            for i in range(2):
                shots.unreal(keys, shots.SMALL, i, 1 + i)
        else:
            shots.sequence(keys, writer, (1, 2), shots.SMALL)
        found = self.write(exwarp, tmp_path / "m.toml", keys)
        assert "motion" in found
        for name, channel_map in (("without", None), ("with", str(tmp_path / "m.toml"))):
            settings = SourceSettings(str(keys), channel_map=channel_map)
            out = str(tmp_path / name)
            upsample(UpsampleSettings(settings, out, method="softsplat", threads=1))
        assert shots.contents(tmp_path / "with") == shots.contents(tmp_path / "without")
        assert len(shots.names(tmp_path / "with")) == 8

    def test_a_map_changes_what_is_read(self, exwarp, tmp_path):
        keys = shots.sequence(tmp_path / "keys", shots.plain, (1, 2), shots.SMALL)
        for name, motion in (("right", "next=u,-v"), ("wrong", "next=-u,v")):
            (tmp_path / name).with_suffix(".toml").write_text(f'motion = "{motion}"')
            settings = SourceSettings(str(keys), channel_map=str(tmp_path / f"{name}.toml"))
            upsample(UpsampleSettings(settings, str(tmp_path / name), method="s6", threads=1))
        one, other = (shots.colour_of(tmp_path / n / "shot.0003.exr") for n in ("right", "wrong"))
        assert abs(one - other).max() > 0.1
