"""Opening shots: every layout of a stereo shot, AOVs in their own files, channel maps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import OpenEXR
import pytest

from exwarp_cli.domain.frame import place_on_canvas
from exwarp_cli.domain.settings import SourceSettings
from exwarp_cli.errors import LayoutError, MissingFrameError
from exwarp_cli.io.channel_map import ChannelMap, parse_aovs
from exwarp_cli.io.channels import Role
from exwarp_cli.io.cryptomatte import IdReading, hash_name
from exwarp_cli.io.depth import DepthKind
from exwarp_cli.io.frames import read_image, read_raw
from exwarp_cli.io.shot import open_shot
from exwarp_cli.pipeline.source import each_view
from tests.matrix import spread
from tests.reference.ranked import identity
from tests.stereo_layouts import LAYOUTS
from tests.stereo_shots import arguments, eyes_at, write_stereo
from tests.unit.cryptomatte_files import Style, write_cryptomatte
from tests.unit.exr_files import (
    box,
    deep_part,
    flat_part,
    plane,
    rgba,
    write_single,
)

INNER = np.s_[4:-4, 4:-4]
"""What every data window of the layouts holds."""


@pytest.fixture(scope="module", params=LAYOUTS)
def stereo(request, tmp_path_factory):
    layout = request.param
    folder = write_stereo(tmp_path_factory.mktemp("stereo") / layout, layout)
    return layout, *arguments(folder, layout)


class TestStereoLayouts:
    @pytest.mark.parametrize("view", spread([None, "left", "right"], 2))
    def test_each_view_is_read(self, stereo, view):
        layout, sequence, aovs = stereo
        shot = open_shot(sequence, view, parse_aovs(aovs))
        assert (shot.views, shot.view) == (("left", "right"), view or "left")
        for number in (1, 3):
            expected = eyes_at(number - 1)[view or "left"]
            raw = read_raw(shot, number)
            pixels = raw.image.on(shot.display).pixels
            for i, letter in enumerate("RGBA"):
                np.testing.assert_array_equal(
                    pixels[INNER][..., i], expected[f"Combined.{letter}"][INNER]
                )
            depth = raw.gbuffer.on(shot.display).depth
            wanted = expected["Depth.Z"]
            np.testing.assert_array_equal(
                depth[INNER], np.where(wanted > 1e9, np.inf, wanted)[INNER]
            )
            motion = place_on_canvas(raw.motion, raw.gbuffer.window, shot.display, np.nan)
            first = expected["Vector.Z"] * -1 if layout == "nuke" else expected["Vector.X"]
            np.testing.assert_array_equal(motion[INNER][..., 0], first[INNER])

    def test_all_views_at_once(self, stereo):
        _, sequence, aovs = stereo
        views = [each.view for each in each_view(SourceSettings(sequence, view="all", aovs=aovs))]
        assert views == ["left", "right"]
        found = [open_shot(sequence, view, parse_aovs(aovs)) for view in views]
        assert [shot.view for shot in found] == views
        assert [shot.by_hand.get("view") for shot in found] == [None, "right"]

    def test_an_unknown_view(self, stereo):
        _, sequence, aovs = stereo
        with pytest.raises(LayoutError, match="views left and right, not 'top'"):
            open_shot(sequence, "top", parse_aovs(aovs))


class TestViews:
    def test_the_names_are_the_same_for_every_view(self, tmp_path):
        folder = write_stereo(tmp_path / "nuke", "nuke", (1,))
        left, right = (open_shot(str(folder), view) for view in ("left", "right"))
        assert left.layout == right.layout and left.layout.producer == right.layout.producer
        names = [ref.name for ref in right.layout.roles[Role.MOTION]]
        assert names == ["forward.u", "forward.v", "backward.u", "backward.v"]

    def test_a_shot_without_views(self, tmp_path):
        write_single(tmp_path / "a.0001.exr", rgba(3, 4))
        shot = open_shot(str(tmp_path))
        assert (shot.views, shot.view, shot.by_hand) == ((), "", {})
        with pytest.raises(LayoutError, match=r"has no views"):
            open_shot(str(tmp_path), "left")
        with pytest.raises(LayoutError, match=r"has no views; leave --view all out"):
            each_view(SourceSettings(str(tmp_path), view="all"))

    def test_a_view_that_ends(self, tmp_path):
        write_stereo(tmp_path / "single", "single", (1,))
        write_single(tmp_path / "single" / "shot.0002.exr", rgba(36, 64))
        shot = open_shot(str(tmp_path / "single"), "right")
        with pytest.raises(LayoutError, match=r"shot\.0002\.exr has no channel"):
            read_raw(shot, 2)

    def test_files_of_a_view_that_call_it_otherwise(self, tmp_path):
        for view in ("left", "right"):
            (tmp_path / view).mkdir()
            planes = eyes_at(0)[view]
            path = tmp_path / view / "a.0001.exr"
            # As programs do that render one camera after the other.
            write_single(path, planes, view="main")
        for view in ("left", "right"):
            shot = open_shot(str(tmp_path / "%V" / "a.####.exr"), view)
            assert (shot.view, shot.within) == (view, {"": ""})
            pixels = read_raw(shot, 1).image.pixels
            np.testing.assert_array_equal(pixels[..., 0], eyes_at(0)[view]["Combined.R"])

    def test_images_of_a_view(self, tmp_path):
        folder = write_stereo(tmp_path / "single", "single", (1,))
        for view, eye in (("", "left"), ("right", "right")):
            image = read_image(folder / "shot.0001.exr", view)
            np.testing.assert_array_equal(image.pixels[..., 0], eyes_at(0)[eye]["Combined.R"])
        write_single(tmp_path / "mono.exr", rgba(3, 4))
        assert read_image(tmp_path / "mono.exr", "right").pixels.shape == (3, 4, 4)


class TestDeepAndLuminance:
    def test_deep_alone_is_refused_at_opening(self, tmp_path):
        OpenEXR.File([deep_part(4, 5, "deep")]).write(str(tmp_path / "a.0001.exr"))
        with pytest.raises(LayoutError, match=r"a\.0001\.exr is a deep image.*give the flat"):
            open_shot(str(tmp_path))

    @pytest.mark.parametrize("first", ["deep", "flat"])
    def test_deep_beside_the_beauty_is_left_alone(self, tmp_path, first):
        planes = rgba(4, 5)
        made = [deep_part(4, 5, "deep"), flat_part(planes, "rgba")]
        path = tmp_path / "a.0001.exr"
        OpenEXR.File(made if first == "deep" else made[::-1]).write(str(path))
        shot = open_shot(str(tmp_path))
        assert set(shot.layout.roles) == {Role.COLOUR}
        pixels = read_raw(shot, 1).image.pixels
        np.testing.assert_array_equal(pixels[..., 0], planes["R"])
        np.testing.assert_array_equal(read_image(path).pixels, pixels)

    def test_luminance_alone(self, tmp_path):
        write_single(tmp_path / "a.0001.exr", {"Y": plane(3, 4, 1), "A": plane(3, 4, 1)})
        with pytest.raises(LayoutError, match=r"holds luminance alone .*; write the frames as RGB"):
            open_shot(str(tmp_path))


@pytest.fixture
def split(tmp_path):
    """Colour with a depth of its own in one folder; vectors and another depth beside it."""
    for number in (1, 2):
        name = f"a.{number:04d}.exr"
        for folder in ("main", "mv", "z"):
            (tmp_path / folder).mkdir(exist_ok=True)
        write_single(tmp_path / "main" / name, rgba(4, 5, seed=number) | {"Z": plane(4, 5, 7)})
        vectors = {c: plane(4, 5, i + 10 * number) for i, c in enumerate("RGBA")}
        write_single(tmp_path / "mv" / name, vectors)
        depth = {"Z": plane(4, 5, 3), "N.X": plane(4, 5, 0)}
        depth |= {"N.Y": plane(4, 5, 1), "N.Z": plane(4, 5, 0)}
        write_single(tmp_path / "z" / name, depth)
    return tmp_path


class TestAovs:
    def open(self, root, *aovs, spec="main"):
        return open_shot(
            str(root / spec), None, parse_aovs(a.replace("=", f"={root}/") for a in aovs)
        )

    def test_roles_come_from_their_files(self, split):
        shot = self.open(split, "motion=mv:B,A", "depth=z", "normal=z/a.####.exr")
        assert set(shot.aovs) == {"motion", "depth"}, "one file for two roles is read once"
        assert [ref.aov for ref in shot.layout.roles[Role.NORMAL]] == ["depth"] * 3
        raw = read_raw(shot, 2)
        assert raw.motion[0, 0].tolist() == [22, 23] and (raw.gbuffer.depth == 3).all()
        assert (raw.gbuffer.normal == (0, 1, 0)).all()
        assert list(shot.by_hand) == ["depth", "motion", "normal"]
        assert shot.by_hand["motion"] == ["motion:B", "motion:A"]
        assert shot.files(2)["motion"] == split / "mv" / "a.0002.exr"

    def test_a_pattern_with_the_view(self, tmp_path):
        folder = write_stereo(tmp_path / "single", "single", (1,))
        write_stereo(tmp_path / "folders", "folders", (1,))
        texts = parse_aovs([f"depth={tmp_path / 'folders' / '%V' / 'shot_%v.####.exr'}"])
        for view in ("left", "right"):
            shot = open_shot(str(folder), view, texts)
            assert shot.aovs["depth"].folder.name == view

    def test_colour_of_its_own_leads(self, split):
        shot = self.open(split, "colour=main", spec="z")
        assert shot.sequence.folder == split / "main" and set(shot.aovs) == {"main"}
        assert [ref.aov for ref in shot.layout.roles[Role.COLOUR]] == [""] * 4
        raw = read_raw(shot, 1)
        assert (raw.gbuffer.depth == 3).all() and raw.path == split / "main" / "a.0001.exr"
        np.testing.assert_array_equal(raw.image.pixels[..., 0], rgba(4, 5, seed=1)["R"])

    def test_ids_go_with_their_files(self, split):
        one = {"box": np.ones((4, 5))}
        for number in (1, 2):
            others = {"Z": plane(4, 5, 3)}
            path = split / "z" / f"a.{number:04d}.exr"
            write_cryptomatte(path, one, Style("uCryptoThing", header_name="uCryptoThing"), others)
        shot = self.open(split, "colour=main", spec="z")
        (found,) = shot.cryptomattes
        assert {ref.aov for rank in found.ranks for ref in rank} == {found.aov} == {"main"}
        assert Role.STENCIL not in shot.layout and shot.ids is None
        raw = read_raw(replace(shot, ids=IdReading(found)), 2, objects=True)
        assert (raw.gbuffer.objects == identity(hash_name("box"))).all()
        assert raw.gbuffer.stencil is None
        assert read_raw(replace(shot, ids=IdReading(found)), 2).gbuffer.objects is None
        joined = self.open(split, "stencil=z")
        assert joined.cryptomattes[0].aov == "stencil" and Role.STENCIL not in joined.layout

    def test_more_frames_are_fine_and_fewer_are_not(self, split):
        write_single(split / "mv" / "a.0003.exr", rgba(4, 5))
        assert list(self.open(split, "motion=mv").aovs["motion"].files) == [1, 2]
        (split / "mv" / "a.0002.exr").unlink()
        with pytest.raises(MissingFrameError, match=r"^frame 2 of --aov motion=.* is missing from"):
            self.open(split, "motion=mv")

    def test_another_size(self, split):
        for number in (1, 2):
            name = f"a.{number:04d}.exr"
            write_single(split / "mv" / name, rgba(2, 3), displayWindow=box(0, 0, 9, 9))
        with pytest.raises(LayoutError, match=r"--aov motion=.* 9x9\+0\+0 where the shot has 5x4"):
            self.open(split, "motion=mv")

    def test_a_channel_that_is_not_there(self, split):
        with pytest.raises(LayoutError, match=r"--aov depth=.*z names the channel 'Q', and .*only"):
            self.open(split, "depth=z:Q")


class TestChannelMap:
    def test_roles_are_replaced_left_out_and_kept(self, split, tmp_path):
        channels = {Role.DEPTH: ("A",), Role.COLOUR: ("B", "G", "R"), Role.NORMAL: ()}
        channel_map = ChannelMap(tmp_path / "m", channels, producer="house")
        shot = open_shot(str(split / "main"), channel_map=channel_map)
        names = {r.value: [c.name for c in refs] for r, refs in shot.layout.roles.items()}
        assert names == {"colour": ["B", "G", "R"], "depth": ["A"]}
        assert shot.by_hand == {"colour": ["B", "G", "R"], "depth": ["A"]}
        assert shot.layout.producer == "house"
        without = ChannelMap(tmp_path / "m", {Role.DEPTH: ()})
        assert Role.DEPTH not in open_shot(str(split / "main"), channel_map=without).layout

    def test_names_guess_nothing_of_other_motion_channels(self, tmp_path):
        vectors = {f"{layer}.{c}": plane(2, 2, 1) for layer in ("forward", "odd") for c in "uv"}
        write_single(tmp_path / "a.0001.exr", rgba(2, 2) | vectors)
        for layer, known in (("forward", True), ("odd", False)):
            channel_map = ChannelMap(tmp_path / "m", {Role.MOTION: (f"{layer}.u", f"{layer}.v")})
            shot = open_shot(str(tmp_path), channel_map=channel_map)
            assert (shot.layout.guess is not None) == known

    def test_what_changes_nothing_is_nothing_by_hand(self, split, tmp_path):
        channel_map = ChannelMap(tmp_path / "m", {Role.DEPTH: ("Z",)}, motion="next=u,v")
        assert open_shot(str(split / "main"), channel_map=channel_map).by_hand == {}

    def test_the_kind_of_depth(self, tmp_path):
        planes = rgba(2, 2) | {"Z": np.array([[0.5, 0.25], [0, 2]], np.float32)}
        write_single(tmp_path / "a.0001.exr", planes)
        channel_map = ChannelMap(tmp_path / "m", depth_kind=DepthKind.INVERSE)
        shot = open_shot(str(tmp_path), channel_map=channel_map)
        assert read_raw(shot, 1).gbuffer.depth.tolist() == [[2, 4], [np.inf, 0.5]]
        assert shot.by_hand == {"depth_kind": "inverse"}
        plain = read_raw(open_shot(str(tmp_path)), 1).gbuffer.depth
        assert plain.tolist() == [[0.5, 0.25], [np.inf, 2]]

    def test_an_absent_channel_is_named_with_file_and_key(self, split, tmp_path):
        channel_map = ChannelMap(tmp_path / "m.toml", {Role.DEPTH: ("zz.Q",)})
        with pytest.raises(LayoutError) as caught:
            open_shot(str(split / "main"), channel_map=channel_map)
        message = f"channels.depth in the channel map {tmp_path / 'm.toml'} names the channel"
        assert str(caught.value).startswith(message) and "only" in str(caught.value)

    def test_options_come_before_the_map(self, split, tmp_path):
        own = parse_aovs([f"motion={split / 'mv'}:R,G"])
        channel_map = ChannelMap(tmp_path / "m", {}, parse_aovs([f"motion={split / 'mv'}:B,A"]))
        for given, taken in ((own, ["R", "G"]), ((), ["B", "A"])):
            shot = open_shot(str(split / "main"), None, given, channel_map)
            assert [ref.name for ref in shot.layout.roles[Role.MOTION]] == taken
        folder = write_stereo(tmp_path / "single", "single", (1,))
        right = ChannelMap(tmp_path / "m", view="right")
        assert open_shot(str(folder), None, (), right).view == "right"
        assert open_shot(str(folder), "left", (), right).view == "left"
        for view in ("right", "none"):
            (tmp_path / "m.toml").write_text(f'view = "{view}"\n')
            settings = SourceSettings(str(folder), view="all", channel_map=str(tmp_path / "m.toml"))
            assert [each.view for each in each_view(settings)] == ["left", "right"]
