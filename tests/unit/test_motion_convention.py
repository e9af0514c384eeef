"""The option --motion: reading it, and writing what it reads."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from exwarp_cli.commands.upsample import command
from exwarp_cli.domain.frame import Window
from exwarp_cli.domain.motion import PRESETS, AxisMap, MotionConvention
from exwarp_cli.errors import UsageError
from exwarp_cli.io.channels import ChannelRef, Layout, Role
from exwarp_cli.io.sequences import Sequence
from exwarp_cli.io.shot import Shot
from exwarp_cli.pipeline.motion_convention import motion_names, parse_motion

XYZW = ("X", "Y", "Z", "W")
UV = ("forward.u", "forward.v", "backward.u", "backward.v")
RGBA, SIZE = ("R", "G", "B", "A"), (1920, 1080)
UV_BACK = ("forward.u", "forward.v", "back.u", "back.v")


def shot_with(motion: tuple[ChannelRef, ...]) -> Shot:
    sequence = Sequence("a.", 4, ".exr", Path(), {1: Path("a.0001.exr")})
    return Shot(sequence, {}, Layout({Role.MOTION: motion}), Window(0, 0, 4, 3))


class TestParseMotion:
    @pytest.mark.parametrize(
        ("text", "names", "expected"),
        [
            ("previous=X,-Y", XYZW, MotionConvention(AxisMap(0, 1, 1, -1))),
            ("next=-Z,W", XYZW, MotionConvention(None, AxisMap(2, 3, -1, 1))),
            ("previous=X,-Y next=-Z,W", XYZW, PRESETS["blender"]),
            ("next=-Z,W   previous=+X,-Y", XYZW, PRESETS["blender"]),
            ("next=0.5*X,-0.25*Y", XYZW, MotionConvention(None, AxisMap(0, 1, 0.5, -0.25))),
            ("next=1920*Y,1080*X", XYZW, MotionConvention(None, AxisMap(1, 0, 1920, 1080))),
            ("next=forward.u,-forward.v", UV, MotionConvention(None, AxisMap(0, 1, 1, -1))),
            ("previous=-backward.u,backward.v", UV, MotionConvention(AxisMap(2, 3, -1, 1))),
        ],
    )
    def test_by_hand(self, text, names, expected):
        assert parse_motion(text, names, SIZE) == expected

    @pytest.mark.parametrize("name", PRESETS)
    def test_presets(self, name):
        expected = PRESETS[name].sized(*SIZE)
        assert parse_motion(name, XYZW, SIZE) == expected
        assert parse_motion(f"  {name.upper()} ", XYZW, SIZE) == expected

    @pytest.mark.parametrize("name", PRESETS)
    def test_what_is_described_can_be_given(self, name):
        for names in (XYZW, UV):
            described = PRESETS[name].describe(names)
            assert parse_motion(described, names, SIZE) == PRESETS[name].sized(*SIZE)

    @pytest.mark.parametrize("name", ["blender", "forward+backward"])
    def test_a_preset_of_more_channels_than_there_are(self, name):
        with pytest.raises(UsageError, match="needs 4 motion channels and there are 2: u, v"):
            parse_motion(name, ("u", "v"), SIZE)

    @pytest.mark.parametrize(
        "text",
        [
            "X,Y",
            "next=X",
            "next=X,Y,Z",
            "later=X,Y",
            "next=X,Q",
            "next=x,y",
            "next=1..5*X,Y",
            "next=.*X,Y",
            "next=X*2,Y",
            "next=--X,Y",
            "next=X, Y",
            "previous=X,Y nonsense",
            "lightwave",
            "next=R",
            "next=width*X",
            "next=(X-0.5),Y",
            "next=X*Z,Y",
            "next=X/W,Y",
            "next=(X-),(Y-)",
            "next=X-0.5,Y-0.5",
            "next=(X,Y)",
            "next=X*Q,Y*Q",
            "next=width*2*X,Y",
            "next=X,Y next=X,Y",
            "next=X,Y previous=",
            "next=infinity*X,Y",
            "next=nan*X,Y",
        ],
    )
    def test_what_is_not_understood(self, text):
        with pytest.raises(UsageError) as caught:
            parse_motion(text, XYZW, SIZE)
        message = str(caught.value)
        assert repr(text) in message and "previous=X,-Y" in message and "blender" in message

    @pytest.mark.parametrize("text", ["", "   "])
    def test_nothing(self, text):
        with pytest.raises(UsageError, match="--motion is empty"):
            parse_motion(text, XYZW, SIZE)


class TestOtherForms:
    @pytest.mark.parametrize(
        ("text", "expected"),
        [
            ("next=(R-0.5),-(G-0.5)", AxisMap(0, 1, 1, -1, still=0.5)),
            ("next=-1920*(R-0.5),1080*(G-0.5)", AxisMap(0, 1, -1920, 1080, still=0.5)),
            ("next=2*(R+1),2*(G+1)", AxisMap(0, 1, 2, 2, still=-1)),
            ("next=R*B,-G*B", AxisMap(0, 1, 1, -1, length=2)),
            ("next=2*(R-0.5)*B,-2*(G-0.5)*B", AxisMap(0, 1, 2, -2, 0.5, length=2)),
            ("next=R/A,-9*G/A", AxisMap(0, 1, 1, -9, alpha=3)),
            ("next=9*(R/A-0.5),9*(G/A-0.5)", AxisMap(0, 1, 9, 9, 0.5, alpha=3)),
            ("next=(R/A-0.5)*B,(G/A-0.5)*B", AxisMap(0, 1, 1, 1, 0.5, 2, 3)),
            ("next=1e-05*R,2.5E+3*G", AxisMap(0, 1, 1e-05, 2500)),
            ("next=width*R,-0.5*height*G", AxisMap(0, 1, 1920, -540)),
            ("next=width*(R-0.5),-width*(G-0.5)", AxisMap(0, 1, 1920, -1920, still=0.5)),
            ("next=width*R,G", AxisMap(0, 1, 1920, 1)),
        ],
    )
    def test_by_hand(self, text, expected):
        assert parse_motion(text, RGBA, SIZE) == MotionConvention(None, expected)

    def test_a_convention_in_pixels_keeps_them(self):
        found = parse_motion("next=width*R,-0.5*height*G", RGBA, SIZE)
        assert found.sized(*SIZE) == found

    def test_presets_count_in_the_frame_s_pixels(self):
        found = parse_motion("moonray", ("R", "G", "A"), SIZE)
        assert found == MotionConvention(None, AxisMap(0, 1, 960, -540, alpha=2))

    @pytest.mark.parametrize(("name", "count"), [("moonray", 3), ("arnold", 3), ("nuke", 4)])
    def test_a_preset_without_its_channels(self, name, count):
        with pytest.raises(UsageError, match=f"needs {count} motion channels and there are 2"):
            parse_motion(name, ("R", "G"), SIZE)

    def test_names_with_signs_in_them(self):
        names = ("my-fwd.u", "my-fwd.v", "a*b(c).u", "a*b(c).v")
        found = parse_motion(
            "next=2*my-fwd.u,-(my-fwd.v-0) previous=a*b(c).u,a*b(c).v", names, SIZE
        )
        expected = MotionConvention(AxisMap(2, 3, 1, 1), AxisMap(0, 1, 2, -1))
        assert found == expected


@pytest.mark.parametrize("text", ["next=1e999*R,G", "next=R,9e37*G", "next=1e28*width*R,G"])
def test_factors_beyond_numbers_are_refused(text):
    with pytest.raises(UsageError, match=r"has a factor above 1e\+30; correct it"):
        parse_motion(text, RGBA, SIZE)


class TestNames:
    """Names of channels that --motion takes."""

    @pytest.mark.parametrize(
        ("refs", "expected"),
        [
            (("forward.u", "forward.v"), ("u", "v")),
            (("a.forward.u", "a.forward.v", "a.back.u", "a.back.v"), UV_BACK),
            (
                ("A.Vec.X", "A.Vec.Y", "B.Vec.X", "B.Vec.Y"),
                ("A.Vec.X", "A.Vec.Y", "B.Vec.X", "B.Vec.Y"),
            ),
            (("fore:R", "fore:G", "back:R", "back:G"), ("fore:R", "fore:G", "back:R", "back:G")),
        ],
    )
    def test_as_short_as_tells_them_apart(self, refs, expected):
        parts = (ref.rpartition(":") for ref in refs)
        motion = tuple(ChannelRef(aov, name) for aov, _, name in parts)
        found = motion_names(shot_with(motion))
        assert found == expected and len(set(found)) == len(found)


scales = st.floats(1e-6, 1e6).flatmap(lambda s: st.sampled_from([s, -s]))
maps = st.builds(
    AxisMap,
    st.integers(0, 3),
    st.integers(0, 3),
    scales,
    scales,
    st.sampled_from([0.0, 0.5, -1.0, 1 / 3]),
    st.sampled_from([None, 2]),
    st.sampled_from([None, 3]),
)


# Artists name layers: spaces, commas, signs and words of the notation itself are all met.
@given(
    maps,
    st.one_of(st.none(), maps),
    st.tuples(*(st.sampled_from(["u", "x y", "a,b", "é-1"]) for _ in range(4))),
)
def test_any_layer_s_name_reads_back(before, after, words):
    names = tuple(f"{word}.{letter}" for word, letter in zip(words, "uvwz", strict=True))
    convention = MotionConvention(before, after)
    assert parse_motion(convention.describe(names), names, SIZE) == convention


@given(maps, st.one_of(st.none(), maps), st.booleans())
def test_what_is_described_reads_back_as_itself(before, after, of_frame):
    convention = MotionConvention(before, after, of_frame)
    assert parse_motion(convention.describe(RGBA), RGBA, SIZE) == convention.sized(*SIZE)


def test_the_command_names_every_preset():
    parameters = {parameter.name: parameter for parameter in command.params}
    assert set(PRESETS) <= set(re.split(r"[(), ]+", parameters["motion"].help))
