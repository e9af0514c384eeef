"""Frames of a sequence as typed arrays: colour, G-buffer and raw motion channels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from exwarp_cli.domain.frame import (
    Float32,
    GBuffer,
    Image,
    Int32,
    KeyFrame,
    Window,
    outside_mask,
    place_on_canvas,
)
from exwarp_cli.domain.motion import MotionConvention
from exwarp_cli.errors import DamagedFileError, InputError, LayoutError
from exwarp_cli.io.channels import ChannelRef, Role, detect_layout
from exwarp_cli.io.cryptomatte import IdReading, cryptomatte_refs, find_cryptomattes
from exwarp_cli.io.depth import FAR
from exwarp_cli.io.exr.reader import ExrFile
from exwarp_cli.io.exr.writer import Plane
from exwarp_cli.io.shot import Shot, count_nonfinite
from exwarp_cli.io.views import view_channels, view_in_file
from exwarp_cli.kernels import raw_channels
from exwarp_cli.runtime.frame_pool import pool

# Share of non-finite colour from which on a frame is refused rather than repaired.
MAX_BROKEN = 0.5

GEOMETRY = (Role.DEPTH, Role.NORMAL, Role.POSITION, Role.STENCIL, Role.MOTION)
SURFACE = (Role.ALBEDO, Role.SPECULAR, Role.ROUGHNESS, Role.METALLIC)


@dataclass(frozen=True)
class RawFrame:
    """One frame before the meaning of its motion channels is settled."""

    number: int
    path: Path  # the frame's main file
    image: Image | None
    # Geometry without motion, on the window of `image`, else on the display window.
    gbuffer: GBuffer
    # float32 [H, W, C]: the motion channels as written.
    motion: Float32 | None

    def settle(self, convention: MotionConvention | None) -> GBuffer:
        """Return the G-buffer with motion read by a convention."""
        if convention is None or self.motion is None:
            return self.gbuffer
        before, after = convention.to_previous, convention.to_next
        return replace(
            self.gbuffer,
            to_previous=None if before is None else before.apply(self.motion),
            to_next=None if after is None else after.apply(self.motion),
        )

    def key(self, convention: MotionConvention | None) -> KeyFrame:
        """Return the frame for synthesis; LayoutError if it has no colour."""
        if self.image is None:
            raise LayoutError(f"{self.path} has no colour channels; render the beauty pass")
        return KeyFrame(self.number, self.image, self.settle(convention))


def read_raw(
    shot: Shot,
    number: int,
    roles: tuple[Role, ...] = (Role.COLOUR, *GEOMETRY),
    objects: bool = False,
) -> RawFrame:
    """Read the channels of some roles of one frame.

    With `Role.STENCIL`, ids of what moves are read from a Cryptomatte, too; with `objects`, also
    the ids of every surface if nothing says what moves.

    Raises InputError if a file is missing, damaged, of another size, lacks a channel, or is mostly
    NaN.
    """
    refs = {role: shot.layout.roles[role] for role in roles if role in shot.layout}
    ids = shot.ids if Role.STENCIL in roles else None
    if ids is not None and ids.dynamic is None and not objects:
        ids = None
    if ids is not None:
        refs[Role.STENCIL] = ids.cryptomatte.ranks[0]
    planes = _Planes(read_planes(shot, number, *refs.values()), refs)
    path = shot.sequence.files[number]
    canvas = planes.planes[refs[Role.COLOUR][0]].window if Role.COLOUR in refs else shot.display
    image = None
    if (pixels := planes.stack(Role.COLOUR, canvas)) is not None:
        image = Image(pixels, canvas, shot.display)
        if (share := planes.broken[Role.COLOUR.value] / canvas.pixels) > MAX_BROKEN:
            raise DamagedFileError(
                f"{path} has NaN or infinite colour in {share:.0%} of its pixels; render it again"
            )
    gbuffer = _geometry(planes, shot, number, canvas, ids)
    motion = planes.stack(Role.MOTION, canvas)
    if motion is not None and not shot.display.covers(canvas):
        # Inside the display window a channel is 0 beyond its data window, as OpenEXR defines it:
        # programs cut a pass to the pixels that are not 0. Outside it is not known.
        overscan = outside_mask(canvas, shot.display)
        for i, ref in enumerate(refs[Role.MOTION]):
            window = planes.planes[ref].window
            if not window.covers(canvas):
                motion[overscan & outside_mask(canvas, window), i] = np.nan
    shot.nonfinite.note(number, planes.broken)
    return RawFrame(number, path, image, gbuffer, motion)


@dataclass(frozen=True)
class _Planes:
    """Channels of a frame as read, and the channels of each role."""

    planes: Mapping[ChannelRef, Plane]
    refs: Mapping[Role, tuple[ChannelRef, ...]]
    # Numbers of pixels that are not finite, by role, of what was joined so far.
    broken: dict[str, int] = field(default_factory=dict)

    def stack(self, role: Role, canvas: Window, fill: float = 0.0) -> Float32 | None:
        """Return a role's channels, float32 [H, W, C] on a canvas; None if it has none."""
        if role not in self.refs:
            return None
        planes = [self.planes[ref] for ref in self.refs[role]]
        members = [plane.values.astype(np.float32, copy=False) for plane in planes]
        windows = [plane.window for plane in planes]
        if len(set(windows)) == 1:
            members, windows = [join_planes(members)], windows[:1]
        self.broken[role.value] = count_nonfinite(members, role)
        pairs = zip(members, windows, strict=True)
        placed = [place_on_canvas(values, window, canvas, fill) for values, window in pairs]
        return placed[0] if len(placed) == 1 else join_planes(placed)


def _geometry(
    planes: _Planes, shot: Shot, number: int, canvas: Window, ids: IdReading | None
) -> GBuffer:
    """Return everything that was read but colour and motion; `ids` if they are a Cryptomatte's."""
    depth, written_depth = None, planes.stack(Role.DEPTH, canvas, np.inf)
    normal = planes.stack(Role.NORMAL, canvas)
    if written_depth is not None:
        depth = clean_depth(shot.depth.distance(written_depth[..., 0]), normal)
    stencil = objects = None
    if ids is not None and (ranks := planes.stack(Role.STENCIL, canvas)) is not None:
        file = shot.files(number)[ids.cryptomatte.aov]
        stencil, objects = ids.read(ranks, depth, file)
    elif Role.STENCIL in planes.refs:
        plane = planes.planes[planes.refs[Role.STENCIL][0]]
        planes.broken[Role.STENCIL.value] = count_nonfinite((plane.values,), Role.STENCIL)
        stencil = place_on_canvas(clean_stencil(plane.values), plane.window, canvas)
    position = planes.stack(Role.POSITION, canvas)
    if position is not None and depth is not None:
        window = planes.planes[planes.refs[Role.POSITION][0]].window
        if not window.covers(canvas):
            # A surface seen beyond the end of their window: as zeros those pixels would be points
            # at the world's origin, and be moved to where that is seen.
            unknown = outside_mask(canvas, window) & np.isfinite(depth)
            position = np.where(unknown[..., None], np.float32(np.nan), position)
    albedo, specular, roughness, metallic = (
        None if values is None else np.where(np.isfinite(values), values, np.float32(0))
        for values in (planes.stack(role, canvas) for role in SURFACE)
    )
    return GBuffer(
        canvas,
        depth,
        normal,
        position,
        stencil,
        albedo=albedo,
        specular=specular,
        roughness=None if roughness is None else roughness[..., 0],
        metallic=None if metallic is None else metallic[..., 0],
        objects=objects,
    )


def read_planes(shot: Shot, number: int, *groups: Sequence[ChannelRef]) -> dict[ChannelRef, Plane]:
    """Read channels of one frame on their data windows; a group is decoded as one array."""
    planes: dict[ChannelRef, Plane] = {}
    files = shot.files(number)
    refs = [ref for group in groups for ref in group]
    for aov in sorted({ref.aov for ref in refs}):
        path = files[aov]
        with shot.headers.open(path, aov) as file:
            display = file.parts[0].display_window
            if display != shot.display:
                raise LayoutError(
                    f"{path} has the display window {display} where the sequence's first frame has "
                    f"{shot.display}; render all frames at one resolution"
                )
            channels = shot.channels(file.parts, aov)
            in_file = [ref for ref in refs if ref.aov == aov]
            for ref in in_file:
                if ref.name not in channels:
                    raise LayoutError(
                        f"{path} has no channel {ref.name!r}, which the sequence's first frame "
                        "has; render all frames with the same passes"
                    )
            pixels = file.read(
                *([channels[ref.name] for ref in group if ref.aov == aov] for group in groups)
            )
            for ref in in_file:
                channel = channels[ref.name]
                planes[ref] = Plane(pixels[channel], file.parts[channel.part].data_window)
    return planes


def read_image(path: Path, view: str = "") -> Image:
    """Read the colour of the beauty layer of one file; "" is the hero view.

    Raises InputError if the file is missing or damaged, LayoutError if no colour is recognised.
    """
    with ExrFile(path) as file:
        channels = view_channels(file.parts, view_in_file(file.parts, view, path))
        mattes = find_cryptomattes({"": channels.values()}, {"": file.header.texts})
        layout = detect_layout({"": channels.values()}, cryptomatte_refs(mattes))
        if Role.COLOUR not in layout:
            partly = layout.incomplete.get(Role.COLOUR, "")
            raise LayoutError(
                f"{path} has no colour channels that are recognised{partly and f' ({partly})'}, "
                f"only {', '.join(channels)}; name them in a channel map, or render the missing "
                "pass"
            )
        colour = [channels[ref.name] for ref in layout.roles[Role.COLOUR]]
        planes = file.read(colour)
        part = file.parts[colour[0].part]
        placed = []
        for channel in colour:
            plane = planes[channel].astype(np.float32, copy=False)
            window = file.parts[channel.part].data_window
            placed.append(place_on_canvas(plane, window, part.data_window))
    return Image(join_planes(placed), part.data_window, part.display_window)


def read_plane(path: Path, name: str) -> tuple[Float32, Window, Window]:
    """Read one channel by name: float32 [H, W], its data window and the display window."""
    with ExrFile(path) as file:
        for part in file.parts:
            for channel in part.channels:
                if name in (channel.name, channel.raw_name):
                    plane = file.read([channel])[channel].astype(np.float32)
                    return np.ascontiguousarray(plane), part.data_window, part.display_window
        names = ", ".join(channel.name for part in file.parts for channel in part.channels)
    raise LayoutError(f"{path} has no channel {name!r}, only {names}; name one of them")


def join_planes(planes: list[np.ndarray]) -> Float32:
    """Join planes [H, W] to a C-contiguous array [H, W, C]."""
    # Planes that lie interleaved in one array already, as a part of just these channels is decoded,
    # are not copied: copying took as long as decoding.
    first, count = planes[0], len(planes)
    step = first.itemsize
    starts = [plane.__array_interface__["data"][0] for plane in planes]
    are_alike = all(p.strides == first.strides and p.dtype == first.dtype for p in planes)
    if (
        are_alike
        and first.strides == (first.shape[1] * count * step, count * step)
        and starts == [starts[0] + i * step for i in range(count)]
    ):
        strides = (*first.strides, step)
        return np.lib.stride_tricks.as_strided(first, (*first.shape, count), strides)
    return np.stack(planes, axis=-1)


def clean_depth(depth: Float32, normal: Float32 | None) -> Float32:
    """Return depth with +inf as background.

    Renderers write background as 0, 1e10, infinity or NaN; Unreal by the normal (-1, -1, -1).
    """
    cleaned: Float32 = pool.empty(depth.shape, np.float32)
    flat, far = np.ascontiguousarray(depth, np.float32).reshape(-1), np.float32(FAR)
    normals = np.zeros(0, np.float32)
    if normal is not None:
        normals = np.ascontiguousarray(normal, np.float32).reshape(-1)
    raw_channels.write_depths(flat, normals, far, cleaned.reshape(-1))
    return cleaned


def clean_stencil(ids: np.ndarray) -> Int32:
    """Return ids, uint32 or float32, as int32; -1 where a fraction tells of mixed ones."""
    if ids.dtype == np.uint32:
        return (ids & np.uint32(0x7FFFFFFF)).astype(np.int32)
    # numpy's passes over the frame took 15 times as long.
    cleaned: Int32 = pool.empty(ids.shape, np.int32)
    raw_channels.round_ids(np.ascontiguousarray(ids, np.float32).reshape(-1), cleaned.reshape(-1))
    return cleaned


def colour_window(shot: Shot, number: int) -> Window:
    """Return the data window of a frame's colour, from its header alone.

    Raises InputError if the file is missing or damaged, or has no such channel.
    """
    ref = shot.layout.roles[Role.COLOUR][0]
    path = shot.files(number)[ref.aov]
    parts = shot.headers.read(path).parts
    channel = shot.channels(parts, ref.aov).get(ref.name)
    if channel is None:
        raise LayoutError(f"{path} has no channel {ref.name!r}; render it again")
    return parts[channel.part].data_window


def is_visible(shot: Shot, number: int) -> bool:
    """Return True if a frame's colour has a pixel in the display window, or no header tells."""
    if Role.COLOUR not in shot.layout:
        return True
    with suppress(InputError):
        return colour_window(shot, number).meets(shot.display)
    return True


def require_visible(shot: Shot) -> None:
    """Refuse a shot of which no frame has a pixel in the display window."""
    # A frame alone may have none: an object that enters later is rendered beyond the edge.
    if any(is_visible(shot, number) for number in shot.sequence.numbers):
        return
    window = colour_window(shot, shot.first)
    raise LayoutError(
        f"the data window {window} of {shot.sequence.files[shot.first]} lies apart from its "
        f"display window {shot.display}, and so in every frame: nothing of the picture is seen; "
        "correct the windows, or render again"
    )
