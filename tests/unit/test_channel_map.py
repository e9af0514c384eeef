"""Channel maps: written text is read back, and whatever is wrong with a file is said."""

from __future__ import annotations

import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from exwarp_cli.errors import ExwarpError, InputError
from exwarp_cli.io.channel_map import (
    AovFile,
    ChannelMap,
    channel_map_text,
    quote_toml,
    read_channel_map,
)
from exwarp_cli.io.channels import Role
from exwarp_cli.io.depth import DepthKind

FULL = """
schema = "exwarp.channel-map/1"
producer = "House renderer"
view = "right"
motion = "previous=X,-Y"
depth_kind = "ray"

[channels]
colour = ["beauty.R", "beauty.G", "beauty.B"]
depth = "Z"
stencil = []

[aovs]
motion = 'C:\\vec\\mv.####.exr:R,G'
"""


def read(tmp_path, text: str) -> ChannelMap:
    path = tmp_path / "map.toml"
    path.write_text(text, encoding="utf-8")
    return read_channel_map(path)


class TestRead:
    def test_everything(self, tmp_path):
        found = read(tmp_path, FULL)
        assert found.channels == {
            Role.COLOUR: ("beauty.R", "beauty.G", "beauty.B"),
            Role.DEPTH: ("Z",),
            Role.STENCIL: (),
        }
        assert found.aovs == (AovFile(Role.MOTION, r"C:\vec\mv.####.exr", ("R", "G")),)
        stated = (found.producer, found.view, found.motion, found.depth_kind)
        assert stated == ("House renderer", "right", "previous=X,-Y", DepthKind.RAY)

    def test_the_mark_that_some_editors_begin_with(self, tmp_path):
        assert read(tmp_path, "\ufeff" + FULL) == read(tmp_path, FULL)

    def test_nothing(self, tmp_path):
        assert read(tmp_path, "") == ChannelMap(tmp_path / "map.toml")

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("chanels = 1", "chanels in the channel map {} is unknown; the keys are schema, "),
            ("view = 3", "view in the channel map {} has to be a text in quotes"),
            ('view = ""', "view in the channel map {} has to be a text in quotes"),
            ("channels = []", "channels in the channel map {} has to be a table; write [channels]"),
            ("[channels]\ndepth = 1", "channels.depth in the channel map {} has to be a list of"),
            ("[channels]\ndepth = [1]", "channels.depth in the channel map {} has to be a list of"),
            ('[channels]\ndepth = [""]', "channels.depth in the channel map {} has to be a list"),
            ('[channels]\ndeep = "Z"', "channels.deep in the channel map {}: 'deep' is no role"),
            (
                '[channels]\nnormal = ["X"]',
                "channels.normal in the channel map {} names 1 channel for normal, which takes 3",
            ),
            ('[aovs]\ndepth = ["a.exr"]', "aovs.depth in the channel map {} has to be a text such"),
            ('[aovs]\ndepth = "a.exr:R,G"', "in [aovs] of the channel map {}: --aov depth="),
            ('schema = "exwarp.channel-map/9"', "schema in the channel map {} is not exwarp."),
            (
                'depth_kind = "far"',
                "depth_kind in the channel map {} is 'far'; write one of axis, ",
            ),
            (
                '[channels]\nmotion = ["X", "X"]',
                "channels.motion in the channel map {} names the channel 'X' of motion twice",
            ),
            (
                '[channels]\ndepth = "a"\nDEPTH = "b"',
                "channels.DEPTH in the channel map {} names depth twice",
            ),
            (
                '[channels]\ndepth = "a"\n[aovs]\ndepth = "b"',
                "the channel map {} names depth in [channels] and in [aovs]",
            ),
            ("view = right", "the channel map {} is not TOML (invalid value (at line 1, "),
            ('view = "a"\nview = "b"', "the channel map {} is not TOML (cannot overwrite"),
        ],
    )
    def test_what_is_wrong_is_said_with_file_and_key(self, tmp_path, text, message):
        with pytest.raises(ExwarpError) as caught:
            read(tmp_path, text)
        assert message.format(tmp_path / "map.toml") in str(caught.value)
        assert "\n" not in str(caught.value) and caught.value.exit_code in (2, 3)

    def test_files_that_cannot_be_read(self, tmp_path):
        (tmp_path / "a.toml").write_bytes(b'view = "\xff"')
        with pytest.raises(InputError, match=r"a\.toml is not TOML"):
            read_channel_map(tmp_path / "a.toml")
        for path in (tmp_path / "none.toml", tmp_path):
            with pytest.raises(InputError, match=r"cannot read the channel map .*; check the path"):
                read_channel_map(path)


class TestWrite:
    @given(text=st.text(st.characters(codec="utf-8")))
    def test_any_text_is_read_back(self, text):
        assert tomllib.loads(f"a = {quote_toml(text)}")["a"] == text

    def test_names_that_are_no_text_still_make_a_file(self):
        assert quote_toml("bad" + chr(0xDCFF)).encode() == b'"bad?"'

    def test_a_map_is_read_back(self, tmp_path):
        channels = {Role.COLOUR: ('a"b\\.R', "é.G", "x\ty.B"), Role.DEPTH: ("Z",)}
        aovs = (AovFile(Role.MOTION, "v/#.exr", ("u", "v")), AovFile(Role.NORMAL, "n"))
        texts = {"view": "ri\nght", "motion": "next=u,-v", "producer": None}
        text = channel_map_text("shot\n####.exr", texts, channels, aovs)
        found = read(tmp_path, text)
        assert (found.channels, found.aovs) == (channels, aovs)
        assert (found.view, found.motion, found.producer) == ("ri\nght", "next=u,-v", None)
        comments = [line for line in text.splitlines() if line.startswith("#")]
        for word in ("# producer: ", "# motion: ", "# albedo = []", "# depth_kind: "):
            assert any(line.startswith(word) for line in comments)
        assert "# motion = []" not in comments, "it lies in [aovs]"
