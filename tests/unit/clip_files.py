"""Small videos, made by ffmpeg."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.cli.pictures import ffmpeg

SIZE = (48, 32)
H264 = ("-c:v", "libx264", "-pix_fmt", "yuv420p", "-g", "8", "-bf", "2")
NTSC = "24000/1001"
STEADY = ("-sc_threshold", 10**9)
"""No key frames but where a group begins."""

PALETTE = ",split[a][b];[a]palettegen=stats_mode=single[p];[b][p]paletteuse=new=1"
"""Filters for GIF: its usual palette has 256 colours, none of them the wanted one."""


def make(path: Path, *options: str, rate: str = NTSC, frames: int = 30, **more: str) -> Path:
    width, height = SIZE
    sound = ("-f", "lavfi", "-i", "sine=d=1") if "audio" in more else ()
    picture = f"testsrc2=s={width}x{height}:r={rate}"
    coded = options or H264
    ffmpeg("-f", "lavfi", "-i", picture, *sound, "-frames:v", frames, *coded, path)
    return path


def shown(path: Path, pixels: str = "rgb24") -> np.ndarray:
    """What ffmpeg itself shows."""
    scale = "scale=in_color_matrix=smpte170m:flags=accurate_rnd+full_chroma_int"
    out = ("-fps_mode", "passthrough", "-f", "rawvideo", "-pix_fmt", pixels, "-")
    return np.frombuffer(ffmpeg("-i", path, "-vf", scale, *out), np.uint8)
