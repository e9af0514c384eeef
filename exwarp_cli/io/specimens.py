"""Small files that are written and read back, to see whether the codecs work."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from exwarp_cli.domain.curves import LINEAR, SRGB
from exwarp_cli.domain.frame import Float32, Image, UInt8, Window
from exwarp_cli.errors import ExwarpError
from exwarp_cli.io.clip import open_clip
from exwarp_cli.io.exr.reader import ExrFile
from exwarp_cli.io.exr.writer import COMPRESSIONS, encode_by_openexr, scanline_structure
from exwarp_cli.io.ffmpeg import told
from exwarp_cli.io.stills import StillTemplate, read_still, require_writer, write_still
from exwarp_cli.io.video import VideoLook, VideoWriter, from_display, to_display
from exwarp_cli.io.vmaf import vmaf

LOSSLESS = frozenset({"none", "rle", "zips", "zip", "piz"})
"""Compressions of OpenEXR that keep every bit."""

LOSSLESS_HALF = LOSSLESS | {"pxr24"}
"""Those that keep every bit of half floats."""

EXR_ERROR = 0.05
"""Most that a lossy compression may be off by on `pattern`, whose values go up to 1."""

STILL_ERROR = {".jpg": 0.02, ".jpeg": 0.02, ".hdr": 0.01}
"""The same for stills, on average; of other formats the codes come back as they were."""

VIDEO_ERROR = 0.04
"""The same for a video, on average: its colour has half the resolution."""

_SIZE = (48, 64)


def pattern(height: int, width: int, phase: float = 0.0) -> Float32:
    """Return smooth scene-linear colour, float32 [H, W, 3], 0.1 to 1."""
    y, x = np.mgrid[:height, :width].astype(np.float64)
    waves = [np.sin(0.21 * x + 0.13 * y + k + phase) for k in range(3)]
    return np.asarray(0.55 + 0.45 * np.stack(waves, axis=-1), np.float32)


def write_exr(
    path: Path, channels: Mapping[str, np.ndarray], compression: str, fps: int = 24
) -> None:
    """Write channels [H, W], each in its own type, to a plain EXR."""
    planes = {name: np.ascontiguousarray(plane) for name, plane in channels.items()}
    height, width = next(iter(planes.values())).shape
    window = Window(0, 0, width, height)
    header: dict[str, Any] = {
        **scanline_structure(window, window),
        "compression": COMPRESSIONS[compression],
        "framesPerSecond": Fraction(fps),
    }
    path.write_bytes(encode_by_openexr([(header, planes)]))


def read_exr(path: Path) -> dict[str, np.ndarray]:
    """Read all channels of an EXR's first part, [H, W], as frames are read."""
    with ExrFile(path) as file:
        part = file.parts[0]
        return {channel.raw_name: plane for channel, plane in file.read(part.channels).items()}


def exr_problem(folder: Path, compression: str) -> str | None:
    """Write and read half and single floats; return what is wrong with what comes back."""
    colour = pattern(*_SIZE)
    written: dict[str, np.ndarray] = {"R": colour[..., 0].astype(np.float16), "Z": colour[..., 1]}
    path = folder / f"{compression}.exr"
    try:
        write_exr(path, written, compression)
        found = read_exr(path)
    except (ExwarpError, RuntimeError, ValueError, TypeError, OSError) as error:
        return str(error)
    for name, kept in (("R", LOSSLESS_HALF), ("Z", LOSSLESS)):
        expected = written[name].astype(np.float32)
        if compression in kept and not np.array_equal(found[name], expected):
            return f"its {written[name].dtype} values do not come back bit for bit"
        if not np.abs(found[name] - expected).max() <= EXR_ERROR:
            return f"its {written[name].dtype} values come back changed"
    return None


def still_problem(folder: Path, suffix: str) -> str | None:
    """Write and read an image; return what is wrong with what comes back.

    Raises
    ------
    UsageError
        When there is no writer of this format.
    """
    path = folder / f"still{suffix}"
    require_writer(path)
    whole = suffix == ".hdr"
    dtype, curve = (np.float32, LINEAR) if whole else (np.uint8, SRGB)
    template = StillTemplate((), np.dtype(dtype), 32 if whole else 8, 3, curve, False)
    shown = from_display(to_display(pattern(*_SIZE)))
    window = Window(0, 0, _SIZE[1], _SIZE[0])
    try:
        write_still(path, Image(shown, window, window), template, {})
        found, _ = read_still(path)
    except (ExwarpError, RuntimeError, ValueError, TypeError, OSError) as error:
        return str(error)
    off = np.abs(found.pixels - shown).mean()
    return None if off <= STILL_ERROR.get(suffix, 0.0) else "its pixels come back changed"


def video_problem(folder: Path) -> str | None:
    """Write and read a video of two frames; return what is wrong with what comes back."""
    path = folder / "video.mp4"
    frames = [to_display(pattern(*_SIZE, phase)) for phase in (0.0, 0.5)]
    try:
        with VideoWriter(path, _SIZE[1], _SIZE[0], Fraction(24), VideoLook()) as video:
            for frame in frames:
                video.write(frame)
        found = list(open_clip(path).frames())
    except ExwarpError as error:
        return str(error)
    if len(found) != len(frames):
        return f"of {len(frames)} frames {len(found)} come back"
    far = max(np.abs(a - from_display(b)).mean() for a, b in zip(found, frames, strict=True))
    return None if far <= VIDEO_ERROR else "its pixels come back changed"


def vmaf_problem() -> str | None:
    """Take VMAF of a frame against itself; return what is wrong with it."""
    frame: UInt8 = to_display(pattern(*_SIZE))
    try:
        (score,) = vmaf([frame], [frame])
    except ExwarpError as error:
        return str(error)
    return None if score > 90 else f"a frame scores {score:.1f} against itself"


def ffmpeg_version() -> str:
    """Return the version of ffmpeg; raises FfmpegError when it does not start."""
    listed, _ = told(["-version"])
    words = listed.decode("utf-8", "replace").split()
    return words[2] if len(words) > 2 else "of unknown version"


def ffmpeg_has(kind: str) -> frozenset[str]:
    """Return the names of its "encoders" or "filters"; raises FfmpegError."""
    listed, _ = told(["-hide_banner", f"-{kind}"])
    rows = (line.split() for line in listed.decode("utf-8", "replace").splitlines())
    return frozenset(row[1] for row in rows if len(row) > 1)


def differing(whole: Path, pieces: Sequence[Path]) -> list[str]:
    """Return the names of the files that folders together hold otherwise than one does."""
    found = {path.name: path.read_bytes() for folder in pieces for path in folder.iterdir()}
    expected = {path.name: path.read_bytes() for path in whole.iterdir()}
    names = sorted(found.keys() | expected.keys())
    return [name for name in names if found.get(name) != expected.get(name)]
