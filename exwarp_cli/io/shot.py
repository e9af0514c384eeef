"""Opening a shot: finding its sequences, and recognising its channels in the first frame.

A channel map corrects what was recognised, and AOVs of several files come together.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from exwarp_cli.domain.frame import Window
from exwarp_cli.domain.timeline import ranges
from exwarp_cli.errors import LayoutError, MissingFrameError
from exwarp_cli.io.aov_files import AovFile, named, recognise
from exwarp_cli.io.channel_map import ChannelMap
from exwarp_cli.io.channels import ChannelRef, Layout, Role, detect
from exwarp_cli.io.cryptomatte import Cryptomatte, find_cryptomattes
from exwarp_cli.io.cryptomatte_ids import IdReading
from exwarp_cli.io.depth import DepthReading
from exwarp_cli.io.depth import named as depth_named
from exwarp_cli.io.exr.header import Channel, Part
from exwarp_cli.io.exr.reader import HeaderCache
from exwarp_cli.io.sequence import Sequence, find_sequence
from exwarp_cli.io.shot_files import Looks, ShotFiles, find_files, look
from exwarp_cli.io.soundness import NonFinite, first_of, require_sound
from exwarp_cli.io.views import ALL, channels_of, choose, expand, views_of

MAIN = "main"
"""AOV of the sequence that the user names, where colour has one of its own and leads."""


@dataclass(frozen=True)
class Shot:
    """A sequence with its layout.

    Attributes
    ----------
    sequence
        The main files.
    aovs
        Further sequences of the same frames, by AOV, where each AOV has a file of its own.
    layout
        Which channels hold what, as detected in the first frame. Their names are without view.
    display
        The display window that all frames must share.
    views
        The shot's views, the hero first; () where it has none.
    view
        The one that is read; "" where there are none.
    within
        The view that is read of each sequence's files, by AOV, "" for the hero and for files
        without views: where each view has files of its own, they need not know of it.
    depth
        How distances are read from the depth channel.
    channel_map
        By which the layout was corrected; None without.
    aov_files
        Roles whose channels were taken from sequences of their own.
    cryptomattes
        Those of the first frame, the best stencil first. Their channels have no role.
    ids
        How ids are read from one of them; None where they are not.
    by_hand
        In what the layout is another than the files' own for their hero view, as plain data; what
        was made of the shot depends on it.
    every
        Every channel of the view that can be read, recognised or not, in the order of the files.
    first
        Number of the frame that it was recognised by.
    keep_going
        Whether frames may be missing or damaged, which are left out then.
    headers
        Of the files that were read last.
    nonfinite
        What was found in its frames; a shot that is read in another way has its own.
    """

    sequence: Sequence
    aovs: Mapping[str, Sequence]
    layout: Layout
    display: Window
    views: tuple[str, ...] = ()
    view: str = ""
    within: Mapping[str, str] = field(default_factory=dict)
    depth: DepthReading = field(default_factory=DepthReading)
    channel_map: ChannelMap | None = None
    aov_files: tuple[AovFile, ...] = ()
    cryptomattes: tuple[Cryptomatte, ...] = ()
    ids: IdReading | None = None
    by_hand: Mapping[str, Any] = field(default_factory=dict)
    every: tuple[ChannelRef, ...] = ()
    first: int = 0
    keep_going: bool = False
    headers: HeaderCache = field(default_factory=HeaderCache, compare=False, repr=False)
    nonfinite: NonFinite = field(default_factory=NonFinite, init=False, compare=False, repr=False)

    def files(self, number: int) -> dict[str, Path]:
        """Files of one frame by AOV; "" is the main one.

        Raises
        ------
        MissingFrameError
            When a sequence has no such frame.
        """
        sequences = {"": self.sequence, **self.aovs}
        for sequence in sequences.values():
            if number not in sequence.files:
                raise MissingFrameError(
                    f"{sequence.pattern} lacks frame {number}; finish rendering it, or leave that "
                    "frame out"
                )
        return {aov: sequence.files[number] for aov, sequence in sequences.items()}

    @property
    def listed(self) -> str:
        """Every channel, by the names that a channel map takes, for a message."""
        return ", ".join(map(spelled, self.every)) or "none that can be read"

    def channels(self, parts: Iterable[Part], aov: str = "") -> dict[str, Channel]:
        """Return the channels of this shot's view in a file, by the names that the layout has."""
        return channels_of(parts, self.within.get(aov, ""))


def open_shot(
    spec: str,
    view: str | None = None,
    aovs: tuple[AovFile, ...] = (),
    channel_map: ChannelMap | None = None,
    keep_going: bool = False,
) -> Shot:
    """Find a sequence and recognise its channels in its first frame.

    Parameters
    ----------
    spec
        Folder, pattern or any frame; ``%V`` in it stands for a view's name, ``%v`` for its letter.
    view
        Which view is read; None for the channel map's, else the hero.
    aovs
        Roles whose channels lie in sequences of their own; they come before those of the map.
    channel_map
        What holds what, by hand.
    keep_going
        Whether to take the first frame that is sound, and list those that are missing in between.

    Raises
    ------
    InputError
        When there is no such sequence or view, its first frame cannot be read, or a sequence of
        its AOVs lacks a frame or is of another size.
    """
    wish = _Wish.of(view, aovs, channel_map, keep_going)
    expanded, named_view, views = expand(spec, wish.view)
    return _opened(find_files(expanded, keep_going, wish.decided), wish, named_view, views)


def open_views(
    spec: str,
    view: str | None = None,
    aovs: tuple[AovFile, ...] = (),
    channel_map: ChannelMap | None = None,
    keep_going: bool = False,
) -> tuple[Shot, ...]:
    """Open every view of a shot, the hero first, where `view` is ``all``; else the one of it.

    Files that hold all views are found and looked into once. See `open_shot`.
    """
    if view != ALL:
        return (open_shot(spec, view, aovs, channel_map, keep_going),)
    wish = replace(_Wish.of(None, aovs, channel_map, keep_going), view=None)
    expanded, named_view, views = expand(spec, None)
    found = find_files(expanded, keep_going, wish.decided)
    hero = _opened(found, wish, named_view, views)
    if not hero.views:
        raise LayoutError(f"{hero.sequence.pattern} has no views; leave --view {ALL} out")
    if named_view:
        others = (open_shot(spec, name, aovs, channel_map, keep_going) for name in views[1:])
        return (hero, *others)
    looks = found.by(hero.first)
    return (hero, *(_open(looks, replace(wish, view=name), "", ()) for name in hero.views[1:]))


@dataclass(frozen=True)
class _Wish:
    """What is asked of a shot beside its name; see `open_shot`."""

    view: str | None
    aovs: tuple[AovFile, ...]
    channel_map: ChannelMap | None
    keep_going: bool

    @property
    def decided(self) -> frozenset[Role]:
        """Roles whose channels the user names."""
        mapped = () if self.channel_map is None else self.channel_map.channels
        return frozenset([*(aov.role for aov in self.aovs), *mapped])

    @classmethod
    def of(
        cls,
        view: str | None,
        aovs: tuple[AovFile, ...],
        channel_map: ChannelMap | None,
        keep_going: bool,
    ) -> _Wish:
        """Join options with a channel map; options come first."""
        if channel_map is None:
            return cls(view, aovs, None, keep_going)
        given = {aov.role for aov in aovs}
        more = tuple(aov for aov in channel_map.aovs if aov.role not in given)
        return cls(view or channel_map.view, aovs + more, channel_map, keep_going)


def _opened(found: ShotFiles, wish: _Wish, named_view: str, views: tuple[str, ...]) -> Shot:
    """Open a shot by its first frame, or by the first that is sound where others are left out."""

    def by(number: int) -> Shot:
        shot = _open(found.by(number), wish, named_view, views)
        if wish.keep_going:
            require_sound(shot.files(number).values())
        return shot

    numbers = found.leader.numbers
    return first_of(numbers if wish.keep_going else numbers[:1], by)


def _open(found: Looks, wish: _Wish, named_view: str, views: tuple[str, ...]) -> Shot:
    """Recognise the channels of one view, and put the shot together.

    Parameters
    ----------
    found
        Its files.
    wish
        What is asked.
    named_view, views
        The view that the files are of by their names, and all that there are; empty where each
        file holds all views.
    """
    main = next(iter(found.parts.values()))
    pattern = found.leader.pattern
    views = views if named_view else views_of(main)
    view = named_view or choose(views, wish.view, pattern)
    within = {aov: _within(parts, view, named_view, pattern) for aov, parts in found.parts.items()}
    channels = {aov: channels_of(parts, within[aov]) for aov, parts in found.parts.items()}
    every = {aov: renamed(members) for aov, members in channels.items()}
    mattes = find_cryptomattes(every, found.texts)
    own = detect({aov: plain(members, mattes, aov) for aov, members in channels.items()})
    if Role.COLOUR in own:
        mattes = find_cryptomattes(every, found.texts, own.roles[Role.COLOUR][0].name)
    if not own.roles:
        _refuse_luminance(channels, pattern)
    layout = own if wish.channel_map is None else corrected(own, channels, wish.channel_map)
    display = main[0].display_window
    shot = Shot(
        found.leader, found.aovs, layout, display, views, view, within, cryptomattes=mattes,
        every=refs_of(channels), first=found.number, keep_going=wish.keep_going,
        headers=found.cache,
    )  # fmt: skip
    for aov in wish.aovs:
        shot = _joined(shot, aov)
    shot = _by_bits(shot)
    channel_map = wish.channel_map
    shot = replace(
        shot, depth=_depth(shot, channel_map), channel_map=channel_map, aov_files=wish.aovs
    )
    return replace(shot, by_hand=_by_hand(shot, own))


def renamed(channels: Mapping[str, Channel]) -> tuple[Channel, ...]:
    """Return channels with the names that they are known by, for detection."""
    return tuple(replace(channel, name=name) for name, channel in channels.items())


def refs_of(channels: Mapping[str, Iterable[str]]) -> tuple[ChannelRef, ...]:
    """Return the channels of files, whose names are known by AOV."""
    return tuple(ChannelRef(aov, name) for aov, names in channels.items() for name in names)


def plain(
    channels: Mapping[str, Channel], cryptomattes: Iterable[Cryptomatte], aov: str = ""
) -> tuple[Channel, ...]:
    """Return channels as `renamed` does, without those of Cryptomattes."""
    taken = {ref for one in cryptomattes for ref in one.refs}
    return tuple(c for c in renamed(channels) if ChannelRef(aov, c.name) not in taken)


def _within(parts: tuple[Part, ...], view: str, named_view: str, where: object) -> str:
    """Return which view of a file is read, "" for one without views or all of one view."""
    views = views_of(parts)
    if not views or (named_view and view not in views):
        return ""
    return choose(views, view or None, where)


def _refuse_luminance(channels: Mapping[str, Mapping[str, Channel]], where: str) -> None:
    names = {name.upper() for members in channels.values() for name in members}
    if "Y" in names:
        raise LayoutError(
            f"{where} holds luminance alone (a channel Y), which is no colour; write the frames as "
            "RGB"
        )


def _joined(shot: Shot, aov: AovFile) -> Shot:
    """Take a role's channels from a sequence of its own."""
    expanded, named_view, _ = expand(aov.pattern, shot.view or None)
    sequence = find_sequence(expanded)
    if shot.keep_going:
        sequence = sequence.over(shot.sequence.numbers)
    if absent := [n for n in shot.sequence.numbers if n not in sequence.files]:
        raise MissingFrameError(
            f"frame {ranges(absent)} of {aov.option} is missing from {sequence.pattern}; render "
            "it, or move that frame's other files elsewhere"
        )
    files = {number: sequence.files[number] for number in shot.sequence.numbers}
    path = files[shot.first]
    header = look(path, shot.headers)
    parts = header.parts
    if parts[0].display_window != shot.display:
        raise LayoutError(
            f"{path} of {aov.option} has the display window {parts[0].display_window} where the "
            f"shot has {shot.display}; render all AOVs at one resolution"
        )
    within = _within(parts, shot.view, named_view, path)
    channels = channels_of(parts, within)
    name = _name_of(shot, aov, sequence)
    mattes = find_cryptomattes({name: renamed(channels)}, {name: header.texts})
    if aov.role is Role.STENCIL and mattes and not aov.channels:
        found = Layout({aov.role: mattes[0].stencil})
    else:
        read = recognise(aov, {c.name: c for c in renamed(channels)}, path)
        found = moved(read, {aov.role.value: name})
    joined = replace(
        shot,
        aovs={**shot.aovs, name: replace(sequence, files=files)},
        layout=merged(shot.layout, found),
        within={**shot.within, name: within},
        every=shot.every + (() if name in shot.aovs else refs_of({name: channels})),
        cryptomattes=shot.cryptomattes + tuple(one for one in mattes if name not in shot.aovs),
    )
    return _led(joined, name) if aov.role is Role.COLOUR else joined


def _by_bits(shot: Shot) -> Shot:
    """Put that Cryptomatte first whose channels were named for ids: they are no numbers."""
    named = set(shot.layout.roles.get(Role.STENCIL, ()))
    meant = [one for one in shot.cryptomattes if named & one.refs]
    if not meant:
        return shot
    roles = dict(shot.layout.roles)
    del roles[Role.STENCIL]
    others = [one for one in shot.cryptomattes if one is not meant[0]]
    return replace(shot, layout=replace(shot.layout, roles=roles), cryptomattes=(meant[0], *others))


def _name_of(shot: Shot, aov: AovFile, sequence: Sequence) -> str:
    """Return what an AOV's sequence goes by: files that hold several roles are read once."""
    known = (name for name, member in shot.aovs.items() if member.pattern == sequence.pattern)
    return next(known, aov.role.value)


def _led(shot: Shot, aov: str) -> Shot:
    """Make an AOV's sequence the leader: frames are named like those with the colour."""
    leads = shot.sequence in shot.aovs.values()
    names = {aov: ""} if leads else {"": MAIN, aov: ""}
    aovs = {name: sequence for name, sequence in shot.aovs.items() if name != aov}
    return replace(
        shot,
        sequence=shot.aovs[aov],
        aovs=aovs if leads else {MAIN: shot.sequence, **aovs},
        layout=moved(shot.layout, names),
        every=tuple(replace(ref, aov=names.get(ref.aov, ref.aov)) for ref in shot.every),
        within={names.get(name, name): view for name, view in shot.within.items()},
        cryptomattes=tuple(one.moved(names) for one in shot.cryptomattes),
    )


def _depth(shot: Shot, channel_map: ChannelMap | None) -> DepthReading:
    """Return how depth is read: as the map says, else as the channel's name does."""
    if channel_map is not None and channel_map.depth_kind is not None:
        return DepthReading.of(channel_map.depth_kind)
    return depth_named(ref.name for ref in shot.layout.roles.get(Role.DEPTH, ()))


def _by_hand(shot: Shot, own: Layout) -> dict[str, Any]:
    """Say in what a shot differs from what is recognised in it by itself."""
    found: dict[str, Any] = {
        role.value: [spelled(ref) for ref in shot.layout.roles.get(role, ())]
        for role in Role
        if shot.layout.roles.get(role) != own.roles.get(role)
    }
    if shot.views and shot.view != shot.views[0]:
        found["view"] = shot.view
    if shot.depth != _depth(shot, None):
        found["depth_kind"] = shot.depth.kind.value
    return found


def corrected(
    layout: Layout, channels: Mapping[str, Mapping[str, Channel]], channel_map: ChannelMap
) -> Layout:
    """Put a channel map's roles in place of those that were recognised."""
    known = {
        spelled(ChannelRef(aov, name)): ChannelRef(aov, name)
        for aov, members in channels.items()
        for name in members
    }
    roles = dict(layout.roles)
    for role, names in channel_map.channels.items():
        roles.pop(role, None)
        option = channel_map.option(f"channels.{role.value}")
        refs = tuple(known[named(name, known, option, "the shot")] for name in names)
        if refs:
            roles[role] = refs
    same = roles.get(Role.MOTION) == layout.roles.get(Role.MOTION)
    producer = channel_map.producer or layout.producer
    guess = layout.guess if same else None
    alphas = () if Role.COLOUR in channel_map.channels else layout.alphas
    return replace(layout, roles=_ordered(roles), guess=guess, producer=producer, alphas=alphas)


def moved(layout: Layout, names: Mapping[str, str]) -> Layout:
    """Return a layout with other names of AOVs."""
    roles = {
        role: tuple(replace(ref, aov=names.get(ref.aov, ref.aov)) for ref in refs)
        for role, refs in layout.roles.items()
    }
    alphas = tuple(replace(ref, aov=names.get(ref.aov, ref.aov)) for ref in layout.alphas)
    return replace(layout, roles=roles, alphas=alphas)


def merged(layout: Layout, more: Layout) -> Layout:
    """Add the roles of another layout, and what it says of motion if that is among them."""
    roles = _ordered({**layout.roles, **more.roles})
    guess = more.guess if Role.MOTION in more else layout.guess
    ours = Role.MOTION in more and more.guess is not None
    producer = (more if ours else layout).producer
    alphas = more.alphas if Role.COLOUR in more else layout.alphas
    return replace(layout, roles=roles, guess=guess, producer=producer, alphas=alphas)


def alpha_left_out(layout: Layout) -> str | None:
    """Say that a colour has no alpha as several channels may be it; None where that is not so."""
    if not layout.alphas:
        return None
    names = ", ".join(spelled(ref) for ref in layout.alphas)
    return (
        f"alpha is left out, as {names} may each be it; name one as the fourth of channels.colour "
        "in a channel map"
    )


def spelled(ref: ChannelRef) -> str:
    """Return a channel's name as users see it, and channel maps have it: with its AOV."""
    return f"{ref.aov}:{ref.name}" if ref.aov else ref.name


def _ordered(roles: Mapping[Role, tuple[ChannelRef, ...]]) -> dict[Role, tuple[ChannelRef, ...]]:
    return {role: roles[role] for role in Role if role in roles}
