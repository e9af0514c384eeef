"""Small OpenEXR files for tests, written with the reference library."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

Planes = Mapping[str, np.ndarray]
ZIP = OpenEXR.ZIP_COMPRESSION


def box(x: int, y: int, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """A window as headers hold it."""
    return np.array([x, y], np.int32), np.array([x + width - 1, y + height - 1], np.int32)


def header(**more: Any) -> dict[str, Any]:
    return {"compression": ZIP, "type": OpenEXR.scanlineimage, **more}


def write_single(path: Path, planes: Planes, **attributes: Any) -> Path:
    OpenEXR.File(header(**attributes), dict(planes)).write(str(path))
    return path


def write_parts(path: Path, parts: Mapping[str, tuple[Planes, Mapping[str, Any]]]) -> Path:
    made = [
        OpenEXR.Part(header(**attributes), dict(planes), name)
        for name, (planes, attributes) in parts.items()
    ]
    OpenEXR.File(made).write(str(path))
    return path


def rgba(height: int, width: int, dtype: type = np.float16, seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {name: rng.random((height, width)).astype(dtype) for name in "RGBA"}


def any_bits(rng: np.random.Generator, kind: str, shape: tuple[int, int]) -> np.ndarray:
    """Any bits at all, smooth ones, or few values."""
    dtype = np.dtype(kind)
    found = rng.integers(0, 1 << 8 * dtype.itemsize, shape, f"u{dtype.itemsize}")
    look = rng.integers(3)
    if look == 1:
        found = np.full_like(found, 7) + np.arange(shape[1], dtype=found.dtype)
    elif look == 2:
        found = found % 3
    return found.view(dtype)


def plane(height: int, width: int, value: float, dtype: type = np.float32) -> np.ndarray:
    return np.full((height, width), value, dtype)


def write_tiled(path: Path, planes: Planes, levels: str = "ONE_LEVEL", tile: int = 16) -> Path:
    """Write tiles; `levels` may be MIPMAP_LEVELS or RIPMAP_LEVELS."""
    tiles = OpenEXR.TileDescription()
    tiles.xSize = tiles.ySize = tile
    tiles.mode = getattr(OpenEXR, levels)
    OpenEXR.File(
        header(type=OpenEXR.tiledimage, tiles=tiles),
        dict(planes),
    ).write(str(path))
    return path


def deep_part(height: int, width: int, name: str, **attributes: Any) -> OpenEXR.Part:
    """A part with two samples in every pixel, R G B A and Z."""
    samples = np.empty((height, width), dtype=object)
    for at in np.ndindex(height, width):
        samples[at] = np.array([0.5, 0.25], np.float32)
    kind = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}
    return OpenEXR.Part(kind | attributes, {c: samples.copy() for c in "RGBAZ"}, name)


def flat_part(planes: Planes, name: str, **attributes: Any) -> OpenEXR.Part:
    return OpenEXR.Part(header(**attributes), dict(planes), name)


LUMINANCE_CHROMA = (("BY", 2), ("RY", 2), ("Y", 1))


def write_subsampled(
    path: Path,
    channels: Sequence[tuple[str, int]] = LUMINANCE_CHROMA,
    width: int = 8,
    height: int = 6,
) -> Path:
    """Write channels with their steps, by hand and uncompressed; Y at full, RY and BY at half size.

    No binding writes luminance and chroma.
    """

    def attribute(name: str, kind: str, value: bytes) -> bytes:
        return b"%s\0%s\0%s" % (name.encode(), kind.encode(), struct.pack("<i", len(value))) + value

    listed = b"".join(
        n.encode() + b"\0" + struct.pack("<iB3xii", 1, 0, step, step) for n, step in channels
    )
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    head = struct.pack("<ii", 20000630, 2) + b"".join(
        (
            attribute("channels", "chlist", listed + b"\0"),
            attribute("compression", "compression", b"\0"),
            attribute("dataWindow", "box2i", window),
            attribute("displayWindow", "box2i", window),
            attribute("lineOrder", "lineOrder", b"\0"),
            attribute("pixelAspectRatio", "float", struct.pack("<f", 1)),
            attribute("screenWindowCenter", "v2f", struct.pack("<ff", 0, 0)),
            attribute("screenWindowWidth", "float", struct.pack("<f", 1)),
            b"\0",
        )
    )
    lines = []
    for y in range(height):
        size = sum(2 * width // step for _, step in channels if y % step == 0)
        lines.append(struct.pack("<ii", y, size) + bytes(size))
    starts = np.cumsum([len(head) + 8 * height, *map(len, lines[:-1])])
    path.write_bytes(head + starts.astype("<u8").tobytes() + b"".join(lines))
    return path
