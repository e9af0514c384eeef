"""Rendered files: whether one is whole, and a key frame's file made of two."""

from __future__ import annotations

from pathlib import Path

from stage.blender import OpenEXR

VECTOR = ".Vector"


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
