"""Reading OpenEXR files: their structure, and the pixels of chosen channels.

`io.exr_decoding` decodes the common kinds. OpenImageIO tells the structure and decodes the rest: it
reads single parts of a multi-part file, without the interpreter lock, and reports damage as an
error where OpenEXR's own bindings print and drop the part.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from exwarp_cli.domain import cores
from exwarp_cli.domain.bounds import require_canvas, require_size
from exwarp_cli.domain.frame import Window
from exwarp_cli.errors import (
    DamagedFileError,
    InputError,
    LayoutError,
    MissingFrameError,
    is_lack_of_threads,
    lack_of_threads,
)
from exwarp_cli.io.exr_decoding import ScanLines, Wanted
from exwarp_cli.io.header_text import attributes_in
from exwarp_cli.io.magic import EXR, head_of, kind_of
from exwarp_cli.io.reading_retry import with_retries
from exwarp_cli.runtime.frame_pool import pool
from exwarp_cli.runtime.read_registry import being_read

LINES, LINES_OF_DWAB = 32, 256
"""Scan lines in a chunk of the lossy compressions, the most that any but DWAB has."""


CUBE_MAP = "CubeFace Environment"
"""What OpenImageIO calls the six faces of a cube in one image."""

HEADER_BYTES = 1 << 16
"""Bytes at the start of a file that hold most headers whole."""


@dataclass(frozen=True)
class Channel:
    """One channel of one part.

    Attributes
    ----------
    part
        Index of the part in the file.
    index
        Index of the channel in the part, in the order in which it is decoded.
    name
        Name with the part's name in front where the channel does not carry its layer itself, or a
        part before has a channel of that name; the part's view is not repeated in it.
    raw_name
        Name as it stands in the file.
    pixel_type
        "half", "float" or "uint".
    """

    part: int
    index: int
    name: str
    raw_name: str
    pixel_type: str


@dataclass(frozen=True)
class Part:
    """One part of a file.

    Attributes
    ----------
    index, name
        Position in the file, and the part's name ("" in single-part files).
    data_window, display_window
        In OpenEXR's coordinates.
    channels
        In the order in which they are decoded.
    view
        Name of the stereo view, "" where there is none.
    deep
        Whether the part holds deep samples.
    tiled
        Whether it is stored in tiles; of several levels the full one is read.
    views
        Views whose channels lie in this one part, the hero first: the attribute ``multiView``.
    """

    index: int
    name: str
    data_window: Window
    display_window: Window
    channels: tuple[Channel, ...]
    view: str
    deep: bool
    tiled: bool = False
    views: tuple[str, ...] = ()


class ExrReader:
    """An open OpenEXR file; a context manager.

    Raises
    ------
    MissingFrameError
        When the file does not exist.
    DamagedFileError
        When it is not a readable OpenEXR file.
    LayoutError
        When it has subsampled channels, as files of luminance and chroma have.
    InputError
        When its name cannot be given to OpenImageIO, which takes UTF-8 alone.
    UnreadableError
        When the system does not let it through, now or while pixels are read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: oiio.ImageInput = with_retries(path, self._opened)
        self._scan_lines: ScanLines | None = None
        self._failed = False
        self.parts = self._parts()

    def _opened(self) -> oiio.ImageInput:
        """Open the file."""
        path = self.path
        if not path.exists():
            raise MissingFrameError(f"{path} does not exist; check the path or render the frame")
        try:
            with being_read(path):
                head = head_of(path)
                if head is not None and not head.startswith(EXR):
                    raise damaged(path, f"its content is {kind_of(head)}")
                file = oiio.ImageInput.open(str(path))
        except TypeError as error:  # what the bindings make of bytes that are no text
            raise InputError(
                f"cannot read {path}: its name or a folder's is not valid UTF-8; rename that"
            ) from error
        except (RuntimeError, ValueError, UnicodeError) as error:
            if is_lack_of_threads(error):  # that is no damage of the file
                raise lack_of_threads() from error
            file = None
        if file is None:
            said = _said(oiio.geterror)
            raise _subsampled(path) if "ubsampled" in said else damaged(path, said)
        return file

    def __enter__(self) -> ExrReader:
        return self

    def __exit__(self, *exc: object) -> None:
        self._close()

    def _close(self) -> None:
        self._file.close()
        if self._scan_lines is not None:
            self._scan_lines.close()
            self._scan_lines = None

    def _reopen(self) -> None:
        """Open the file again after a failed read: a stale handle stays stale."""
        self._close()
        self._file = self._opened()
        self._failed = False
        if self._parts() != self.parts:
            raise damaged(self.path, "it changes while it is read")

    def _parts(self) -> tuple[Part, ...]:
        """Describe every part."""
        specs: list[oiio.ImageSpec] = []
        while True:
            spec = self._file.spec(len(specs), 0)
            if spec.width == 0 or spec.nchannels == 0:
                break
            specs.append(spec)
        if not specs:
            raise damaged(self.path, "it holds no image")
        parts = [_part(i, spec, len(specs) > 1) for i, spec in enumerate(specs)]
        if any(spec.getattribute("textureformat") == CUBE_MAP for spec in specs):
            # OpenImageIO gives a cube map with smaller levels the window of a single face.
            windows: dict[int, Window] = {}
            with suppress(OSError, ValueError):
                windows = dict(_display_windows(self.path.read_bytes()))
            parts = [
                replace(part, display_window=windows.get(part.index, part.display_window))
                for part in parts
            ]
        for part in parts:
            require_size(self.path, *part.data_window.shape)
            require_size(self.path, *part.display_window.shape)
            require_canvas(self.path, part.data_window.union(part.display_window))
        return _told_apart(parts)

    @property
    def headers(self) -> list[dict[str, object]]:
        """The attributes of every part, as OpenImageIO names them.

        Text that is no UTF-8 keeps its bytes as lone surrogates.
        """
        specs = (self._file.spec(part.index, 0) for part in self.parts)
        return [{one.name: one.value for one in spec.extra_attribs} for spec in specs]

    def read(self, *groups: Iterable[Channel]) -> dict[Channel, np.ndarray]:
        """Decode channels: [H, W] arrays on their part's data window.

        Half and float become float32; uint stays uint32, as ids above 2^24 need it. Each part is
        decoded once, whatever the number of its channels.

        Parameters
        ----------
        *groups
            Channels of one group are used together: those of one part and type lie interleaved in
            one array, in the order given, where the part is decoded here.
        """
        wanted: dict[tuple[int, int, bool], list[Channel]] = {}
        seen: set[Channel] = set()
        for number, group in enumerate(groups):
            for channel in group:
                if channel not in seen:
                    key = number, channel.part, channel.pixel_type == "uint"
                    wanted.setdefault(key, []).append(channel)
                    seen.add(channel)
        if any(self.parts[part].deep for _, part, _ in wanted):
            raise deep_only(self.path)
        return with_retries(self.path, partial(self._read, wanted))

    def _read(
        self, wanted: Mapping[tuple[int, int, bool], Sequence[Channel]]
    ) -> dict[Channel, np.ndarray]:
        """Decode channels once, of a file that is opened again after a failure."""
        if self._failed:
            self._reopen()
        try:
            return self._decode(wanted)
        except (OSError, DamagedFileError):
            self._failed = True
            raise

    def _decode(
        self, wanted: Mapping[tuple[int, int, bool], Sequence[Channel]]
    ) -> dict[Channel, np.ndarray]:
        """Decode channels here, and by OpenImageIO what is left."""
        out: dict[Channel, np.ndarray] = {}
        left: list[Channel] = []
        with being_read(self.path):
            for members, pixels in zip(wanted.values(), self._decoded(wanted), strict=True):
                if pixels is None:
                    left += members
                else:
                    out |= {channel: pixels[..., i] for i, channel in enumerate(members)}
            return out | self._by_openimageio(left)

    def _decoded(
        self, wanted: Mapping[tuple[int, int, bool], Sequence[Channel]]
    ) -> list[np.ndarray | None]:
        """Decode what can be decoded here: float32 or uint32 [H, W, C] of each, else None."""
        if self._scan_lines is None:
            try:
                self._scan_lines = ScanLines(self.path)
            except OSError:
                return [None] * len(wanted)
        asked = [
            Wanted(part, self.parts[part].data_window, tuple(c.raw_name for c in members), integer)
            for (_, part, integer), members in wanted.items()
        ]
        return self._scan_lines.read(asked)

    def _by_openimageio(self, channels: Iterable[Channel]) -> dict[Channel, np.ndarray]:
        """Decode channels of any kind, or say why they cannot be decoded."""
        wanted: dict[tuple[int, bool], list[Channel]] = {}
        for channel in channels:
            wanted.setdefault((channel.part, channel.pixel_type == "uint"), []).append(channel)
        out: dict[Channel, np.ndarray] = {}
        for (part, integer), members in sorted(wanted.items(), key=lambda item: item[0]):
            begin = min(c.index for c in members)
            end = max(c.index for c in members) + 1
            pixels = self._pixels(self.parts[part], begin, end, integer)
            for channel in members:
                out[channel] = pixels[..., channel.index - begin]
        return out

    def _pixels(self, part: Part, begin: int, end: int, integer: bool) -> np.ndarray:
        """Read neighbouring channels of a part, float32 or uint32 [H, W, C].

        A chunk a core at a time, into memory that later frames get: whole images of OpenImageIO's
        lay in pieces of the allocator's heap, 100 to 160 MB at 1920x1080.
        """
        window, kind = part.data_window, "uint" if integer else "float"
        out = pool.empty((*window.shape, end - begin), np.uint32 if integer else np.float32)
        across = (window.x, window.x + window.width)
        step = self._lines_at_once(part)
        for top in range(0, window.height, step):
            lines = (window.y + top, window.y + min(top + step, window.height))
            if part.tiled:
                places = (*across, *lines, 0, 1)
                read = self._file.read_tiles(part.index, 0, *places, begin, end, kind)
            else:
                read = self._file.read_scanlines(part.index, 0, *lines, 0, begin, end, kind)
            if read is None:
                raise damaged(self.path, _said(self._file.geterror))
            out[top : top + step] = read.reshape(-1, *out.shape[1:])
        return out

    def _lines_at_once(self, part: Part) -> int:
        """Return how many lines make a chunk for each core, or whole rows of tiles."""
        spec = self._file.spec(part.index, 0)
        dwab = spec.getattribute("compression") == "dwab"
        lines = (LINES_OF_DWAB if dwab else LINES) * cores.count()
        return lines if not part.tiled else -(-lines // spec.tile_height) * int(spec.tile_height)


def display_window(path: Path) -> Window:
    """Return a file's display window.

    It is read in the first bytes of the header: 0.1 ms a file, where opening it takes 2 ms.

    Raises
    ------
    InputError
        When the file is missing or damaged.
    """
    with suppress(OSError, ValueError):
        with path.open("rb") as file:
            head = file.read(HEADER_BYTES)
        part, window = next(_display_windows(head), (None, None))
        if part == 0 and window is not None:
            return window
    with ExrReader(path) as reader:
        return reader.parts[0].display_window


def _display_windows(data: bytes) -> Iterator[tuple[int, Window]]:
    """Yield part and window of each display window in the beginning of a file.

    Raises
    ------
    ValueError
        When the headers are broken, or longer than that.
    """
    for one in attributes_in(data):
        if one.name == b"displayWindow" and one.end - one.begin == 16:
            left, top, right, bottom = struct.unpack("<4i", data[one.begin : one.end])
            if left <= right and top <= bottom:
                yield one.part, Window(left, top, right - left + 1, bottom - top + 1)


def deep_only(path: Path) -> LayoutError:
    """Build the error for a file whose pixels are deep samples.

    They are not flattened here: compositing by depth is right for colour alone, and would mix the
    ids, normals and vectors of what lies behind one another.
    """
    return LayoutError(
        f"{path} is a deep image, which is not read; give the flat render, or flatten the colour "
        "with 'oiiotool IN --flatten -o OUT'"
    )


def _subsampled(path: Path) -> LayoutError:
    """Build the error for a file with channels of fewer pixels, which OpenImageIO does not open."""
    names = _fewer_pixels(path)
    if {name.rpartition(".")[2] for name in names} == {"RY", "BY"}:
        return LayoutError(
            f"{path} holds luminance and chroma (Y, RY, BY) in channels of different sizes, which "
            "is not read; write it as RGB"
        )
    listed = ", ".join(f"{name} (1 pixel in {x}x{y})" for name, (x, y) in names.items())
    return LayoutError(
        f"{path} is not read, as it has subsampled channels, stored at a lower resolution than the "
        f"others{listed and ': '}{listed}; render them at full resolution, or leave them out"
    )


def _fewer_pixels(path: Path) -> dict[str, tuple[int, int]]:
    """Return the channels that lack pixels, with the steps across and down of those they have."""
    found: dict[str, tuple[int, int]] = {}
    with suppress(OSError, ValueError, struct.error):
        data = path.read_bytes()
        for one in attributes_in(data):
            if one.kind != b"chlist":
                continue
            at = one.begin
            while at < one.end - 1:
                end = data.index(b"\0", at)
                steps = struct.unpack_from("<2i", data, end + 9)
                if steps != (1, 1):
                    found[data[at:end].decode("utf-8", "replace")] = steps
                at = end + 17
    return found


def damaged(path: Path, reason: str) -> DamagedFileError:
    """Build the error for a file that cannot be decoded."""
    told = " ".join(reason.split()).rstrip(".")  # decoders write several lines
    detail = f" ({told})" if told else ""
    return DamagedFileError(
        f"{path} is truncated, damaged or not an OpenEXR file{detail}; render or copy it again"
    )


def _said(geterror: Callable[[], str]) -> str:
    """Return the first line of what the decoder reports; it may quote the file's broken bytes."""
    try:
        lines = geterror().strip().splitlines()
    except UnicodeDecodeError:
        return ""
    return lines[0] if lines else ""


def _part(index: int, spec: oiio.ImageSpec, multipart: bool) -> Part:
    """Describe one part from OpenImageIO's specification."""
    name = spec.getattribute("oiio:subimagename") or ""
    view = spec.getattribute("view") or ""
    layer = _without(view, name) if multipart else ""
    formats = [str(f) for f in spec.channelformats] or [str(spec.format)] * spec.nchannels
    channels = []
    for i, raw in enumerate(spec.channelnames):
        full = raw if not layer or "." in raw else f"{layer}.{raw}"
        channels.append(Channel(index, i, full, raw, formats[i]))
    return Part(
        index,
        name if multipart else "",
        Window(spec.x, spec.y, spec.width, spec.height),
        Window(spec.full_x, spec.full_y, spec.full_width, spec.full_height),
        tuple(channels),
        view,
        bool(spec.deep),
        spec.tile_width > 0,
        _strings(spec.getattribute("multiView")),
    )


def _told_apart(parts: list[Part]) -> tuple[Part, ...]:
    """Return parts whose channels have names of their own, among those of one view."""
    taken: set[tuple[str, str]] = set()
    found = []
    for part in parts:
        layer = _without(part.view, part.name)
        own = {channel.name for channel in part.channels if (part.view, channel.name) in taken}
        channels = tuple(
            replace(channel, name=f"{layer}.{channel.name}") if channel.name in own else channel
            for channel in part.channels
        )
        found.append(replace(part, channels=channels))
        if not part.deep:
            taken |= {(part.view, channel.name) for channel in channels}
    return tuple(found)


def _without(view: str, name: str) -> str:
    """Take a view off a part's name, where it is an element: "depth_left", "left.depth"."""
    if not view:
        return name
    element = re.compile(rf"(^|[._ -]){re.escape(view)}($|[._ -])")
    return element.sub(lambda m: m[1] if m[1] and m[2] else "", name, count=1)


def _strings(value: object) -> tuple[str, ...]:
    """Read an attribute of strings, which is a string where there is one alone."""
    if isinstance(value, str):
        return (value,) if value else ()
    return tuple(str(v) for v in value) if isinstance(value, (tuple, list)) else ()
