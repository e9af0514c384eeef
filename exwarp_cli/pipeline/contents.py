"""What generated frames hold: which layers of a view, and where they come from."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from exwarp_cli.domain.motion import MotionConvention
from exwarp_cli.io.channels import ChannelRef, Role
from exwarp_cli.io.cryptomatte import find_cryptomattes
from exwarp_cli.io.exr.template import Plane, ViewLayers, read_template
from exwarp_cli.io.footage import is_plain, make_frame_template
from exwarp_cli.io.frames import read_planes
from exwarp_cli.io.generated_frames import FrameTemplate
from exwarp_cli.io.layers import ALL, BEAUTY, Kind, Layer, chosen, layers_of
from exwarp_cli.io.shot import Shot, renamed
from exwarp_cli.io.soundness import count_broken
from exwarp_cli.pipeline.frame_writer import frame_suffix
from exwarp_cli.pipeline.source import Source

POINTS = (Kind.POSITION, Kind.DEPTH)
"""Layers whose values change as a point moves."""


@dataclass(frozen=True)
class Content:
    """What is written of one view.

    Attributes
    ----------
    source
        The view.
    layers
        Layers to write; () for the beauty alone.
    rendered
        For layers that the slots' own files have too: the layer there, which is taken as it is.
    leads
        Whether decisions are made for this view.
    """

    source: Source
    layers: tuple[Layer, ...] = ()
    rendered: Mapping[Layer, Layer] = field(default_factory=dict)
    leads: bool = True

    @property
    def wanted(self) -> ViewLayers:
        """What a template is read for."""
        shot = self.source.keys
        within = shot.within.get("", "")
        return ViewLayers(shot.view, within, shot.layout.roles[Role.COLOUR], self.layers)

    @cached_property
    def beside(self) -> tuple[Layer, ...]:
        """The layers that have channels beside the beauty's own."""
        colour = set(self.source.keys.layout.roles[Role.COLOUR])
        return tuple(layer for layer in self.layers if not colour.issuperset(layer.refs))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of those."""
        return tuple(dict.fromkeys(layer.name for layer in self.beside))

    @property
    def looks_back(self) -> bool:
        """Whether the key frame before is of use where the next one is not."""
        return self.source.finding is not None and any(
            layer.kind in POINTS and layer not in self.rendered for layer in self.beside
        )

    @property
    def convention(self) -> MotionConvention | None:
        """How the key frames' vectors are read; None where that is not known."""
        finding = self.source.finding if self.source.slots is None else None
        return None if finding is None else finding.convention

    @cached_property
    def motion(self) -> tuple[ChannelRef, ...]:
        """The motion channels that have to be read to write any of them; () without."""
        if all(layer.kind is not Kind.MOTION for layer in self.beside) or self.convention is None:
            return ()
        return self.source.keys.layout.roles[Role.MOTION]


@dataclass(frozen=True)
class LayerFrames:
    """Layers around the slots of one interval.

    Attributes
    ----------
    before, after
        Those of the key frames on both sides; `after` only where it is used.
    older
        Those of the key frame before, where points are led on from there.
    slots
        For each slot what its own file has, by the key frames' channels; empty without.
    """

    before: Planes
    after: Planes | None
    older: Planes | None
    slots: tuple[Planes, ...]


class LayerReader:
    """Reads the layers of a view, interval by interval; what several share is read once."""

    def __init__(self, content: Content) -> None:
        self._content = content
        source = content.source
        self._keys = LayerStore(source.keys, content.beside, content.motion)
        self._slots = None
        if source.slots is not None and content.rendered:
            self._slots = LayerStore(source.slots, content.rendered.values())

    def read(self, key: int, lookahead: bool, older: int | None) -> LayerFrames:
        """Read an interval.

        Parameters
        ----------
        key
            Index of the key frame.
        lookahead
            Whether the next one is used.
        older
            Index of the one before, where it is used.
        """
        numbers = self._content.source.timeline.numbers
        before = self._keys.frame(numbers[key])
        after = self._keys.frame(numbers[key + 1]) if lookahead else None
        back = None if older is None else self._keys.frame(numbers[older])
        self.release_before(key)
        return LayerFrames(before, after, back, self._rendered(key))

    def require(self, key: int) -> None:
        """Read a key frame's layers ahead; raises InputError where that fails."""
        self._keys.frame(self._content.source.timeline.numbers[key])

    def release_before(self, key: int) -> None:
        """Drop what no interval after this one needs."""
        self._keys.keep(self._content.source.timeline.numbers[key : key + 2])

    def _rendered(self, key: int) -> tuple[Planes, ...]:
        """Read what the slots' own files have; () where a slot has no file."""
        if self._slots is None:
            return ()
        source = self._content.source
        slots = [source.slot_number(slot) for slot in source.timeline.between(key)]
        numbers = [number for number in slots if number is not None]
        if len(numbers) < len(slots):
            return ()
        planes = tuple(self._by_key_channels(self._slots.frame(number)) for number in numbers)
        self._slots.keep(())
        return planes

    def _by_key_channels(self, planes: Planes) -> Planes:
        """Return a slot's planes by the key frames' channels."""
        named: dict[ChannelRef, Plane] = {}
        for layer in self._content.beside:
            rendered = self._content.rendered.get(layer)
            if rendered is not None:
                own = {ref.component: ref for ref in rendered.refs}
                named |= {ref: planes[own[ref.component]] for ref in layer.refs}
        return named


def content_of(source: Source, text: str, leader: Content | None = None) -> Content:
    """Choose the layers of a view.

    Parameters
    ----------
    source
        The view.
    text
        As `io.layers.chosen` takes it.
    leader
        Of the view that leads, for every other one: its layers have the same names, as far as this
        view has them.

    Raises
    ------
    UsageError
        When a name matches nothing.
    """
    leads = leader is None
    if text == BEAUTY:
        return Content(source, leads=leads)
    there = _layers_of(source.keys, main=True)
    if leader is None:
        layers = chosen(there, text, source.keys.layout)
    else:
        names = {layer.name for layer in leader.layers}
        layers = tuple(layer for layer in there if layer.name in names or text == ALL)
    slots = () if source.slots is None else _layers_of(source.slots, main=False)
    # By the layers themselves, as two parts may have layers of one name.
    found = {layer: layer.rendered_in(slots) for layer in layers}
    rendered = {layer: other for layer, other in found.items() if other is not None}
    return Content(source, layers, rendered, leads)


def contents_of(sources: tuple[Source, ...], text: str) -> tuple[Content, ...]:
    """Choose the layers of every view, the one that leads first; see `content_of`."""
    leader = content_of(sources[0], text)
    return (leader, *(content_of(source, text, leader) for source in sources[1:]))


def template_of(contents: tuple[Content, ...], output: str, number: int) -> FrameTemplate:
    """Return what frames made of a key frame take over from its file.

    Parameters
    ----------
    contents
        What is written of each view.
    output
        Where frames go, as the user names it.
    number
        Of the key frame.

    Raises
    ------
    InputError
        When its file cannot be read.
    """
    keys = contents[0].source.keys
    if is_plain(keys.sequence):
        return make_frame_template(keys, number, frame_suffix(output, keys.sequence))
    wanted = tuple(content.wanted for content in contents)
    return read_template(keys.sequence.files[number], wanted, keys.headers)


def files_apart(shot: Shot) -> tuple[str, ...]:
    """Return the AOVs whose layers lie in files of their own, which are not written."""
    return tuple(aov for aov in shot.aovs if aov)


def _layers_of(shot: Shot, main: bool) -> tuple[Layer, ...]:
    """Return the layers of a shot's view in its first frame: of the main file, or of all."""
    files, cryptomattes = {}, set()
    for aov, path in shot.files(shot.first).items():
        if aov and main:
            continue
        header = shot.headers.read(path)
        files[aov] = shot.channels(header.parts, aov)
        known = find_cryptomattes({aov: renamed(files[aov])}, {aov: header.texts})
        cryptomattes |= {found.name for found in known}
    return layers_of(files, shot.layout, cryptomattes)


Planes = Mapping[ChannelRef, Plane]
"""Channels of one frame, each in the file's own type and on its own window."""


class LayerStore:
    """Reads channels of frames; a frame stays at hand until it is dropped."""

    def __init__(
        self, shot: Shot, layers: Collection[Layer], more: Iterable[ChannelRef] = ()
    ) -> None:
        self._shot = shot
        groups: dict[tuple[str, int], dict[ChannelRef, bool]] = {}
        for layer in layers:
            for ref, channel in zip(layer.refs, layer.channels, strict=True):
                half = channel.pixel_type == "half"
                groups.setdefault((ref.aov, channel.part), {})[ref] = half
        known = {ref for group in groups.values() for ref in group}
        for ref in more:
            if ref not in known:
                groups.setdefault((ref.aov, -1), {})[ref] = False
        self._groups = tuple(groups.values())
        self._layers = tuple(layers)
        self._frames: dict[int, Planes] = {}

    def frame(self, number: int) -> Planes:
        """Return the channels of a frame.

        Raises
        ------
        InputError
            When a file is missing, damaged, of another size, or lacks a channel.
        """
        if number not in self._frames:
            found: dict[ChannelRef, Plane] = {}
            # Part by part: what is decoded as float32 takes half the memory once it is half again.
            for group in self._groups:
                planes, windows = read_planes(self._shot, number, list(group))
                for ref, half in group.items():
                    found[ref] = Plane(_kept(planes[ref], half), windows[ref])
            self._frames[number] = found
            self._shot.nonfinite.note(number, dict(self._broken(found)))
        return self._frames[number]

    def _broken(self, found: Planes) -> Iterator[tuple[str, int]]:
        """Count the pixels of layers that are not finite; those of a role have its name."""
        roles = {refs: role for role, refs in self._shot.layout.roles.items()}
        for layer in self._layers:
            role = roles.get(layer.refs)
            counted = Role.DEPTH if layer.kind is Kind.DEPTH else role
            count = count_broken((found[ref].values for ref in layer.refs), counted)
            yield layer.name if role is None else role.value, count

    def keep(self, numbers: Iterable[int]) -> None:
        """Drop all other frames."""
        self._frames = {n: self._frames[n] for n in numbers if n in self._frames}


def _kept(values: np.ndarray, half: bool) -> np.ndarray:
    """Return a plane of its own, so that the part that it was decoded with can be freed."""
    if half and values.dtype == np.float32:
        with np.errstate(over="ignore"):  # another frame may hold the channel as float
            return values.astype(np.float16)
    return np.ascontiguousarray(values)
