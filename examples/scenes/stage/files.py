"""Rendered files: whether one is whole, the mean of several, a key frame's file made of two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stage.blender import OpenEXR

VECTOR = ".Vector"

SKY_DEPTH = 1e10
"""As Cycles writes it; EEVEE writes the far end of what the camera sees."""

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


def read_colour(path: Path) -> np.ndarray:
    """Return a frame's colour, finite float32 [H, W, 3], scene-linear."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = {
            name.rsplit(".", 1)[-1]: channel.pixels.astype(np.float32)
            for part in file.parts
            for name, channel in part.channels.items()
            if "Combined." in name
        }
    return np.nan_to_num(np.stack([channels[key] for key in "RGB"], axis=-1))


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


@dataclass(frozen=True)
class View:
    """A camera, for positions from depths.

    Attributes
    ----------
    placed : numpy.ndarray
        Float64 [4, 4], from camera space (looking along -z) to the world.
    wide : float
        Tangent of half the horizontal field of view.
    size : tuple of int
        Width and height of the frame, pixels.
    """

    placed: np.ndarray
    wide: float
    size: tuple[int, int]

    def positions(self, depth: np.ndarray) -> np.ndarray:
        """Return world positions [H, W, 3] of pixel centres at planar depths [H, W]."""
        height, width = depth.shape
        x = (np.arange(width) + 0.5) * 2 / width - 1
        y = (height - 2 * (np.arange(height) + 0.5)) / width
        rays = np.stack(np.broadcast_arrays(x, y[:, None], -1.0), axis=-1)
        rays *= (self.wide, self.wide, 1.0)
        return (rays * depth[..., None]) @ self.placed[:3, :3].T + self.placed[:3, 3]


def reduce_grid(colour: Path, data: Path, target: Path, view: View, exposure: float) -> None:
    """Write a raster frame from a render several times as wide and high.

    Parameters
    ----------
    colour : Path
        Its samples' mean, times `exposure`, is the frame's colour.
    data : Path
        Its samples at the pixels' centres are the data passes; the same file, or one of any odd
        multiple of the frame's size. Object Index is raised by 1, so that the sky is 0.
    target : Path
        The file to write. Vectors are in its pixels, Depth is `SKY_DEPTH` in the sky, and Position
        comes from Depth, as EEVEE's own is a half float.
    view : View
        The camera.
    exposure : float
        Factor on colour.
    """
    with (
        OpenEXR.File(str(colour), separate_channels=True) as fine,
        OpenEXR.File(str(data), separate_channels=True) as centred,
    ):
        planes = _centres(centred, view)
        for part in fine.parts:
            for name, channel in part.channels.items():
                if ".Combined." in name:
                    shade = _mean(channel.pixels, view.size)
                    planes[name] = shade if name.endswith(".A") else shade * exposure
        times = [fine] if colour == data else [fine, centred]
        seconds = sum(read_seconds(str(file.parts[0].header["RenderTime"])) for file in times)
        _write_parts(centred, planes, write_seconds(seconds), target)


def _centres(file: OpenEXR.File, view: View) -> dict[str, np.ndarray]:
    """Return every channel [H, W] at the pixels' centres, as it is written."""
    grid = next(iter(file.parts[0].channels.values())).pixels.shape[1] // view.size[0]
    first, planes = grid // 2, {}
    for part in file.parts:
        for name, channel in part.channels.items():
            planes[name] = channel.pixels[first::grid, first::grid]
            if VECTOR in name:
                planes[name] = planes[name] / grid
    index, depth = (
        next(name for name in planes if name.endswith(end))
        for end in (".Object Index.X", ".Depth.Z")
    )
    sky = planes[index] < 0.5
    planes[index] = np.where(sky, 0, np.rint(planes[index]) - 1)
    positions = view.positions(planes[depth].astype(np.float64))
    positions[sky] = 0
    planes[depth] = np.where(sky, SKY_DEPTH, planes[depth])
    for name in planes:
        if ".Position." in name:
            planes[name] = positions[..., "XYZ".index(name[-1])]
    return planes


def _mean(pixels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Average the samples of every pixel; `size` is (width, height) of the result."""
    height, width = pixels.shape
    blocks = pixels.reshape(size[1], height // size[1], size[0], width // size[0])
    return np.asarray(blocks.astype(np.float64).mean(axis=(1, 3)))


def _write_parts(
    like: OpenEXR.File, planes: dict[str, np.ndarray], seconds: str, target: Path
) -> None:
    """Write channels [H, W] in the parts and types of another file, and the render time."""
    parts = []
    for part in like.parts:
        for name, channel in part.channels.items():
            channel.pixels = np.ascontiguousarray(planes[name], channel.pixels.dtype)
            height, width = planes[name].shape
        window = (np.zeros(2, np.int32), np.array([width - 1, height - 1], np.int32))
        header = part.header | {"dataWindow": window, "displayWindow": window}
        if "RenderTime" in header:
            header["RenderTime"] = seconds
        parts.append(OpenEXR.Part(header, part.channels, part.name()))
    OpenEXR.File(parts).write(str(target))


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
