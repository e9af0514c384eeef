"""The option --aov: reading it, and finding a role's channels in a file of its own."""

from __future__ import annotations

import pytest

from exwarp_cli.errors import LayoutError, UsageError
from exwarp_cli.io.channel_map import AovFile, detect_aov, parse_aovs, require_channel_count
from exwarp_cli.io.channels import Role
from exwarp_cli.io.exr.header import Channel


def channels(*names: str) -> dict[str, Channel]:
    return {name: Channel(0, i, name, name, "float") for i, name in enumerate(names)}


class TestParse:
    @pytest.mark.parametrize(
        ("text", "role", "pattern", "names"),
        [
            ("motion=vec/mv.####.exr:R,G", Role.MOTION, "vec/mv.####.exr", ("R", "G")),
            ("depth=z/####.exr:Z", Role.DEPTH, "z/####.exr", ("Z",)),
            ("depth=z/####.exr", Role.DEPTH, "z/####.exr", ()),
            (r"depth=C:\z\####.exr:Z", Role.DEPTH, r"C:\z\####.exr", ("Z",)),
            (r"depth=C:\z\####.EXR", Role.DEPTH, r"C:\z\####.EXR", ()),
            (r"depth=C:\folder", Role.DEPTH, r"C:\folder", ()),
            (r"depth=C:\my shot\z.%04d.exr:Z", Role.DEPTH, r"C:\my shot\z.%04d.exr", ("Z",)),
            ("depth=50% grey/z %04d.exr", Role.DEPTH, "50% grey/z %04d.exr", ()),
            ("color=a.exr:Y,Y,Y", Role.COLOUR, "a.exr", ("Y", "Y", "Y")),
            ("depth=C:/folder/z:Z", Role.DEPTH, "C:/folder/z", ("Z",)),
            ("depth=folder:depth.Z", Role.DEPTH, "folder", ("depth.Z",)),
            ("Depth=/a/z.1.exr:ray:hitPz.R", Role.DEPTH, "/a/z.1.exr", ("ray:hitPz.R",)),
            ("color=a.#.exr: R , G,B", Role.COLOUR, "a.#.exr", ("R", "G", "B")),
            ("motion=x.exr/a=b.####.exr:u,v", Role.MOTION, "x.exr/a=b.####.exr", ("u", "v")),
        ],
    )
    def test_what_people_write(self, text, role, pattern, names):
        assert parse_aovs([text]) == (AovFile(role, pattern, names),)

    @pytest.mark.parametrize(
        ("texts", "message"),
        [
            (["depth"], "not understood; write ROLE=PATTERN"),
            (["depth="], "not understood"),
            (["=a.exr"], "'' is no role; the roles are colour, depth"),
            (["deep=a.exr"], "'deep' is no role; the roles are colour, depth"),
            (["depth=a.exr:"], "a channel's name is empty"),
            (["motion=a.exr:R,,G"], "a channel's name is empty"),
            (["depth=a.exr:R,G"], "names 2 channels for depth, which takes 1; write"),
            (["motion=a.exr:R"], "names 1 channel for motion, which takes 2 to 5"),
            (["depth=a", "depth=b"], "names depth twice"),
            (["motion=a.exr:R,R"], "names the channel 'R' of motion twice"),
        ],
    )
    def test_what_is_refused(self, texts, message):
        with pytest.raises(UsageError, match=r"^--aov") as caught:
            parse_aovs(texts)
        assert message in str(caught.value) and "\n" not in str(caught.value)

    def test_counts_of_roles(self):
        for role, fits in ((Role.COLOUR, {3, 4}), (Role.NORMAL, {3}), (Role.STENCIL, {1})):
            for count in range(6):
                names = tuple("abcdef"[:count])
                if count in fits:
                    require_channel_count(role, names, "it")
                else:
                    with pytest.raises(UsageError, match=f"names {count} channel"):
                        require_channel_count(role, names, "it")


class TestRecognise:
    @pytest.mark.parametrize(
        ("role", "there", "taken"),
        [
            (Role.DEPTH, ("Z",), ("Z",)),
            (Role.DEPTH, ("R",), ("R",)),
            (Role.DEPTH, ("odd.V",), ("odd.V",)),
            (Role.DEPTH, ("R", "G", "B", "A", "depth.Z"), ("depth.Z",)),
            (Role.MOTION, ("X", "Y", "Z", "W"), ("X", "Y", "Z", "W")),
            (Role.DEPTH, ("R", "G", "B"), ("R",)),
            (Role.MOTION, ("u", "v"), ("u", "v")),
            (Role.MOTION, ("odd.x", "odd.y"), ("odd.x", "odd.y")),
            (Role.NORMAL, ("R", "G", "B"), ("R", "G", "B")),
            (Role.POSITION, ("odd.X", "odd.Y", "odd.Z"), ("odd.X", "odd.Y", "odd.Z")),
            (Role.STENCIL, ("Y",), ("Y",)),
            (Role.COLOUR, ("diffuse.R", "diffuse.G", "diffuse.B"), tuple("RGB")),
        ],
    )
    def test_by_the_role_or_the_only_layer(self, role, there, taken):
        found = detect_aov(AovFile(role, "p"), channels(*there), "aov", "it")
        (refs,) = found.roles.values()
        assert {ref.aov for ref in refs} == {"aov"}
        names = tuple(ref.name for ref in refs)
        assert names == taken or tuple(name.rpartition(".")[2] for name in names) == taken

    def test_colour_that_holds_vectors(self):
        found = detect_aov(AovFile(Role.MOTION, "p"), channels(*"RGBA"), "aov", "it")
        names = [ref.name for ref in found.roles[Role.MOTION]]
        assert names == ["R", "G", "B"], "alpha is no component of a vector"

    def test_names_say_what_motion_means(self):
        found = detect_aov(
            AovFile(Role.MOTION, "p"), channels("forward.u", "forward.v"), "aov", "it"
        )
        assert found.guess is not None
        assert detect_aov(AovFile(Role.MOTION, "p"), channels("u", "v"), "aov", "it").guess is None

    def test_channels_by_name(self):
        there = channels("mv.R", "mv.G", "other.B", "a.X", "b.X")
        found = detect_aov(AovFile(Role.MOTION, "p", ("R", "mv.G")), there, "aov", "it")
        assert [ref.name for ref in found.roles[Role.MOTION]] == ["mv.R", "mv.G"]
        for name, message in (("Q", "it has only mv.R, mv.G"), ("X", "several of that name")):
            with pytest.raises(
                LayoutError, match=f"--aov motion=p names .*{message}.*; correct it"
            ):
                detect_aov(AovFile(Role.MOTION, "p", (name, "G")), there, "aov", "it")

    def test_nothing_to_recognise(self):
        with pytest.raises(LayoutError, match=r"it has no depth .* --aov depth=p:Z"):
            detect_aov(AovFile(Role.DEPTH, "p"), channels("G", "B"), "aov", "it")
