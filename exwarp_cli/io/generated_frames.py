"""Generated frames: writing them, and telling intact ones from damaged, edited or foreign files.

A generated frame carries a checksum of its file and a fingerprint: a digest of all sources and
settings that it depends on. So damage shows without decoding, whatever the compression, and a run
knows whether a frame is the one that it would write.

A checksum that holds proves that a file is ExWarp's, byte for byte. Where it does not hold, the
pixels decide: a file that decodes was edited, a file that does not was damaged. Formats without
room for a checksum have the program's name at most, which edits in other programs replace.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import reduce
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, Image, Window, place_on_canvas
from exwarp_cli.errors import DamagedFileError, InputError, OutputError, UsageError
from exwarp_cli.io import files, stills
from exwarp_cli.io.exr import writer
from exwarp_cli.io.exr.header import MAGIC, replace_non_utf8, restore_non_utf8
from exwarp_cli.io.exr.reader import read_headers
from exwarp_cli.io.exr.writer import COMPRESSIONS, PREFIX, Buffer, OutputPart, Plane, PlaneKey
from exwarp_cli.io.frames import read_image
from exwarp_cli.io.sequences import EXR
from exwarp_cli.io.shot import require_sound

CHECKSUM = f"{PREFIX}{files.CHECKSUM_NAME}"
FINGERPRINT = f"{PREFIX}recipe"

# Attributes of generated frames: numbers and digests of the key frames on both sides; and the run's
# method, which a single frame's method may differ from.
KEY_FRAMES = "keyFrames"
REQUESTED_METHOD = "requestedMethod"
FACTS = ("kind", "method", REQUESTED_METHOD, KEY_FRAMES)

# Compressions that OpenEXR can make, too; see `io.exr.writer` for what that takes.
OPENEXR_COMPRESSIONS = {
    f"{name}:4": writer.OpenExrCompression(COMPRESSIONS[name]) for name in ("zips", "zip", "pxr24")
}

# What a generated frame takes over from its key frame's file.
FrameTemplate: TypeAlias = writer.Template | stills.StillTemplate

# The attribute's digits are the group. It is searched for in the whole file: a Cryptomatte's
# manifest, which comes before it, may be megabytes long.
_CHECKSUM_PATTERN = re.compile(
    re.escape(CHECKSUM.encode() + b"\0string\0" + files.CHECKSUM_DIGITS.to_bytes(4, "little"))
    + b"(.{%d})" % files.CHECKSUM_DIGITS,
    re.DOTALL,
)
_PROGRAM_NAME = re.compile(rb"ExWarp \d")
_NAME_RANGE = 4096  # bytes from both ends in which a format keeps the program's name


def parse_compression(name: str | None) -> Any:
    """Return OpenEXR's constant for a compression, maybe an `OpenExrCompression`; None for None.

    Raises UsageError when the name is not known.
    """
    if name is None:
        return None
    compressions = COMPRESSIONS | OPENEXR_COMPRESSIONS
    if name not in compressions:
        raise UsageError(f"--compression {name} is not one of {', '.join(compressions)}")
    return compressions[name]


def write_picture(
    path: Path,
    image: Image,
    template: FrameTemplate,
    attributes: Mapping[str, Any],
    extra_planes: Mapping[PlaneKey, Plane] | None = None,
) -> list[Buffer]:
    """Write a generated frame, whole or not at all; return its bytes, piece by piece.

    Each part of an EXR covers what its source's did; see `filled_window`. Raises OutputError when
    it cannot be written.

    Parameters
    ----------
    path
        Target; its folder exists, and its suffix names the format of the template.
    image
        Scene-linear colour [H, W, C] of the leading view, with C the number of the template's
        colour channels.
    template
        From the key frame's file.
    attributes
        Header attributes that replace or join the template's. Those with `PREFIX` stand in the
        first part; stills keep those alone.
    extra_planes
        Every other channel that the template has; None for stills.
    """
    own = {name: value for name, value in attributes.items() if name.startswith(PREFIX)}
    if isinstance(template, stills.StillTemplate):
        facts = {name.removeprefix(PREFIX): value for name, value in own.items()}
        return stills.write_still(path, image, template, facts)
    planes = dict(extra_planes or {})
    for i, plane in enumerate(template.colour):
        planes[plane.key] = Plane(image.pixels[..., i], image.data_window)
    shared = {name: value for name, value in attributes.items() if name not in own}
    parts: list[OutputPart] = []
    for part in template.parts:
        # Bring the channels of a part onto one window, in their types.
        members = {plane: planes[plane.key] for plane in part.planes}
        window = filled_window(members.values(), part.window)
        channels = {
            target.name: target.channel(place_on_canvas(plane.values, plane.window, window))
            for target, plane in members.items()
        }
        structure = writer.scanline_attributes(window, image.display_window)
        parts.append(({**part.header, **shared, **structure}, channels))
    return _write_exr(path, parts, own)


def write_mask(
    path: Path, mask: Bool, windows: tuple[Window, Window], attributes: Mapping[str, Any]
) -> list[Buffer]:
    """Write a hole mask as one half channel named ``holes``: 1 in holes, else 0.

    The windows are data and display. Its bytes are returned, piece by piece.
    """
    structure = writer.scanline_attributes(*windows)
    header = {"compression": COMPRESSIONS["zips"], **attributes, **structure}
    return _write_exr(path, [(header, {"holes": mask.astype(np.float16)})], {})


def _write_exr(path: Path, parts: list[OutputPart], own: Mapping[str, Any]) -> list[Buffer]:
    """Encode in memory, with `own` attributes in the first part, seal, and write."""
    header, channels = parts[0]
    parts[0] = {**header, **own, CHECKSUM: files.CHECKSUM_ZEROS}, channels
    utf8_parts = [
        ({k: replace_non_utf8(v) if isinstance(v, str) else v for k, v in header.items()}, channels)
        for header, channels in parts
    ]
    try:
        head, *pieces = writer.encode(utf8_parts)
    except (RuntimeError, ValueError, TypeError) as error:
        raise OutputError(f"cannot encode {path}: {error}; try another --compression") from error
    head = restore_non_utf8(memoryview(head), (header for header, _ in parts))
    sealed = seal(head, *pieces)
    files.atomic_write_bytes(path, *sealed)
    return sealed


def seal(head: Buffer, *rest: Buffer) -> list[Buffer]:
    """Put the checksum of an encoded file into its header; the file is in pieces.

    The header is in the first piece, which is changed in place if it can be.
    """
    match = _CHECKSUM_PATTERN.search(head)
    if match is None:
        raise ValueError("no place for the checksum")
    sealed = memoryview(head)
    if sealed.readonly:
        sealed = memoryview(bytearray(head))
    digits = sealed[match.start(1) : match.end(1)]
    digits[:] = files.CHECKSUM_ZEROS.encode()
    digits[:] = files.compute_checksum((sealed, *rest)).encode()
    return [sealed, *rest]


def is_intact(data: bytes) -> bool:
    """Return whether a file's bytes are those that :func:`seal` produced."""
    match = _CHECKSUM_PATTERN.search(data)
    if match is None:
        return False
    view = memoryview(data)
    pieces = (view[: match.start(1)], files.CHECKSUM_ZEROS.encode(), view[match.end(1) :])
    return files.compute_checksum(pieces).encode() == match[1]


def read_string_attribute(data: bytes, name: str) -> str | None:
    """Return a string attribute from the bytes of an EXR file; None without it."""
    mark = name.encode() + b"\0string\0"
    at = data.find(mark)
    if at < 0:
        return None
    begin = at + len(mark) + 4
    size = int.from_bytes(data[begin - 4 : begin], "little")
    return data[begin : begin + size].decode("utf-8", "replace")


def read_fingerprint(path: Path) -> str | None:
    """Return the fingerprint of an undamaged generated frame; None for anything else."""
    if path.suffix.lower() not in EXR:
        fingerprint = read_facts(path).get("recipe")
        return fingerprint if isinstance(fingerprint, str) else None
    try:
        data = path.read_bytes()
    except OSError:
        return None
    return read_string_attribute(data, FINGERPRINT) if is_intact(data) else None


def read_facts(path: Path) -> dict[str, Any]:
    """Return the ``exwarp:`` attributes of a frame, without the prefix; {} if it has none."""
    if path.suffix.lower() not in EXR:
        return stills.still_facts(path) or {}
    header = read_headers(path)[0]
    return {k[len(PREFIX) :]: v for k, v in header.items() if k.startswith(PREFIX)}


def filled_window(planes: Iterable[Plane], source: Window) -> Window:
    """Return the window of nonzero pixels, or the whole one if their source filled its own.

    A key frame that holds only an object's bounding box stays that small when it is moved. The
    planes are those of one part; `source` is that part's data window in the key frame.
    """
    planes = tuple(planes)
    window = reduce(Window.union, (plane.window for plane in planes))
    if source == window:
        return window
    filled = np.zeros(window.shape, np.bool_)
    for plane in planes:
        filled |= place_on_canvas(plane.values != 0, plane.window, window)
    rows, columns = np.flatnonzero(filled.any(axis=1)), np.flatnonzero(filled.any(axis=0))
    if rows.size == 0:
        return Window(window.x, window.y, 1, 1)
    left, right = int(columns[0]), int(columns[-1])
    top, bottom = int(rows[0]), int(rows[-1])
    return Window(window.x + left, window.y + top, right - left + 1, bottom - top + 1)


def read_picture(path: Path, view: str = "") -> Image:
    """Read the colour of one file; see `read_image` and `read_still`."""
    return read_image(path, view) if path.suffix.lower() in EXR else stills.read_still(path)[0]


def quantise_picture(pixels: Float32, template: FrameTemplate) -> Float32:
    """Round pixels to the precision of the file, so that scores hold for the written frame.

    Values beyond the range of an EXR channel's type become its largest, not infinity.
    """
    if isinstance(template, stills.StillTemplate):
        return stills.quantise_still(pixels, template)
    out = pixels.copy()
    for i, plane in enumerate(template.colour):
        if plane.dtype.kind == "f":
            channel = plane.channel(pixels[..., i])
            out[..., i] = channel.rounded() if isinstance(channel, writer.PendingHalf) else channel
    return out


class FileState(Enum):
    """What a file's bytes say of who wrote them."""

    # ExWarp wrote it, byte for byte; or so says its name in a format without checksums.
    INTACT = "intact"
    # ExWarp wrote it, and its pixels do not decode; or it is empty.
    DAMAGED = "damaged"
    # ExWarp wrote it, and another program changed it since.
    EDITED = "edited"
    # Nothing in it is ExWarp's.
    FOREIGN = "foreign"


@dataclass(frozen=True)
class Authorship:
    """Who wrote a file, with those of its `FACTS` that it has, without the prefix."""

    state: FileState
    facts: Mapping[str, Any] = field(default_factory=dict)


def find_authorship(path: Path) -> Authorship | None:
    """Find out who wrote a file; None if there is no file.

    Raises UnreadableError when the system does not let the file through.
    """
    try:
        data = files.with_retries(path, path.read_bytes)
    except OSError as error:
        # There is none, or the path is wrong, which is reported when it is written.
        is_folder = isinstance(error, IsADirectoryError)
        return Authorship(FileState.FOREIGN) if is_folder else None
    if not data.strip(b"\0"):
        # After a power cut files are empty, or have their length and no content.
        return Authorship(FileState.DAMAGED)
    suffix = path.suffix.lower()
    # Whether it is as ExWarp wrote it, and its facts; None if it is foreign.
    is_authentic, facts = True, None
    if suffix in stills.SEALED:
        is_authentic, facts = stills.parse_still_facts(data)
    elif suffix not in EXR:
        facts = {} if _PROGRAM_NAME.search(data[:_NAME_RANGE] + data[-_NAME_RANGE:]) else None
    elif data.startswith(MAGIC):
        texts = {name: read_string_attribute(data, f"{PREFIX}{name}") for name in FACTS}
        facts = {name: text for name, text in texts.items() if text is not None}
        is_authentic = is_intact(data)
        if not (is_authentic or facts or read_string_attribute(data, CHECKSUM) is not None):
            facts = None
    if facts is None:
        return Authorship(FileState.FOREIGN)
    if is_authentic:
        return Authorship(FileState.INTACT, facts)
    try:
        if suffix in EXR:
            require_sound((path,))
        else:
            stills.read_still(path)
    except DamagedFileError:
        return Authorship(FileState.DAMAGED, facts)
    except InputError:  # never ExWarp's: deep, subsampled, other channels, EXR under that name
        pass
    return Authorship(FileState.EDITED, facts)
