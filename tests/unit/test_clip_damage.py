"""Video that is damaged, or not what it seems."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.errors import DamagedFileError, InputError
from exwarp_cli.io.display_colour import to_display
from exwarp_cli.io.ffmpeg import FfmpegReader
from exwarp_cli.io.video_reader import ClipReader, is_clip, open_clip
from exwarp_cli.io.video_timing import (
    Pacing,
)
from tests.cli.pictures import ffmpeg
from tests.matrix import spread
from tests.unit.clip_files import H264, PALETTE, make


class TestDamage:
    """Some bytes in the middle of the file are wrong."""

    NOISY = ("-vf", "scale=160:96,noise=alls=20:allf=t")
    MPEG2 = ("-c:v", "mpeg2video", "-bf", "2", "-g", "10")
    AVC = (*H264[:4], "-g", "10", "-bf", "2")
    CASES = (
        ("a.ts", MPEG2, 200),
        ("a.mpg", MPEG2, 200),
        ("b.ts", AVC, 2000),
        ("a.avi", ("-c:v", "mpeg4", "-bf", "2", "-g", "10", "-q:v", "4"), 200),
        ("a.mkv", AVC, 3000),  # a damaged B-frame of H.264 alone may decode without an error
        ("a.mp4", AVC, 3000),
    )

    @pytest.fixture(params=CASES, ids=lambda case: case[0])
    def videos(self, request, tmp_path) -> tuple[Path, Path]:
        """A video of 60 frames, with groups of 10 to 12 pictures, and a damaged copy."""
        name, coded, size = request.param
        good = make(tmp_path / name, *self.NOISY, *coded, rate="25", frames=60)
        data = bytearray(good.read_bytes())
        noise = np.random.default_rng(1).integers(0, 256, size, np.uint8).tobytes()
        data[len(data) // 2 : len(data) // 2 + size] = noise
        bad = tmp_path / f"bad{good.suffix}"
        bad.write_bytes(data)
        return good, bad

    def test_loses_its_group_of_pictures_alone(self, videos, monkeypatch):
        good, bad = videos
        whole, clip, runs = list(open_clip(good).frames()), open_clip(bad), []
        lost = []

        class Counted(FfmpegReader):
            def __init__(self, options, frame_bytes) -> None:
                runs.append(options)
                super().__init__(options, frame_bytes=frame_bytes)

        monkeypatch.setattr("exwarp_cli.io.video_reader.FfmpegReader", Counted)
        assert clip.count == 60
        with closing(ClipReader(clip)) as reader:
            for index in range(clip.count):
                try:
                    assert np.array_equal(reader.read(index), whole[index]), index
                except DamagedFileError as error:
                    assert f"frame {index + 1} of 60 is damaged" in str(error)
                    assert "0x" not in str(error)
                    lost.append(index)
        assert 0 < len(lost) <= 14 and lost == list(range(lost[0], lost[-1] + 1))
        assert len(runs) == 1  # it goes on over the damage
        with closing(ClipReader(clip)) as reader:
            after = lost[-1] + 1
            assert np.array_equal(reader.read(after), whole[after])
            with pytest.raises(DamagedFileError, match=f"frame {lost[0] + 1} of 60"):
                reader.read(lost[0])
        for index in spread(lost, 3):  # read first, it is no less damaged
            with (
                closing(ClipReader(clip)) as reader,
                pytest.raises(DamagedFileError, match=f"frame {index + 1} of 60"),
            ):
                reader.read(index)


class TestBadFiles:
    def test_no_file(self, tmp_path):
        with pytest.raises(InputError, match="there is no video"):
            open_clip(tmp_path / "a.mp4")

    def test_no_video(self, tmp_path):
        path = tmp_path / "a.mp4"
        path.write_bytes(b"nothing of the kind" * 100)
        with pytest.raises(DamagedFileError, match=r"cannot read the video .*; export it again"):
            open_clip(path)

    def test_sound_alone(self, tmp_path):
        path = tmp_path / "a.m4v"
        ffmpeg("-f", "lavfi", "-i", "sine=d=0.1", "-f", "mp4", path)
        with pytest.raises(InputError, match="holds no picture, only sound; name a video"):
            open_clip(path)

    @pytest.mark.parametrize("suffix", ["gif", "apng", "y4m", "flv", "wmv", "m2ts"])
    def test_other_kinds_of_video_are_read(self, tmp_path, suffix):
        path = tmp_path / f"a.{suffix}"
        colour = "color=0x2060C0:s=48x32:r=25" + (PALETTE if suffix == "gif" else "")
        ffmpeg("-f", "lavfi", "-i", colour, "-frames:v", 5, path)
        clip = open_clip(path)
        assert is_clip(str(path)) and (clip.count, clip.rate) == (5, 25)
        for frame in clip.frames():
            away = to_display(frame).astype(int) - (0x20, 0x60, 0xC0)
            assert np.abs(away).max() <= 8  # a palette, or coarse 4:2:0

    def test_the_end_of_a_truncated_file_is_reported(self, tmp_path):
        path = make(tmp_path / "a.mp4", *H264, "-movflags", "+faststart")
        clip, data = open_clip(path), path.read_bytes()
        path.write_bytes(data[: len(data) * 2 // 3])
        with closing(ClipReader(clip)) as reader:
            reader.read(0)
            with pytest.raises(DamagedFileError, match=r"cannot read the video .*: frame 30 of 30"):
                reader.read(clip.count - 1)

    def test_a_file_with_fewer_frames_than_packets(self, tmp_path):
        clip = open_clip(make(tmp_path / "a.mp4", frames=5))
        longer = replace(clip, pacing=Pacing(clip.rate, tuple(range(8))))
        with closing(ClipReader(longer)) as reader:
            reader.read(4)
            with pytest.raises(DamagedFileError, match="frame 6 of 8 is damaged"):
                reader.read(5)

    def test_a_decoder_that_does_not_start(self, tmp_path, monkeypatch):
        clip = open_clip(make(tmp_path / "a.mp4", frames=5))
        with closing(ClipReader(clip)) as reader:
            monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(tmp_path / "none"))
            for _ in range(2):
                with pytest.raises(DamagedFileError, match="ffmpeg does not start"):
                    reader.read(0)

    @pytest.mark.parametrize(("transfer", "name"), [("smpte2084", "PQ"), ("arib-std-b67", "HLG")])
    def test_hdr(self, tmp_path, transfer, name):
        path = make(tmp_path / "a.mp4", "-vf", f"setparams=color_trc={transfer}", *H264, frames=1)
        with pytest.raises(InputError, match=rf"HDR \({name}\)"):
            open_clip(path)

    def test_fields(self, tmp_path):
        path = make(tmp_path / "a.mp4", "-vf", "interlace", *H264, "-flags", "+ildct", frames=4)
        wanted = r"is interlaced, .*--scan deinterlace, or --scan progressive"
        with pytest.raises(InputError, match=wanted):
            open_clip(path)
