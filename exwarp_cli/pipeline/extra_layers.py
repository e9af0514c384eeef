"""What generated frames hold beside the beauty: further layers, and other views."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from exwarp_cli.domain.frame import Float32, Window, outside_mask, place_on_canvas
from exwarp_cli.io.channels import ChannelRef, Role
from exwarp_cli.io.cryptomatte import find_cryptomattes
from exwarp_cli.io.exr.writer import Plane, PlaneKey, Template, ViewLayers, read_template
from exwarp_cli.io.footage import is_plain, make_frame_template
from exwarp_cli.io.frames import read_planes
from exwarp_cli.io.generated_frames import FrameTemplate
from exwarp_cli.io.layers import ALL, BEAUTY, Layer, LayerKind, group_layers, select_layers
from exwarp_cli.io.shot import Shot, count_nonfinite
from exwarp_cli.pipeline.source import Source
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.layer_retiming import LayerMotion, LayerRetimer, make_retimer
from exwarp_cli.synthesis.methods import Predicted

if TYPE_CHECKING:
    from exwarp_cli.pipeline.interval_builder import IntervalBuilder
    from exwarp_cli.pipeline.interval_inputs import IntervalInputs

# Layers whose values change as a point moves.
POINTS = (LayerKind.POSITION, LayerKind.DEPTH)

# Channels of one frame, each in the file's own type and on its own window.
Planes = Mapping[ChannelRef, Plane]

# Makes the frame of a slot from an interval of any view, by what was decided.
Predict = Callable[[Interval], Predicted]


@dataclass(frozen=True)
class Content:
    """What is written of one view."""

    source: Source
    layers: tuple[Layer, ...] = ()  # () for the beauty alone
    # For layers that the slots' own files have too: the layer there, which is taken as it is.
    rendered: Mapping[Layer, Layer] = field(default_factory=dict)
    leads: bool = True  # True if decisions are made for this view

    @property
    def wanted(self) -> ViewLayers:
        """What a template is read for."""
        shot = self.source.keys
        within = shot.within.get("", "")
        return ViewLayers(shot.view, within, shot.layout.roles[Role.COLOUR], self.layers)

    @cached_property
    def extra(self) -> tuple[Layer, ...]:
        """The layers that have channels beside the beauty's own."""
        colour = set(self.source.keys.layout.roles[Role.COLOUR])
        return tuple(layer for layer in self.layers if not colour.issuperset(layer.refs))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the extra layers."""
        return tuple(dict.fromkeys(layer.name for layer in self.extra))

    @property
    def looks_back(self) -> bool:
        """True if the key frame before is of use where the next one is not."""
        return self.source.finding is not None and any(
            layer.kind in POINTS and layer not in self.rendered for layer in self.extra
        )

    @cached_property
    def motion(self) -> tuple[ChannelRef, ...]:
        """The motion channels that have to be read to write any of them; () without."""
        has_motion = any(layer.kind is LayerKind.MOTION for layer in self.extra)
        # With slots' G-buffers the convention is theirs; that of the key frames is not known.
        if not has_motion or self.source.slots is not None or self.source.convention is None:
            return ()
        return self.source.keys.layout.roles[Role.MOTION]


def contents_of(sources: tuple[Source, ...], text: str) -> tuple[Content, ...]:
    """Choose the layers of every view, the one that leads first.

    The other views' layers have the same names as the leader's, as far as they have them. `text` is
    as `io.layers.select_layers` takes it; raises UsageError when a name matches nothing.
    """
    if text == BEAUTY:
        return tuple(Content(source, leads=source is sources[0]) for source in sources)
    contents: list[Content] = []
    for source in sources:
        available = _layers_in(source.keys, main=True)
        if contents:
            names = {layer.name for layer in contents[0].layers}
            layers = tuple(layer for layer in available if layer.name in names or text == ALL)
        else:
            layers = select_layers(available, text, source.keys.layout)
        # By the layers themselves, as two parts may have layers of one name.
        in_slots = () if source.slots is None else _layers_in(source.slots, main=False)
        matches = {layer: layer.rendered_in(in_slots) for layer in layers}
        rendered = {layer: match for layer, match in matches.items() if match is not None}
        contents.append(Content(source, layers, rendered, leads=not contents))
    return tuple(contents)


def _layers_in(shot: Shot, main: bool) -> tuple[Layer, ...]:
    """Return the layers of a shot's view in its first frame: of the main file, or of all."""
    files, cryptomattes = {}, set()
    for aov, path in shot.files(shot.first).items():
        if aov and main:
            continue
        header = shot.headers.read(path)
        files[aov] = shot.channels(header.parts, aov)
        mattes = find_cryptomattes({aov: files[aov].values()}, {aov: header.texts})
        cryptomattes |= {matte.name for matte in mattes}
    return group_layers(files, shot.layout, cryptomattes)


def template_of(contents: tuple[Content, ...], suffix: str, key: int) -> FrameTemplate:
    """Return what frames made of a key frame, by its index, take over from its file.

    `suffix` is that of the frames' files; it counts where the input has colour alone. Raises
    InputError when the key frame's file cannot be read.
    """
    source = contents[0].source
    keys, number = source.keys, source.timeline.numbers[key]
    if is_plain(keys.sequence):
        return make_frame_template(keys, number, suffix)
    wanted = tuple(content.wanted for content in contents)
    return read_template(keys.sequence.files[number], wanted, keys.headers)


@dataclass(frozen=True)
class LayerFrames:
    """Layers around the slots of one interval."""

    before: Planes
    after: Planes | None  # of the next key frame, where it is used
    older: Planes | None  # of the key frame before, where points are led on from there
    slots: tuple[Planes, ...]  # of the slots' own files, by the key frames' channels; () without


class LayerStore:
    """Reads channels of frames, and remembers them until they are dropped."""

    def __init__(
        self, shot: Shot, layers: Collection[Layer], more: Iterable[ChannelRef] = ()
    ) -> None:
        self._shot = shot
        self._layers = tuple(layers)
        # Part by part: what is decoded as float32 takes half the memory once it is half again.
        groups: dict[tuple[str, int], dict[ChannelRef, bool]] = {}
        for layer in layers:
            for ref, channel in zip(layer.refs, layer.channels, strict=True):
                is_half = channel.pixel_type == "half"
                groups.setdefault((ref.aov, channel.part), {})[ref] = is_half
        in_layers = {ref for group in groups.values() for ref in group}
        for ref in more:
            if ref not in in_layers:
                groups.setdefault((ref.aov, -1), {})[ref] = False
        self._groups = tuple(groups.values())
        self._frames: dict[int, Planes] = {}

    def frame(self, number: int) -> Planes:
        """Return the channels of a frame.

        Raises InputError when a file is missing, damaged, of another size, or lacks a channel.
        """
        if number in self._frames:
            return self._frames[number]
        planes: dict[ChannelRef, Plane] = {}
        for group in self._groups:
            for ref, plane in read_planes(self._shot, number, list(group)).items():
                # Copied, so that the part that it was decoded with can be freed.
                if group[ref] and plane.values.dtype == np.float32:
                    with np.errstate(over="ignore"):  # another frame may hold the channel as float
                        values = plane.values.astype(np.float16)
                else:
                    values = np.ascontiguousarray(plane.values)
                planes[ref] = replace(plane, values=values)
        self._frames[number] = planes
        roles = {refs: role for role, refs in self._shot.layout.roles.items()}
        broken = {}
        for layer in self._layers:
            role = roles.get(layer.refs)
            counted_as = Role.DEPTH if layer.kind is LayerKind.DEPTH else role
            count = count_nonfinite((planes[ref].values for ref in layer.refs), counted_as)
            broken[layer.name if role is None else role.value] = count
        self._shot.nonfinite.note(number, broken)
        return planes

    def keep(self, numbers: Iterable[int]) -> None:
        """Drop all other frames."""
        self._frames = {n: self._frames[n] for n in numbers if n in self._frames}


class LayerReader:
    """Reads the layers of a view, interval by interval; what several share is read once."""

    def __init__(self, content: Content) -> None:
        self._content = content
        source = content.source
        self._keys = LayerStore(source.keys, content.extra, content.motion)
        self._slots = None
        if source.slots is not None and content.rendered:
            self._slots = LayerStore(source.slots, content.rendered.values())

    def read(self, key: int, lookahead: bool, older: int | None) -> LayerFrames:
        """Read an interval, by the index of its key frame.

        With `lookahead` the next key frame is used; `older` is the index of an older one, if used.
        """
        source = self._content.source
        numbers = source.timeline.numbers
        before = self._keys.frame(numbers[key])
        after = self._keys.frame(numbers[key + 1]) if lookahead else None
        back = None if older is None else self._keys.frame(numbers[older])
        slots = source.timeline.between(key)
        in_slots = [number for number in map(source.slot_number, slots) if number is not None]
        if self._slots is None or len(in_slots) < len(slots):
            return LayerFrames(before, after, back, ())
        refs: dict[ChannelRef, ChannelRef] = {}  # the slots' channels by the key frames'
        for layer, rendered in self._content.rendered.items():
            own = {ref.component: ref for ref in rendered.refs}
            refs |= {ref: own[ref.component] for ref in layer.refs}
        frames = (self._slots.frame(number) for number in in_slots)
        planes = tuple({ref: frame[own] for ref, own in refs.items()} for frame in frames)
        self._slots.keep(())
        return LayerFrames(before, after, back, planes)

    def read_key(self, key: int) -> None:
        """Read a key frame's layers ahead; raises InputError where that fails."""
        self._keys.frame(self._content.source.timeline.numbers[key])

    def release_before(self, key: int) -> None:
        """Drop what no interval after this one needs."""
        self._keys.keep(self._content.source.timeline.numbers[key : key + 2])


@dataclass
class ExtraLayers:
    """Makes the planes that are written with the beauty of the view that leads."""

    contents: tuple[Content, ...]  # what is written of each view, the one that leads first
    builders: tuple[IntervalBuilder, ...] = ()  # of the other views, in the same order
    _views: tuple[ViewInterval, ...] = field(default=(), init=False)

    @property
    def any(self) -> bool:
        """True if more than the beauty of the view that leads is written."""
        return len(self.contents) > 1 or bool(self.contents[0].extra)

    @property
    def kinds(self) -> set[LayerKind]:
        """What the layers of all views are, beside the beauty."""
        return {layer.kind for content in self.contents for layer in content.extra}

    def begin(self, inputs: IntervalInputs, interval: Interval | None) -> None:
        """Turn to an interval; None where nothing of it has to be made, and to drop the last."""
        self._views = ()
        if interval is None:
            return
        views = [ViewInterval(self.contents[0], inputs, interval)]
        for content, builder, view in zip(
            self.contents[1:], self.builders, inputs.views, strict=True
        ):
            # One view decides which network mixes all of them, and how its tiles are chosen.
            network, chooser = interval.interpolator, interval.chooser
            built = replace(builder.build(view), interpolator=network, chooser=chooser)
            views.append(ViewInterval(content, view, built))
        self._views = tuple(views)

    def make(
        self, slot: int, shown: Predicted, predict: Predict, template: Template
    ) -> dict[PlaneKey, Plane]:
        """Make the planes of a slot, 1 or more, that `template` has.

        `shown` is the beauty of the view that leads, `predict` makes that of another view; a path
        that made them is their method's name.
        """
        needed = {plane.key for part in template.parts for plane in part.planes}
        leader, *further = self._views
        planes = leader.planes(slot, shown, needed)
        for view in further:
            beauty, wanted = predict(view.interval), view.content.wanted
            for i, ref in enumerate(wanted.colour):
                planes[wanted.view, ref] = Plane(beauty.pixels[..., i], view.window)
            planes |= view.planes(slot, beauty, needed)
        return planes


@dataclass(frozen=True)
class ViewInterval:
    """One view of an interval."""

    content: Content
    inputs: IntervalInputs
    interval: Interval

    @property
    def window(self) -> Window:
        """What its planes are made on."""
        return self.interval.key.image.data_window

    @cached_property
    def course(self) -> LayerMotion | None:
        """How its points move; None where that is not known."""
        key, following = self.interval.key.gbuffer, self.interval.following
        if key is None or not key.has_motion:
            return None
        older = None if self.inputs.older is None else self.inputs.older.extended(self.window)
        others = (None if frame is None else frame.gbuffer for frame in (following, older))
        return LayerMotion(key, *others)

    def planes(self, slot: int, shown: Predicted, needed: set[PlaneKey]) -> dict[PlaneKey, Plane]:
        """Make the layers beside the beauty `shown`, one after the other.

        `needed` are those that are written: a channel that several views share is the first one's.
        """
        view, beauty = self.content.wanted.view, self.content.wanted.colour
        frames = self.inputs.layers
        if frames is None:
            return {}
        retimer = make_retimer(self.interval, slot, shown)
        motion, convention = self.content.motion, self.content.source.convention
        vectors: dict[ChannelRef, np.ndarray] = {}  # made once: several layers may hold them
        own = frames.slots[slot - 1] if frames.slots else {}
        planes: dict[PlaneKey, Plane] = {}
        for layer in self.content.extra:
            if not any((view, ref) in needed for ref in layer.refs):
                continue
            if all(ref in own for ref in layer.refs):
                values = {
                    ref: np.array(place_on_canvas(own[ref].values, own[ref].window, self.window))
                    for ref in layer.refs
                }
            else:
                is_motion = layer.kind is LayerKind.MOTION and any(r in motion for r in layer.refs)
                if is_motion and not vectors and convention is not None:
                    before = self._stack(frames.before, motion)
                    after = None if frames.after is None else self._stack(frames.after, motion)
                    moved = retimer.vectors(convention, before, after)
                    vectors = {ref: moved[..., i] for i, ref in enumerate(motion)}
                values = self._retimed(layer, frames, retimer, vectors if is_motion else {})
            if layer.kind is not LayerKind.COLOUR:  # which is mended where it is mixed
                background = np.inf if layer.kind is LayerKind.DEPTH else 0.0
                retimer.sources.mend(list(values.values()), background)
            for ref, plane in values.items():
                if ref not in beauty:
                    planes[view, ref] = Plane(plane, self.window)
        return planes

    def _retimed(
        self,
        layer: Layer,
        frames: LayerFrames,
        retimer: LayerRetimer,
        vectors: Mapping[ChannelRef, np.ndarray],  # the motion channels; {} for other layers
    ) -> dict[ChannelRef, np.ndarray]:
        """Make a layer's channels for a slot, [H, W] each, in the type that its file has."""
        refs, window = layer.refs, self.window
        sides = [side for side in (frames.before, frames.after) if side is not None]
        if layer.kind is LayerKind.COLOUR:
            stacks = [self._stack(side, refs) for side in sides]
            display = self.interval.key.image.display_window
            for side, stack in zip(sides, stacks, strict=True):
                for i, ref in enumerate(refs):
                    # What no data tells is unknown, as in the beauty.
                    if side[ref].window != window:
                        unknown = outside_mask(window, side[ref].window)
                        stack[unknown & outside_mask(window, display), i] = np.nan
            values = retimer.colour(*stacks)
        elif layer.kind in POINTS:
            # What a key frame does not tell of a point is no change: not that it went to 0.
            known = tuple(
                None if planes is None else self._stack(planes, refs, np.nan)
                for planes in (frames.before, frames.after, frames.older)
            )
            values = retimer.moved(self.course, known, layer.kind is LayerKind.POSITION)
            for i, ref in enumerate(refs):
                ends = [side[ref].window for side in sides]
                if any(not end.covers(window) for end in ends):
                    outside = (outside_mask(window, end) for end in ends)
                    values[retimer.sources.take(*outside), i] = 0
        else:
            copied: dict[ChannelRef, np.ndarray] = {}
            for ref in refs:
                if ref in vectors:
                    copied[ref] = vectors[ref]
                    continue
                # The sources' values, bit for bit, in the type that the key frame has.
                dtype = frames.before[ref].values.dtype
                placed = [place_on_canvas(s[ref].values, s[ref].window, window) for s in sides]
                with np.errstate(invalid="ignore", over="ignore"):
                    alike = [plane.astype(dtype, copy=False) for plane in placed]
                copied[ref] = retimer.sources.take(*alike)
            return copied
        # Copied, so that half takes its own memory.
        return {ref: np.ascontiguousarray(values[..., i]) for i, ref in enumerate(refs)}

    def _stack(self, planes: Planes, refs: tuple[ChannelRef, ...], fill: float = 0.0) -> Float32:
        placed = []
        for plane in (planes[ref] for ref in refs):
            values = plane.values.astype(np.float32, copy=False)
            placed.append(place_on_canvas(values, plane.window, self.window, fill))
        return np.stack(placed, axis=-1)
