"""Rendered files: whether one is whole, the mean of several, a key frame's file made of two."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from stage.blender import OpenEXR

VECTOR = ".Vector"

UNFILTERED = (".Depth", ".Position", ".Object Index")
"""Passes that hold one value of the pixel's centre, whatever the noise is."""


def is_whole(path: Path, size: tuple[int, int]) -> bool:
    """Say whether a file exists, decodes in all its parts and has the size (width, height)."""
    if not path.is_file():
        return False
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            shapes = {
                channel.pixels.shape for part in file.parts for channel in part.channels.values()
            }
    except (RuntimeError, ValueError, OSError, MemoryError):
        return False
    return shapes == {(size[1], size[0])}


def join_key(instant: Path, vectors: Path, target: Path) -> None:
    """Write a key frame: everything of an instant but its vectors, which come from another file.

    Parameters
    ----------
    instant : Path
        Rendered at the rate of the instants, with all passes.
    vectors : Path
        The same instant rendered at the rate of the key frames, with the pass Vector.
    target : Path
        Written under another name first, so that it appears only once it is whole.
    """
    with (
        OpenEXR.File(str(instant), separate_channels=True) as image,
        OpenEXR.File(str(vectors), separate_channels=True) as motion,
    ):
        found = [part for part in motion.parts if part.name().endswith(VECTOR)]
        (source,) = found
        parts = []
        for part in image.parts:
            channels = source.channels if part.name().endswith(VECTOR) else part.channels
            parts.append(OpenEXR.Part(part.header, channels, part.name()))
        part_file = target.with_name(f".part-{target.name}")
        OpenEXR.File(parts).write(str(part_file))
    part_file.replace(target)


def join_mean(sources: Sequence[Path], target: Path) -> None:
    """Write the mean of several renders of one frame; `UNFILTERED` passes are those of the first.

    The header gets the sum of the render times.

    Parameters
    ----------
    sources : sequence of Path
        Rendered with other noise each, with equal passes.
    target : Path
        Written under another name first, so that it appears only once it is whole.
    """
    sums: dict[str, np.ndarray] = {}
    seconds = 0.0
    for path in sources:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            seconds += read_seconds(str(file.parts[0].header["RenderTime"]))
            for part in file.parts:
                for name, channel in part.channels.items():
                    pixels = channel.pixels.astype(np.float64)
                    sums[name] = sums[name] + pixels if name in sums else pixels
    with OpenEXR.File(str(sources[0]), separate_channels=True) as first:
        for part in first.parts:
            if "RenderTime" in part.header:
                part.header["RenderTime"] = write_seconds(seconds)
            if part.name().endswith(UNFILTERED):
                continue
            for name, channel in part.channels.items():
                mean = sums[name] / len(sources)
                channel.pixels = mean.astype(channel.pixels.dtype)
        parts = [OpenEXR.Part(part.header, part.channels, part.name()) for part in first.parts]
        part_file = target.with_name(f".part-{target.name}")
        OpenEXR.File(parts).write(str(part_file))
    part_file.replace(target)


def read_seconds(text: str) -> float:
    """Read a time as Blender writes it into a header: MM:SS.ss or HH:MM:SS.ss."""
    seconds = 0.0
    for part in text.split(":"):
        seconds = 60 * seconds + float(part)
    return seconds


def write_seconds(seconds: float) -> str:
    """Write a time as Blender does; see `read_seconds`."""
    minutes, rest = divmod(round(100 * seconds), 6000)
    hours, minutes = divmod(minutes, 60)
    text = f"{minutes:02d}:{rest / 100:05.2f}"
    return f"{hours:02d}:{text}" if hours else text
