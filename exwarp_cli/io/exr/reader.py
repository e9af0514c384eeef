"""Opening OpenEXR files: their parts, their attributes, and the pixels of chosen channels.

A file is opened once. Its parts come from its header where that is usual, and ZIP and ZIPS are
decoded by `scanlines`. OpenImageIO opens the file for everything else: it reads single parts of a
multi-part file, without the interpreter lock, and reports damage as an error where OpenEXR's own
bindings print and drop the part.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from operator import attrgetter
from pathlib import Path
from threading import Lock
from typing import Any, BinaryIO

import numpy as np
import OpenImageIO as oiio

from exwarp_cli.domain.frame import Window, require_canvas, require_size
from exwarp_cli.errors import (
    DamagedFileError,
    InputError,
    LayoutError,
    MissingFrameError,
    thread_limit_error,
)
from exwarp_cli.io.exr.header import (
    COMPRESSION_NAMES,
    MAGIC,
    SIGNATURE_BYTES,
    SIGNATURES,
    Channel,
    Part,
    RawHeader,
    channels_in,
    decode,
    describe_part,
    in_openimageio_order,
    name_channels,
    window_of,
)
from exwarp_cli.io.exr.scanlines import ChunkLayout, parse_layouts, read_blocks
from exwarp_cli.io.files import with_retries
from exwarp_cli.runtime import cores
from exwarp_cli.runtime.frame_pool import pool
from exwarp_cli.runtime.read_registry import report_reading

# Scan lines in a chunk of the lossy compressions, the most that any but DWAB has.
LINES, LINES_OF_DWAB = 32, 256

# Pixels across or down, channels, and bytes of a part that OpenImageIO takes for sure. It has
# limits of its own, and refuses files beyond them.
USUAL_SIZE, USUAL_CHANNELS, USUAL_BYTES = 1 << 16, 256, 1 << 30

MAX_HEADERS = 4  # in a `HeaderCache`: a Cryptomatte's manifest in one may take megabytes

_STAMP = attrgetter("st_dev", "st_ino", "st_size", "st_mtime_ns")


@dataclass(frozen=True)
class FileHeader:
    """The headers of a file."""

    path: Path
    parts: tuple[Part, ...] = ()  # its parts; empty where OpenImageIO has to read them
    raw: RawHeader | None = None  # the headers as bytes; None where they are not understood here
    # How each part is stored; None for a part that OpenImageIO has to read
    layouts: tuple[ChunkLayout | None, ...] = ()
    # What `_STAMP` reads of the file, by which another one at the path is noticed
    stamp: tuple[int, ...] = ()

    @cached_property
    def texts(self) -> tuple[dict[str, str], ...]:
        """The attributes of each part that are text, and the compression's name.

        Text that is no UTF-8 keeps its bytes as lone surrogates.
        """
        count = len(self.parts) if self.raw is None else self.raw.part_count
        headers: tuple[dict[str, str], ...] = tuple({} for _ in range(count))
        for attribute in () if self.raw is None else self.raw.attributes:
            texts, value = headers[attribute.part], attribute.value
            if attribute.kind == b"string" and (value := value.partition(b"\0")[0]):
                texts[decode(attribute.name)] = decode(value)
            elif attribute.kind == b"compression" and value and value[0] < len(COMPRESSION_NAMES):
                texts[decode(attribute.name)] = COMPRESSION_NAMES[value[0]]
        return headers

    @property
    def attributes(self) -> tuple[dict[str, Any], ...]:
        """Attributes of each part as OpenEXR has them; see `RawHeader.typed`.

        Raises DamagedFileError when OpenEXR refuses a header.
        """
        try:
            if self.raw is None:
                raise ValueError("the header has no end")
            with report_reading(self.path):
                return self.raw.typed
        except (RuntimeError, ValueError, ArithmeticError) as error:  # a rate of 0/0 as well
            raise damaged_error(self.path, str(error)) from error


def parse_header(path: Path, file: BinaryIO) -> FileHeader:
    """Read the headers of an open file.

    Without parts, only OpenImageIO can say what the file holds, or what is wrong.
    """
    header, parts = FileHeader(path), []
    try:
        status = os.fstat(file.fileno())
        raw = RawHeader.read(file, status.st_size)
        header = replace(header, raw=raw, stamp=_STAMP(status))
        layouts = parse_layouts(raw, file, status.st_size)
        header = replace(header, layouts=tuple(layouts))
        # OpenImageIO opens what OpenEXR opens: so both readers accept the same files.
        with report_reading(path):
            attributes = raw.typed
        by_part = zip(raw.by_part(), layouts, attributes, strict=True)
        for index, (values, layout, own) in enumerate(by_part):
            # `typed` leaves out a list of views that is no UTF-8: OpenImageIO reads it then.
            if layout is None or (b"multiView" in values and "multiView" not in own):
                return header
            windows = layout.window, window_of(values, b"displayWindow")
            channels = in_openimageio_order(layout.channels)
            is_tiled = layout.tile is not None
            part = describe_part(index, own, windows, channels, len(layouts) > 1, False, is_tiled)
            sides = part.data_window.shape + part.display_window.shape
            size = part.data_window.pixels * sum(layout.sizes)
            count = len(part.channels)
            if max(sides) > USUAL_SIZE or count > USUAL_CHANNELS or size > USUAL_BYTES:
                return header
            parts.append(part)
        return replace(header, parts=name_channels(parts))
    except (OSError, RuntimeError, ValueError, ArithmeticError, DamagedFileError):
        pass
    return header


class ExrFile(AbstractContextManager["ExrFile"]):
    """An open OpenEXR file; a context manager.

    With `by_openimageio` OpenImageIO opens the file at once, as it is probably not decoded here.
    Its attributes are not read then.

    Raises MissingFrameError when the file does not exist, DamagedFileError when it is not a
    readable OpenEXR file, LayoutError when it has subsampled channels, as files of luminance and
    chroma have, and InputError when its name is no UTF-8, which OpenImageIO needs. Raises
    UnreadableError when the system does not let it through, now or while pixels are read.
    """

    def __init__(self, path: Path, by_openimageio: bool = False) -> None:
        self.path = path
        self._by_openimageio = by_openimageio
        self._file: BinaryIO | None = None
        self._image: oiio.ImageInput | None = None
        self._has_failed = False
        self.header: FileHeader = with_retries(path, self._open)
        self.parts = self.header.parts

    def __exit__(self, *exc: object) -> None:
        self._close()

    def _close(self) -> None:
        if self._image is not None:
            self._image.close()
        if self._file is not None:
            self._file.close()
        self._image = self._file = None

    def _open(self) -> FileHeader:
        path = self.path
        if not path.exists():
            raise MissingFrameError(f"{path} does not exist; check the path or render the frame")
        try:
            os.fsencode(path).decode()
        except UnicodeDecodeError as error:
            raise InputError(
                f"cannot read {path}: its name or a folder's is not valid UTF-8; rename that"
            ) from error
        header = FileHeader(path)
        try:
            if self._by_openimageio:
                with suppress(InputError):
                    header = replace(header, parts=self._parts_by_openimageio(None))
            if not header.parts:
                self._close()
                self._by_openimageio = False  # the usual way reports what is wrong
                with suppress(OSError):  # OpenImageIO fails, too, and the cause is looked up then
                    self._file = path.open("rb", buffering=0)
                    head = self._file.read(SIGNATURE_BYTES)
                    # Checked before decoding: OpenImageIO prints warnings for foreign data.
                    if not head.startswith(MAGIC):
                        kinds = (name for magic, name in SIGNATURES if head.startswith(magic))
                        content = next(kinds, "something else" if head else "nothing")
                        raise damaged_error(path, f"its content is {content}")
                    header = parse_header(path, self._file)
            if not header.parts:
                header = replace(header, parts=self._parts_by_openimageio(header.raw))
            for part in header.parts:
                require_size(path, *part.data_window.shape)
                require_size(path, *part.display_window.shape)
                require_canvas(path, part.data_window.union(part.display_window))
            return header
        except BaseException:
            self._close()
            raise

    def _parts_by_openimageio(self, raw: RawHeader | None) -> tuple[Part, ...]:
        specs: list[oiio.ImageSpec] = []
        with report_reading(self.path):
            image = self._image = open_image(self.path)
            is_exr = image.format_name() == "openexr"
            while is_exr and (spec := image.spec(len(specs), 0)).width and spec.nchannels:
                specs.append(spec)
        if not specs:
            raise damaged_error(self.path, "it holds no image")
        parts = []
        for index, spec in enumerate(specs):
            names = {"name": "oiio:subimagename", "view": "view", "multiView": "multiView"}
            own = {name: spec.getattribute(key) for name, key in names.items()}
            data = Window(spec.x, spec.y, spec.width, spec.height)
            display = Window(spec.full_x, spec.full_y, spec.full_width, spec.full_height)
            types = [str(t) for t in spec.channelformats] or [str(spec.format)] * spec.nchannels
            channels = zip(spec.channelnames, types, strict=True)
            is_deep, is_tiled, is_multipart = bool(spec.deep), spec.tile_width > 0, len(specs) > 1
            parts.append(
                describe_part(
                    index, own, (data, display), channels, is_multipart, is_deep, is_tiled
                )
            )
        if any(spec.getattribute("textureformat") == "CubeFace Environment" for spec in specs):
            # OpenImageIO gives a cube map with smaller levels the window of a single face.
            if raw is None:
                raise damaged_error(self.path, "its header is unknown")
            with suppress(ValueError, KeyError):
                windows = [window_of(values, b"displayWindow") for values in raw.by_part()]
                parts = [replace(p, display_window=w) for p, w in zip(parts, windows, strict=True)]
        return name_channels(parts)

    def read(self, *groups: Iterable[Channel]) -> dict[Channel, np.ndarray]:
        """Decode groups of channels: [H, W] arrays on their part's data window.

        Half and float become float32; uint stays uint32, as ids above 2^24 need it. Each part is
        decoded once, whatever the number of its channels. Channels of one group are used together:
        those of one part and type lie interleaved in one array, in this order, where the part is
        decoded here.
        """
        # By the number of their group, their part, and whether they are integers.
        wanted: dict[tuple[int, int, bool], list[Channel]] = {}
        visited: set[Channel] = set()
        for number, group in enumerate(groups):
            for channel in group:
                if channel not in visited:
                    key = number, channel.part, channel.pixel_type == "uint"
                    wanted.setdefault(key, []).append(channel)
                    visited.add(channel)
        if any(self.parts[part].deep for _, part, _ in wanted):
            raise deep_image_error(self.path)
        return with_retries(self.path, partial(self._read, wanted))

    def _read(
        self, groups: dict[tuple[int, int, bool], list[Channel]]
    ) -> dict[Channel, np.ndarray]:
        """Decode channels once, of a file that is opened again after a failure."""
        if self._has_failed:
            self._close()  # a stale handle stays stale
            header = self._open()
            if header.parts != self.parts:
                raise damaged_error(self.path, "it changes while it is read")
            self.header, self._has_failed = header, False
        # Interpreted, kernels would take minutes for a frame.
        is_interpreted = os.environ.get("NUMBA_DISABLE_JIT", "0") != "0"
        requests = {}
        for key, channels in groups.items():
            _, index, _ = key
            layout = self.header.layouts[index] if index < len(self.header.layouts) else None
            if layout is None or not layout.is_decoded_here or is_interpreted:
                continue
            if layout.window == self.parts[index].data_window:
                requests[key] = layout, channels
        out: dict[Channel, np.ndarray] = {}
        try:
            with report_reading(self.path):
                if self._file is not None:
                    arrays = read_blocks(self._file, [*requests.values()])
                    for key, pixels in zip(requests, arrays, strict=True):
                        if pixels is not None:
                            out |= {c: pixels[..., i] for i, c in enumerate(groups[key])}
                remaining = [c for channels in groups.values() for c in channels if c not in out]
                return out | self._decode_by_openimageio(remaining)
        except (OSError, DamagedFileError):
            self._has_failed = True
            raise

    def _decode_by_openimageio(self, channels: Iterable[Channel]) -> dict[Channel, np.ndarray]:
        """Decode channels of any kind, float32 or uint32 [H, W]; raises DamagedFileError."""
        by_part: dict[tuple[int, bool], list[Channel]] = {}
        for channel in channels:
            by_part.setdefault((channel.part, channel.pixel_type == "uint"), []).append(channel)
        out: dict[Channel, np.ndarray] = {}
        for (index, is_integer), members in sorted(by_part.items(), key=lambda item: item[0]):
            image = self._image = self._image or open_image(self.path)
            spec, window = image.spec(index, 0), self.parts[index].data_window
            places = {name: i for i, name in enumerate(spec.channelnames)}
            is_same = window == Window(spec.x, spec.y, spec.width, spec.height)
            if not is_same or any(channel.raw_name not in places for channel in members):
                raise damaged_error(self.path, "it changes while it is read")
            columns = [places[channel.raw_name] for channel in members]
            begin, end = min(columns), max(columns) + 1
            kind, dtype = ("uint", np.uint32) if is_integer else ("float", np.float32)
            pixels = pool.empty((*window.shape, end - begin), dtype)
            # A chunk for each core at a time, into memory that later frames get: complete images of
            # OpenImageIO's lay in pieces of the allocator's heap, 100 to 160 MB at 1920x1080.
            is_dwab = spec.getattribute("compression") == "dwab"
            step = (LINES_OF_DWAB if is_dwab else LINES) * cores.count()
            tile_height = int(spec.tile_height) or 1
            step = -(-step // tile_height) * tile_height
            for top in range(0, window.height, step):
                lines = (window.y + top, window.y + min(top + step, window.height))
                if self.parts[index].tiled:
                    box = (window.x, window.x + window.width, *lines, 0, 1)
                    chunk = image.read_tiles(index, 0, *box, begin, end, kind)
                else:
                    chunk = image.read_scanlines(index, 0, *lines, 0, begin, end, kind)
                if chunk is None:
                    raise damaged_error(self.path, _first_line(image.geterror))
                pixels[top : top + step] = chunk.reshape(-1, *pixels.shape[1:])
            out |= {c: pixels[..., i - begin] for c, i in zip(members, columns, strict=True)}
        return out


@dataclass(eq=False)
class HeaderCache:
    """Keeps headers that were read last, and which AOVs' files OpenImageIO decodes.

    So a shot's files are opened less often. Several threads use it.
    """

    _headers: OrderedDict[Path, FileHeader] = field(default_factory=OrderedDict)
    _decoded_here: dict[str, bool] = field(default_factory=dict)
    _lock: Lock = field(default_factory=Lock)

    def open(self, path: Path, aov: str) -> ExrFile:
        """Open a file of an AOV, the way that was right for the one before; see `ExrFile`."""
        file = ExrFile(path, not self._decoded_here.get(aov, True))
        is_decoded_here = any(layout and layout.is_decoded_here for layout in file.header.layouts)
        self._decoded_here.setdefault(aov, is_decoded_here)
        return file

    def read(self, path: Path) -> FileHeader:
        """Return the header of a file; raises as `ExrFile` does."""
        with self._lock:
            header = self._headers.get(path)
        with suppress(OSError):
            if header is not None and header.stamp == _STAMP(path.stat()):
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
            while len(self._headers) > MAX_HEADERS:
                self._headers.popitem(last=False)


def open_image(path: Path) -> oiio.ImageInput:
    """Open a file by OpenImageIO; the only place that does so for OpenEXR files.

    Raises DamagedFileError when it cannot be opened. Raises LayoutError when it has subsampled
    channels.
    """
    try:
        image = oiio.ImageInput.open(str(path))
    except (RuntimeError, ValueError, UnicodeError) as error:
        if (limit := thread_limit_error(error)) is not None:  # that is no damage of the file
            raise limit from error
        image = None
    if image is None:
        reason = _first_line(oiio.geterror)
        if "ubsampled" not in reason:
            raise damaged_error(path, reason)
        steps: dict[str, tuple[int, int]] = {}  # across and down, of the channels that lack pixels
        with suppress(OSError, ValueError):
            with path.open("rb", buffering=0) as file:
                raw = RawHeader.read(file, path.stat().st_size)
            for attribute in raw.attributes:
                if attribute.kind == b"chlist":
                    for name, _, pixel_steps in channels_in(attribute.value):
                        if pixel_steps != (1, 1):
                            steps[name.decode("utf-8", "replace")] = pixel_steps
        if {name.rpartition(".")[2] for name in steps} == {"RY", "BY"}:
            raise LayoutError(
                f"{path} holds luminance and chroma (Y, RY, BY) in channels of different sizes, "
                "which is not read; write it as RGB"
            )
        listed = ", ".join(f"{name} (1 pixel in {x}x{y})" for name, (x, y) in steps.items())
        raise LayoutError(
            f"{path} is not read, as it has subsampled channels, stored at a lower resolution than "
            f"the others{listed and ': '}{listed}; render them at full resolution, or leave them "
            "out"
        )
    return image


def read_headers(path: Path) -> tuple[dict[str, Any], ...]:
    """Read the attributes of every part; see `RawHeader.typed`.

    Raises DamagedFileError when a header cannot be read. Raises InputError as `ExrFile`.
    """
    with ExrFile(path) as file:
        return file.header.attributes


def deep_image_error(path: Path) -> LayoutError:
    """Build the error for a file whose pixels are deep samples."""
    # They are not flattened here: compositing by depth is right for colour alone, and would mix
    # the ids, normals and vectors of what lies behind one another.
    return LayoutError(
        f"{path} is a deep image, which is not read; give the flat render, or flatten the colour "
        "with 'oiiotool IN --flatten -o OUT'"
    )


def damaged_error(path: Path, reason: str) -> DamagedFileError:
    """Build the error for a file that cannot be decoded."""
    text = " ".join(reason.split()).rstrip(".")  # decoders write several lines
    detail = f" ({text})" if text else ""
    return DamagedFileError(
        f"{path} is truncated, damaged or not an OpenEXR file{detail}; render or copy it again"
    )


def _first_line(geterror: Callable[[], str]) -> str:
    """Return the first line of a decoder's error; it may quote the file's broken bytes."""
    with suppress(UnicodeDecodeError):
        return next(iter(geterror().strip().splitlines()), "")
    return ""
