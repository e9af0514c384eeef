"""Written frames: what they carry, how they are sealed, what damage shows."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import xxhash
from hypothesis import given, settings
from hypothesis import strategies as st

from exwarp_cli.domain.frame import Image, Window
from exwarp_cli.domain.timeline import parse_rate
from exwarp_cli.errors import DamagedFileError, OutputError, UsageError
from exwarp_cli.io import generated_frames
from exwarp_cli.io.channels import ChannelRef
from exwarp_cli.io.exr.reader import ExrFile, read_headers
from exwarp_cli.io.exr.writer import OpenExrCompression, Plane, read_template
from exwarp_cli.io.frames import read_image
from exwarp_cli.io.key_file import file_digest
from tests.unit.exr_files import box, plane, rgba, write_parts, write_single
from tests.unit.written_frames import CARRIED, WINDOW, beauty, image, pixels, template


@pytest.fixture
def frame(tmp_path) -> Path:
    path = tmp_path / "out.exr"
    kept = template(tmp_path / "in.exr", **CARRIED)
    generated_frames.write_picture(
        path, image(), kept, {generated_frames.FINGERPRINT: "abc", "exwarp:method": "s6"}
    )
    return path


class TestTemplate:
    @pytest.mark.parametrize("name", CARRIED)
    def test_attributes_are_carried(self, frame, name):
        found, value = read_headers(frame)[0][name], CARRIED[name]
        if isinstance(value, str | Fraction):
            assert found == value
        else:
            np.testing.assert_allclose(np.asarray(found), np.asarray(value), rtol=1e-6)

    def test_types_are_kept(self, frame, tmp_path):
        before = read_headers(tmp_path / "in.exr")[0]
        after = read_headers(frame)[0]
        for name in CARRIED:
            assert type(after[name]) is type(before[name]), name

    def test_nothing_tells_of_an_earlier_run(self, tmp_path):
        """Frames of ours may be upsampled again, which had another path."""
        kept = template(tmp_path / "in.exr", **{"exwarp:path": "S3", "exwarp:kind": "repeated"})
        generated_frames.write_picture(
            tmp_path / "out.exr", image(), kept, {generated_frames.FINGERPRINT: "abc"}
        )
        assert set(generated_frames.read_facts(tmp_path / "out.exr")) == {"recipe", "xxh128"}

    @pytest.mark.parametrize("name", ["framesPerSecond", "preview", "timeCode"])
    def test_what_belongs_to_the_source_alone_is_not(self, tmp_path, name):
        values = {"framesPerSecond": Fraction(24)}
        kept = template(tmp_path / "in.exr", **{k: v for k, v in values.items() if k == name})
        assert name not in kept.parts[0].header

    @pytest.mark.parametrize("compression", ["none", "zips", "piz", "dwaa"])
    def test_compression_is_the_source_s(self, tmp_path, compression):
        constant = generated_frames.parse_compression(compression)
        kept = template(tmp_path / "in.exr", compression=constant)
        generated_frames.write_picture(tmp_path / "out.exr", image(), kept, {})
        assert read_headers(tmp_path / "out.exr")[0]["compression"] == constant

    @pytest.mark.parametrize("dtype", [np.float16, np.float32])
    def test_pixel_types_are_the_source_s(self, tmp_path, dtype):
        kept = template(tmp_path / "in.exr", dtype)
        assert [plane.dtype for plane in kept.colour] == [np.dtype(dtype)] * 4
        generated_frames.write_picture(tmp_path / "out.exr", image(), kept, {})
        with ExrFile(tmp_path / "out.exr") as file:
            types = {channel.pixel_type for channel in file.parts[0].channels}
        assert types == {"half" if dtype is np.float16 else "float"}
        found = read_image(tmp_path / "out.exr").pixels
        np.testing.assert_array_equal(found, pixels().astype(dtype))

    def test_of_several_parts_the_colour_s_counts(self, tmp_path):
        path = write_parts(
            tmp_path / "in.exr",
            {
                "V.Depth": ({"V.Depth.Z": plane(3, 4, 1)}, {"owner": "depth"}),
                "V.Combined": (
                    {f"V.Combined.{c}": p for c, p in rgba(3, 4).items()},
                    {"owner": "colour"},
                ),
            },
        )
        colour = tuple(ChannelRef("", f"V.Combined.{c}") for c in "RGBA")
        kept = read_template(path, beauty(*colour))
        assert [part.header["owner"] for part in kept.parts] == ["colour"]
        assert [plane.name for plane in kept.colour] == [ref.name for ref in colour]
        generated_frames.write_picture(tmp_path / "out.exr", image(), kept, {})
        np.testing.assert_array_equal(
            read_image(tmp_path / "out.exr").pixels, pixels().astype(np.float16)
        )

    def test_a_damaged_source(self, tmp_path):
        (tmp_path / "in.exr").write_bytes(b"\x76\x2f\x31\x01 and no more")
        with pytest.raises(DamagedFileError, match=r"in\.exr"):
            read_template(tmp_path / "in.exr", beauty())
        with pytest.raises(DamagedFileError, match=r"in\.exr"):
            read_headers(tmp_path / "in.exr")


class TestFrame:
    def test_windows_and_attributes(self, frame):
        with ExrFile(frame) as file:
            assert file.parts[0].data_window == WINDOW
            assert file.parts[0].display_window == Window(0, 0, 16, 10)
        assert generated_frames.read_facts(frame) == {
            "recipe": "abc",
            "method": "s6",
            "xxh128": generated_frames.read_facts(frame)["xxh128"],
        }

    def test_the_same_frame_gives_the_same_bytes(self, frame, tmp_path):
        again = tmp_path / "again.exr"
        kept = read_template(tmp_path / "in.exr", beauty())
        generated_frames.write_picture(
            again, image(), kept, {generated_frames.FINGERPRINT: "abc", "exwarp:method": "s6"}
        )
        assert again.read_bytes() == frame.read_bytes()

    def test_half_ends_at_its_largest_value(self, tmp_path):
        kept = template(tmp_path / "in.exr")
        bright = image()
        bright.pixels[0, 0] = (1e6, -1e6, 65519, 1)
        generated_frames.write_picture(tmp_path / "out.exr", bright, kept, {})
        found = read_image(tmp_path / "out.exr").pixels
        assert found[0, 0].tolist() == [65504, -65504, 65504, 1]

    def test_float_does_not(self, tmp_path):
        kept = template(tmp_path / "in.exr", np.float32)
        bright = image()
        bright.pixels[0, 0] = (1e6, -1e30, 65519, 1)
        generated_frames.write_picture(tmp_path / "out.exr", bright, kept, {})
        found = read_image(tmp_path / "out.exr").pixels
        np.testing.assert_array_equal(found[0, 0], np.float32([1e6, -1e30, 65519, 1]))

    @pytest.mark.parametrize("dtype", [np.float16, np.float32])
    def test_quantised_pixels_are_those_that_are_read_back(self, tmp_path, dtype):
        kept = template(tmp_path / "in.exr", dtype)
        bright = image()
        bright.pixels[0, :3] = 7e4, -0.0, 1e-9, 0.1
        rounded = generated_frames.quantise_picture(bright.pixels, kept)
        generated_frames.write_picture(tmp_path / "out.exr", bright, kept, {})
        np.testing.assert_array_equal(read_image(tmp_path / "out.exr").pixels, rounded)
        np.testing.assert_array_equal(generated_frames.quantise_picture(rounded, kept), rounded)

    def test_nowhere_to_write(self, tmp_path):
        kept = template(tmp_path / "in.exr")
        with pytest.raises(OutputError, match="the folder does not exist"):
            generated_frames.write_picture(tmp_path / "no" / "out.exr", image(), kept, {})

    def test_nothing_else_is_left_in_the_folder(self, frame, tmp_path):
        assert sorted(p.name for p in tmp_path.iterdir()) == ["in.exr", "out.exr"]

    def test_a_mask(self, tmp_path):
        mask = np.random.default_rng(0).random(WINDOW.shape) < 0.3
        generated_frames.write_mask(
            tmp_path / "m.exr", mask, (WINDOW, WINDOW), {generated_frames.FINGERPRINT: "r"}
        )
        with ExrFile(tmp_path / "m.exr") as file:
            (channel,) = file.parts[0].channels
            assert (channel.name, channel.pixel_type) == ("holes", "half")
            np.testing.assert_array_equal(file.read([channel])[channel], mask)
        assert generated_frames.read_fingerprint(tmp_path / "m.exr") == "r"


class TestSeal:
    def test_a_written_frame_is_intact(self, frame):
        data = frame.read_bytes()
        assert generated_frames.is_intact(data)
        assert generated_frames.read_fingerprint(frame) == "abc"
        digits = generated_frames.read_facts(frame)["xxh128"]
        plain = data.replace(digits.encode(), b"0" * 32)
        assert xxhash.xxh3_128(plain).hexdigest() == digits

    def test_a_manifest_may_be_of_any_length(self, tmp_path):
        """Attributes are sorted by name: those of Cryptomatte come before."""
        manifest = {"cryptomatte/1/manifest": '{"a":"' + "0" * 2_000_000 + '"}'}
        kept = template(tmp_path / "in.exr", **manifest)
        generated_frames.write_picture(
            tmp_path / "out.exr", image(), kept, {generated_frames.FINGERPRINT: "abc"}
        )
        assert generated_frames.read_fingerprint(tmp_path / "out.exr") == "abc"

    def test_any_flipped_bit_shows(self, frame):
        data = frame.read_bytes()
        rng = np.random.default_rng(0)
        start = data.index(generated_frames.CHECKSUM.encode())
        places = {0, 4, start, start + 10, start + 60, len(data) - 1}
        places |= set(range(start, start + 110, 7)) | set(rng.integers(0, len(data), 150).tolist())
        for place in sorted(places):
            for bit in (1, 0x20, 0x80):
                broken = bytearray(data)
                broken[place] ^= bit
                assert not generated_frames.is_intact(bytes(broken)), place

    @settings(derandomize=True, max_examples=30)
    @given(st.floats(0, 0.999))
    def test_any_truncation_shows(self, share):
        header = (
            generated_frames.CHECKSUM.encode()
            + b"\0string\0"
            + (32).to_bytes(4, "little")
            + b"0" * 32
        )
        data = b"".join(
            generated_frames.seal(b"head" + header, bytes(range(99)), bytes(range(99, 256)))
        )
        assert generated_frames.is_intact(data)
        assert not generated_frames.is_intact(data[: int(len(data) * share)])
        assert not generated_frames.is_intact(data + b"\0")

    def test_foreign_files_have_no_recipe(self, tmp_path):
        plain = write_single(
            tmp_path / "plain.exr", rgba(3, 4), **{generated_frames.FINGERPRINT: "abc"}
        )
        assert generated_frames.read_fingerprint(plain) is None
        assert generated_frames.read_fingerprint(tmp_path / "none.exr") is None
        folder = tmp_path / "folder.exr"
        folder.mkdir()
        assert generated_frames.read_fingerprint(folder) is None
        (tmp_path / "empty.exr").touch()
        assert generated_frames.read_fingerprint(tmp_path / "empty.exr") is None
        assert not generated_frames.is_intact(plain.read_bytes())

    def test_a_file_without_room_for_it_cannot_be_sealed(self, tmp_path):
        plain = write_single(tmp_path / "plain.exr", rgba(3, 4))
        with pytest.raises(ValueError, match="no place"):
            generated_frames.seal(plain.read_bytes())

    def test_text_is_read_from_the_bytes(self, frame):
        data = frame.read_bytes()
        assert generated_frames.read_string_attribute(data, "exwarp:method") == "s6"
        assert generated_frames.read_string_attribute(data, "owner") == "Ada Lovelace"
        assert generated_frames.read_string_attribute(data, "exwarp:nothing") is None


class TestFilledWindow:
    def test_a_part_that_filled_its_window_stays(self):
        empty = Plane(np.zeros(WINDOW.shape, np.float32), WINDOW)
        assert generated_frames.filled_window([empty], WINDOW) == WINDOW

    def test_the_rest_is_cropped_to_what_is_not_empty(self):
        first, second = np.zeros((2, *WINDOW.shape), np.float32)
        first[3:5, 2] = 1
        second[4, 7] = -0.5
        canvas = Window(-5, 10, 12, 9)
        planes = [Plane(first, canvas), Plane(second, canvas)]
        assert generated_frames.filled_window(planes, Window(0, 0, 3, 3)) == Window(-3, 13, 6, 2)

    def test_planes_on_different_windows(self):
        one = np.ones((2, 2), np.uint32)
        planes = [Plane(one, Window(-4, 0, 2, 2)), Plane(0 * one, Window(9, 9, 2, 2))]
        assert generated_frames.filled_window(planes, Window(0, 0, 3, 3)) == Window(-4, 0, 2, 2)
        assert generated_frames.filled_window(planes, Window(-4, 0, 15, 11)) == Window(
            -4, 0, 15, 11
        )

    def test_nothing_is_one_pixel(self):
        empty = Plane(np.zeros(WINDOW.shape, np.float32), Window(3, 4, 12, 9))
        assert generated_frames.filled_window([empty], Window(0, 0, 3, 3)) == Window(3, 4, 1, 1)

    def test_a_frame_is_cropped_when_it_is_written(self, tmp_path):
        kept = template(tmp_path / "in.exr")
        values = np.zeros((*WINDOW.shape, 4), np.float32)
        values[3:5, 2:6] = pixels()[3:5, 2:6]
        generated_frames.write_picture(
            tmp_path / "out.exr", Image(values, WINDOW, WINDOW), kept, {}
        )
        found = read_image(tmp_path / "out.exr")
        assert found.data_window == Window(2, 3, 4, 2)
        np.testing.assert_array_equal(found.pixels, values[3:5, 2:6].astype(np.float16))


class TestSmallThings:
    @pytest.mark.parametrize(
        ("value", "rate"),
        [(Fraction(24), 24), (Fraction(0), None), (Fraction(-5), None), (25.0, 25), (None, None)],
    )
    def test_frame_rate(self, value, rate):
        assert parse_rate(value) == rate

    def test_compressions_by_name(self):
        assert generated_frames.parse_compression(None) is None
        assert generated_frames.parse_compression("zip") == OpenEXR.ZIP_COMPRESSION
        assert generated_frames.parse_compression("zip:4") == OpenExrCompression(
            OpenEXR.ZIP_COMPRESSION
        )
        with pytest.raises(UsageError, match=r"--compression lzma is not one of none, rle"):
            generated_frames.parse_compression("lzma")

    def test_digest(self, tmp_path):
        (tmp_path / "a").write_bytes(b"abc")
        assert file_digest(tmp_path / "a") == xxhash.xxh3_128(b"abc").hexdigest()
        with pytest.raises(DamagedFileError):
            file_digest(tmp_path / "none")

    def test_display_windows_off_the_origin(self, tmp_path):
        source = tmp_path / "in.exr"
        write_single(source, rgba(3, 4), dataWindow=box(-7, -9, 4, 3))
        kept = read_template(source, beauty())
        shifted = Image(pixels(window=Window(-7, -9, 4, 3)), Window(-7, -9, 4, 3), WINDOW)
        generated_frames.write_picture(tmp_path / "out.exr", shifted, kept, {})
        assert read_image(tmp_path / "out.exr").data_window == Window(-7, -9, 4, 3)
