"""The parts of an OpenEXR file, and the channels in them, by its header or by OpenImageIO."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from exwarp_cli.domain.frame import Window
from exwarp_cli.io.exr.header import decode

if TYPE_CHECKING:
    import OpenImageIO as oiio

UINT, HALF, FLOAT = 0, 1, 2
PIXEL_TYPES = {UINT: "uint", HALF: "half", FLOAT: "float"}

SIZES = {
    b"int": 4,
    b"float": 4,
    b"double": 8,
    b"rational": 8,
    b"timecode": 8,
    b"keycode": 28,
    b"v2i": 8,
    b"v2f": 8,
    b"v2d": 16,
    b"v3i": 12,
    b"v3f": 12,
    b"v3d": 24,
    b"envmap": 1,
    b"m33f": 36,
    b"m33d": 72,
    b"m44f": 64,
    b"m44d": 128,
    b"box2i": 16,
    b"box2f": 16,
    b"chromaticities": 32,
    b"compression": 1,
    b"lineOrder": 1,
}
"""Bytes of attributes, by the types that are of one size."""

Values = Mapping[bytes, tuple[bytes, bytes]]
"""Type and value of each attribute of a header."""


@dataclass(frozen=True)
class Channel:
    """One channel of one part.

    Attributes
    ----------
    part
        Index of the part in the file.
    index
        Index of the channel in the part, in the order that OpenImageIO has.
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
        In the order that OpenImageIO has.
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


def part_from_spec(index: int, spec: oiio.ImageSpec, multipart: bool) -> Part:
    """Describe a part by OpenImageIO's specification."""
    name = _string(spec.getattribute("oiio:subimagename")) if multipart else ""
    formats = [str(f) for f in spec.channelformats] or [str(spec.format)] * spec.nchannels
    view = _string(spec.getattribute("view"))
    return Part(
        index,
        name,
        Window(spec.x, spec.y, spec.width, spec.height),
        Window(spec.full_x, spec.full_y, spec.full_width, spec.full_height),
        _named(index, name, view, zip(spec.channelnames, formats, strict=True)),
        view,
        bool(spec.deep),
        spec.tile_width > 0,
        _strings(spec.getattribute("multiView")),
    )


def part_from_header(
    index: int, values: Values, channels: Iterable[tuple[bytes, int]], multipart: bool
) -> Part:
    """Describe a part of flat pixels by its header, as `part_from_spec` does.

    Parameters
    ----------
    index, values
        Of the part. Windows are whole and valid.
    channels
        Name and pixel type of each.
    multipart
        Whether the file has several parts.

    Raises
    ------
    ValueError
        When texts are stored in an unusual way.
    """
    name, view = _text(values, b"name"), _text(values, b"view")
    if values.get(b"multiView", (b"stringvector", b""))[0] != b"stringvector":
        raise ValueError("multiView is no list")
    # OpenImageIO drops the attributes after a broken one.
    if any(len(value) != SIZES.get(kind, len(value)) for kind, value in values.values()):
        raise ValueError("an attribute has a wrong size")
    lists = {n: _text_list(values, n) for n, (kind, _) in values.items() if kind == b"stringvector"}
    name = name if multipart else ""
    listed = ((decode(raw), PIXEL_TYPES[kind]) for raw, kind in in_openimageio_order(channels))
    return Part(
        index,
        name,
        window_of(values, b"dataWindow"),
        window_of(values, b"displayWindow"),
        _named(index, name, view, listed),
        view,
        False,
        b"tiles" in values,
        lists.get(b"multiView", ()),
    )


def window_of(values: Values, name: bytes) -> Window:
    """Return a window of a header."""
    left, top, right, bottom = struct.unpack("<4i", values[name][1])
    return Window(left, top, right - left + 1, bottom - top + 1)


def with_distinct_names(parts: Iterable[Part]) -> tuple[Part, ...]:
    """Return parts whose channels have names of their own, among those of one view."""
    taken: set[tuple[str, str]] = set()
    distinct = []
    for part in parts:
        layer = _without_view(part.view, part.name)
        own = {channel.name for channel in part.channels if (part.view, channel.name) in taken}
        channels = tuple(
            replace(channel, name=f"{layer}.{channel.name}") if channel.name in own else channel
            for channel in part.channels
        )
        distinct.append(replace(part, channels=channels))
        if not part.deep:
            taken |= {(part.view, channel.name) for channel in channels}
    return tuple(distinct)


_ORDER = (
    b"r red g green b blue y real imag a alpha ar ra ag ga ab ba z depth zback".split(),
    b"r red g green b blue x y z real imag a alpha ar ra ag ga ab ba depth zback".split(),
)
"""Last elements of names that OpenImageIO sorts first: in a usual layer, and in one of a vector."""


def in_openimageio_order(channels: Iterable[tuple[bytes, int]]) -> list[tuple[bytes, int]]:
    """Sort names and types of channels as OpenImageIO does: layer by layer, RGBA first.

    Raises
    ------
    ValueError
        When OpenImageIO takes them for luminance and chroma, and gives them other names.
    """
    layers: dict[bytes, dict[bytes, tuple[bytes, int]]] = {}
    for name, kind in channels:
        dot = name.rfind(b".") + 1
        layers.setdefault(name[:dot], {})[name[dot:]] = name, kind
    if {b"y", b"ry", b"by"} <= {last.lower() for layer in layers.values() for last in layer}:
        raise ValueError("luminance and chroma")
    ordered = []
    for _, layer in sorted(layers.items()):
        letters = {last.lower() for last in layer}
        vector = b"x" in letters and bool(letters & {b"y", b"z"})
        rank = {last: i for i, last in enumerate(_ORDER[vector])}
        ordered += [
            channel
            for _, _, channel in sorted(
                (rank.get(last.lower(), len(rank)), last, channel)
                for last, channel in layer.items()
            )
        ]
    return ordered


def _named(
    part: int, part_name: str, view: str, channels: Iterable[tuple[str, str]]
) -> tuple[Channel, ...]:
    """Return channels, of which raw names and types are given, with the names to know them by."""
    layer = _without_view(view, part_name)
    return tuple(
        Channel(part, i, raw if not layer or "." in raw else f"{layer}.{raw}", raw, pixel_type)
        for i, (raw, pixel_type) in enumerate(channels)
    )


def _without_view(view: str, name: str) -> str:
    """Take a view off a part's name, where it is an element: "depth_left", "left.depth"."""
    if not view:
        return name
    element = re.compile(rf"(^|[._ -]){re.escape(view)}($|[._ -])")
    return element.sub(lambda m: m[1] if m[1] and m[2] else "", name, count=1)


def _string(value: object) -> str:
    return value if isinstance(value, str) else ""


def _strings(value: object) -> tuple[str, ...]:
    """Read an attribute of strings, which is a string where there is one alone."""
    if isinstance(value, str):
        return (value,) if value else ()
    return tuple(str(v) for v in value) if isinstance(value, (tuple, list)) else ()


def _text(values: Values, name: bytes) -> str:
    """Return an attribute that is a string; "" without."""
    kind, value = values.get(name, (b"string", b""))
    if kind != b"string" or b"\0" in value:
        raise ValueError(f"{decode(name)} is no plain text")
    return decode(value)


def _text_list(values: Values, name: bytes) -> tuple[str, ...]:
    """Return an attribute that is a list of strings."""
    value, texts, at = values[name][1], [], 0
    while at + 4 <= len(value):
        (size,) = struct.unpack_from("<I", value, at)
        texts.append(value[at + 4 : at + 4 + size])
        at += 4 + size
    if at != len(value) or b"" in texts or any(b"\0" in text for text in texts):
        raise ValueError(f"{decode(name)} is no plain list")
    return tuple(decode(text) for text in texts)
