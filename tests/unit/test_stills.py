"""Still images: what is read, and that generated frames are of their key frame's kind."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image as Pillow
from PIL import ImageCms

from exwarp_cli.domain.colour import FILM, LINEAR, SRGB
from exwarp_cli.domain.frame import Image, Window
from exwarp_cli.errors import DamagedFileError, InputError, LayoutError, OutputError, UsageError
from exwarp_cli.io.exr.reader import ExrFile
from exwarp_cli.io.stills import (
    SEALED,
    quantise_still,
    read_still,
    read_still_header,
    seal_still,
    still_facts,
    write_still,
)
from tests.unit.exr_files import rgba, write_single

ORIENTATION = 0x0112
"""Tag of EXIF."""

DATE = "2024:05:06 07:08:09"
FACTS = {"recipe": "ab" * 32, "kind": "generated", "sources": "1,2", "holeFraction": 0.25}


def write(path: Path, codes: np.ndarray, **attributes: Any) -> Path:
    """Write code values with OpenImageIO itself."""
    height, width, channels = codes.shape
    kind = codes.dtype.name.replace("float32", "float")
    spec = oiio.ImageSpec(width, height, channels, kind)
    for name, value in attributes.items():
        spec.attribute(name.replace("__", ":"), value)
    if channels in (2, 4):
        spec.alpha_channel = channels - 1
    file = oiio.ImageOutput.create(path.suffix[1:])
    assert file.open(str(path), spec) and file.write_image(codes) and file.close()
    return path


def codes_of(path: Path) -> np.ndarray:
    """Code values as the file has them."""
    hint = oiio.ImageSpec()
    hint.attribute("oiio:UnassociatedAlpha", 1)
    file = oiio.ImageInput.open(str(path), hint)
    return np.asarray(file.read_image(0, 0, 0, file.spec().nchannels, file.spec().format))


def smooth_colour() -> np.ndarray:
    """uint8 [16, 16, 3] without fine detail, which JPEG would change."""
    ramp = np.linspace(100, 130, 16)
    red, green = np.meshgrid(ramp, ramp)
    return np.dstack([red, green, 255 - red]).astype(np.uint8)


def noise(channels: int, dtype: str, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    if dtype == "float32":
        return rng.random((9, 13, channels), np.float32)
    top = np.iinfo(dtype).max
    made = rng.integers(0, top, (9, 13, channels), endpoint=True).astype(dtype)
    if channels in (2, 4):
        made[..., -1] = np.maximum(made[..., -1], top // 2)
        made[..., :-1] = np.minimum(made[..., :-1], made[..., -1:])
    return made


LOSSLESS = [
    *(("png", dtype, c) for dtype in ("uint8", "uint16") for c in (1, 2, 3, 4)),
    *(("tif", dtype, c) for dtype in ("uint8", "uint16", "float32") for c in (1, 2, 3, 4)),
    *(("dpx", dtype, 3) for dtype in ("uint8", "uint16")),
    *(("tga", "uint8", c) for c in (3, 4)),
    ("bmp", "uint8", 3),
    ("ppm", "uint16", 3),
    ("webp", "uint8", 3),
]


class TestRoundTrip:
    @pytest.mark.parametrize(("suffix", "dtype", "channels"), LOSSLESS)
    def test_a_frame_of_the_same_light_has_the_same_codes(self, tmp_path, suffix, dtype, channels):
        extra = {"compression": "lossless:100"} if suffix == "webp" else {}
        key = write(tmp_path / f"a.{suffix}", noise(channels, dtype), **extra)
        image, template = read_still(key)
        assert image.pixels.dtype == np.float32
        assert image.pixels.shape == (9, 13, 4 if channels in (2, 4) else 3)
        out = tmp_path / f"b.{suffix}"
        write_still(out, image, template, FACTS)
        found = codes_of(out)
        assert found.dtype == dtype
        assert np.array_equal(found, codes_of(key))
        again, other = read_still(out)
        assert np.array_equal(again.pixels, image.pixels)
        assert (other.dtype, other.bits) == (template.dtype, template.bits)

    @pytest.mark.parametrize("bits", [10, 12])
    @pytest.mark.parametrize("suffix", ["dpx", "tif"])
    def test_depths_between(self, tmp_path, suffix, bits):
        key = write(tmp_path / f"a.{suffix}", noise(3, "uint16"), oiio__BitsPerSample=bits)
        image, template = read_still(key)
        assert template.bits == bits
        write_still(tmp_path / f"b.{suffix}", image, template, FACTS)
        assert np.array_equal(codes_of(key), codes_of(tmp_path / f"b.{suffix}"))
        assert read_still_header(tmp_path / f"b.{suffix}")[0].bits == bits

    def test_jpeg_is_near(self, tmp_path):
        smooth = np.indices((32, 48)).sum(0)[..., None].repeat(3, 2) * 3
        key = write(tmp_path / "a.jpg", smooth.astype(np.uint8))
        image, template = read_still(key)
        write_still(tmp_path / "b.jpg", image, template, FACTS)
        away = codes_of(tmp_path / "b.jpg").astype(int) - codes_of(key)
        assert np.abs(away).max() <= 3

    def test_what_is_scored_is_what_is_kept(self, tmp_path):
        _, template = read_still(write(tmp_path / "a.png", noise(3, "uint8")))
        rng = np.random.default_rng(5)
        pixels = rng.normal(0.4, 0.6, (9, 13, 3)).astype(np.float32)
        pixels[0, 0] = np.nan, np.inf, -np.inf
        window = Window(0, 0, 13, 9)
        write_still(tmp_path / "b.png", Image(pixels, window, window), template, FACTS)
        kept = read_still(tmp_path / "b.png")[0].pixels
        assert np.array_equal(kept, quantise_still(pixels, template))
        assert list(kept[0, 0]) == [0, 1, 0]

    def test_floats_keep_what_a_display_does_not_show(self, tmp_path):
        codes = np.array([[[-0.5, 7.25, 1e4]]], np.float32)
        image, template = read_still(write(tmp_path / "a.tif", codes))
        assert template.curve is LINEAR and np.array_equal(image.pixels, codes)
        write_still(tmp_path / "b.tif", image, template, FACTS)
        assert np.array_equal(codes_of(tmp_path / "b.tif"), codes)

    def test_no_clock_gets_into_a_frame(self, tmp_path):
        image, template = read_still(write(tmp_path / "a.tif", noise(3, "uint8")))
        timeless = replace(template, metadata=())
        write_still(tmp_path / "b.tif", image, timeless, FACTS)
        made = oiio.ImageInput.open(str(tmp_path / "b.tif")).spec()
        assert made.get_string_attribute("DateTime") == "1970:01:01 00:00:00"

    def test_the_same_bytes_each_time(self, tmp_path):
        for suffix in ("png", "tif", "jpg", "dpx"):
            image, template = read_still(write(tmp_path / f"a.{suffix}", noise(3, "uint8")))
            made = []
            for clock in ("x", "y" * 70):  # a folder's name got into DPX headers
                folder = tmp_path / clock / suffix
                folder.mkdir(parents=True)
                write_still(folder / f"b.{suffix}", image, template, FACTS)
                made.append((folder / f"b.{suffix}").read_bytes())
            assert made[0] == made[1], suffix


class TestMeaning:
    def test_integers_are_srgb(self, tmp_path):
        image, template = read_still(write(tmp_path / "a.png", np.full((2, 3, 3), 128, np.uint8)))
        assert template.curve is SRGB
        assert np.allclose(image.pixels, ((128 / 255 + 0.055) / 1.055) ** 2.4)
        assert image.data_window == image.display_window == Window(0, 0, 3, 2)

    def test_linear_integers_where_the_file_says_so(self, tmp_path):
        codes = np.full((2, 3, 3), 20000, np.uint16)
        path = write(tmp_path / "a.dpx", codes, dpx__Transfer="Linear", oiio__ColorSpace="linear")
        image, template = read_still(path)
        assert template.curve is LINEAR and np.allclose(image.pixels, 20000 / 65535)
        write_still(tmp_path / "b.dpx", image, template, FACTS)
        assert read_still_header(tmp_path / "b.dpx")[0].curve is LINEAR

    def test_film_scans_are_logarithmic(self, tmp_path):
        codes = np.full((2, 3, 3), 685 << 6, np.uint16)
        log = {"dpx__Transfer": "Printing density", "oiio__BitsPerSample": 10}
        image, template = read_still(write(tmp_path / "a.dpx", codes, **log))
        assert template.curve is FILM and np.allclose(image.pixels, 1, atol=0.01)
        write_still(tmp_path / "b.dpx", image, template, FACTS)
        assert read_still_header(tmp_path / "b.dpx")[0].curve is FILM

    @pytest.mark.parametrize("suffix", ["png", "tif"])
    def test_light_is_premultiplied_whatever_the_file_does(self, tmp_path, suffix):
        half = np.array([[[188, 188, 188, 128]]], np.uint8)  # sRGB code 188 is half the light
        path = write(tmp_path / f"a.{suffix}", half, oiio__UnassociatedAlpha=1)
        image, template = read_still(path)
        assert not template.premultiplied
        assert np.allclose(image.pixels, [[[0.25, 0.25, 0.25, 0.5]]], atol=0.005)

    def test_premultiplied_codes_are_divided_before_the_curve(self, tmp_path):
        path = write(tmp_path / "a.tif", np.array([[[94, 94, 94, 128]]], np.uint8))
        image, template = read_still(path)
        assert template.premultiplied
        assert np.allclose(image.pixels, [[[0.25, 0.25, 0.25, 0.5]]], atol=0.005)

    def test_metadata_goes_along(self, tmp_path):
        key = write(tmp_path / "a.tif", noise(3, "uint8"), Artist="Ann", DateTime=DATE)
        spec = oiio.ImageInput.open(str(key)).spec()
        assert spec.get_string_attribute("Artist") == "Ann"
        image, template = read_still(key)
        write_still(tmp_path / "b.tif", image, template, FACTS)
        made = oiio.ImageInput.open(str(tmp_path / "b.tif")).spec()
        assert made.get_string_attribute("Artist") == "Ann"
        assert made.get_string_attribute("DateTime") == DATE
        assert made.get_string_attribute("Software").startswith("ExWarp ")

    @pytest.mark.parametrize("suffix", ["png", "tif", "jpg"])
    def test_the_colour_profile_goes_along(self, tmp_path, suffix):
        profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
        key, out = tmp_path / f"a.{suffix}", tmp_path / f"b.{suffix}"
        Pillow.new("RGB", (4, 3), (200, 100, 50)).save(key, icc_profile=profile)
        image, template = read_still(key)
        write_still(out, image, template, FACTS)
        with Pillow.open(out) as picture:
            assert picture.info["icc_profile"] == profile

    @pytest.mark.parametrize("suffix", ["png", "tif", "jpg", "webp"])
    def test_the_orientation_goes_along(self, tmp_path, suffix):
        exif = Pillow.Exif()
        exif[ORIENTATION] = 6
        key, out = tmp_path / f"a.{suffix}", tmp_path / f"b.{suffix}"
        Pillow.fromarray(noise(4 if suffix == "webp" else 3, "uint8")).save(key, exif=exif)
        image, template = read_still(key)
        write_still(out, image, template, FACTS)
        with Pillow.open(out) as picture, Pillow.open(key) as given:
            assert picture.getexif()[ORIENTATION] == 6
            picture.load()
            assert picture.size == given.size and picture.mode == given.mode
        assert read_still_header(out)[0].has_alpha == (suffix == "webp")

    @pytest.mark.parametrize("suffix", ["png", "tif", "jpg"])
    def test_colour_after_a_grey_frame_is_colour(self, tmp_path, suffix):
        key, out = tmp_path / f"a.{suffix}", tmp_path / f"b.{suffix}"
        _, grey = read_still(write(key, noise(1, "uint8")))
        colour, _ = read_still(write(tmp_path / "c.png", smooth_colour()))
        write_still(out, colour, grey, FACTS)
        assert codes_of(out).shape[-1] == 3
        assert np.abs(codes_of(out).astype(int) - smooth_colour()).max() <= 3
        assert np.array_equal(quantise_still(colour.pixels, grey), colour.pixels)

    def test_a_grey_frame_with_alpha_gets_colour_too(self, tmp_path):
        _, grey = read_still(write(tmp_path / "a.png", noise(2, "uint8")))
        key = write(tmp_path / "c.png", np.dstack([smooth_colour(), smooth_colour()[..., :1]]))
        colour, _ = read_still(key)
        write_still(tmp_path / "b.png", colour, grey, FACTS)
        assert np.array_equal(codes_of(tmp_path / "b.png"), codes_of(key))

    def test_what_stays_grey_is_a_grey_file(self, tmp_path):
        image, template = read_still(write(tmp_path / "a.png", noise(1, "uint8")))
        write_still(tmp_path / "b.png", image, template, FACTS)
        assert codes_of(tmp_path / "b.png").shape[-1] == 1

    @given(st.floats(-2, 50, width=32))
    def test_curves_are_undone(self, light):
        value = np.array([light], np.float32)
        for curve in (SRGB, LINEAR):
            assert np.allclose(curve.to_linear(curve.to_code(value)), value, rtol=1e-4, atol=1e-6)
        seen = np.maximum(value, FILM.to_linear(np.zeros(1, np.float32)))  # less has no code
        assert np.allclose(FILM.to_linear(FILM.to_code(value)), seen, rtol=1e-4, atol=1e-4)


class TestSeal:
    @pytest.mark.parametrize("suffix", ["png", "jpg", "tif"])
    def test_a_frame_tells_what_it_was_made_of(self, tmp_path, suffix):
        image, template = read_still(write(tmp_path / f"a.{suffix}", noise(3, "uint8")))
        out = tmp_path / f"b.{suffix}"
        write_still(out, image, template, FACTS)
        assert still_facts(out) == FACTS
        assert still_facts(tmp_path / f"a.{suffix}") is None
        assert still_facts(tmp_path / "none.png") is None

    @pytest.mark.parametrize("suffix", ["png", "jpg", "tif"])
    def test_any_damage_shows(self, tmp_path, suffix):
        image, template = read_still(write(tmp_path / f"a.{suffix}", noise(3, "uint8")))
        out = tmp_path / f"b.{suffix}"
        write_still(out, image, template, FACTS)
        data = out.read_bytes()
        for place in np.random.default_rng(1).integers(0, len(data), 60):
            hurt = bytearray(data)
            hurt[place] ^= 1
            out.write_bytes(hurt)
            assert still_facts(out) is None, place
        out.write_bytes(data[:-1])
        assert still_facts(out) is None

    def test_png_checksums_stay_right(self, tmp_path):
        image, template = read_still(write(tmp_path / "a.png", noise(4, "uint16")))
        write_still(tmp_path / "b.png", image, template, FACTS)
        read_still(tmp_path / "b.png")
        with Pillow.open(tmp_path / "b.png") as picture:  # which refuses wrong ones
            picture.load()
            assert "recipe" in picture.text["Software"]

    def test_other_formats_are_never_taken_for_good(self, tmp_path):
        for suffix in ("dpx", "tga", "bmp"):
            assert f".{suffix}" not in SEALED
            image, template = read_still(write(tmp_path / f"a.{suffix}", noise(3, "uint8")))
            write_still(tmp_path / f"b.{suffix}", image, template, FACTS)
            assert still_facts(tmp_path / f"b.{suffix}") is None

    def test_what_has_no_place_is_left_as_it_is(self):
        assert seal_still(b"no place here") == b"no place here"


class TestBadFiles:
    def test_no_file(self, tmp_path):
        with pytest.raises(InputError, match="there is no image"):
            read_still(tmp_path / "a.png")

    @pytest.mark.parametrize("suffix", ["png", "jpg", "tif", "dpx", "webp"])
    @pytest.mark.parametrize("share", [0.0, 0.4, 0.95])
    def test_truncated_files(self, tmp_path, suffix, share):
        path = write(tmp_path / f"a.{suffix}", noise(3, "uint8"))
        data = path.read_bytes()
        path.write_bytes(data[: int(share * len(data))])
        with pytest.raises(DamagedFileError, match=r"cannot read the image .*; write it again"):
            read_still(path)

    @pytest.mark.parametrize("kind", ["png", "jpg", "tif", "dpx", "bmp", "gif"])
    def test_a_library_that_guesses_by_content_says_nothing_itself(self, tmp_path, capfd, kind):
        data = write(tmp_path / f"a.{kind}", noise(3, "uint8")).read_bytes()
        for suffix in ("exr", "jpg", "dpx"):
            for size in (len(data), len(data) // 2):
                path = tmp_path / f"b.{suffix}"
                path.write_bytes(data[:size])
                try:
                    if suffix == "exr":
                        ExrFile(path)
                    else:
                        read_still(path)
                except DamagedFileError as error:
                    assert str(path) in str(error)
                else:
                    assert suffix != "exr" and (size == len(data) or kind == "bmp")
        assert capfd.readouterr() == ("", "")

    def test_openexr_by_another_name_is_no_still(self, tmp_path):
        frame = write_single(tmp_path / "a.exr", rgba(3, 4))
        path = frame.rename(tmp_path / "a.png")
        with pytest.raises(InputError, match=r"a\.png is an OpenEXR file.*name it \.exr"):
            read_still(path)

    def test_too_many_channels(self, tmp_path):
        path = write(tmp_path / "a.tif", noise(5, "uint8"))
        with pytest.raises(LayoutError, match="only grey or RGB"):
            read_still(path)

    def test_a_format_that_cannot_be_read_right(self, tmp_path):
        path = write(tmp_path / "a.dpx", noise(4, "uint16"), oiio__BitsPerSample=10)
        with pytest.raises(LayoutError, match="16 bits"):
            read_still(path)

    def test_a_format_that_cannot_be_written(self, tmp_path):
        image, template = read_still(write(tmp_path / "a.png", noise(3, "uint8")))
        with pytest.raises(UsageError, match=r"cannot be written as \.cin"):
            write_still(tmp_path / "b.cin", image, template, FACTS)

    def test_a_missing_folder(self, tmp_path):
        image, template = read_still(write(tmp_path / "a.png", noise(3, "uint8")))
        with pytest.raises(OutputError, match="the folder does not exist"):
            write_still(tmp_path / "no" / "b.png", image, template, FACTS)

    def test_size_alone(self, tmp_path):
        _, window = read_still_header(write(tmp_path / "a.png", noise(3, "uint8")))
        assert window == Window(0, 0, 13, 9)
