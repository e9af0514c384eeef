"""The preview video: display encoding, exact rates, whole or absent."""

from __future__ import annotations

import re
import subprocess
from fractions import Fraction
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest

from exwarp_cli.errors import InstallationError, OutputError, UsageError
from exwarp_cli.io import video_writer
from exwarp_cli.io.display_colour import (
    VideoColour,
    from_display,
    to_display,
    to_display_16,
)
from exwarp_cli.io.video_writer import (
    CODECS,
    Soundtrack,
    Timecode,
    VideoLook,
    VideoWriter,
    find_codec,
    read_video_note,
)
from exwarp_cli.io.view_transform import DisplayLook


def ffmpeg(*arguments: str) -> subprocess.CompletedProcess[bytes]:
    program = imageio_ffmpeg.get_ffmpeg_exe()
    return subprocess.run([program, "-nostdin", *arguments], capture_output=True, check=False)


def decode(path: Path, width: int, height: int) -> np.ndarray:
    matrix = "scale=in_color_matrix=bt709"
    raw = ffmpeg("-i", str(path), "-vf", matrix, "-f", "rawvideo", "-pix_fmt", "rgb24", "-")
    return np.frombuffer(raw.stdout, np.uint8).reshape(-1, height, width, 3)


def flat(width: int, height: int, *colour: int) -> np.ndarray:
    return np.full((height, width, 3), colour, np.uint8)


class TestToDisplay:
    def test_the_curve_against_the_standard_in_double_precision(self):
        linear = np.linspace(0, 1, 4001, dtype=np.float32).reshape(1, -1, 1).repeat(3, axis=2)
        exact = linear.astype(np.float64)
        curved = np.where(exact <= 0.0031308, 12.92 * exact, 1.055 * exact ** (1 / 2.4) - 0.055)
        distance = np.abs(to_display(linear) - 255 * curved)
        assert distance.max() < 0.5 + 1e-4

    def test_every_code_value_survives(self):
        codes = np.arange(256, dtype=np.float64) / 255
        linear = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)
        pixels = linear.astype(np.float32).reshape(16, 16, 1).repeat(3, axis=2)
        assert np.array_equal(to_display(pixels)[..., 0].ravel(), np.arange(256))

    def test_halves_are_rounded_up(self):
        # 0.5/255 and 1.5/255 on the linear part; the float just below must stay below
        for code in (0.5, 1.5):
            x = np.float32(code / 255 / 12.92)
            around = np.array([x * (1 - 1e-5), x * (1 + 1e-5)], np.float32)
            found = to_display(around.reshape(1, 2, 1).repeat(3, axis=2))[0, :, 0]
            assert list(found) == [int(code - 0.5), int(code + 0.5)]

    def test_out_of_range_and_non_finite_values(self):
        values = [-5.0, -np.inf, np.nan, np.inf, 7.0, 3e38]
        pixels = np.array(values, np.float32).reshape(1, -1, 1).repeat(3, axis=2)
        for light in (pixels, DisplayLook().apply(pixels, 20)):
            assert list(to_display(light)[0, :, 0]) == [0, 0, 0, 255, 255, 255]

    def test_exposure_is_in_stops(self):
        pixels = np.full((2, 2, 3), 0.1, np.float32)
        assert np.array_equal(DisplayLook().apply(pixels, 2.0), pixels * 4)

    def test_alpha_is_dropped_and_the_input_kept(self):
        pixels = np.full((2, 3, 4), np.nan, np.float32)
        assert to_display(pixels).shape == (2, 3, 3)
        assert np.isnan(pixels).all()


class TestToDisplay16:
    def test_it_has_the_curve_of_8_bits_at_257_times_the_codes(self):
        linear = np.linspace(-0.1, 1.1, 4001, dtype=np.float32).reshape(1, -1, 1).repeat(3, axis=2)
        exact = linear.astype(np.float64).clip(0, 1)
        curved = np.where(exact <= 0.0031308, 12.92 * exact, 1.055 * exact ** (1 / 2.4) - 0.055)
        distance = np.abs(to_display_16(linear) - 65535 * curved)
        assert distance.max() < 0.6  # half a code, and what float32 rounds

    def test_it_inverts_16_bits(self):
        codes = np.arange(0, 65536, 7, dtype=np.uint16).reshape(1, -1, 1).repeat(3, axis=2)
        assert np.array_equal(to_display_16(from_display(codes)), codes)


class TestFromDisplay:
    def test_eight_bits_come_back(self):
        codes = np.arange(256, dtype=np.uint8).reshape(1, 256, 1).repeat(3, axis=2)
        assert np.array_equal(to_display(from_display(codes)), codes)

    def test_both_depths_against_the_standard(self):
        for dtype, top in ((np.uint8, 255), (np.uint16, 65535)):
            codes = np.array([0, 1, top // 30, top // 2, top], dtype)
            exact = codes / top
            linear = np.where(exact <= 0.04045, exact / 12.92, ((exact + 0.055) / 1.055) ** 2.4)
            assert np.allclose(from_display(codes), linear, rtol=1e-5)


class TestLook:
    def written(self, path: Path, look: VideoLook, frames: int = 10) -> str:
        with VideoWriter(path, 32, 32, 10, look) as video:
            for _ in range(frames):
                video.write(flat(32, 32, 90, 20, 60))
        return ffmpeg("-i", str(path)).stderr.decode()

    def sound(self, path: Path, codec: str) -> Path:
        tone = ("-f", "lavfi", "-i", "sine=d=2", "-metadata", "title=Night")
        assert ffmpeg("-y", *tone, "-c:a", codec, str(path)).returncode == 0
        return path

    def test_colour_and_pixels_are_labelled(self, tmp_path):
        colour = VideoColour("smpte170m", "smpte170m", "unknown", full_range=True)
        output = self.written(tmp_path / "a.mp4", VideoLook(colour, Fraction(4, 3)))
        assert "(pc, smpte170m/smpte170m/unknown" in output and "SAR 4:3" in output

    @pytest.mark.parametrize(
        ("codec", "name", "target", "becomes"),
        [
            ("aac", "aac", "a.mp4", "aac"),
            ("pcm_s16le", "pcm_s16le", "a.mov", "pcm_s16le"),
            ("pcm_s16le", "pcm_s16le", "a.mp4", "aac"),
            ("libopus", "opus", "a.mp4", "opus"),
            ("libopus", "opus", "a.mov", "aac"),
        ],
    )
    def test_sound_is_copied_where_players_know_it(self, tmp_path, codec, name, target, becomes):
        source = self.sound(tmp_path / "s.mkv", codec)
        output = self.written(tmp_path / target, VideoLook(sound=Soundtrack(source, (name,))))
        assert re.search(rf"Audio: {becomes}\b", output) and "title           : Night" in output

    def test_the_sound_of_a_part(self, tmp_path):
        source = self.sound(tmp_path / "s.mkv", "pcm_s16le")
        whole = Soundtrack(source, ("pcm_s16le",))
        part = Soundtrack(source, ("pcm_s16le",), Fraction(1, 2), Fraction(1))
        end = Soundtrack(source, ("pcm_s16le",), Fraction(3, 2))
        rest = Soundtrack(source, ("pcm_s16le",), Fraction(1, 2), Fraction(7, 4))
        cases = ((whole, "02.0"), (part, "01.0"), (end, "00.5"), (rest, "01.5"))
        for sound, seconds in cases:
            output = self.written(tmp_path / "a.mov", VideoLook(sound=sound), frames=3)
            assert f"Duration: 00:00:{seconds}" in output

    def test_a_track_that_no_player_knows_is_left_out_alone(self, tmp_path):
        """As phones write it: ffmpeg cannot decode the second track."""
        tones = [
            part for pitch in (300, 500) for part in ("-f", "lavfi", "-i", f"sine={pitch}:d=1")
        ]
        source = tmp_path / "s.mov"
        maps = ("-map", "0", "-map", "1", "-c:a", "aac")
        assert ffmpeg("-y", *tones, *maps, str(source)).returncode == 0
        data = source.read_bytes()
        first, second = data[: data.rindex(b"stsd")], data[data.rindex(b"stsd") :]
        second = second.replace(b"mp4a", b"apac", 1).replace(b"esds", b"free", 1)
        source.write_bytes(first + second)
        sound = Soundtrack(source, ("aac", "apple_apac"))
        with VideoWriter(tmp_path / "a.mp4", 32, 32, 10, VideoLook(sound=sound)) as video:
            video.write(flat(32, 32, 90, 20, 60))
        (said,) = video.remarks
        assert said.startswith(f"sound track 2 (apple_apac) of {source} is left out")
        assert re.findall(
            r"Audio: (\w+)", ffmpeg("-i", str(tmp_path / "a.mp4")).stderr.decode()
        ) == ["aac"]

    def test_usual_tracks_are_tried_in_one_run(self, tmp_path, monkeypatch):
        """A trial reads the whole other video, which may be long."""
        tones = [part for d in (1, 2) for part in ("-f", "lavfi", "-i", f"sine=d={d}")]
        source, runs, run = tmp_path / "s.mov", [], video_writer.ffmpeg.run_ffmpeg
        maps = ("-map", "0", "-map", "1", "-c:a", "aac")
        assert ffmpeg("-y", *tones, *maps, str(source)).returncode == 0
        look = VideoLook(sound=Soundtrack(source, ("aac", "aac")))

        def count(options: list[str]) -> tuple[bytes, str]:
            runs.append(options)
            return run(options)

        monkeypatch.setattr(video_writer.ffmpeg, "run_ffmpeg", count)
        assert self.remarks(tmp_path / "a.mp4", look) == () and len(runs) == 1

    def test_more_channels_than_mp4_has_go_into_mov(self, tmp_path):
        source = tmp_path / "s.mov"
        many = ("-f", "lavfi", "-i", "sine=d=1", "-af", "pan=10c|c0=c0|c9=c0", "-c:a", "pcm_s16le")
        assert ffmpeg("-y", *many, str(source)).returncode == 0
        look = VideoLook(sound=Soundtrack(source, ("pcm_s16le",)))
        (said,) = self.remarks(tmp_path / "a.mp4", look)
        assert "is left out of the video" in said and "a video named .mov can hold it" in said
        assert self.remarks(tmp_path / "a.mov", look) == ()
        made = ffmpeg("-i", str(tmp_path / "a.mov")).stderr.decode()
        assert "pcm_s16le" in made and ("5.1.4" in made or "10 channels" in made)

    def test_damaged_sound_is_encoded_again(self, tmp_path):
        source = tmp_path / "s.ts"
        tone = ("-f", "lavfi", "-i", "anoisesrc=d=4:seed=1", "-c:a", "aac")
        assert ffmpeg("-y", *tone, str(source)).returncode == 0
        look = VideoLook(sound=Soundtrack(source, ("aac",)))
        assert self.remarks(tmp_path / "sound.mp4", look) == ()
        data = bytearray(source.read_bytes())
        noise = np.random.default_rng(0)
        for packet in range(len(data) // 3 // 188 * 188, len(data) // 2, 188):
            data[packet + 30 : packet + 188] = noise.bytes(158)
        source.write_bytes(data)
        (said,) = self.remarks(tmp_path / "hurt.mp4", look)
        assert "sound track 1 (aac)" in said and "encoded again as aac, since it is damaged" in said
        made = ffmpeg("-i", str(tmp_path / "hurt.mp4")).stderr.decode()
        assert "Audio: aac" in made and "Duration: 00:00:0" in made

    def remarks(self, path: Path, look: VideoLook) -> tuple[str, ...]:
        with VideoWriter(path, 32, 32, 10, look) as video:
            video.write(flat(32, 32, 90, 20, 60))
        return video.remarks

    def test_text_of_subtitles_goes_along(self, tmp_path):
        text = tmp_path / "s.srt"
        text.write_text("1\n00:00:00,100 --> 00:00:00,800\nGood night\n")
        look = VideoLook(sound=Soundtrack(text, (), subtitles=("subrip",)))
        for suffix in ("mp4", "mov"):
            assert self.remarks(tmp_path / f"a.{suffix}", look) == ()
            back = ffmpeg("-i", str(tmp_path / f"a.{suffix}"), "-f", "srt", "-").stdout.decode()
            assert "Good night" in back

    @pytest.mark.parametrize(
        ("rate", "code", "later", "target", "becomes"),
        [
            (24, "01:00:00:07", 0, 96, "01:00:00:28"),
            (24, "01:00:59:23", 2, 96, "01:01:00:04"),
            (Fraction(30000, 1001), "00:01:00;02", 0, Fraction(120000, 1001), "00:01:00;008"),
            (Fraction(30000, 1001), "00:09:59;29", 1, Fraction(120000, 1001), "00:10:00;000"),
            (25, "23:59:59:24", 1, 50, "00:00:00:00"),
            (24, "10:00:00:05", 0, 60, "10:00:00:12"),
        ],
    )
    def test_the_frames_of_a_timecode_go_with_the_rate(
        self, tmp_path, rate, code, later, target, becomes
    ):
        look = VideoLook(timecode=Timecode(code, Fraction(rate), Fraction(later)))
        with VideoWriter(tmp_path / "a.mov", 32, 32, target, look) as video:
            for _ in range(4):
                video.write(flat(32, 32, 90, 20, 60))
        assert video.remarks == ()
        made = ffmpeg("-i", str(tmp_path / "a.mov")).stderr.decode()
        found = re.search(r"timecode\s*: (\S+)", made)
        assert found is not None
        assert re.sub(r"\D0*(?=\d)", ":", found[1]) == re.sub(r"\D0*(?=\d)", ":", becomes)

    def test_a_timecode_that_cannot_count_the_rate_is_left_out(self, tmp_path):
        look = VideoLook(timecode=Timecode("01:00:00:00", Fraction(60)))
        with VideoWriter(tmp_path / "a.mov", 32, 32, 480, look) as video:
            video.write(flat(32, 32, 90, 20, 60))
        assert video.remarks == (
            "the timecode is left out of the video, as it cannot count 480 frames a second",
        )

    @pytest.mark.parametrize("suffix", ["mp4", "mov"])
    def test_a_note_is_kept(self, tmp_path, suffix):
        path, source = tmp_path / f"a.{suffix}", self.sound(tmp_path / "s.mkv", "aac")
        note = 'exwarp {"recipe": "ab=c;d#e\\f", "method": "softsplat"}'
        self.written(path, VideoLook(sound=Soundtrack(source, ("aac",)), note=note))
        assert read_video_note(path) == note
        self.written(path, VideoLook())
        assert read_video_note(path) is None

    def test_there_is_no_note_where_there_is_no_video(self, tmp_path):
        assert read_video_note(tmp_path / "none.mp4") is None
        (tmp_path / "a.mp4").write_bytes(b"no video")
        assert read_video_note(tmp_path / "a.mp4") is None

    def test_silence(self, tmp_path):
        source = self.sound(tmp_path / "s.mkv", "aac")
        output = self.written(tmp_path / "a.mp4", VideoLook(sound=Soundtrack(source, ())))
        assert "Audio" not in output and "Night" not in output


class TestCodecs:
    """Each codec that --video-codec names, as ffmpeg reads it back."""

    WIDTH, HEIGHT, FRAMES = 2048, 32, 6

    def ramp(self, dtype: type[np.unsignedinteger]) -> np.ndarray:
        """Grey from black to white, the whole width."""
        codes = np.linspace(0, np.iinfo(dtype).max, self.WIDTH).round().astype(dtype)
        return np.broadcast_to(codes[None, :, None], (self.HEIGHT, self.WIDTH, 3))

    def written(self, path: Path, name: str, look: VideoLook | None = None) -> str:
        codec = find_codec(name, path)
        frame = self.ramp(np.uint16 if codec.is_deep else np.uint8)
        with VideoWriter(path, self.WIDTH, self.HEIGHT, 120, look, codec) as video:
            for _ in range(self.FRAMES):
                video.write(frame)
        return ffmpeg("-i", str(path)).stderr.decode()

    def levels(self, path: Path) -> np.ndarray:
        """The luma of each frame's middle row, float, 16 bits."""
        grey = ("-f", "rawvideo", "-pix_fmt", "gray16le", "-")
        raw = np.frombuffer(ffmpeg("-i", str(path), *grey).stdout, np.uint16)
        return raw.reshape(-1, self.HEIGHT, self.WIDTH)[:, self.HEIGHT // 2]

    @pytest.mark.parametrize(
        ("name", "suffix", "stream"),
        [
            ("h264", ".mp4", r"h264 \(High\) \(avc1.*yuv420p"),
            ("h264", ".mov", r"h264 \(High\) \(avc1.*yuv420p"),
            ("hevc", ".mp4", r"hevc \(Main 10\) \(hvc1.*yuv420p10le"),
            ("hevc", ".mov", r"hevc \(Main 10\) \(hvc1.*yuv420p10le"),
            ("prores", ".mov", r"prores \(HQ\) \(apch.*yuv422p10le"),
        ],
    )
    def test_what_players_are_told(self, tmp_path, name, suffix, stream):
        path = tmp_path / f"a{suffix}"
        output = self.written(path, name, VideoLook(pixel_aspect=Fraction(4, 3)))
        assert re.search(stream + r"\(tv, bt709/bt709/iec61966-2-1", output)
        assert "SAR 4:3" in output and "120 fps" in output
        assert "Duration: 00:00:00.05" in output  # 6 of 120 a second
        assert len(self.levels(path)) == self.FRAMES

    @pytest.mark.parametrize("name", ["hevc", "prores"])
    def test_ten_bits_arrive(self, tmp_path, name):
        self.written(tmp_path / "a.mov", name)
        for row in self.levels(tmp_path / "a.mov"):
            assert len(np.unique(row)) > 3 * 256
            assert np.abs(np.diff(row.astype(float))).max() < 65535 / 255

    def test_eight_bits_have_no_more_than_256_levels(self, tmp_path):
        self.written(tmp_path / "a.mov", "h264")
        assert len(np.unique(self.levels(tmp_path / "a.mov")[0])) <= 256

    def test_prores_of_a_video_of_full_range_has_the_usual_range(self, tmp_path):
        look = VideoLook(VideoColour(full_range=True))
        assert "(tv, bt709" in self.written(tmp_path / "a.mov", "prores", look)
        assert "(pc, bt709" in self.written(tmp_path / "b.mov", "hevc", look)

    def test_frames_of_eight_bits_are_no_input_of_ten(self, tmp_path):
        codec = CODECS["hevc"]
        writer = VideoWriter(tmp_path / "a.mp4", 32, 32, 24, codec=codec)
        with pytest.raises(ValueError, match="expected uint16"), writer as video:
            video.write(flat(32, 32, 0, 0, 0))

    def test_prores_needs_mov(self, tmp_path):
        with pytest.raises(UsageError, match=r"ProRes does not go into .*a\.mp4; name the video"):
            find_codec("prores", tmp_path / "a.mp4")

    def test_an_unknown_name(self, tmp_path):
        with pytest.raises(UsageError, match="av1 is not one of h264, hevc, prores"):
            find_codec("av1", tmp_path / "a.mp4")

    def test_an_encoder_that_ffmpeg_lacks(self, tmp_path, monkeypatch):
        fake = tmp_path / "ffmpeg"
        fake.write_text("#!/bin/sh\necho \"Unknown encoder 'libx265'\" >&2\nexit 1\n")
        fake.chmod(0o755)
        monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(fake))
        with pytest.raises(InstallationError, match="cannot encode HEVC by libx265: ffmpeg says"):
            find_codec("hevc", tmp_path / "a.mp4")
        assert find_codec("h264", tmp_path / "a.mp4") is CODECS["h264"]


class TestVideoWriter:
    def test_frames_come_back_in_order_and_colour(self, tmp_path):
        shades = [(200, 40, 30), (20, 180, 60), (30, 60, 220), (128, 128, 128), (255, 255, 255)]
        path = tmp_path / "ä %d #.mp4"
        with VideoWriter(path, 64, 32, 120) as video:
            for shade in shades:
                video.write(flat(64, 32, *shade))
            assert not path.exists()
        assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
        frames = decode(path, 64, 32)
        assert frames.shape[0] == len(shades)
        difference = frames.astype(int) - np.array(shades)[:, None, None, :]
        assert np.abs(difference).max() <= 3

    @pytest.mark.parametrize("suffix", [".mp4", ".mov", ".MP4"])
    def test_rate_and_tags(self, tmp_path, suffix):
        path = tmp_path / f"a{suffix}"
        with VideoWriter(path, 32, 32, Fraction(30000, 1001) * 4) as video:
            for _ in range(8):
                video.write(flat(32, 32, 9, 9, 9))
        output = ffmpeg("-i", str(path)).stderr.decode()
        assert "119.88 fps" in output and "120k tbn" in output
        assert re.search(r"h264.*yuv420p\(tv, bt709/bt709/iec61966-2-1", output)

    @pytest.mark.parametrize(("fps", "rate"), [(23.976023976, "24000/1001"), (96.0, "96")])
    def test_a_float_rate_becomes_the_fraction_that_is_meant(self, tmp_path, fps, rate):
        assert str(VideoWriter(tmp_path / "a.mp4", 2, 2, fps)._rate) == rate

    def test_odd_sizes_are_padded_by_the_edge(self, tmp_path):
        frame = flat(33, 17, 40, 40, 40)
        frame[:, -1] = frame[-1, :] = 220
        with VideoWriter(tmp_path / "a.mp4", 33, 17, 24) as video:
            video.write(frame)
        (shown,) = decode(tmp_path / "a.mp4", 34, 18)
        assert shown[:, -1].min() > 190 and shown[-1, :].min() > 190

    def test_a_frame_of_another_size_is_a_defect(self, tmp_path):
        writer = VideoWriter(tmp_path / "a.mp4", 32, 32, 24)
        with pytest.raises(ValueError, match="expected uint8"), writer as video:
            video.write(flat(16, 32, 0, 0, 0))
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize("name", ["a.avi", "a", "a.exr", "mp4"])
    def test_other_containers_are_refused(self, tmp_path, name):
        with pytest.raises(UsageError, match=r"neither \.mp4 nor \.mov"):
            VideoWriter(tmp_path / name, 32, 32, 24)

    @pytest.mark.parametrize("fps", [0, -1.0, float("nan"), float("inf")])
    def test_a_rate_must_be_positive(self, tmp_path, fps):
        with pytest.raises(UsageError, match="frame rate"):
            VideoWriter(tmp_path / "a.mp4", 32, 32, fps)

    @pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
    def test_an_interrupted_video_leaves_nothing(self, tmp_path, error):
        with pytest.raises(error), VideoWriter(tmp_path / "a.mp4", 32, 32, 24) as video:
            video.write(flat(32, 32, 1, 2, 3))
            raise error
        assert list(tmp_path.iterdir()) == []

    def test_no_frames_no_video(self, tmp_path):
        writer = VideoWriter(tmp_path / "a.mp4", 32, 32, 24)
        with pytest.raises(OutputError, match="would have no frames"), writer:
            pass
        assert list(tmp_path.iterdir()) == []

    def test_a_missing_folder(self, tmp_path):
        with pytest.raises(OutputError, match="the folder does not exist"):
            VideoWriter(tmp_path / "no" / "a.mp4", 32, 32, 24).__enter__()

    def test_a_missing_ffmpeg(self, tmp_path, monkeypatch):
        monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(tmp_path / "none"))
        with pytest.raises(OutputError, match="ffmpeg does not start"):
            VideoWriter(tmp_path / "a.mp4", 32, 32, 24).__enter__()
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize("frames", [1, 200])
    def test_a_failing_ffmpeg_is_quoted(self, tmp_path, monkeypatch, frames):
        folder = tmp_path / "out"
        folder.mkdir()
        fake = tmp_path / "ffmpeg"
        fake.write_text("#!/bin/sh\necho '[mp4 @ 0x1] No space left on device' >&2\nexit 1\n")
        fake.chmod(0o755)
        monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(fake))
        writer = VideoWriter(folder / "a.mp4", 64, 64, 24)
        said = "ffmpeg says 'No space left on device'"
        with pytest.raises(OutputError, match=said), writer as video:
            for _ in range(frames):
                video.write(flat(64, 64, 0, 0, 0))
        assert list(folder.iterdir()) == []
