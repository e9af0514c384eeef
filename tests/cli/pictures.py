"""Pictures without AOVs, as stills and as video: a texture that is panned, of known truth."""

from __future__ import annotations

import subprocess
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
import OpenImageIO as oiio
from scipy.ndimage import gaussian_filter

SIZE = (64, 48)
"""Width and height."""

PAN = 8
"""Pixels to the left from key frame to key frame."""

TEST_RATE = 24


def texture(seed: int = 0) -> np.ndarray:
    """uint8 [48, 256, 3], smooth; with any seed but 0 much finer, so that flow finds no way."""
    noise = np.random.default_rng(seed).random((SIZE[1], 256, 3))
    blur = 1 if seed else 4
    smooth = gaussian_filter(noise, (blur, blur, 0), mode="wrap")
    low, high = smooth.min(), smooth.max()
    return np.floor(40 + 180 * (smooth - low) / (high - low)).astype(np.uint8)


def frame(time: float, seed: int = 0) -> np.ndarray:
    """uint8 [48, 64, 3]: the texture at a time in key intervals, shifted by whole pixels."""
    left = round(PAN * time)
    return np.ascontiguousarray(texture(seed)[:, left : left + SIZE[0]])


def write_still(path: Path, codes: np.ndarray, **attributes: Any) -> Path:
    """Write code values with OpenImageIO itself."""
    path.parent.mkdir(parents=True, exist_ok=True)
    height, width, channels = codes.shape
    spec = oiio.ImageSpec(width, height, channels, codes.dtype.name)
    for name, value in attributes.items():
        spec.attribute(name, value)
    if channels == 4:
        spec.alpha_channel = 3
        spec.attribute("oiio:UnassociatedAlpha", 1)
    file = oiio.ImageOutput.create(path.suffix[1:])
    assert file.open(str(path), spec) and file.write_image(codes) and file.close()
    return path


def stills(
    folder: Path, frames: Iterable[np.ndarray], suffix: str = ".png", first: int = 1
) -> Path:
    """Write pan.####.png."""
    for number, codes in enumerate(frames, first):
        write_still(folder / f"pan.{number:04d}{suffix}", codes)
    return folder


def codes_of(path: Path) -> np.ndarray:
    """Code values as a file has them."""
    hint = oiio.ImageSpec()
    hint.attribute("oiio:UnassociatedAlpha", 1)
    file = oiio.ImageInput.open(str(path), hint)
    return np.asarray(file.read_image(0, 0, 0, file.spec().nchannels, file.spec().format))


def ffmpeg(*arguments: object, data: bytes = b"") -> bytes:
    program = imageio_ffmpeg.get_ffmpeg_exe()
    command = [program, "-v", "error", "-nostdin", "-y", *map(str, arguments)]
    if data:
        command.remove("-nostdin")
    return subprocess.run(command, input=data, capture_output=True, check=True).stdout


def clip(
    path: Path, frames: list[np.ndarray], rate: object = TEST_RATE, sound: bool = True
) -> Path:
    """Write a lossless video, with a tone as long as it if wanted."""
    width, height = SIZE
    tone = ("-f", "lavfi", "-i", f"sine=d={len(frames) / float(rate)}") if sound else ()
    raw = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", rate, "-i", "-")
    scale = "scale=out_color_matrix=bt709:out_range=tv:flags=accurate_rnd+full_chroma_int"
    scale += ",setparams=colorspace=bt709:color_primaries=bt709:color_trc=bt709:range=tv"
    coded = ("-c:v", "libx264", "-qp", "0", "-pix_fmt", "yuv444p", "-g", "4", "-vf", scale)
    data = b"".join(f.tobytes() for f in frames)
    ffmpeg(*raw, *tone, *coded, path, data=data)
    return path


def shown(path: Path) -> np.ndarray:
    """uint8 [N, 48, 64, 3]: what a player shows."""
    width, height = SIZE
    scale = "scale=in_color_matrix=bt709:in_range=tv:flags=accurate_rnd+full_chroma_int"
    out = ("-fps_mode", "passthrough", "-f", "rawvideo", "-pix_fmt", "rgb24", "-")
    return np.frombuffer(ffmpeg("-i", path, "-vf", scale, *out), np.uint8).reshape(
        -1, height, width, 3
    )


def psnr(reference: np.ndarray, test: np.ndarray, margin: int = PAN) -> float:
    """Decibels between codes, without the columns that come into view."""
    inside = (..., slice(margin, -margin), slice(0, 3))
    error = (reference[inside].astype(float) - test[inside]) / 255
    return float(-10 * np.log10(max(np.mean(error**2), 1e-10)))
