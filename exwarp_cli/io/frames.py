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
from exwarp_cli.io.channels import ChannelRef, Role, detect, require
from exwarp_cli.io.cryptomatte import find_cryptomattes
from exwarp_cli.io.exr.reader import ExrFile
from exwarp_cli.io.shot import Shot as Shot
from exwarp_cli.io.shot import open_shot as open_shot
from exwarp_cli.io.shot import plain, renamed
from exwarp_cli.io.soundness import count_broken
from exwarp_cli.io.views import channels_of, choose, views_of
from exwarp_cli.runtime.frame_pool import pool

FAR = 1e9
"""Depth from which on a pixel counts as background: Blender writes 1e10 there."""

MAX_BROKEN = 0.5
"""Share of non-finite colour from which on a frame is refused rather than repaired."""

GEOMETRY = (Role.DEPTH, Role.NORMAL, Role.POSITION, Role.STENCIL, Role.MOTION)
SURFACE = (Role.ALBEDO, Role.SPECULAR, Role.ROUGHNESS, Role.METALLIC)


@dataclass(frozen=True)
class RawFrame:
    """One frame before the meaning of its motion channels is settled.

    Attributes
    ----------
    number
        Frame number.
    path
        The frame's main file.
    image
        Colour; None for G-buffers without colour.
    gbuffer
        Geometry without motion, on the window of `image`, else on the display window.
    motion
        float32 [H, W, C]: the motion channels as written; None without.
    broken
        How many pixels of the colour are NaN or infinite; None where that is not known at once.
    """

    number: int
    path: Path
    image: Image | None
    gbuffer: GBuffer
    motion: Float32 | None
    broken: int | None = None

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
        """Return the frame for synthesis."""
        if self.image is None:
            raise LayoutError(f"{self.path} has no colour channels; render the beauty pass")
        gbuffer = self.settle(convention)
        return KeyFrame(self.number, self.image, gbuffer, self.broken)


def read_raw(
    shot: Shot,
    number: int,
    roles: tuple[Role, ...] = (Role.COLOUR, *GEOMETRY),
    objects: bool = False,
) -> RawFrame:
    """Read the channels of some roles of one frame.

    Parameters
    ----------
    shot, number
        The frame.
    roles
        What is read of it. With `Role.STENCIL` ids of what moves are read from a Cryptomatte, too.
    objects
        Whether to read the ids of whatever is shown with that role, where nothing says what moves.

    Raises
    ------
    InputError
        When a file is missing, damaged, of another size, lacks a channel, or is mostly NaN.
    """
    refs = {role: shot.layout.roles[role] for role in roles if role in shot.layout}
    ids = shot.ids if Role.STENCIL in roles else None
    if ids is not None and ids.dynamic is None and not objects:
        ids = None
    ranks = () if ids is None else ids.cryptomatte.stencil
    found = _Planes(*read_planes(shot, number, *refs.values(), ranks), refs)
    path = shot.sequence.files[number]
    canvas = found.windows[refs[Role.COLOUR][0]] if Role.COLOUR in refs else shot.display
    image = None
    if (pixels := found.stack(Role.COLOUR, canvas)) is not None:
        image = Image(pixels, canvas, shot.display)
        _refuse_broken(found.broken[Role.COLOUR.value] / canvas.pixels, path)
    gbuffer = _geometry(found, shot, canvas)
    if ids is not None:
        source = shot.files(number)[ids.cryptomatte.aov]
        stencil, shown = ids.read(
            found.joined(Role.STENCIL, ranks, canvas, 0.0), gbuffer.depth, source
        )
        gbuffer = replace(gbuffer, stencil=stencil, objects=shown)
    raw = RawFrame(number, path, image, gbuffer, _motion(found, shot, canvas), found.broken_colour)
    shot.nonfinite.note(number, found.broken)
    return raw


@dataclass(frozen=True)
class _Planes:
    """Channels of a frame as read, with the data window of each, and those of each role.

    In `broken` is counted how many pixels of what was asked for are not finite, by role.
    """

    planes: Mapping[ChannelRef, np.ndarray]
    windows: Mapping[ChannelRef, Window]
    refs: Mapping[Role, tuple[ChannelRef, ...]]
    broken: dict[str, int] = field(default_factory=dict)

    def stack(
        self, role: Role, canvas: Window, fill: float = 0.0, count: bool = True
    ) -> Float32 | None:
        """Return a role's channels, float32 [H, W, C] on a canvas; None where it is not there.

        Without `count` what covers just the canvas is left for others to look through.
        """
        if role not in self.refs:
            return None
        return self.joined(role, self.refs[role], canvas, fill, count)

    @property
    def broken_colour(self) -> int | None:
        """Pixels of the colour that are not finite; None unless all its channels lie alike."""
        known = Role.COLOUR in self.refs and self.window(self.refs[Role.COLOUR]) is not None
        return self.broken[Role.COLOUR.value] if known else None

    def window(self, refs: tuple[ChannelRef, ...]) -> Window | None:
        """Return the data window that all these channels have; None where they differ."""
        windows = {self.windows[ref] for ref in refs}
        return windows.pop() if len(windows) == 1 else None

    def joined(
        self,
        role: Role,
        refs: tuple[ChannelRef, ...],
        canvas: Window,
        fill: float,
        count: bool = True,
    ) -> Float32:
        """Return channels of a role, float32 [H, W, C] on a canvas; see `stack`."""
        members = [self.planes[ref].astype(np.float32, copy=False) for ref in refs]
        if (window := self.window(refs)) is not None:
            pixels = joined(members)
            if count or window != canvas:
                self.broken[role.value] = count_broken((pixels,), role)
            return place_on_canvas(pixels, window, canvas, fill)
        self.broken[role.value] = count_broken(members, role)
        placed = [
            place_on_canvas(plane, self.windows[ref], canvas, fill)
            for ref, plane in zip(refs, members, strict=True)
        ]
        return joined(placed)


def _geometry(found: _Planes, shot: Shot, canvas: Window) -> GBuffer:
    """Return what was read but colour and motion."""
    depth = found.stack(Role.DEPTH, canvas, np.inf)
    normal = found.stack(Role.NORMAL, canvas, count=False)
    stencil = None
    if Role.STENCIL in found.refs:
        ref = found.refs[Role.STENCIL][0]
        plane = found.planes[ref]
        found.broken[Role.STENCIL.value] = count_broken((plane,), Role.STENCIL)
        stencil = place_on_canvas(clean_stencil(plane), found.windows[ref], canvas)
    known, finite = None, False
    if depth is not None:
        known, finite = cleaned(shot.depth.distance(depth[..., 0]), normal)
    if normal is not None and Role.NORMAL.value not in found.broken:
        found.broken[Role.NORMAL.value] = 0 if finite else count_broken((normal,), Role.NORMAL)
    return GBuffer(
        canvas,
        known,
        normal,
        _positions(found, canvas, known),
        stencil,
        albedo=_finite(found.stack(Role.ALBEDO, canvas)),
        specular=_finite(found.stack(Role.SPECULAR, canvas)),
        roughness=_only(_finite(found.stack(Role.ROUGHNESS, canvas))),
        metallic=_only(_finite(found.stack(Role.METALLIC, canvas))),
    )


def _motion(found: _Planes, shot: Shot, canvas: Window) -> Float32 | None:
    """Return the motion channels, NaN outside the display window where a channel ends before it.

    Inside the display window a channel is 0 beyond its data window, as OpenEXR defines it: programs
    cut a pass to the pixels that are not 0.
    """
    motion = found.stack(Role.MOTION, canvas)
    if motion is None or shot.display.covers(canvas):
        return motion
    unseen = outside_mask(canvas, shot.display)
    for i, ref in enumerate(found.refs[Role.MOTION]):
        if not found.windows[ref].covers(canvas):
            motion[unseen & outside_mask(canvas, found.windows[ref]), i] = np.nan
    return motion


def _positions(found: _Planes, canvas: Window, depth: Float32 | None) -> Float32 | None:
    """Return world positions, NaN where a surface is seen beyond the end of their window.

    As zeros those pixels would be points at the world's origin, and be moved to where that is seen.
    """
    position = found.stack(Role.POSITION, canvas)
    if position is None or depth is None:
        return position
    window = found.windows[found.refs[Role.POSITION][0]]
    if window.covers(canvas):
        return position
    unknown = outside_mask(canvas, window) & np.isfinite(depth)
    return np.where(unknown[..., None], np.float32(np.nan), position)


def _finite(planes: Float32 | None) -> Float32 | None:
    """Return surface colour with 0 where the renderer's value is unusable."""
    if planes is None or np.isfinite(planes).all():
        return planes
    return np.where(np.isfinite(planes), planes, np.float32(0))


def _only(planes: Float32 | None) -> Float32 | None:
    """Return the one plane of [H, W, 1]."""
    return None if planes is None else planes[..., 0]


def read_image(path: Path, view: str = "") -> Image:
    """Read the colour of the beauty layer of one file.

    Parameters
    ----------
    path
        The file.
    view
        Which view of it; "" for the hero. Files without views are of any.

    Raises
    ------
    InputError
        When the file is missing or damaged.
    LayoutError
        When no colour is recognised.
    """
    with ExrFile(path) as file:
        views = views_of(file.parts)
        channels = channels_of(file.parts, choose(views, view or None, path) if views else "")
        mattes = find_cryptomattes({"": renamed(channels)}, {"": file.header.texts})
        layout = detect({"": plain(channels, mattes)})
        refs = require(layout, Role.COLOUR, str(path), channels)
        chosen = [channels[ref.name] for ref in refs]
        planes = file.read(chosen)
        part = file.parts[chosen[0].part]
        windows = [file.parts[channel.part].data_window for channel in chosen]
    pixels = joined(
        [
            place_on_canvas(
                planes[channel].astype(np.float32, copy=False), window, part.data_window
            )
            for channel, window in zip(chosen, windows, strict=True)
        ]
    )
    return Image(pixels, part.data_window, part.display_window)


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


def joined(planes: list[np.ndarray]) -> Float32:
    """Join planes [H, W] to a C-contiguous array [H, W, C].

    Planes that lie interleaved in one array already, as a part of just these channels is decoded,
    are not copied: copying took as long as decoding.
    """
    first, count = planes[0], len(planes)
    step = first.itemsize
    starts = [plane.__array_interface__["data"][0] for plane in planes]
    together = all(p.strides == first.strides and p.dtype == first.dtype for p in planes)
    if (
        together
        and first.strides == (first.shape[1] * count * step, count * step)
        and starts == [starts[0] + i * step for i in range(count)]
    ):
        strides = (*first.strides, step)
        return np.lib.stride_tricks.as_strided(first, (*first.shape, count), strides)
    return np.stack(planes, axis=-1)


def cleaned(depth: Float32, normal: Float32 | None) -> tuple[Float32, bool]:
    """Return depth with every way of writing background made +inf.

    Background is written as 0, 1e10, infinity or NaN; Unreal marks it by the normal (-1, -1, -1).
    The second value tells whether there are normals, all of them finite.
    """
    from exwarp_cli.kernels import raw_channels  # numba: not for what only lists channels

    out: Float32 = pool.empty(depth.shape, np.float32)
    flat, far = np.ascontiguousarray(depth, np.float32).reshape(-1), np.float32(FAR)
    if normal is None:
        raw_channels.write_depths(flat, far, out.reshape(-1))
        return out, False
    normals = np.ascontiguousarray(normal, np.float32).reshape(-1)
    return out, raw_channels.write_depths_by_normal(flat, normals, far, out.reshape(-1))


def clean_stencil(ids: np.ndarray) -> Int32:
    """Return ids, uint32 or float32, as int32; -1 where a fraction tells of mixed ones."""
    if ids.dtype == np.uint32:
        return (ids & np.uint32(0x7FFFFFFF)).astype(np.int32)
    from exwarp_cli.kernels.raw_channels import round_ids  # numba: not for what only lists channels

    # Passes over the frame took 15 times as long.
    out: Int32 = pool.empty(ids.shape, np.int32)
    round_ids(np.ascontiguousarray(ids, np.float32).reshape(-1), out.reshape(-1))
    return out


def _refuse_broken(share: float, path: Path) -> None:
    if share > MAX_BROKEN:
        raise DamagedFileError(
            f"{path} has NaN or infinite colour in {share:.0%} of its pixels; render it again"
        )


def colour_window(shot: Shot, number: int) -> Window:
    """Return the data window of a frame's colour, from its header alone.

    Raises
    ------
    InputError
        When the file is missing or damaged, or has no such channel.
    """
    ref = shot.layout.roles[Role.COLOUR][0]
    path = shot.files(number)[ref.aov]
    parts = shot.headers.read(path).parts
    channel = shot.channels(parts, ref.aov).get(ref.name)
    if channel is None:
        raise LayoutError(f"{path} has no channel {ref.name!r}; render it again")
    return parts[channel.part].data_window


def is_seen(shot: Shot, number: int) -> bool:
    """Whether a frame's colour has a pixel in the display window; also where no header tells."""
    if Role.COLOUR not in shot.layout:
        return True
    with suppress(InputError):
        return colour_window(shot, number).meets(shot.display)
    return True


def require_seen(shot: Shot) -> None:
    """Refuse a shot of which no frame has a pixel in the display window.

    A frame alone may have none: an object that enters later is rendered beyond the edge.

    Raises
    ------
    LayoutError
        When all frames lie apart from it.
    """
    numbers = shot.sequence.numbers
    if is_seen(shot, shot.first) or any(is_seen(shot, number) for number in numbers):
        return
    window = colour_window(shot, shot.first)
    raise LayoutError(
        f"the data window {window} of {shot.sequence.files[shot.first]} lies apart from its "
        f"display window {shot.display}, and so in every frame: nothing of the picture is seen; "
        "correct the windows, or render again"
    )


def read_planes(
    shot: Shot, number: int, *groups: Sequence[ChannelRef]
) -> tuple[dict[ChannelRef, np.ndarray], dict[ChannelRef, Window]]:
    """Read channels of one frame, with the data window of each; those of a group are joined."""
    planes: dict[ChannelRef, np.ndarray] = {}
    windows: dict[ChannelRef, Window] = {}
    files = shot.files(number)
    refs = [ref for group in groups for ref in group]
    for aov in sorted({ref.aov for ref in refs}):
        path = files[aov]
        with shot.headers.open(path, aov) as file:
            _same_size(file.parts[0].display_window, shot, path)
            channels = shot.channels(file.parts, aov)
            mine = [ref for ref in refs if ref.aov == aov]
            for ref in mine:
                if ref.name not in channels:
                    raise LayoutError(
                        f"{path} has no channel {ref.name!r}, which the sequence's first frame "
                        "has; render all frames with the same passes"
                    )
            pixels = file.read(
                *([channels[ref.name] for ref in group if ref.aov == aov] for group in groups)
            )
            for ref in mine:
                channel = channels[ref.name]
                planes[ref] = pixels[channel]
                windows[ref] = file.parts[channel.part].data_window
    return planes, windows


def _same_size(display: Window, shot: Shot, path: Path) -> None:
    if display != shot.display:
        raise LayoutError(
            f"{path} has the display window {display} where the sequence's first frame has "
            f"{shot.display}; render all frames at one resolution"
        )
