"""What a generated frame takes over from its key frame's file: parts, channels, types, headers.

The header may also contain how long the frame took to render: `render_seconds`.
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
from exwarp_cli.errors import LayoutError
from exwarp_cli.io.channels import ChannelRef
from exwarp_cli.io.exr.header import Part
from exwarp_cli.io.exr.reader import HeaderCache, damaged_error
from exwarp_cli.io.exr.writer import OutputChannel, PendingHalf
from exwarp_cli.io.layers import Layer, LayerKind
from exwarp_cli.io.views import list_views, view_channels

HALF_MAX = 65504.0

PREFIX = "exwarp:"  # of ExWarp's own attributes, which describe one generated frame

# Structure, which the writer sets itself; and what belongs to the source frame's own pixels.
_NOT_CARRIED = frozenset(
    [
        *("channels", "chunkCount", "dataWindow", "displayWindow", "lineOrder", "tiles", "type"),
        *("version", "compression", "view", "multiView", "maxSamplesPerPixel", "dataHash"),
        *("preview", "idManifest", "timeCode", "keyCode", "framesPerSecond"),
    ]
)

PIXEL_TYPES = {"half": np.float16, "float": np.float32, "uint": np.uint32}

# A channel of one view: the view's name, "" where there are none, and the channel in it.
PlaneKey = tuple[str, ChannelRef]

# Attributes with the render time: Blender's, V-Ray's, and those of Cycles' render layers.
BLENDER, VRAY = "RenderTime", "vrayInfo/rendertime"
_CYCLES_LAYER = re.compile(r"cycles\..*\.render_time", re.DOTALL)
_CLOCK = re.compile(r"(?:(?:(\d+):)?(\d+):)?(\d+(?:\.\d+)?)")
_UNITS = re.compile(r"(?:(\d+)h)?\s*(?:(\d+)m)?\s*(\d+(?:\.\d+)?)s")


@dataclass(frozen=True)
class Plane:
    """One channel of a generated frame: values [H, W] of any type, and their window."""

    values: np.ndarray
    window: Window


@dataclass(frozen=True)
class ViewLayers:
    """The layers of one view of a shot that are written."""

    view: str  # its name; "" where there are none
    within: str  # which view of the files it is, as in :func:`exwarp_cli.io.views.view_channels`
    colour: tuple[ChannelRef, ...]  # R, G, B and, if there, A of the beauty
    layers: tuple[Layer, ...] = ()  # further layers; the beauty may be among them

    @property
    def keys(self) -> dict[PlaneKey, bool]:
        """Every channel, the beauty's first, and whether its values are bounded."""
        bounded = {(self.view, ref): True for ref in self.colour}
        for layer in self.layers:
            for ref in layer.refs:
                bounded.setdefault((self.view, ref), layer.kind is not LayerKind.DEPTH)
        return bounded


@dataclass(frozen=True)
class PlaneTemplate:
    """One channel to write."""

    key: PlaneKey  # which one it is
    name: str  # as it stands in the file
    dtype: np.dtype[Any]  # pixel type: half, float or uint32
    # Whether values beyond the type's range become its largest; a depth may be infinite
    bounded: bool

    def channel(self, values: np.ndarray) -> OutputChannel:
        """Return values [H, W] in the channel's type; floats for halfs are rounded later."""
        if self.dtype == np.float32 and values.dtype == np.float32 and self.bounded:
            return replace_overflow(np.ascontiguousarray(values))
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
    """One part to write."""

    header: Mapping[str, Any]  # attributes to carry, with the part's compression
    planes: tuple[PlaneTemplate, ...]  # its channels
    window: Window  # the data window of the source's part


@dataclass(frozen=True)
class Template:
    """What a generated frame takes over from its key frame's file."""

    parts: tuple[PartTemplate, ...]  # in the order of the file, those of which something is written
    colour: tuple[PlaneTemplate, ...]  # the beauty of the leading view: R, G, B and, if there, A
    # Seconds that the key frame took to render, and the attribute with them; None if unknown
    render: tuple[float, str] | None = None

    @property
    def planes(self) -> Iterator[PlaneTemplate]:
        """Every channel to write."""
        return (plane for part in self.parts for plane in part.planes)


def read_template(
    path: Path, wanted: tuple[ViewLayers, ...], headers: HeaderCache | None = None
) -> Template:
    """Read what a generated frame takes over from the file of its key frame.

    Raises DamagedFileError when the header cannot be read, or a colour channel is missing. Raises
    LayoutError when a layer is missing.

    Parameters
    ----------
    path
        The key frame's file.
    wanted
        What is written of each view, the leading one first. A channel that several of them have
        in common is the first one's.
    headers
        Where the file's header may be kept; None to open the file.
    """
    header = (headers or HeaderCache()).read(path)
    parts, attributes = header.parts, header.attributes
    placed: dict[int, dict[int, PlaneTemplate]] = {}
    for layers in wanted:
        channels = view_channels(parts, layers.within)
        for key, bounded in layers.keys.items():
            ref = key[1]
            channel = channels.get(ref.name)
            if channel is None and ref in layers.colour:
                raise damaged_error(path, "its colour channels are gone")
            if channel is None:
                raise LayoutError(
                    f"{path} has no channel {ref.name!r}, which the sequence's first frame has; "
                    "render all frames with the same passes, or leave that layer out of --layers"
                )
            dtype = np.dtype(PIXEL_TYPES.get(channel.pixel_type, np.float32))
            plane = PlaneTemplate(key, channel.raw_name, dtype, bounded)
            placed.setdefault(channel.part, {}).setdefault(channel.index, plane)
    written_views = [layers.within for layers in wanted]
    part_templates = tuple(
        PartTemplate(
            _carried_header(attributes[index], parts, index, written_views),
            tuple(plane for _, plane in sorted(planes.items())),
            parts[index].data_window,
        )
        for index, planes in sorted(placed.items())
    )
    by_key = {plane.key: plane for part in part_templates for plane in part.planes}
    colour = tuple(by_key[wanted[0].view, ref] for ref in wanted[0].colour)
    return Template(part_templates, colour, render_seconds(attributes))


def quantise_colour(pixels: Float32, template: Template) -> Float32:
    """Round pixels to the types of the file, so that scores hold for the written frame.

    Values beyond a type's range become its largest, not infinity.
    """
    out = pixels.copy()
    for i, plane in enumerate(template.colour):
        if plane.dtype == np.float16:
            out[..., i] = PendingHalf(pixels[..., i], plane.bounded).rounded()
        elif plane.dtype == np.float32 and plane.bounded:
            out[..., i] = replace_overflow(pixels[..., i])
    return out


def replace_overflow(values: Float32) -> Float32:
    """Return generated values with the largest floats in place of infinity, and 0 for NaN."""
    if not nonfinite_pixels(values[..., None]).any():
        return values
    return np.nan_to_num(values)


def _carried_header(
    header: Mapping[str, Any], parts: tuple[Part, ...], index: int, written_views: Iterable[str]
) -> dict[str, Any]:
    """Return the attributes that go over; of the views of one part those that are written."""
    carried = {
        name: value
        for name, value in header.items()
        if name not in _NOT_CARRIED and not name.startswith(PREFIX) and (name != "name" or value)
    }
    carried["compression"] = header["compression"]
    part = parts[index]
    if part.view:
        carried["view"] = part.view
        return carried
    # Views side by side in one part, the hero first.
    views = part.views or (list_views(parts) if len(parts) == 1 else ())
    written = {view or (views[0] if views else "") for view in written_views}
    if kept_views := [view for view in views if view in written]:
        carried["multiView"] = kept_views
    return carried


def render_seconds(headers: Iterable[Mapping[str, Any]]) -> tuple[float, str] | None:
    """Return how many seconds a frame took to render, and the attribute that contains it.

    None where no attribute contains it, or none is above 0. The headers are those of every part of
    the frame's file. Parts repeat the attributes of the whole frame, so the first one counts.
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
            if _CYCLES_LAYER.fullmatch(name) and (seconds := parse_duration(value)):
                layers.setdefault(name, seconds)
    return (sum(layers.values()), "cycles.*.render_time") if layers else None


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
