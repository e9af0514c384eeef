"""Reading OpenEXR files: structure, pixels, and whatever is wrong with them."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest

from exwarp_cli.domain.frame import Window
from exwarp_cli.errors import DamagedFileError, InputError, LayoutError, MissingFrameError
from exwarp_cli.io.exr import reader
from exwarp_cli.io.exr.reader import ExrFile, read_headers
from exwarp_cli.io.frames import read_image, read_plane
from tests.unit.cryptomatte_files import Style, attributes_of, planes_of, write_cryptomatte
from tests.unit.exr_files import (
    box,
    deep_part,
    plane,
    rgba,
    write_parts,
    write_single,
    write_subsampled,
    write_tiled,
)


def read_all(path):
    with ExrFile(path) as file:
        channels = [channel for part in file.parts for channel in part.channels]
        planes = file.read(channels)
        return file.parts, {channel.name: planes[channel] for channel in channels}


class TestStructure:
    def test_one_part(self, tmp_path):
        planes = rgba(4, 6) | {"Z": plane(4, 6, 2.5), "id": plane(4, 6, 7, np.uint32)}
        path = write_single(
            tmp_path / "a.exr",
            planes,
            dataWindow=box(-2, 3, 6, 4),
            displayWindow=box(0, 0, 10, 8),
        )
        parts, found = read_all(path)
        assert len(parts) == 1
        part = parts[0]
        assert (part.index, part.name, part.view, part.deep) == (0, "", "", False)
        assert part.data_window == Window(-2, 3, 6, 4)
        assert part.display_window == Window(0, 0, 10, 8)
        types = {channel.name: channel.pixel_type for channel in part.channels}
        assert types == dict.fromkeys("RGBA", "half") | {"Z": "float", "id": "uint"}
        for name, expected in planes.items():
            np.testing.assert_array_equal(found[name], expected)

    def test_parts_give_their_name_to_bare_channels_alone(self, tmp_path):
        path = write_parts(
            tmp_path / "a.exr",
            {
                "beauty": (rgba(3, 4), {}),
                "depth": ({"Z": plane(3, 4, 1)}, {}),
                "V.Normal": ({f"V.Normal.{c}": plane(3, 4, 0) for c in "XYZ"}, {}),
            },
        )
        parts, found = read_all(path)
        assert [part.name for part in parts] == ["beauty", "depth", "V.Normal"]
        assert set(found) == {f"beauty.{c}" for c in "RGBA"} | {"depth.Z"} | {
            f"V.Normal.{c}" for c in "XYZ"
        }
        raw = {channel.raw_name for part in parts for channel in part.channels}
        assert "Z" in raw and "V.Normal.X" in raw

    def test_parts_tell_channels_of_one_name_apart(self, tmp_path):
        first, second, other = (rgba(3, 4, seed=seed) for seed in range(3))
        named = [{f"diff.{c}": p[c] for c in "RGB"} for p in (first, second, other)]
        path = write_parts(
            tmp_path / "a.exr",
            {
                "key_left": (named[0], {"view": "left"}),
                "rim_left": (named[1], {"view": "left"}),
                "key_right": (named[2], {"view": "right"}),
            },
        )
        parts, found = read_all(path)
        assert [part.channels[0].name for part in parts] == ["diff.R", "rim.diff.R", "diff.R"]
        np.testing.assert_array_equal(found["rim.diff.R"], second["R"])

    def test_views_are_known(self, tmp_path):
        path = write_parts(
            tmp_path / "a.exr",
            {
                "l": (rgba(3, 4, seed=1), {"view": "left"}),
                "r": (rgba(3, 4, seed=2), {"view": "right"}),
            },
        )
        parts, _ = read_all(path)
        assert [part.view for part in parts] == ["left", "right"]

    @pytest.mark.parametrize("views", [("left", "right"), ("right",), ("a", "b", "c")])
    def test_views_in_one_part_are_known(self, tmp_path, views):
        path = write_single(tmp_path / "a.exr", rgba(3, 4), multiView=list(views))
        parts, _ = read_all(path)
        assert parts[0].views == views and parts[0].view == ""

    @pytest.mark.parametrize(
        ("part", "name"),
        [
            ("depth_left", "depth.Z"),
            ("depth-left", "depth.Z"),
            ("left.depth", "depth.Z"),
            ("a.left.b", "a.b.Z"),
            ("left", "Z"),
            ("leftover", "leftover.Z"),
            ("depth", "depth.Z"),
        ],
    )
    def test_the_view_is_no_part_of_the_layer(self, tmp_path, part, name):
        path = write_parts(
            tmp_path / "a.exr",
            {
                part: ({"Z": plane(3, 4, 1)}, {"view": "left"}),
                "o": ({"Z": plane(3, 4, 1)}, {"view": "right"}),
            },
        )
        parts, _ = read_all(path)
        assert [c.name for c in parts[0].channels] == [name]
        assert parts[0].name == part and parts[0].channels[0].raw_name == "Z"

    def test_plain_files_are_neither_tiled_nor_deep(self, tmp_path):
        parts, _ = read_all(write_single(tmp_path / "a.exr", rgba(3, 4)))
        assert (parts[0].tiled, parts[0].deep, parts[0].views) == (False, False, ())


def test_attributes_of_every_part(tmp_path):
    made = {
        "rgba": (rgba(4, 5), {"shot:by": "Ada"}),
        "z": ({"Z": plane(4, 5, 1)}, {"shot:take": 3}),
    }
    with ExrFile(write_parts(tmp_path / "a.exr", made)) as file:
        first, second = file.header.attributes
    assert first["shot:by"] == "Ada" and "shot:by" not in second
    assert second["shot:take"] == 3 and second["compression"] == OpenEXR.ZIP_COMPRESSION
    assert file.header.texts[0]["shot:by"] == "Ada" and file.header.texts[1]["compression"] == "zip"


class TestPixels:
    def test_what_the_header_calls_ids_is_no_colour(self, tmp_path):
        style = Style("rgb", header_name="rgb", spelling="upper")
        path = write_cryptomatte(tmp_path / "a.exr", {"box": np.ones((4, 5))}, style, rgba(4, 5))
        np.testing.assert_array_equal(read_image(path).pixels[..., 0], rgba(4, 5)["R"])
        (layer,) = planes_of({"box": np.ones((4, 5))}, style, ranks=2).values()
        lone = write_single(tmp_path / "b.exr", layer, **attributes_of(["box"], style))
        with pytest.raises(LayoutError, match="no colour channels"):
            read_image(lone)

    def test_parts_of_different_windows(self, tmp_path):
        path = write_parts(
            tmp_path / "a.exr",
            {
                "rgb": (rgba(5, 6), {"displayWindow": box(0, 0, 8, 8)}),
                "z": (
                    {"Z": np.arange(6, dtype=np.float32).reshape(2, 3)},
                    {"dataWindow": box(2, -1, 3, 2), "displayWindow": box(0, 0, 8, 8)},
                ),
            },
        )
        parts, found = read_all(path)
        assert [str(part.data_window) for part in parts] == ["6x5+0+0", "3x2+2-1"]
        np.testing.assert_array_equal(found["z.Z"], [[0, 1, 2], [3, 4, 5]])

    def test_large_ids_are_exact(self, tmp_path):
        ids = np.array([[0, 1, 2**24 + 1], [2**31 - 1, 2**31, 2**32 - 1]], np.uint32)
        path = write_single(tmp_path / "a.exr", rgba(2, 3) | {"id": ids})
        _, found = read_all(path)
        assert found["id"].dtype == np.uint32
        np.testing.assert_array_equal(found["id"], ids)

    @pytest.mark.parametrize("dtype", [np.float16, np.float32])
    def test_values_come_as_they_are(self, tmp_path, dtype):
        values = np.array([[-0.0, -3, 65504], [1e-7, np.inf, np.nan]], dtype)
        path = write_single(tmp_path / "a.exr", dict.fromkeys("RGB", values))
        _, found = read_all(path)
        assert found["R"].dtype == np.float32
        np.testing.assert_array_equal(found["R"], values.astype(np.float32))

    def test_a_single_channel_by_name(self, tmp_path):
        path = write_parts(
            tmp_path / "a.exr", {"rgb": (rgba(3, 4), {}), "d": ({"Z": plane(3, 4, 5)}, {})}
        )
        for name in ("Z", "d.Z"):
            found, window, display = read_plane(path, name)
            assert (found == 5).all() and found.flags.c_contiguous
            assert window == display == Window(0, 0, 4, 3)
        with pytest.raises(LayoutError, match="has no channel 'W'"):
            read_plane(path, "W")

    def test_an_image_and_its_windows(self, tmp_path):
        planes = rgba(3, 4)
        path = write_single(
            tmp_path / "a.exr", planes, dataWindow=box(1, 2, 4, 3), displayWindow=box(0, 0, 9, 9)
        )
        image = read_image(path)
        assert image.data_window == Window(1, 2, 4, 3)
        assert image.display_window == Window(0, 0, 9, 9)
        for i, name in enumerate("RGBA"):
            np.testing.assert_array_equal(image.pixels[..., i], planes[name])

    def test_an_image_without_colour(self, tmp_path):
        path = write_single(tmp_path / "a.exr", {"Z": plane(3, 4, 5)})
        named = r"^\S+a\.exr has no colour channels that .*, only Z; name them in a channel map"
        with pytest.raises(LayoutError, match=named):
            read_image(path)
        path = write_single(tmp_path / "b.exr", {f"beauty.{c}": plane(3, 4, 5) for c in "RG"})
        with pytest.raises(
            LayoutError, match=r"recognised \('beauty' has only R, G\), only beauty"
        ):
            read_image(path)


class TestTiles:
    """Tiles by OpenEXR's own library and by OpenImageIO; of several levels the full one is read."""

    PLANES = rgba(37, 70, np.float32)

    @pytest.mark.parametrize("levels", ["ONE_LEVEL", "MIPMAP_LEVELS", "RIPMAP_LEVELS"])
    def test_every_kind_of_levels(self, tmp_path, levels):
        path = write_tiled(tmp_path / "a.exr", self.PLANES, levels)
        assert levels in str(read_headers(path)[0]["tiles"])
        parts, found = read_all(path)
        assert parts[0].tiled and parts[0].data_window == Window(0, 0, 70, 37)
        for name, expected in self.PLANES.items():
            np.testing.assert_array_equal(found[name], expected)

    def test_a_texture_with_its_smaller_levels(self, tmp_path):
        pixels = np.stack([self.PLANES[c] for c in "RGBA"], -1)
        source = oiio.ImageBuf(oiio.ImageSpec(70, 37, 4, "float"))
        assert source.set_pixels(oiio.ROI(), pixels)
        path = tmp_path / "a.exr"
        assert oiio.ImageBufAlgo.make_texture(oiio.MakeTxTexture, source, str(path))
        file = oiio.ImageInput.open(str(path))
        assert file.spec(0, 3).width == 8, "it has levels"
        file.close()
        np.testing.assert_array_equal(read_image(path).pixels, pixels)

    def test_a_window_off_the_tiles(self, tmp_path):
        spec = oiio.ImageSpec(70, 37, 4, "float")
        spec.channelnames = ("R", "G", "B", "A")
        spec.tile_width = spec.tile_height = 16
        spec.x, spec.y, spec.full_width, spec.full_height = -3, 5, 64, 48
        out = oiio.ImageOutput.create("a.exr")
        assert out.open(str(tmp_path / "a.exr"), spec)
        pixels = np.stack([self.PLANES[c] for c in "RGBA"], -1)
        assert out.write_image(pixels) and out.close()
        image = read_image(tmp_path / "a.exr")
        assert image.data_window == Window(-3, 5, 70, 37)
        assert image.display_window == Window(0, 0, 64, 48)
        np.testing.assert_array_equal(image.pixels, pixels)


@pytest.mark.parametrize("size", [16, 48, 0], ids=["tiles", "large tiles", "lines"])
@pytest.mark.parametrize("compression", ["piz", "dwaa", "dwab", "b44", "zip"])
def test_what_is_read_in_bands_is_what_openimageio_reads_at_once(
    tmp_path, monkeypatch, compression, size
):
    """Taller than a band for two cores, and of a window that begins anywhere."""
    monkeypatch.setattr(reader.cores, "count", lambda: 2)
    spec = oiio.ImageSpec(21, 2 * 2 * 256 + 37, 4, "half")
    spec.channelnames = ("R", "G", "B", "A")
    spec.tile_width = spec.tile_height = size
    spec.x, spec.y, spec.full_width, spec.full_height = -3, 5, 64, 2000
    spec.attribute("compression", compression)
    path = str(tmp_path / "a.exr")
    out = oiio.ImageOutput.create(path)
    noise = np.random.default_rng(1).random((spec.height, spec.width, 4)).astype(np.float32)
    assert out.open(path, spec) and out.write_image(noise) and out.close()
    parts, found = read_all(Path(path))
    assert parts[0].tiled == bool(size)
    file = oiio.ImageInput.open(path)
    expected = file.read_image(0, 0, 0, 4, "float")
    for i, name in enumerate("RGBA"):
        np.testing.assert_array_equal(found[name], expected[..., i])


def one_sentence(error: InputError, path: object) -> bool:
    text = str(error)
    return str(path) in text and "\n" not in text and "; " in text


class TestBadFiles:
    def test_missing(self, tmp_path):
        with pytest.raises(MissingFrameError, match="does not exist") as caught:
            ExrFile(tmp_path / "none.exr")
        assert one_sentence(caught.value, tmp_path / "none.exr")

    @pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="names are Unicode there")
    def test_a_name_that_is_no_text(self, tmp_path):
        path = tmp_path / os.fsdecode(b"\xff.exr")
        write_single(tmp_path / "a.exr", rgba(4, 4)).rename(path)
        with pytest.raises(InputError, match="not valid UTF-8; rename") as caught:
            ExrFile(path)
        assert one_sentence(caught.value, path)

    @pytest.mark.parametrize(
        "content", [b"", b"\x76\x2f\x31\x01", b"hello world, this is text\n" * 40, b"\0" * 4096]
    )
    def test_not_an_exr(self, tmp_path, content):
        path = tmp_path / "a.exr"
        path.write_bytes(content)
        with pytest.raises(DamagedFileError, match="truncated, damaged or not") as caught:
            ExrFile(path)
        assert one_sentence(caught.value, path)

    def test_another_format_under_the_name(self, tmp_path):
        source = tmp_path / "a.png"
        image = oiio.ImageBuf(oiio.ImageSpec(4, 4, 3, "uint8"))
        assert image.write(str(source))
        path = source.rename(tmp_path / "a.exr")
        with pytest.raises(DamagedFileError, match="png") as caught:
            ExrFile(path)
        assert one_sentence(caught.value, path)

    def test_channels_of_different_sizes(self, tmp_path):
        path = write_subsampled(tmp_path / "a.exr")
        with pytest.raises(LayoutError, match=r"luminance and chroma .* write it as RGB") as caught:
            ExrFile(path)
        assert one_sentence(caught.value, path)

    def test_a_subsampled_channel_beside_colour_is_named(self, tmp_path):
        channels = (("B", 1), ("G", 1), ("R", 1), ("ao.Y", 2))
        path = write_subsampled(tmp_path / "a.exr", channels)
        message = r"subsampled .* others: ao\.Y \(1 pixel in 2x2\); render .* full resolution"
        with pytest.raises(LayoutError, match=message) as caught:
            ExrFile(path)
        assert one_sentence(caught.value, path) and "luminance" not in str(caught.value)

    def test_deep_pixels(self, tmp_path):
        path = tmp_path / "a.exr"
        OpenEXR.File([deep_part(4, 5, "deep")]).write(str(path))
        with (
            ExrFile(path) as file,
            pytest.raises(LayoutError, match=r"deep image.*--flatten") as caught,
        ):
            file.read(file.parts[0].channels)
        assert one_sentence(caught.value, path)

    def test_a_folder(self, tmp_path):
        folder = tmp_path / "a.exr"
        folder.mkdir()
        with pytest.raises(InputError) as caught:
            ExrFile(folder)
        assert one_sentence(caught.value, folder)

    @pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.95])
    def test_truncated_anywhere(self, tmp_path, share):
        whole = write_single(tmp_path / "whole.exr", rgba(64, 64)).read_bytes()
        path = tmp_path / "a.exr"
        path.write_bytes(whole[: int(len(whole) * share)])
        with pytest.raises(DamagedFileError) as caught:
            read_image(path)
        assert one_sentence(caught.value, path)

    def test_flipped_bytes_in_the_pixels(self, tmp_path):
        data = bytearray(write_single(tmp_path / "a.exr", rgba(64, 64)).read_bytes())
        middle = len(data) // 2
        data[middle : middle + 400] = b"\xff" * 400
        path = tmp_path / "b.exr"
        path.write_bytes(data)
        with pytest.raises(DamagedFileError) as caught:
            read_image(path)
        assert one_sentence(caught.value, path)
