"""Opening a shot: finding its sequences, and recognising its channels in the first frame.

A channel map corrects what was recognised, and AOVs of several files come together. What is damaged
in a frame, pixels that are no numbers too, shows when it is decoded.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from exwarp_cli.domain.frame import Bool, Window, nonfinite_pixels
from exwarp_cli.domain.timeline import ranges
from exwarp_cli.errors import InputError, LayoutError, MissingFrameError
from exwarp_cli.io.channel_map import AovFile, ChannelMap, detect_aov, find_channel
from exwarp_cli.io.channels import (
    BACKWARD_NAMES,
    FORWARD_NAMES,
    ChannelRef,
    Layout,
    Role,
    detect_layout,
)
from exwarp_cli.io.cryptomatte import Cryptomatte, IdReading, cryptomatte_refs, find_cryptomattes
from exwarp_cli.io.depth import DEFAULT_READINGS, DepthReading, depth_reading_by_name
from exwarp_cli.io.exr.header import Channel, Part
from exwarp_cli.io.exr.reader import ExrFile, FileHeader, HeaderCache, deep_image_error
from exwarp_cli.io.frame_names import split_pass
from exwarp_cli.io.sequences import AovSet, Sequence, find_aov_set, find_sequence
from exwarp_cli.io.views import choose_view, expand_view, list_views, view_channels, view_in_file

T = TypeVar("T")

# AOV of the sequence that the user names, if colour has a sequence of its own and leads.
MAIN = "main"

# Channels that are decoded together: a part may have dozens, of 33 MB each at 3840x2160.
CHANNEL_BATCH = 8


@dataclass(eq=False)
class NonFinite:
    """Counts of NaN and infinite pixels in a sequence's frames. Several threads may note them."""

    # By frame number, then by the channels' role or layer; only counts above 0.
    counts: defaultdict[int, dict[str, int]] = field(default_factory=lambda: defaultdict(dict))

    def note(self, number: int, pixels: Mapping[str, int]) -> None:
        """Note counts of a frame, which may be read several times."""
        counts = self.counts[number]
        for channels, count in pixels.items():
            if count:
                counts[channels] = max(count, counts.get(channels, 0))


@dataclass(frozen=True)
class ShotFiles(AovSet):
    """The sequences of a shot.

    `view` is the view that the files are of by their names, and `views` are all; empty if each file
    holds all views.
    """

    view: str = ""
    views: tuple[str, ...] = ()
    cache: HeaderCache = field(default_factory=HeaderCache)


@dataclass(frozen=True)
class Shot:
    """A sequence with its layout."""

    # The main files.
    sequence: Sequence
    # Further sequences of the same frames, by AOV, if each AOV has a file of its own.
    aovs: Mapping[str, Sequence]
    # What the channels hold, by the first frame. Their names are without view.
    layout: Layout
    # The display window that all frames must share.
    display: Window
    # The shot's views, the hero first; () if it has none.
    views: tuple[str, ...] = ()
    # The one that is read; "" if there are none.
    view: str = ""
    # The view that is read of each sequence's files, by AOV, "" for the hero and for files without
    # views: if each view has files of its own, they need not know of it.
    within: Mapping[str, str] = field(default_factory=dict)
    depth: DepthReading = field(default_factory=DepthReading)
    channel_map: ChannelMap | None = None
    # Roles whose channels were taken from sequences of their own.
    aov_files: tuple[AovFile, ...] = ()
    # Those of the first frame, the best stencil first. Their channels have no role.
    cryptomattes: tuple[Cryptomatte, ...] = ()
    # How ids are read from one of them; None if they are not.
    ids: IdReading | None = None
    # How the layout differs from the files' own for their hero view, as plain data. What was
    # generated from the shot depends on it.
    by_hand: Mapping[str, Any] = field(default_factory=dict)
    # Every channel of the view that can be read, recognised or not, in the order of the files.
    every: tuple[ChannelRef, ...] = ()
    # Number of the frame that it was recognised by.
    first: int = 0
    # True if frames may be missing or damaged, which are left out then.
    keep_going: bool = False
    # Of the files that were read last.
    headers: HeaderCache = field(default_factory=HeaderCache, compare=False, repr=False)
    # Of its frames; a shot that is read in another way has its own.
    nonfinite: NonFinite = field(default_factory=NonFinite, init=False, compare=False, repr=False)

    def files(self, number: int) -> dict[str, Path]:
        """Return the files of one frame by AOV, "" the main one; MissingFrameError if absent."""
        sequences = {"": self.sequence, **self.aovs}
        for sequence in sequences.values():
            if number not in sequence.files:
                raise MissingFrameError(
                    f"{sequence.pattern} lacks frame {number}; finish rendering it, or leave that "
                    "frame out"
                )
        return {aov: sequence.files[number] for aov, sequence in sequences.items()}

    @property
    def unused(self) -> list[ChannelRef]:
        """The channels without a role, those of Cryptomattes too, in the order of the files."""
        used = {ref for refs in self.layout.roles.values() for ref in refs}
        return [ref for ref in self.every if ref not in used]

    def channels(self, parts: Iterable[Part], aov: str = "") -> dict[str, Channel]:
        """Return the channels of this shot's view in a file, by the names that the layout has."""
        return view_channels(parts, self.within.get(aov, ""))


def open_shot(
    spec: str,
    view: str | None = None,
    aovs: tuple[AovFile, ...] = (),
    channel_map: ChannelMap | None = None,
    keep_going: bool = False,
) -> Shot:
    """Find a sequence and recognise its channels in its first frame.

    `spec` is a folder, pattern or any frame; ``%V`` in it stands for a view's name, ``%v`` for its
    letter. Without a view, it is the channel map's, else the hero. `aovs`, roles whose channels lie
    in sequences of their own, come before those of the map. With `keep_going`, the first frame that
    is sound counts, and missing frames in between are listed.

    Raises InputError if there is no such sequence or view, its first frame cannot be read, or a
    sequence of its AOVs lacks a frame or is of another size.
    """
    roles = {aov.role for aov in aovs}
    if channel_map is not None:
        view = view or channel_map.view
        aovs += tuple(aov for aov in channel_map.aovs if aov.role not in roles)
        roles.update((aov.role for aov in aovs), channel_map.channels)
    pattern, view_in_name, views = expand_view(spec, view)
    aov_set = find_aov_set(pattern, keep_going, partial(_needed_aovs, decided=roles))
    files = ShotFiles(aov_set.leader, aov_set.aovs, view_in_name, views)
    numbers = files.leader.numbers if keep_going else files.leader.numbers[:1]
    return first_usable(
        numbers, lambda number: _open_view(files, number, view, aovs, channel_map, keep_going)
    )


def _open_view(
    files: ShotFiles,
    number: int,
    wanted: str | None,
    aovs: tuple[AovFile, ...],
    channel_map: ChannelMap | None,
    keep_going: bool,
) -> Shot:
    """Recognise the channels of one view in one frame; with `keep_going` it has to be sound."""
    members = files.aovs if files.colour is None else {"": files.colour, **files.aovs}
    headers = {aov: read_flat_header(m.files[number], files.cache) for aov, m in members.items()}
    parts = {aov: header.parts for aov, header in headers.items()}
    texts = {aov: header.texts for aov, header in headers.items()}
    main, pattern = next(iter(parts.values())), files.leader.pattern
    views = files.views if files.view else list_views(main)
    view = files.view or choose_view(views, wanted, pattern)
    within = {aov: view_in_file(own, view, pattern, files.view) for aov, own in parts.items()}
    channels = {aov: view_channels(own, within[aov]) for aov, own in parts.items()}
    members_by_aov = {aov: members.values() for aov, members in channels.items()}
    mattes = find_cryptomattes(members_by_aov, texts)
    own = detect_layout(members_by_aov, cryptomatte_refs(mattes))
    if Role.COLOUR in own:
        mattes = find_cryptomattes(members_by_aov, texts, own.roles[Role.COLOUR][0].name)
    names = {name.upper() for members in channels.values() for name in members}
    if not own.roles and "Y" in names:
        raise LayoutError(
            f"{pattern} holds luminance alone (a channel Y), which is no colour; write the frames "
            "as RGB"
        )
    shot = Shot(
        files.leader,
        files.aovs,
        own if channel_map is None else _corrected(own, channels, channel_map),
        main[0].display_window,
        views,
        view,
        within,
        channel_map=channel_map,
        aov_files=aovs,
        cryptomattes=mattes,
        every=tuple(ChannelRef(aov, name) for aov, names in channels.items() for name in names),
        first=number,
        keep_going=keep_going,
        headers=files.cache,
    )
    for aov in aovs:
        shot = _with_aov(shot, aov)
    shot = _with_readings(shot, own)
    if keep_going:
        require_sound(shot.files(number).values())
    return shot


def _with_readings(shot: Shot, own: Layout) -> Shot:
    """Set how depth and ids are read, and how the layout differs from the files' `own`."""
    roles = {role: shot.layout.roles[role] for role in Role if role in shot.layout}
    mattes = shot.cryptomattes
    # A Cryptomatte whose channels were named for ids comes first: they are no numbers.
    ids = roles.get(Role.STENCIL, ())
    named = [matte for matte in mattes if cryptomatte_refs([matte]).intersection(ids)][:1]
    if named:
        del roles[Role.STENCIL]
        mattes = (*named, *(matte for matte in mattes if matte is not named[0]))
    by_name = depth_reading_by_name(ref.name for ref in roles.get(Role.DEPTH, ()))
    depth = by_name
    if shot.channel_map is not None and shot.channel_map.depth_kind is not None:
        depth = DEFAULT_READINGS[shot.channel_map.depth_kind]
    by_hand: dict[str, Any] = {
        role.value: [ref.label for ref in roles.get(role, ())]
        for role in Role
        if roles.get(role) != own.roles.get(role)
    }
    if shot.views and shot.view != shot.views[0]:
        by_hand["view"] = shot.view
    if depth != by_name:
        by_hand["depth_kind"] = depth.kind.value
    layout = replace(shot.layout, roles=roles)
    return replace(shot, layout=layout, cryptomattes=mattes, depth=depth, by_hand=by_hand)


def _needed_aovs(aov_set: AovSet, decided: Collection[Role]) -> list[str]:
    """Return the AOVs of a set that its colour's own files do not hold.

    `decided` are the roles whose channels the user names. Raises LayoutError if two passes are of
    one role, and nothing tells which one is meant.
    """
    own: set[Role] = set()
    for path in () if aov_set.colour is None else aov_set.colour.files.values():
        try:
            parts = read_flat_header(path, HeaderCache()).parts
        except InputError:  # reported when that frame is read
            continue
        own = set(detect_layout({"": view_channels(parts).values()}).roles)
        break
    roles = {name: split_pass(name).role for name in aov_set.aovs}
    names = [
        name
        for name, role in roles.items()
        # Files that hold vectors are a render by themselves.
        if role not in own and not (role is None and Role.MOTION in own)
    ]
    for role in (Role.MOTION, Role.DEPTH):
        rivals = [name for name in names if roles[name] is role and role not in decided]
        words = [re.sub(r"[^a-z]", "", name.lower()) for name in rivals]
        ends = {(w.endswith(FORWARD_NAMES), w.endswith(BACKWARD_NAMES)) for w in words}
        # Forward and backward vectors belong together.
        if len(rivals) > 1 and ends != {(True, False), (False, True)}:
            listed = " and ".join(aov_set.aovs[name].pattern for name in rivals)
            raise LayoutError(
                f"{listed} both go by a name of {role.value}; say which one holds it with "
                f"--aov {role.value}={aov_set.aovs[rivals[0]].pattern}"
            )
    return names


def read_flat_header(path: Path, headers: HeaderCache) -> FileHeader:
    """Read the header of a file, and refuse one of which all parts are deep."""
    header = headers.read(path)
    if all(part.deep for part in header.parts):
        raise deep_image_error(path)
    return header


def _with_aov(shot: Shot, aov: AovFile) -> Shot:
    """Take a role's channels from a sequence of its own."""
    expanded, view_in_name, _ = expand_view(aov.pattern, shot.view or None)
    sequence = find_sequence(expanded)
    numbers = shot.sequence.numbers
    if not shot.keep_going and (absent := [n for n in numbers if n not in sequence.files]):
        raise MissingFrameError(
            f"frame {ranges(absent)} of {aov.option} is missing from {sequence.pattern}; render "
            "it, or move that frame's other files elsewhere"
        )
    sequence = sequence.over(numbers)
    path = sequence.files[shot.first]
    header = read_flat_header(path, shot.headers)
    parts = header.parts
    if parts[0].display_window != shot.display:
        raise LayoutError(
            f"{path} of {aov.option} has the display window {parts[0].display_window} where the "
            f"shot has {shot.display}; render all AOVs at one resolution"
        )
    within = view_in_file(parts, shot.view, path, view_in_name)
    channels = view_channels(parts, within)
    # Files that hold several roles are read once.
    same_files = (n for n, member in shot.aovs.items() if member.pattern == sequence.pattern)
    name = next(same_files, aov.role.value)
    mattes = find_cryptomattes({name: channels.values()}, {name: header.texts})
    if aov.role is Role.STENCIL and mattes and not aov.channels:
        layout = Layout({aov.role: mattes[0].ranks[0]})
    else:
        layout = detect_aov(aov, channels, name, path)
    every, cryptomattes = shot.every, shot.cryptomattes
    if name not in shot.aovs:
        every += tuple(ChannelRef(name, channel) for channel in channels)
        cryptomattes += mattes
    has_guess = Role.MOTION in layout and layout.guess is not None
    merged = replace(
        shot.layout,
        roles={**shot.layout.roles, **layout.roles},
        guess=layout.guess if Role.MOTION in layout else shot.layout.guess,
        producer=(layout if has_guess else shot.layout).producer,
        alphas=layout.alphas if Role.COLOUR in layout else shot.layout.alphas,
    )
    joined = replace(
        shot,
        aovs={**shot.aovs, name: sequence},
        layout=merged,
        within={**shot.within, name: within},
        every=every,
        cryptomattes=cryptomattes,
    )
    return _with_leader(joined, name) if aov.role is Role.COLOUR else joined


def _with_leader(shot: Shot, aov: str) -> Shot:
    """Make an AOV's sequence the leader: frames are named like those with the colour."""
    has_aov_name = shot.sequence in shot.aovs.values()
    names = {aov: ""} if has_aov_name else {"": MAIN, aov: ""}

    def rename(refs: Iterable[ChannelRef]) -> tuple[ChannelRef, ...]:
        return tuple(replace(ref, aov=names.get(ref.aov, ref.aov)) for ref in refs)

    roles = {role: rename(refs) for role, refs in shot.layout.roles.items()}
    aovs = {name: sequence for name, sequence in shot.aovs.items() if name != aov}
    return replace(
        shot,
        sequence=shot.aovs[aov],
        aovs=aovs if has_aov_name else {MAIN: shot.sequence, **aovs},
        layout=replace(shot.layout, roles=roles, alphas=rename(shot.layout.alphas)),
        every=rename(shot.every),
        within={names.get(name, name): view for name, view in shot.within.items()},
        cryptomattes=tuple(
            replace(m, aov=names.get(m.aov, m.aov), ranks=tuple(map(rename, m.ranks)))
            for m in shot.cryptomattes
        ),
    )


def _corrected(
    layout: Layout, channels: Mapping[str, Mapping[str, Channel]], channel_map: ChannelMap
) -> Layout:
    """Put a channel map's roles in place of those that were recognised."""
    refs = [ChannelRef(aov, name) for aov, members in channels.items() for name in members]
    by_label = {ref.label: ref for ref in refs}
    roles = dict(layout.roles)
    for role, names in channel_map.channels.items():
        roles.pop(role, None)
        option = f"channels.{role.value} in the channel map {channel_map.path}"
        if names:
            labels = (find_channel(name, by_label, option, "the shot") for name in names)
            roles[role] = tuple(by_label[label] for label in labels)
    is_same_motion = roles.get(Role.MOTION) == layout.roles.get(Role.MOTION)
    return replace(
        layout,
        roles=roles,
        guess=layout.guess if is_same_motion else None,
        producer=channel_map.producer or layout.producer,
        alphas=() if Role.COLOUR in channel_map.channels else layout.alphas,
    )


def alpha_note(layout: Layout) -> str | None:
    """Return the note that a colour has no alpha as several channels may be it, or None."""
    if not layout.alphas:
        return None
    names = ", ".join(ref.label for ref in layout.alphas)
    return (
        f"alpha is left out, as {names} may each be it; name one as the fourth of channels.colour "
        "in a channel map"
    )


def first_usable(numbers: Iterable[int], read: Callable[[int], T]) -> T:
    """Return what `read` gives for the first frame for which it raises no InputError.

    Raises the InputError of the very first frame, of at least one, if all fail.
    """
    first_error: InputError | None = None
    for number in numbers:
        try:
            return read(number)
        except InputError as error:
            first_error = first_error or error
    assert first_error is not None
    raise first_error


def require_sound(paths: Iterable[Path]) -> None:
    """Decode all flat pixels of EXR files, as damage shows there alone; InputError if damaged."""
    for path in paths:
        with ExrFile(path) as file:
            for part in file.parts:
                for i in range(0, 0 if part.deep else len(part.channels), CHANNEL_BATCH):
                    file.read(part.channels[i : i + CHANNEL_BATCH])


def count_nonfinite(planes: Iterable[np.ndarray], role: Role | None = None) -> int:
    """Count the pixels that are not finite in any of these channels.

    `planes` are [H, W] or [H, W, C] of any types; those of other windows than the first are left
    out. In a depth NaN alone counts: infinity is how renderers write the background.
    """
    nonfinite: Bool | None = None
    for plane in planes:
        if plane.dtype.kind != "f":
            continue
        values = plane.reshape(*plane.shape[:2], -1)
        is_depth = role is Role.DEPTH
        pixels = np.isnan(values).any(axis=-1) if is_depth else nonfinite_pixels(values)
        if nonfinite is None:
            nonfinite = pixels
        elif nonfinite.shape == pixels.shape:
            nonfinite |= pixels
    return 0 if nonfinite is None else int(np.count_nonzero(nonfinite))
