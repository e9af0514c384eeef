"""The sound of plain video, and when it begins."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.io.display_colour import to_display
from exwarp_cli.io.video_reader import open_clip
from exwarp_cli.io.video_writer import VideoWriter
from tests.cli.pictures import ffmpeg
from tests.matrix import combinations
from tests.unit.clip_files import SIZE


def onset(path: Path) -> float:
    """Seconds from the first picture to the first loud sample, as players show it."""
    silence = ("-af", "aresample=async=1:first_pts=0", "-ar", "48000", "-ac", "1", "-f", "f32le")
    samples = np.frombuffer(ffmpeg("-i", path, "-map", "0:a", *silence, "-"), "<f4")
    return float(np.argmax(np.abs(samples) > 0.02)) / 48000


class TestSound:
    """A tone begins 0.5 s after the beginning of the sound track."""

    BEEP = "sine=f=440:r=48000:d=1.5,adelay=500"

    def source(self, path: Path, picture_late: str = "0", sound_late: str = "0") -> Path:
        """2 s with the streams offset against each other."""
        picture = f"testsrc2=s={SIZE[0]}x{SIZE[1]}:r=25:d=2"
        coded = (
            "-c:v",
            "mpeg2video",
            "-q:v",
            "2",
            "-g",
            "8",
            "-fps_mode",
            "passthrough",
            "-c:a",
            "mp2",
        )
        ffmpeg("-itsoffset", picture_late, "-f", "lavfi", "-i", picture,
               "-itsoffset", sound_late, "-f", "lavfi", "-i", self.BEEP, *coded, path)  # fmt: skip
        return path

    @staticmethod
    def copied(path: Path, start: int = 0) -> Path:
        """The clip from a frame on, written as a video."""
        clip, copy = open_clip(path), path.with_name("copy.mp4")
        look = replace(clip.look, sound=clip.sound(start, clip.count))
        with VideoWriter(copy, clip.width, clip.height, clip.rate, look) as video:
            for frame in clip.frames(start):
                video.write(to_display(frame))
        return copy

    OFFSETS = (
        ({}, 0, 0.5),
        ({"sound_late": "0.3"}, 0, 0.8),
        ({"picture_late": "0.3"}, 0, 0.2),
        ({"sound_late": "0.3"}, 5, 0.6),
        ({"picture_late": "0.13"}, 5, 0.17),
    )

    @pytest.mark.parametrize(
        ("suffix", "offset"), combinations([".ts", ".mts", ".mpg", ".mp4", ".mkv"], OFFSETS)
    )
    def test_it_keeps_its_offset_to_the_picture(self, tmp_path, suffix, offset):
        late, start, expected = offset
        path = self.source(tmp_path / f"a{suffix}", **late)
        assert abs(onset(self.copied(path, start)) - expected) < 0.03
