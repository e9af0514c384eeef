"""Writing generated frames, and telling a good one on disk from a damaged or foreign one.

A generated frame carries its own checksum: the SHA-256 of the file with the checksum's 64 digits
taken as zeros. So any damage shows without decoding, whatever the compression; and an attribute
that digests sources and settings shows whether the frame is the one that this run would write.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from exwarp_cli.domain.frame import Bool, Float32, Image, Window
from exwarp_cli.errors import OutputError, UsageError
from exwarp_cli.io.atomic import atomic_write_bytes
from exwarp_cli.io.channels import ChannelRef
from exwarp_cli.io.exr import ExrReader, damaged
from exwarp_cli.io.render_time import render_seconds

PREFIX = "exwarp:"
CHECKSUM = f"{PREFIX}sha256"
RECIPE = f"{PREFIX}recipe"
_ZEROS = "0" * 64

COMPRESSIONS: dict[str, Any] = {
    "none": OpenEXR.NO_COMPRESSION,
    "rle": OpenEXR.RLE_COMPRESSION,
    "zips": OpenEXR.ZIPS_COMPRESSION,
    "zip": OpenEXR.ZIP_COMPRESSION,
    "piz": OpenEXR.PIZ_COMPRESSION,
    "pxr24": OpenEXR.PXR24_COMPRESSION,
    "b44": OpenEXR.B44_COMPRESSION,
    "b44a": OpenEXR.B44A_COMPRESSION,
    "dwaa": OpenEXR.DWAA_COMPRESSION,
    "dwab": OpenEXR.DWAB_COMPRESSION,
}

HALF_MAX = 65504.0

# Structure, which the writer sets itself; and what belongs to the source frame's own pixels.
_NOT_CARRIED = frozenset(
    [
        "channels",
        "chunkCount",
        "dataWindow",
        "displayWindow",
        "lineOrder",
        "tiles",
        "type",
        "version",
        "compression",
        "view",
        "maxSamplesPerPixel",
        "dataHash",
        "preview",
        "idManifest",
        "timeCode",
        "keyCode",
        "framesPerSecond",
    ]
)


@dataclass(frozen=True)
class Template:
    """What a generated frame takes over from its key frame's file.

    Attributes
    ----------
    header
        Attributes to carry, with the part's name and compression.
    channels
        Names of R, G, B and, if there, A as in the source.
    dtypes
        Pixel type of each.
    render
        Seconds that the key frame took to render, and the attribute that tells; None where none
        does.
    """

    header: Mapping[str, Any]
    channels: tuple[str, ...]
    dtypes: tuple[np.dtype[Any], ...]
    render: tuple[float, str] | None = None


def read_template(path: Path, colour: tuple[ChannelRef, ...]) -> Template:
    """Read the header of a source frame's colour part.

    Raises
    ------
    DamagedFileError
        When the header cannot be read.
    """
    with ExrReader(path) as file:
        parts = file.parts
    names = [ref.name for ref in colour]
    headers = read_headers(path)
    for part, header in zip(parts, headers, strict=False):
        found = {channel.name: channel for channel in part.channels}
        if all(name in found for name in names):
            kept = {k: v for k, v in header.items() if k not in _NOT_CARRIED and _writable(k, v)}
            kept["compression"] = header["compression"]
            half = [found[name].pixel_type == "half" for name in names]
            dtypes = tuple(np.dtype(np.float16 if h else np.float32) for h in half)
            raw = tuple(found[name].raw_name for name in names)
            return Template(kept, raw, dtypes, render_seconds(headers))
    raise damaged(path, "its colour channels are gone")


def read_headers(path: Path) -> list[dict[str, Any]]:
    """Read the header of every part."""
    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            return [dict(part.header) for part in file.parts]
    except (RuntimeError, ValueError, OSError) as error:
        raise damaged(path, str(error)) from error


def frame_rate(header: Mapping[str, Any]) -> Fraction | None:
    """Return framesPerSecond from a header, None when absent or not positive."""
    value = header.get("framesPerSecond")
    if not isinstance(value, Fraction) or value <= 0:
        return None
    return value


def compression_of(name: str | None) -> Any:
    """Return OpenEXR's constant for a compression; None for None.

    Raises
    ------
    UsageError
        When the name is not known.
    """
    if name is None:
        return None
    if name not in COMPRESSIONS:
        raise UsageError(f"--compression {name} is not one of {', '.join(COMPRESSIONS)}")
    return COMPRESSIONS[name]


def quantise(pixels: Float32, template: Template) -> Float32:
    """Round pixels to the types that the file will have, so that what is scored is what is kept.

    Half values beyond its range become its largest, not infinity.
    """
    out = pixels.copy()
    for i, dtype in enumerate(template.dtypes):
        if dtype == np.float16:
            plane = np.clip(out[..., i], -HALF_MAX, HALF_MAX)
            out[..., i] = plane.astype(np.float16).astype(np.float32)
    return out


def write_frame(
    path: Path,
    image: Image,
    template: Template,
    attributes: Mapping[str, Any],
) -> None:
    """Write a generated frame, whole or not at all.

    Parameters
    ----------
    path
        Target; its folder exists.
    image
        Colour [H, W, C] with C the number of the template's channels.
    template
        From the key frame's file.
    attributes
        Header attributes that replace or join the template's.

    Raises
    ------
    OutputError
        When it cannot be written.
    """
    planes = {
        name: np.ascontiguousarray(np.clip(image.pixels[..., i], -HALF_MAX, HALF_MAX), dtype=dtype)
        if dtype == np.float16
        else np.ascontiguousarray(image.pixels[..., i], dtype=dtype)
        for i, (name, dtype) in enumerate(zip(template.channels, template.dtypes, strict=True))
    }
    header = {**template.header, **attributes}
    _write(path, header, planes, (image.data_window, image.display_window))


def write_mask(
    path: Path, mask: Bool, windows: tuple[Window, Window], attributes: Mapping[str, Any]
) -> None:
    """Write a hole mask as one half channel named ``holes``: 1 in holes, else 0."""
    header = {"compression": OpenEXR.ZIPS_COMPRESSION, **attributes}
    _write(path, header, {"holes": mask.astype(np.float16)}, windows)


def _write(
    path: Path,
    header: Mapping[str, Any],
    planes: Mapping[str, np.ndarray],
    windows: tuple[Window, Window],
) -> None:
    """Encode in memory, seal, and write; windows are data and display.

    One thread encodes: frames are written side by side, which shares the cores better.
    """
    full = {
        **header,
        "type": OpenEXR.scanlineimage,
        "dataWindow": _box(windows[0]),
        "displayWindow": _box(windows[1]),
        CHECKSUM: _ZEROS,
    }
    buffer = io.BytesIO()
    try:
        OpenEXR.File(full, dict(planes), num_threads=0).write(buffer)
    except (RuntimeError, ValueError, TypeError) as error:
        raise OutputError(f"cannot encode {path}: {error}; try another --compression") from error
    atomic_write_bytes(path, seal(buffer.getbuffer()))


def seal(data: memoryview | bytes) -> bytes:
    """Put the checksum of an encoded file into its header."""
    sealed = bytearray(data)
    start = _checksum_at(sealed)
    if start is None:
        raise ValueError("no place for the checksum")
    sealed[start : start + 64] = hashlib.sha256(sealed).hexdigest().encode()
    return bytes(sealed)


def is_intact(data: bytes) -> bool:
    """Whether a file's bytes are those that :func:`seal` produced."""
    start = _checksum_at(data)
    if start is None:
        return False
    plain = bytearray(data)
    written = bytes(plain[start : start + 64])
    plain[start : start + 64] = _ZEROS.encode()
    return hashlib.sha256(plain).hexdigest().encode() == written


def recipe_of(path: Path) -> str | None:
    """Return the recipe of an undamaged generated frame, None for anything else."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    return read_text(data, RECIPE) if is_intact(data) else None


def read_text(data: bytes, name: str) -> str | None:
    """Return a string attribute straight from a file's bytes."""
    mark = name.encode() + b"\0string\0"
    at = data.find(mark)
    if at < 0:
        return None
    begin = at + len(mark) + 4
    size = int.from_bytes(data[begin - 4 : begin], "little")
    return data[begin : begin + size].decode("utf-8", "replace")


def written_attributes(path: Path) -> dict[str, Any]:
    """Return the ``exwarp:`` attributes of a generated frame, without the prefix."""
    header = read_headers(path)[0]
    return {k[len(PREFIX) :]: v for k, v in header.items() if k.startswith(PREFIX)}


def file_digest(path: Path) -> str:
    """SHA-256 of a file's bytes, hexadecimal."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise damaged(path, str(error.strerror)) from error


def tight_window(image: Image, source: Window) -> Image:
    """Crop an image to what is not empty, unless its source filled the window.

    A key frame that holds only an object's bounding box stays that small when it is moved.
    """
    if source == image.data_window:
        return image
    rows = np.flatnonzero(image.pixels.any(axis=(1, 2)))
    columns = np.flatnonzero(image.pixels.any(axis=(0, 2)))
    window = image.data_window
    if rows.size == 0:
        return image.on(Window(window.x, window.y, 1, 1))
    crop = Window(
        window.x + int(columns[0]),
        window.y + int(rows[0]),
        int(columns[-1] - columns[0]) + 1,
        int(rows[-1] - rows[0]) + 1,
    )
    return image.on(crop)


def _checksum_at(data: bytes | bytearray) -> int | None:
    """Return where the checksum's digits begin."""
    mark = CHECKSUM.encode() + b"\0string\0" + (64).to_bytes(4, "little")
    at = data.find(mark, 0, 1 << 20)
    return None if at < 0 or at + len(mark) + 64 > len(data) else at + len(mark)


def _box(window: Window) -> tuple[np.ndarray, np.ndarray]:
    x0, y0, x1, y1 = window.corners
    return np.array([x0, y0], np.int32), np.array([x1, y1], np.int32)


def _writable(name: str, value: object) -> bool:
    """Whether OpenEXR's bindings can write back what they read."""
    if name == "name" and not value:
        return False
    return not isinstance(value, OpenEXR.OpaqueAttribute)
