"""Opening OpenEXR files: their parts, their attributes, and the pixels of chosen channels.

A file is opened once. Its parts come from its header where that is usual, and ZIP and ZIPS are
decoded by `scanlines`. OpenImageIO opens the file for everything else: it reads single parts of a
multi-part file, without the interpreter lock, and reports damage as an error where OpenEXR's own
bindings print and drop the part.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any, BinaryIO

import numpy as np
import OpenImageIO as oiio

from exwarp_cli.domain import cores
from exwarp_cli.domain.frame import Window, require_canvas, require_size
from exwarp_cli.errors import (
    DamagedFileError,
    InputError,
    LayoutError,
    MissingFrameError,
    is_lack_of_threads,
    lack_of_threads,
)
from exwarp_cli.io.exr.header import (
    MAGIC,
    SIGNATURE_BYTES,
    RawHeader,
    channels_in,
    kind_of,
)
from exwarp_cli.io.exr.parts import (
    Channel,
    Part,
    part_from_header,
    part_from_spec,
    window_of,
    with_distinct_names,
)
from exwarp_cli.io.exr.scanlines import (
    ChannelRequest,
    ChunkLayout,
    FileBytes,
    parse_layouts,
    read_blocks,
)
from exwarp_cli.io.reading_retry import with_retries
from exwarp_cli.runtime.frame_pool import pool
from exwarp_cli.runtime.read_registry import being_read

LINES, LINES_OF_DWAB = 32, 256
"""Scan lines in a chunk of the lossy compressions, the most that any but DWAB has."""

CUBE_MAP = "CubeFace Environment"
"""What OpenImageIO calls the six faces of a cube in one image."""

USUAL_SIZE, USUAL_CHANNELS, USUAL_BYTES = 1 << 16, 256, 1 << 30
"""Pixels across or down, channels, and bytes of a part that OpenImageIO takes for sure.

It has limits of its own, and refuses files beyond them.
"""

HEADERS_KEPT = 4
"""Headers that a `HeaderCache` keeps: a Cryptomatte's manifest in one may take megabytes."""

Wanted = Mapping[tuple[int, int, bool], Sequence[Channel]]
"""Channels by the number of their group, their part, and whether they are integers."""


@dataclass(frozen=True)
class FileHeader:
    """What the headers of a file say.

    Attributes
    ----------
    path
        The file.
    parts
        Its parts.
    raw
        The headers as bytes; None where they are not understood here.
    layouts
        How each part is stored; None for a part that OpenImageIO has to read.
    stamp
        By which a file is known that is another one now; see `_stamp`.
    """

    path: Path
    parts: tuple[Part, ...]
    raw: RawHeader | None
    layouts: tuple[ChunkLayout | None, ...]
    stamp: tuple[int, ...] = ()

    @property
    def is_decoded_here(self) -> bool:
        """Whether a part's pixels are decoded without OpenImageIO."""
        return any(layout is not None and layout.is_decoded_here for layout in self.layouts)

    @property
    def texts(self) -> tuple[dict[str, str], ...]:
        """Attributes of each part that are text, and its compression's name."""
        return tuple({} for _ in self.parts) if self.raw is None else self.raw.texts

    @property
    def attributes(self) -> tuple[dict[str, Any], ...]:
        """Attributes of each part as OpenEXR has them; see `RawHeader.typed`.

        Raises
        ------
        DamagedFileError
            When OpenEXR refuses a header.
        """
        try:
            if self.raw is None:
                raise ValueError("the header has no end")
            with being_read(self.path):
                return self.raw.typed
        except (RuntimeError, ValueError, ArithmeticError) as error:  # a rate of 0/0 as well
            raise damaged(self.path, str(error)) from error


def parse_header(path: Path, file: BinaryIO) -> FileHeader:
    """Read the headers of an open file.

    Without parts it is one of which OpenImageIO has to say what it holds, or what is wrong.
    """
    header, parts = FileHeader(path, (), None, ()), []
    try:
        status = os.fstat(file.fileno())
        raw = RawHeader.read(file, status.st_size)
        header = replace(header, raw=raw, stamp=_stamp(status))
        layouts = parse_layouts(raw, FileBytes(file).read, status.st_size)
        header = replace(header, layouts=tuple(layouts))
        for index, values in enumerate(raw.by_part()):
            layout = layouts[index]
            if layout is None:
                return header
            part = part_from_header(index, values, layout.channels, len(layouts) > 1)
            if not _is_usual(part, sum(layout.sizes)):
                return header
            parts.append(part)
        # OpenImageIO opens what OpenEXR opens: so a file is judged alike by both readers.
        with being_read(path):
            if len(raw.typed) == len(parts):
                return replace(header, parts=with_distinct_names(parts))
    except (OSError, RuntimeError, ValueError, ArithmeticError, DamagedFileError):
        pass
    return header


def _stamp(status: os.stat_result) -> tuple[int, ...]:
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


def _is_usual(part: Part, pixel_bytes: int) -> bool:
    sides = part.data_window.shape + part.display_window.shape
    size = part.data_window.pixels * pixel_bytes
    return max(sides) <= USUAL_SIZE and len(part.channels) <= USUAL_CHANNELS and size <= USUAL_BYTES


class ExrFile:
    """An open OpenEXR file; a context manager.

    Parameters
    ----------
    path
        The file.
    by_openimageio
        Whether OpenImageIO opens the file at once, as it is likely to be one that is not decoded
        here. Its attributes are not read then.

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

    def __init__(self, path: Path, by_openimageio: bool = False) -> None:
        self.path = path
        self._by_openimageio = by_openimageio
        self._file: BinaryIO | None = None
        self._bytes: FileBytes | None = None
        self._image: oiio.ImageInput | None = None
        self._failed = False
        self.header: FileHeader = with_retries(path, self._open)

    @property
    def parts(self) -> tuple[Part, ...]:
        """The parts of the file."""
        return self.header.parts

    def __enter__(self) -> ExrFile:
        return self

    def __exit__(self, *exc: object) -> None:
        self._close()

    def _close(self) -> None:
        if self._image is not None:
            self._image.close()
        if self._file is not None:
            self._file.close()
        self._image = self._file = self._bytes = None

    def _open(self) -> FileHeader:
        """Open the file, and read its header."""
        path = self.path
        if not path.exists():
            raise MissingFrameError(f"{path} does not exist; check the path or render the frame")
        try:
            os.fsencode(path).decode()
        except UnicodeDecodeError as error:
            raise InputError(
                f"cannot read {path}: its name or a folder's is not valid UTF-8; rename that"
            ) from error
        try:
            return _bounded(self._header())
        except BaseException:
            self._close()
            raise

    def _header(self) -> FileHeader:
        if self._by_openimageio:
            with suppress(InputError), being_read(self.path):
                self._image = open_image(self.path)
                if self._image.format_name() == "openexr":
                    parts = self._parts_by_openimageio(self._image, None)
                    return FileHeader(self.path, parts, None, ())
            self._close()
            self._by_openimageio = False  # what is wrong is said as always
        header = FileHeader(self.path, (), None, ())
        with suppress(OSError):  # OpenImageIO fails, too, and the cause is looked up then
            self._file = self.path.open("rb", buffering=0)
            head = self._file.read(SIGNATURE_BYTES)
            if not head.startswith(MAGIC):
                raise damaged(self.path, f"its content is {kind_of(head)}")
            self._bytes = FileBytes(self._file)
            header = parse_header(self.path, self._file)
        if not header.parts:
            with being_read(self.path):
                self._image = open_image(self.path)
                parts = self._parts_by_openimageio(self._image, header.raw)
            header = replace(header, parts=parts)
        return header

    def _parts_by_openimageio(
        self, image: oiio.ImageInput, raw: RawHeader | None
    ) -> tuple[Part, ...]:
        specs: list[oiio.ImageSpec] = []
        while True:
            spec = image.spec(len(specs), 0)
            if spec.width == 0 or spec.nchannels == 0:
                break
            specs.append(spec)
        if not specs:
            raise damaged(self.path, "it holds no image")
        parts = [part_from_spec(i, spec, len(specs) > 1) for i, spec in enumerate(specs)]
        if any(spec.getattribute("textureformat") == CUBE_MAP for spec in specs):
            # OpenImageIO gives a cube map with smaller levels the window of a single face.
            if raw is None:
                raise damaged(self.path, "its header is unknown")
            with suppress(ValueError, KeyError):
                windows = [window_of(values, b"displayWindow") for values in raw.by_part()]
                parts = [replace(p, display_window=w) for p, w in zip(parts, windows, strict=True)]
        return with_distinct_names(parts)

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

    def _read(self, wanted: Wanted) -> dict[Channel, np.ndarray]:
        """Decode channels once, of a file that is opened again after a failure."""
        if self._failed:
            self._close()  # a stale handle stays stale
            header = self._open()
            if header.parts != self.parts:
                raise damaged(self.path, "it changes while it is read")
            self.header, self._failed = header, False
        try:
            return self._decode(wanted)
        except (OSError, DamagedFileError):
            self._failed = True
            raise

    def _decode(self, wanted: Wanted) -> dict[Channel, np.ndarray]:
        """Decode channels here, and by OpenImageIO what remains."""
        out: dict[Channel, np.ndarray] = {}
        remaining: list[Channel] = []
        with being_read(self.path):
            for members, pixels in zip(wanted.values(), self._decode_here(wanted), strict=True):
                if pixels is None:
                    remaining += members
                else:
                    out |= {channel: pixels[..., i] for i, channel in enumerate(members)}
            return out | self._decode_by_openimageio(remaining)

    def _decode_here(self, wanted: Wanted) -> list[np.ndarray | None]:
        """Decode what can be decoded here: float32 or uint32 [H, W, C] of each, else None."""
        # Interpreted, kernels would take minutes for a frame.
        interpreted = os.environ.get("NUMBA_DISABLE_JIT", "0") != "0"
        requests = {}
        for key, members in wanted.items():
            part = self.parts[key[1]]
            layout = dict(enumerate(self.header.layouts)).get(part.index)
            usable = layout is not None and layout.is_decoded_here and not interpreted
            if layout is not None and usable and layout.window == part.data_window:
                requests[key] = ChannelRequest(layout, tuple(c.raw_name for c in members), key[2])
        if self._bytes is None or not requests:
            return [None] * len(wanted)
        decoded = dict(zip(requests, read_blocks(self._bytes, [*requests.values()]), strict=True))
        return [decoded.get(key) for key in wanted]

    def _decode_by_openimageio(self, channels: Iterable[Channel]) -> dict[Channel, np.ndarray]:
        """Decode channels of any kind, or say why they cannot be decoded."""
        wanted: dict[tuple[int, bool], list[Channel]] = {}
        for channel in channels:
            wanted.setdefault((channel.part, channel.pixel_type == "uint"), []).append(channel)
        out: dict[Channel, np.ndarray] = {}
        if not wanted:
            return out
        if self._image is None:
            self._image = open_image(self.path)
        for (index, integer), members in sorted(wanted.items(), key=lambda item: item[0]):
            part = self.parts[index]
            spec = self._image.spec(index, 0)
            places = {name: i for i, name in enumerate(spec.channelnames)}
            window = Window(spec.x, spec.y, spec.width, spec.height)
            if window != part.data_window or any(c.raw_name not in places for c in members):
                raise damaged(self.path, "it changes while it is read")
            at = [places[channel.raw_name] for channel in members]
            pixels = self._pixels(self._image, part, min(at), max(at) + 1, integer)
            out |= {c: pixels[..., i - min(at)] for c, i in zip(members, at, strict=True)}
        return out

    def _pixels(
        self, image: oiio.ImageInput, part: Part, begin: int, end: int, integer: bool
    ) -> np.ndarray:
        """Read neighbouring channels of a part, float32 or uint32 [H, W, C]."""
        window, kind = part.data_window, "uint" if integer else "float"
        spec = image.spec(part.index, 0)
        out = pool.empty((*window.shape, end - begin), np.uint32 if integer else np.float32)
        across = (window.x, window.x + window.width)
        # A chunk for each core at a time, into memory that later frames get: whole images of
        # OpenImageIO's lay in pieces of the allocator's heap, 100 to 160 MB at 1920x1080.
        dwab = spec.getattribute("compression") == "dwab"
        step = (LINES_OF_DWAB if dwab else LINES) * cores.count()
        if part.tiled:
            step = -(-step // spec.tile_height) * int(spec.tile_height)
        for top in range(0, window.height, step):
            lines = (window.y + top, window.y + min(top + step, window.height))
            if part.tiled:
                places = (*across, *lines, 0, 1)
                read = image.read_tiles(part.index, 0, *places, begin, end, kind)
            else:
                read = image.read_scanlines(part.index, 0, *lines, 0, begin, end, kind)
            if read is None:
                raise damaged(self.path, _first_line(image.geterror))
            out[top : top + step] = read.reshape(-1, *out.shape[1:])
        return out


class HeaderCache:
    """Keeps what was learnt of a shot's files, so that they are opened less often.

    These are the headers that were read last, for what wants them shortly after another reason to
    open the file; and which AOVs' files OpenImageIO decodes.
    """

    def __init__(self) -> None:
        self._headers: OrderedDict[Path, FileHeader] = OrderedDict()
        self._decoded_here: dict[str, bool] = {}
        self._lock = Lock()

    def open(self, path: Path, aov: str) -> ExrFile:
        """Open a file of an AOV, the way that was right for the one before; see `ExrFile`."""
        file = ExrFile(path, not self._decoded_here.get(aov, True))
        self._decoded_here.setdefault(aov, file.header.is_decoded_here)
        return file

    def read(self, path: Path) -> FileHeader:
        """Return the header of a file; raises as `ExrFile` does."""
        with self._lock:
            header = self._headers.get(path)
        with suppress(OSError):
            if header is not None and header.stamp == _stamp(path.stat()):
                return header
        with ExrFile(path) as file:
            self.keep(path, file.header)
            return file.header

    def keep(self, path: Path, header: FileHeader) -> None:
        """Keep a header as the newest; one without parts drops what is kept of that file."""
        with self._lock:
            self._headers.pop(path, None)
            if header.parts:
                self._headers[path] = header
            while len(self._headers) > HEADERS_KEPT:
                self._headers.popitem(last=False)


def open_image(path: Path) -> oiio.ImageInput:
    """Open a file by OpenImageIO; the only place that does so for OpenEXR files.

    Raises
    ------
    DamagedFileError
        When it cannot be opened.
    LayoutError
        When it has subsampled channels.
    """
    try:
        image = oiio.ImageInput.open(str(path))
    except (RuntimeError, ValueError, UnicodeError) as error:
        if is_lack_of_threads(error):  # that is no damage of the file
            raise lack_of_threads() from error
        image = None
    if image is None:
        reason = _first_line(oiio.geterror)
        raise _subsampled(path) if "ubsampled" in reason else damaged(path, reason)
    return image


def read_headers(path: Path) -> tuple[dict[str, Any], ...]:
    """Read the attributes of every part; see `RawHeader.typed`.

    Raises
    ------
    DamagedFileError
        When a header cannot be read.
    InputError
        As `ExrFile`.
    """
    with ExrFile(path) as file:
        return file.header.attributes


def display_window(path: Path) -> Window:
    """Return a file's display window.

    Raises
    ------
    InputError
        When the file is missing or damaged.
    """
    with ExrFile(path) as file:
        return file.parts[0].display_window


def _bounded(header: FileHeader) -> FileHeader:
    """Return a header; refuse it where its windows are larger than frames may be."""
    for part in header.parts:
        require_size(header.path, *part.data_window.shape)
        require_size(header.path, *part.display_window.shape)
        require_canvas(header.path, part.data_window.union(part.display_window))
    return header


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
    names: dict[str, tuple[int, int]] = {}
    with suppress(OSError, ValueError):
        with path.open("rb", buffering=0) as file:
            raw = RawHeader.read(file, path.stat().st_size)
        for attribute in raw.attributes:
            if attribute.kind == b"chlist":
                for name, _, steps in channels_in(raw.value(attribute)):
                    if steps != (1, 1):
                        names[name.decode("utf-8", "replace")] = steps
    return names


def damaged(path: Path, reason: str) -> DamagedFileError:
    """Build the error for a file that cannot be decoded."""
    text = " ".join(reason.split()).rstrip(".")  # decoders write several lines
    detail = f" ({text})" if text else ""
    return DamagedFileError(
        f"{path} is truncated, damaged or not an OpenEXR file{detail}; render or copy it again"
    )


def _first_line(geterror: Callable[[], str]) -> str:
    """Return the first line of what the decoder reports; it may quote the file's broken bytes."""
    try:
        lines = geterror().strip().splitlines()
    except UnicodeDecodeError:
        return ""
    return lines[0] if lines else ""
