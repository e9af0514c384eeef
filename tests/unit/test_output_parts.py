"""Frames of several parts, views and layers, as they are written."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.domain.frame import Image, Window
from exwarp_cli.errors import LayoutError
from exwarp_cli.io import generated_frames
from exwarp_cli.io.channels import Role, detect_layout
from exwarp_cli.io.exr.reader import ExrFile, read_headers
from exwarp_cli.io.exr.writer import (
    PIXEL_TYPES,
    Plane,
    PlaneKey,
    Template,
    ViewLayers,
    read_template,
)
from exwarp_cli.io.frames import read_image
from exwarp_cli.io.layers import group_layers
from exwarp_cli.io.views import view_channels
from tests.unit.exr_files import box, plane, rgba, write_parts, write_single
from tests.unit.written_frames import WINDOW, image, pixels


class TestParts:
    """Frames of several layers and views; `pipeline.extra_layers` makes their planes."""

    @pytest.fixture
    def source(self, tmp_path) -> Path:
        """Beauty, ids and depth of two views; one part deep, as compositors leave them."""
        made = {}
        for view, x in (("left", 0), ("right", 3)):
            window = {"view": view, "dataWindow": box(x, 1, 4, 3), "displayWindow": box(0, 0, 9, 7)}
            made[f"rgba.{view}"] = (rgba(3, 4), window | {"owner": view})
            made[f"id.{view}"] = ({"id.X": plane(3, 4, 7, np.uint32)}, window)
            made[f"z.{view}"] = ({"Z": plane(3, 4, 2, np.float16)}, window)
        return write_parts(tmp_path / "in.exr", made)

    @staticmethod
    def wanted(source: Path, *views: str) -> tuple[ViewLayers, ...]:
        with ExrFile(source) as file:
            parts = file.parts
        found = []
        for view in views:
            channels = view_channels(parts, view)
            layout = detect_layout({"": tuple(replace(c, name=n) for n, c in channels.items())})
            layers = group_layers({"": channels}, layout)
            found.append(ViewLayers(view, view, layout.roles[Role.COLOUR], layers))
        return tuple(found)

    @staticmethod
    def planes(kept: Template, window: Window, seed: int = 0) -> dict[PlaneKey, Plane]:
        rng = np.random.default_rng(seed)
        made = {}
        for wanted in (target for part in kept.parts for target in part.planes):
            high = 2**32 if wanted.dtype == np.uint32 else 9
            values = rng.integers(1, high, window.shape, np.uint32)
            made[wanted.key] = Plane(values.astype(wanted.dtype), window)
        return made

    def test_what_is_written_is_read_back(self, source, tmp_path):
        kept = read_template(source, self.wanted(source, "left", "right"))
        right = Window(-2, 0, 9, 7)
        beside = self.planes(kept, WINDOW) | {
            key: values for key, values in self.planes(kept, right, 1).items() if key[0] == "right"
        }
        out = tmp_path / "out.exr"
        own = {generated_frames.FINGERPRINT: "abc", "framesPerSecond": Fraction(96)}
        generated_frames.write_picture(out, image(), kept, own, beside)
        assert generated_frames.read_fingerprint(out) == "abc"
        headers = read_headers(out)
        assert [h["name"] for h in headers] == [h["name"] for h in read_headers(source)]
        assert [h["view"] for h in headers] == ["left"] * 3 + ["right"] * 3
        assert [h.get("owner") for h in headers] == ["left", None, None, "right", None, None]
        assert [generated_frames.FINGERPRINT in h for h in headers] == [True] + [False] * 5
        assert {h["framesPerSecond"] for h in headers} == {Fraction(96)}
        with ExrFile(out) as file:
            assert [p.data_window for p in file.parts] == [WINDOW] * 3 + [right] * 3
            for part, wanted in zip(file.parts, kept.parts, strict=True):
                for channel, target in zip(part.channels, wanted.planes, strict=True):
                    assert np.dtype(PIXEL_TYPES[channel.pixel_type]) == target.dtype
                    if target not in kept.colour:
                        found = file.read([channel])[channel]
                        np.testing.assert_array_equal(found, beside[target.key].values)
        np.testing.assert_array_equal(read_image(out).pixels, pixels().astype(np.float16))

    def test_one_view_of_them(self, source, tmp_path):
        kept = read_template(source, self.wanted(source, "right"))
        generated_frames.write_picture(
            tmp_path / "o.exr", image(), kept, {}, self.planes(kept, WINDOW)
        )
        with ExrFile(tmp_path / "o.exr") as file:
            assert [part.view for part in file.parts] == ["right"] * 3

    def test_views_of_one_part_are_those_that_are_written(self, tmp_path):
        planes = {f"{view}{c}": p for view in ("", "right.") for c, p in rgba(3, 4).items()}
        source = write_single(tmp_path / "in.exr", planes, multiView=["left", "right"])
        for views in (("left",), ("right",), ("left", "right")):
            kept = read_template(source, self.wanted(source, *views))
            generated_frames.write_picture(
                tmp_path / "o.exr", image(), kept, {}, self.planes(kept, WINDOW)
            )
            with ExrFile(tmp_path / "o.exr") as file:
                (part,) = file.parts
                assert part.views == views
                assert len(part.channels) == 4 * len(views)
            found = read_image(tmp_path / "o.exr", views[0]).pixels
            np.testing.assert_array_equal(found, pixels().astype(np.float16))

    def test_light_ends_at_the_largest_half_and_depth_does_not(self, source, tmp_path):
        kept = read_template(source, self.wanted(source, "left"))
        beside = {
            target.key: Plane(np.full(WINDOW.shape, 1e5, np.float32), WINDOW)
            for part in kept.parts
            for target in part.planes
        }
        bright = Image(np.full((*WINDOW.shape, 4), 1e5, np.float32), WINDOW, WINDOW)
        generated_frames.write_picture(tmp_path / "o.exr", bright, kept, {}, beside)
        with ExrFile(tmp_path / "o.exr") as file:
            found = {c.name: file.read([c])[c][0, 0] for p in file.parts for c in p.channels}
        assert found["rgba.R"] == 65504 and np.isinf(found["z.Z"]) and found["id.X"] == 100000

    def test_a_channel_that_is_gone(self, source, tmp_path):
        kept = self.wanted(source, "left")
        other = write_single(tmp_path / "b.exr", {f"rgba.{c}": p for c, p in rgba(3, 4).items()})
        with pytest.raises(LayoutError, match=r"b\.exr has no channel 'id\.X', .* --layers"):
            read_template(other, kept)
