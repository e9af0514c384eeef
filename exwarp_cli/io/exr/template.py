"""What a generated frame takes over from its key frame's file: parts, channels, types, headers.

The header may say how long the frame took to render, too: `render_seconds`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from exwarp_cli.domain.frame import Float32, Window, nonfinite_pixels
from exwarp_cli.errors import InputError, LayoutError
from exwarp_cli.io.channels import ChannelRef
from exwarp_cli.io.exr.parts import Part
from exwarp_cli.io.exr.reader import HeaderCache, damaged
from exwarp_cli.io.exr.writer import OutputChannel, PendingHalf
from exwarp_cli.io.layers import Kind, Layer
from exwarp_cli.io.views import channels_of, views_of

HALF_MAX = 65504.0

PREFIX = "exwarp:"
"""Of ExWarp's own attributes, which tell of one generated frame."""

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
        "multiView",
        "maxSamplesPerPixel",
        "dataHash",
        "preview",
        "idManifest",
        "timeCode",
        "keyCode",
        "framesPerSecond",
    ]
)

PIXEL_TYPES = {"half": np.float16, "float": np.float32, "uint": np.uint32}

PlaneKey = tuple[str, ChannelRef]
"""A channel of one view: the view's name, "" where there are none, and the channel in it."""


@dataclass(frozen=True)
class Plane:
    """One channel of a generated frame.

    Attributes
    ----------
    values
        [H, W] of any type.
    window
        Where they lie.
    """

    values: np.ndarray
    window: Window


@dataclass(frozen=True)
class ViewLayers:
    """What is written of one view of a shot.

    Attributes
    ----------
    view
        Its name; "" where there are none.
    within
        Which view of the files it is, as in :func:`exwarp_cli.io.views.channels_of`.
    colour
        R, G, B and, if there, A of the beauty.
    layers
        Layers beside; the beauty may be among them.
    """

    view: str
    within: str
    colour: tuple[ChannelRef, ...]
    layers: tuple[Layer, ...] = ()

    @property
    def keys(self) -> dict[PlaneKey, bool]:
        """Every channel, the beauty's first, and whether its values are bounded."""
        found = {(self.view, ref): True for ref in self.colour}
        for layer in self.layers:
            for ref in layer.refs:
                found.setdefault((self.view, ref), layer.kind is not Kind.DEPTH)
        return found


@dataclass(frozen=True)
class PlaneTemplate:
    """One channel to write.

    Attributes
    ----------
    key
        Which one it is.
    name
        As it stands in the file.
    dtype
        Pixel type: half, float or uint32.
    bounded
        Whether values beyond the type's range become its largest; a depth may be infinite.
    """

    key: PlaneKey
    name: str
    dtype: np.dtype[Any]
    bounded: bool

    def channel(self, values: np.ndarray) -> OutputChannel:
        """Return values [H, W] in the channel's type; floats for halfs are rounded later."""
        if self.dtype == np.float32 and values.dtype == np.float32 and self.bounded:
            return within_floats(np.ascontiguousarray(values))
        if self.dtype != np.float16 or values.dtype == np.float16:
            return np.ascontiguousarray(values, dtype=self.dtype)
        if values.dtype == np.float32:
            return PendingHalf(values, self.bounded)
        if self.bounded:
            values = np.clip(values, -HALF_MAX, HALF_MAX)
        with np.errstate(over="ignore"):
            return np.ascontiguousarray(values, dtype=np.float16)


@dataclass(frozen=True)
class PartTemplate:
    """One part to write.

    Attributes
    ----------
    header
        Attributes to carry, with the part's compression.
    planes
        Its channels.
    window
        The data window of the source's part.
    """

    header: Mapping[str, Any]
    planes: tuple[PlaneTemplate, ...]
    window: Window


@dataclass(frozen=True)
class Template:
    """What a generated frame takes over from its key frame's file.

    Attributes
    ----------
    parts
        In the order of the file, as far as something of them is written.
    colour
        The beauty of the view that leads: R, G, B and, if there, A.
    render
        Seconds that the key frame took to render, and the attribute that tells; None where none
        does.
    """

    parts: tuple[PartTemplate, ...]
    colour: tuple[PlaneTemplate, ...]
    render: tuple[float, str] | None = None

    @property
    def planes(self) -> Iterator[PlaneTemplate]:
        """Every channel to write."""
        return (plane for part in self.parts for plane in part.planes)


def read_template(
    path: Path, wanted: tuple[ViewLayers, ...], headers: HeaderCache | None = None
) -> Template:
    """Read what a generated frame takes over.

    Parameters
    ----------
    path
        The key frame's file.
    wanted
        What is written of each view, the one that leads first. A channel that several of them have
        in common is the first one's.

    headers
        Where the file's header may be kept; None to open the file.

    Raises
    ------
    DamagedFileError
        When the header cannot be read, or the colour is gone.
    LayoutError
        When a layer is gone.
    """
    header = (headers or HeaderCache()).read(path)
    parts, attributes = header.parts, header.attributes
    placed: dict[int, dict[int, PlaneTemplate]] = {}
    for layers in wanted:
        channels = channels_of(parts, layers.within)
        for key, bounded in layers.keys.items():
            channel = channels.get(key[1].name)
            if channel is None:
                raise _gone(path, key[1], layers)
            dtype = np.dtype(PIXEL_TYPES.get(channel.pixel_type, np.float32))
            plane = PlaneTemplate(key, channel.raw_name, dtype, bounded)
            placed.setdefault(channel.part, {}).setdefault(channel.index, plane)
    views = [layers.within for layers in wanted]
    made = tuple(
        PartTemplate(
            _header(attributes[index], parts[index], _views(parts, index, views)),
            tuple(plane for _, plane in sorted(planes.items())),
            parts[index].data_window,
        )
        for index, planes in sorted(placed.items())
    )
    every = {plane.key: plane for part in made for plane in part.planes}
    colour = tuple(every[wanted[0].view, ref] for ref in wanted[0].colour)
    return Template(made, colour, render_seconds(attributes))


def quantise(pixels: Float32, template: Template) -> Float32:
    """Round pixels to the types that the file will have, so that what is scored is what is kept.

    Values beyond a type's range become its largest, not infinity.
    """
    out = pixels.copy()
    for i, plane in enumerate(template.colour):
        if plane.dtype == np.float16:
            out[..., i] = PendingHalf(pixels[..., i], plane.bounded).rounded()
        elif plane.dtype == np.float32 and plane.bounded:
            out[..., i] = within_floats(pixels[..., i])
    return out


def within_floats(values: Float32) -> Float32:
    """Return made values with the largest floats where numbers near them overflowed on the way."""
    if not nonfinite_pixels(values[..., None]).any():
        return values
    return np.nan_to_num(values)


def _gone(path: Path, ref: ChannelRef, layers: ViewLayers) -> InputError:
    """Build the error for a frame without a channel that another one of its shot has."""
    if ref in layers.colour:
        return damaged(path, "its colour channels are gone")
    return LayoutError(
        f"{path} has no channel {ref.name!r}, which the sequence's first frame has; render all "
        "frames with the same passes, or leave that layer out of --layers"
    )


def _header(header: Mapping[str, Any], part: Part, views: tuple[str, ...]) -> dict[str, Any]:
    """Return the attributes that go over; of the views of one part those that are written."""
    kept = {k: v for k, v in header.items() if k not in _NOT_CARRIED and _writable(k, v)}
    kept["compression"] = header["compression"]
    if part.view:
        kept["view"] = part.view
    if views:
        kept["multiView"] = list(views)
    return kept


def _views(parts: tuple[Part, ...], index: int, written: Iterable[str]) -> tuple[str, ...]:
    """Return the views that lie in one part side by side and are written, the hero first."""
    if parts[index].view:
        return ()
    views = parts[index].views or (views_of(parts) if len(parts) == 1 else ())
    wanted = {view or (views[0] if views else "") for view in written}
    return tuple(view for view in views if view in wanted)


def _writable(name: str, value: object) -> bool:
    """Whether an attribute is no other frame's own, and can be written."""
    return not name.startswith(PREFIX) and (name != "name" or bool(value))


BLENDER, VRAY = "RenderTime", "vrayInfo/rendertime"

_LAYER = re.compile(r"cycles\..*\.render_time", re.DOTALL)
_CLOCK = re.compile(r"(?:(?:(\d+):)?(\d+):)?(\d+(?:\.\d+)?)")
_UNITS = re.compile(r"(?:(\d+)h)?\s*(?:(\d+)m)?\s*(\d+(?:\.\d+)?)s")


def render_seconds(headers: Iterable[Mapping[str, Any]]) -> tuple[float, str] | None:
    """Return how many seconds a frame took to render, and the attribute that tells it.

    Parameters
    ----------
    headers
        Of every part of the frame's file. Parts repeat the attributes of the whole frame, so the
        first that has one counts.

    Returns
    -------
    float and str, or None
        None where no attribute tells, or none is above 0.
    """
    listed = list(headers)
    for name in (BLENDER, VRAY):
        for header in listed:
            seconds = parse_duration(header.get(name))
            if seconds:
                return seconds, name
    layers: dict[str, float] = {}
    for header in listed:
        for name, value in header.items():
            if _LAYER.fullmatch(name) and (seconds := parse_duration(value)):
                layers.setdefault(name, seconds)
    if not layers:
        return None
    return sum(layers.values()), "cycles.*.render_time"


def parse_duration(value: object) -> float | None:
    """Read ``01:02:03.45``, ``02:03.45``, ``0h 28m 39.3s`` or a number of seconds; else None."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value) if math.isfinite(value) and value >= 0 else None
    if not isinstance(value, str):
        return None
    text = value.strip()
    match = _CLOCK.fullmatch(text) or _UNITS.fullmatch(text)
    if match is None:
        return None
    hours, minutes, seconds = match.groups()
    return 3600.0 * int(hours or 0) + 60.0 * int(minutes or 0) + float(seconds)
