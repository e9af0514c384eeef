"""Views of stereo files: which there are, whose a channel is, and patterns with a view in them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from exwarp_cli.domain.frame import Window
from exwarp_cli.errors import InputError, LayoutError
from exwarp_cli.io.exr.header import Channel, Part
from exwarp_cli.io.views import choose_view, expand_view, list_views, view_channels

WINDOW = Window(0, 0, 4, 3)


def part(*names: str, index: int = 0, view: str = "", views: tuple[str, ...] = (), deep=False):
    channels = tuple(Channel(index, i, name, name, "half") for i, name in enumerate(names))
    return Part(index, "", WINDOW, WINDOW, channels, view, deep, False, views)


def seen(parts, view="") -> dict[str, str]:
    """What is read under each name: the name in the file, with its part where that is not 0."""
    return {
        name: c.raw_name if c.part == 0 else f"{c.part}/{c.raw_name}"
        for name, c in view_channels(parts, view).items()
    }


PLAIN_HERO = part(
    *"RGB", "right.R", "right.G", "right.B", "depth.Z", "depth.right.Z", "forward.u",
    "forward.right.u", "mask.A", views=("left", "right"),
)  # fmt: skip
# As in OpenEXR's own example of this kind: only the hero's colour goes without its view.
NAMED_HERO = part(
    *"RGBZ", "left.R", "left.G", "left.B", "left.Z", "disparityL.x", "forward.left.u",
    "forward.right.u", views=("right", "left"),
)  # fmt: skip
ALL_NAMED = part("left.R", "right.R", "forward.left.u", "forward.right.u", "depth.Z")


class TestViewsOf:
    @pytest.mark.parametrize(
        ("parts", "views"),
        [
            ([part(*"RGB")], ()),
            ([PLAIN_HERO], ("left", "right")),
            ([NAMED_HERO], ("right", "left")),
            ([part("R", view="b"), part("R", index=1), part("R", index=2, view="a")], ("b", "a")),
            ([ALL_NAMED], ("left", "right")),
            ([part("R", "right.R")], ()),
            ([part("left", "right")], ()),
            # Lights named so, beside the beauty.
            ([part(*"RGB", "left.R", "left.G", "right.R", "right.G")], ()),
            ([part("Z", "left.R", "right.R")], ("left", "right")),
            ([part("R", "left.R", "right.G")], ("left", "right")),
            ([part("left.x.R", "right.x.R")], ()),
            ([part("R", views=("mono",))], ("mono",)),
        ],
    )
    def test_hero_first(self, parts, views):
        assert list_views(parts) == views


class TestChoose:
    def test_hero_unless_asked(self):
        assert (
            choose_view(("r", "l"), None, "x") == "r" and choose_view(("r", "l"), "l", "x") == "l"
        )
        assert choose_view((), None, "x") == ""

    def test_others_are_refused_in_one_sentence(self):
        with pytest.raises(LayoutError, match=r"^x has the views a and b, not 'c'; name one"):
            choose_view(("a", "b"), "c", "x")
        with pytest.raises(LayoutError, match=r"^x has no views, .* leave --view out"):
            choose_view((), "left", "x")


class TestChannelsOf:
    def test_without_views_all(self):
        assert list(seen([part(*"RGB", "a.b.X"), part("Z", index=1)])) == [*"RGB", "a.b.X", "Z"]

    def test_a_hero_without_its_name(self):
        own = {"R": "R", "G": "G", "B": "B", "depth.Z": "depth.Z", "forward.u": "forward.u"}
        assert seen([PLAIN_HERO]) == seen([PLAIN_HERO], "left") == own | {"mask.A": "mask.A"}
        other = {"R": "right.R", "G": "right.G", "B": "right.B"}
        other |= {"depth.Z": "depth.right.Z", "forward.u": "forward.right.u"}
        assert seen([PLAIN_HERO], "right") == other

    def test_a_named_hero_leaves_the_rest_to_all(self):
        shared = {"disparityL.x": "disparityL.x"}
        own = {c: c for c in "RGBZ"} | {"forward.u": "forward.right.u"}
        assert seen([NAMED_HERO]) == own | shared
        other = {c: f"left.{c}" for c in "RGBZ"} | {"forward.u": "forward.left.u"}
        assert seen([NAMED_HERO], "left") == other | shared

    def test_all_named(self):
        found = {"R": "right.R", "forward.u": "forward.right.u", "depth.Z": "depth.Z"}
        assert seen([ALL_NAMED], "right") == found

    def test_without_a_layer_it_is_the_hero_s_alone(self):
        parts = [part("Q", "m.Q", "f.left.u", "right.R", views=("left", "right"))]
        assert seen(parts, "right") == {"m.Q": "m.Q", "R": "right.R"}
        assert seen(parts) == {"Q": "Q", "m.Q": "m.Q", "f.u": "f.left.u"}

    def test_a_view_before_all_else(self):
        names = ["R", "depth.Z", "forward.u", "right.R", "right.depth.Z", "right.a.forward.u"]
        parts = [part(*names, "forward.right.v", views=("left", "right"))]
        assert seen(parts) == {"R": "R", "depth.Z": "depth.Z", "forward.u": "forward.u"}
        assert seen(parts, "right") == {
            "R": "right.R",
            "depth.Z": "right.depth.Z",
            "a.forward.u": "right.a.forward.u",
            "forward.v": "forward.right.v",
        }
        assert seen([part("right.depth.Z", view="right")]) == {"depth.Z": "right.depth.Z"}
        assert seen([part("right.depth.Z", view="left")]) == {"right.depth.Z": "right.depth.Z"}

    def test_a_layer_named_like_another_view_stays_with_its_part(self):
        parts = [part("a.right.X", view="left"), part("a.X", index=1, view="right")]
        assert seen(parts) == {"a.right.X": "a.right.X"}

    def test_a_channel_of_the_view_comes_before_one_of_all(self):
        for order in (("x.A", "x.right.A"), ("x.right.A", "x.A")):
            parts = [part("left.R", "right.R", *order, views=("left", "right"))]
            assert seen(parts, "right")["x.A"] == "x.right.A"
            assert seen(parts, "left")["x.A"] == "x.A"

    def test_parts(self):
        parts = [
            part("c.R", view="left"),
            part("c.R", index=1, view="right"),
            part("z.Z", index=2),
            part("z.Z", index=3, view="right"),
            part("m.X", index=4),
        ]
        assert seen(parts) == {"c.R": "c.R", "z.Z": "2/z.Z", "m.X": "4/m.X"}
        assert seen(parts, "right") == {"c.R": "1/c.R", "z.Z": "3/z.Z", "m.X": "4/m.X"}

    def test_a_view_in_names_within_a_part_of_it(self):
        parts = [part("f.left.u", view="left"), part("f.right.u", index=1, view="right")]
        assert seen(parts, "right") == {"f.u": "1/f.right.u"}

    def test_deep_parts_are_left_out(self):
        parts = [part(*"RZ", deep=True), part("R", "A", index=1)]
        assert seen(parts) == {"R": "1/R", "A": "1/A"}

    def test_a_view_that_is_not_there_is_not_replaced(self):
        assert seen([PLAIN_HERO], "middle") == {}

    @given(
        names=st.sets(st.sampled_from(["R", "G", "a.R", "a.b.X", "f.u", "z.Z"]), min_size=1),
        hero_named=st.booleans(),
        order=st.randoms(use_true_random=False),
    )
    def test_what_is_written_for_a_view_is_read_for_it(self, names, hero_named, order):
        written = {}
        for view in ("one", "two"):
            for name in names:
                layer, _, component = name.rpartition(".")
                mark = view if view == "two" or hero_named else ""
                written[view, name] = ".".join(filter(None, (layer, mark, component)))
        listed = list(written.values())
        order.shuffle(listed)
        file = [part(*listed, views=("one", "two"))]
        for view in ("one", "two"):
            assert seen(file, view) == {name: written[view, name] for name in names}


@pytest.fixture
def tree(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in (
        "s_left.0001.exr",
        "s_right.0001.exr",
        "s_left_v2.0001.exr",
        "t_l.0001.exr",
        "t_r.0001.exr",
        "0001_a.exr",
        "0001_b.exr",
        "left/u_l.0001.exr",
        "right/u_r.0001.exr",
        "right/u_x.0001.exr",
        "left/0001.exr",
        "top/u_x.0001.exr",
    ):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.touch()
    return tmp_path


class TestExpand:
    @pytest.mark.parametrize(
        ("spec", "hero", "views"),
        [
            ("s_%V.####.exr", "s_left.####.exr", ("left", "right")),
            ("./s_%V.%04d.exr", "./s_left.%04d.exr", ("left", "right")),
            ("t_%v.####.exr", "t_l.####.exr", ("left", "right")),
            ("####_%V.exr", "####_a.exr", ("a", "b")),
            ("%V/u_%v.$F4.exr", "left/u_l.$F4.exr", ("left", "right")),
            ("%V", "left", ("left", "right", "top")),
            ("%V/", "left/", ("left", "right", "top")),
            ("%V/####.exr", "left/####.exr", ("left",)),
            ("%V/%V.####.exr", None, ()),
        ],
    )
    def test_patterns(self, tree, spec, hero, views):
        if hero is None:
            with pytest.raises(InputError, match=r"nothing fits .*check the pattern"):
                expand_view(spec, None)
            return
        assert expand_view(spec, None) == (hero, "left" if "left" in views else views[0], views)
        if "right" in views:
            changed = spec.replace("%V", "right").replace("%v", "r")
            assert expand_view(spec, "right") == (changed, "right", views)

    def test_absolute_ones(self, tree):
        found = expand_view(str(tree / "s_%V.####.exr"), "right")
        assert found == (str(tree / "s_right.####.exr"), "right", ("left", "right"))

    def test_no_token_or_a_file_of_that_name(self, tree):
        (tree / "odd%V.0001.exr").touch()
        for spec in ("s_left.####.exr", "odd%V.0001.exr", "s_%04d.exr"):
            assert expand_view(spec, "right") == (spec, "", ())

    def test_a_view_without_files(self, tree):
        with pytest.raises(LayoutError, match=r"views left and right, not 'top'"):
            expand_view("s_%V.####.exr", "top")

    def test_a_name_that_no_disk_takes(self, tree):
        with pytest.raises(InputError, match=r"cannot look for .*; check the path"):
            expand_view("%V" * 300 + ".####.exr", None)

    def test_brackets_in_names_are_text(self, tree):
        (tree / "[a]_left.0001.exr").touch()
        assert expand_view("[a]_%V.####.exr", None) == ("[a]_left.####.exr", "left", ("left",))
