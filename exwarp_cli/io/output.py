"""Writing generated frames, and telling a good one on disk from a damaged or foreign one.

A generated frame carries its own checksum, see `io.checksum`. So any damage shows without decoding,
whatever the compression; and an attribute that digests sources and settings shows whether the frame
is the one that this run would write.

A checksum that holds proves that a file is ExWarp's, byte for byte. Where it does not hold, the
pixels decide: a file that decodes was edited, a file that does not was damaged. Formats without
room for a checksum have the program's name at most, which edits in other programs replace.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from fractions import Fraction
from functools import reduce
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, Image, Window, place_on_canvas
from exwarp_cli.domain.timeline import parse_rate
from exwarp_cli.errors import DamagedFileError, InputError, OutputError, UsageError
from exwarp_cli.io import checksum
from exwarp_cli.io.atomic import atomic_write_bytes
from exwarp_cli.io.exr.header import MAGIC, replace_non_utf8, restore_non_utf8
from exwarp_cli.io.exr.reader import damaged, read_headers
from exwarp_cli.io.exr.template import PREFIX as PREFIX
from exwarp_cli.io.exr.template import PartTemplate, Plane, PlaneKey, Template
from exwarp_cli.io.exr.template import ViewLayers as ViewLayers
from exwarp_cli.io.exr.template import quantise as quantise
from exwarp_cli.io.exr.template import read_template as read_template
from exwarp_cli.io.exr.writer import COMPRESSIONS as COMPRESSIONS
from exwarp_cli.io.exr.writer import (
    Buffer,
    OpenExrCompression,
    OutputChannel,
    encode,
    scanline_structure,
)
from exwarp_cli.io.frames import read_image
from exwarp_cli.io.reading_retry import with_retries
from exwarp_cli.io.sequence import EXR
from exwarp_cli.io.soundness import require_sound
from exwarp_cli.io.stills import (
    SEALED,
    StillTemplate,
    facts_in_bytes,
    has_seal,
    quantise_still,
    read_still,
    still_facts,
    write_still,
)

CHECKSUM = f"{PREFIX}{checksum.NAME}"
RECIPE = f"{PREFIX}recipe"

SMALLER = {f"{name}:4": OpenExrCompression(COMPRESSIONS[name]) for name in ("zips", "zip", "pxr24")}
"""Those that can also be had as OpenEXR makes them; see `io.exr.writer` for what that takes."""


def frame_rate(header: Mapping[str, Any]) -> Fraction | None:
    """Return framesPerSecond from a header, of any type; None when absent or not positive."""
    return parse_rate(header.get("framesPerSecond"))


def compression_of(name: str | None) -> Any:
    """Return OpenEXR's constant for a compression, maybe an `OpenExrCompression`; None for None.

    Raises
    ------
    UsageError
        When the name is not known.
    """
    if name is None:
        return None
    known = COMPRESSIONS | SMALLER
    if name not in known:
        raise UsageError(f"--compression {name} is not one of {', '.join(known)}")
    return known[name]


def write_frame(
    path: Path,
    image: Image,
    template: Template,
    attributes: Mapping[str, Any],
    beside: Mapping[PlaneKey, Plane] | None = None,
) -> list[Buffer]:
    """Write a generated frame, whole or not at all; return its bytes, piece by piece.

    Parameters
    ----------
    path
        Target; its folder exists.
    image
        Colour [H, W, C] of the view that leads, with C the number of the template's colour
        channels.
    template
        From the key frame's file.
    attributes
        Header attributes that replace or join the template's. Those of ExWarp's own stand in the
        first part.
    beside
        Every other channel that the template has.

    Raises
    ------
    OutputError
        When it cannot be written.

    Notes
    -----
    Each part covers what its source's did; see `filled_window`.
    """
    planes = dict(beside or {})
    for i, plane in enumerate(template.colour):
        planes[plane.key] = Plane(image.pixels[..., i], image.data_window)
    own = {name: value for name, value in attributes.items() if name.startswith(PREFIX)}
    others = {name: value for name, value in attributes.items() if name not in own}
    parts = [_encoded(part, planes, image.display_window, others) for part in template.parts]
    parts[0][0].update(own)
    return _write(path, parts)


def write_mask(
    path: Path, mask: Bool, windows: tuple[Window, Window], attributes: Mapping[str, Any]
) -> list[Buffer]:
    """Write a hole mask as one half channel named ``holes``: 1 in holes, else 0.

    The windows are data and display. Its bytes are returned, piece by piece.
    """
    header = {"compression": COMPRESSIONS["zips"], **attributes, **scanline_structure(*windows)}
    return _write(path, [(header, {"holes": mask.astype(np.float16)})])


Encoded = tuple[dict[str, Any], dict[str, OutputChannel]]
"""Header and channels of one part."""


def _encoded(
    part: PartTemplate,
    planes: Mapping[PlaneKey, Plane],
    display: Window,
    attributes: Mapping[str, Any],
) -> Encoded:
    """Bring the channels of a part onto one window, in their types."""
    members = {plane: planes[plane.key] for plane in part.planes}
    window = filled_window(members.values(), part.window)
    channels = {
        template.name: template.channel(place_on_canvas(plane.values, plane.window, window))
        for template, plane in members.items()
    }
    return {**part.header, **attributes, **scanline_structure(window, display)}, channels


def _write(path: Path, parts: list[Encoded]) -> list[Buffer]:
    """Encode in memory, seal, and write; return what was written."""
    parts[0][0][CHECKSUM] = checksum.ZEROS
    try:
        head, *pieces = encode([(_in_utf8(header), planes) for header, planes in parts])
    except (RuntimeError, ValueError, TypeError) as error:
        raise OutputError(f"cannot encode {path}: {error}; try another --compression") from error
    head = restore_non_utf8(memoryview(head), (header for header, _ in parts))
    sealed = seal(head, *pieces)
    atomic_write_bytes(path, *sealed)
    return sealed


def _in_utf8(header: dict[str, Any]) -> dict[str, Any]:
    return {name: replace_non_utf8(v) if isinstance(v, str) else v for name, v in header.items()}


def seal(head: Buffer, *rest: Buffer) -> list[Buffer]:
    """Put the checksum of an encoded file into its header.

    Parameters
    ----------
    head, rest
        What the file has one after the other; the header is in the first, which is changed where it
        can be.
    """
    start = _checksum_at(head)
    if start is None:
        raise ValueError("no place for the checksum")
    sealed = memoryview(head)
    if sealed.readonly:
        sealed = memoryview(bytearray(head))
    digits = checksum.digits_of((sealed, *rest)).encode()
    sealed[start : start + checksum.DIGITS] = digits
    return [sealed, *rest]


def is_intact(data: bytes) -> bool:
    """Whether a file's bytes are those that :func:`seal` produced."""
    start = _checksum_at(data)
    if start is None:
        return False
    whole, end = memoryview(data), start + checksum.DIGITS
    pieces = (whole[:start], checksum.ZEROS.encode(), whole[end:])
    return checksum.digits_of(pieces).encode() == whole[start:end]


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
    """Digest a file's bytes, hexadecimal, as generated files' checksums do.

    Raises
    ------
    DamagedFileError
        When there is no such file.
    UnreadableError
        When the system does not let it through.
    """

    def digest() -> str:
        with path.open("rb") as file:
            return hashlib.file_digest(file, checksum.new).hexdigest()

    try:
        return with_retries(path, digest)
    except OSError as error:
        raise damaged(path, str(error.strerror)) from error


def filled_window(planes: Iterable[Plane], source: Window) -> Window:
    """Return the window that holds what is not empty, unless their source filled theirs.

    A key frame that holds only an object's bounding box stays that small when it is moved.

    Parameters
    ----------
    planes
        Of one part, on the windows that they were made on.
    source
        The data window of that part in the key frame.
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
    return Window(
        window.x + int(columns[0]),
        window.y + int(rows[0]),
        int(columns[-1] - columns[0]) + 1,
        int(rows[-1] - rows[0]) + 1,
    )


_SIZE = checksum.DIGITS.to_bytes(4, "little")
_CHECKSUM = re.compile(re.escape(CHECKSUM.encode() + b"\0string\0" + _SIZE))


def _checksum_at(data: Buffer) -> int | None:
    """Return where the checksum's digits begin."""
    # Anywhere: a Cryptomatte's manifest, which comes before it, may be megabytes long.
    found = _CHECKSUM.search(data)
    if found is None or found.end() + checksum.DIGITS > len(data):
        return None
    return found.end()


FrameTemplate: TypeAlias = Template | StillTemplate
"""What a generated frame takes over from its key frame's file."""


def write_picture(
    path: Path,
    image: Image,
    template: FrameTemplate,
    attributes: Mapping[str, Any],
    beside: Mapping[PlaneKey, Plane] | None = None,
) -> list[Buffer]:
    """Write a generated frame, whole or not at all; return its bytes, piece by piece.

    Parameters
    ----------
    path
        Target; its folder exists.
    image
        Scene-linear colour.
    template
        Of the format that the suffix tells.
    attributes
        As for :func:`exwarp_cli.io.output.write_frame`; stills keep those of ExWarp's own.
    beside
        Further channels; only for EXR.

    Raises
    ------
    OutputError
        When it cannot be written.
    """
    if isinstance(template, StillTemplate):
        own = {k[len(PREFIX) :]: v for k, v in attributes.items() if k.startswith(PREFIX)}
        return write_still(path, image, template, own)
    return write_frame(path, image, template, attributes, beside)


def read_picture(path: Path, view: str = "") -> Image:
    """Read the colour of one file; see `read_image` and `read_still`."""
    return read_image(path, view) if _is_exr(path) else read_still(path)[0]


def recipe_in(path: Path) -> str | None:
    """Return the recipe of an undamaged generated frame; None for anything else."""
    if _is_exr(path):
        return recipe_of(path)
    recipe = facts_in(path).get("recipe")
    return recipe if isinstance(recipe, str) else None


def facts_in(path: Path) -> dict[str, Any]:
    """Return what a generated frame says of itself; nothing for what says nothing."""
    return written_attributes(path) if _is_exr(path) else still_facts(path) or {}


def quantised(pixels: Float32, template: FrameTemplate) -> Float32:
    """Round pixels to what the file will have, so that what is scored is what is kept."""
    if isinstance(template, StillTemplate):
        return quantise_still(pixels, template)
    return quantise(pixels, template)


def _is_exr(path: Path) -> bool:
    return path.suffix.lower() in EXR


KEY_FRAMES = "keyFrames"
"""Attribute of generated frames: number and digest of the key frames on both sides."""

REQUESTED_METHOD = "requestedMethod"
"""Attribute of generated frames: the run's method, which a single frame's may differ from."""

FACTS = ("kind", "method", REQUESTED_METHOD, KEY_FRAMES)

_NAME = re.compile(rb"ExWarp \d")
_NAMED_WITHIN = 4096
"""Bytes from both ends in which a format keeps the program's name."""


class State(Enum):
    """What a file's bytes say of who wrote them."""

    INTACT = "intact"
    """ExWarp wrote it, byte for byte; or so says its name in a format without checksums."""

    DAMAGED = "damaged"
    """ExWarp wrote it, and its pixels do not decode; or it is empty."""

    EDITED = "edited"
    """ExWarp wrote it, and another program changed it since."""

    FOREIGN = "foreign"
    """Nothing in it is ExWarp's."""


@dataclass(frozen=True)
class Authorship:
    """Whose work a file is.

    Attributes
    ----------
    state
        What its bytes say.
    facts
        Those of `FACTS` that it says of itself, without the prefix.
    """

    state: State
    facts: Mapping[str, Any] = field(default_factory=dict)


def authorship_of(path: Path) -> Authorship | None:
    """Return whose work a file is; None if there is no file.

    Raises
    ------
    UnreadableError
        When the system does not let the file through.
    """
    try:
        data = with_retries(path, path.read_bytes)
    except IsADirectoryError:
        return Authorship(State.FOREIGN)
    except OSError:  # there is none, or the path is wrong, which is reported when it is written
        return None
    if not data.strip(b"\0"):
        # After a power cut files are empty, or have their length and no content.
        return Authorship(State.DAMAGED)
    if path.suffix.lower() in EXR:
        return _of_exr(path, data)
    return _of_still(path, data)


def _of_exr(path: Path, data: bytes) -> Authorship:
    if not data.startswith(MAGIC):
        return Authorship(State.FOREIGN)
    texts = {name: read_text(data, f"{PREFIX}{name}") for name in FACTS}
    facts = {name: text for name, text in texts.items() if text is not None}
    if is_intact(data):
        return Authorship(State.INTACT, facts)
    if not facts and read_text(data, CHECKSUM) is None:
        return Authorship(State.FOREIGN)
    try:
        require_sound((path,))
    except DamagedFileError:
        return Authorship(State.DAMAGED, facts)
    except InputError:  # deep or subsampled: never ExWarp's
        return Authorship(State.EDITED, facts)
    return Authorship(State.EDITED, facts)


def _of_still(path: Path, data: bytes) -> Authorship:
    if path.suffix.lower() not in SEALED:
        ends = data[:_NAMED_WITHIN] + data[-_NAMED_WITHIN:]
        return Authorship(State.INTACT if _NAME.search(ends) else State.FOREIGN)
    facts = facts_in_bytes(data)
    if facts is not None:
        return Authorship(State.INTACT, facts)
    if not has_seal(data):
        return Authorship(State.FOREIGN)
    try:
        read_still(path)
    except DamagedFileError:
        return Authorship(State.DAMAGED)
    except InputError:  # other channels, or EXR under that name
        return Authorship(State.EDITED)
    return Authorship(State.EDITED)
