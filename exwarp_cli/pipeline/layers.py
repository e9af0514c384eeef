"""What generated frames hold beside the beauty: further layers, and other views."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from exwarp_cli.domain.frame import Float32, Window, outside_mask, place_on_canvas
from exwarp_cli.io.channels import ChannelRef
from exwarp_cli.io.exr.template import Plane, PlaneKey, Template
from exwarp_cli.io.layers import Kind, Layer
from exwarp_cli.pipeline.contents import POINTS, Content, LayerFrames, Planes
from exwarp_cli.pipeline.interval_builder import IntervalBuilder
from exwarp_cli.pipeline.interval_inputs import IntervalInputs
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import Predicted
from exwarp_cli.synthesis.retime import Course, Retiming, retiming

Predict = Callable[[Interval], Predicted]
"""Makes the frame of a slot from an interval of any view, by what was decided."""


class ExtraLayers:
    """Makes the planes that are written with the beauty of the view that leads.

    Parameters
    ----------
    contents
        What is written of each view, the one that leads first.
    builders
        Of the other views, in the same order.
    """

    def __init__(
        self, contents: tuple[Content, ...], builders: tuple[IntervalBuilder, ...] = ()
    ) -> None:
        self._contents = contents
        self._builders = builders
        self._views: tuple[ViewInterval, ...] = ()

    @property
    def any(self) -> bool:
        """Whether more than the beauty of the view that leads is written."""
        return len(self._contents) > 1 or bool(self._contents[0].beside)

    @property
    def moves_vectors(self) -> bool:
        """Whether motion vectors are written."""
        return any(la.kind is Kind.MOTION for content in self._contents for la in content.beside)

    @property
    def moves_light(self) -> bool:
        """Whether layers of colour are written, which may add up to the beauty."""
        return any(la.kind is Kind.COLOUR for content in self._contents for la in content.beside)

    def begin(self, inputs: IntervalInputs, interval: Interval | None) -> None:
        """Turn to an interval; None where nothing of it has to be made, and to let the last go."""
        self._views = ()
        if interval is None:
            return
        views = [ViewInterval(self._contents[0], inputs, interval)]
        for content, builder, view in zip(
            self._contents[1:], self._builders, inputs.views, strict=True
        ):
            # One view decides which network mixes all of them.
            other = replace(builder.build(view), interpolator=interval.interpolator)
            views.append(ViewInterval(content, view, other))
        self._views = tuple(views)

    def make(
        self, slot: int, shown: Predicted, predict: Predict, template: Template
    ) -> dict[PlaneKey, Plane]:
        """Make the planes of a slot.

        Parameters
        ----------
        slot
            1 or more.
        shown
            The beauty of the view that leads; its method is a path's name where a path made it.
        predict
            Makes that of another view.
        template
            Which planes there have to be.
        """
        needed = {plane.key for plane in template.planes}
        leader, *others = self._views
        found = leader.planes(slot, shown, needed)
        for view in others:
            beauty = predict(view.interval)
            found |= view.beauty(beauty)
            found |= view.planes(slot, beauty, needed)
        return found


@dataclass(frozen=True)
class ViewInterval:
    """One view of an interval.

    Attributes
    ----------
    content
        What is written of it.
    inputs, interval
        As read, and on one window.
    """

    content: Content
    inputs: IntervalInputs
    interval: Interval

    @property
    def window(self) -> Window:
        """What its planes are made on."""
        return self.interval.key.image.data_window

    @cached_property
    def course(self) -> Course | None:
        """How its points move; None where that is not known."""
        key, following = self.interval.key.gbuffer, self.interval.following
        if key is None or not key.has_motion:
            return None
        older = None if self.inputs.older is None else self.inputs.older.extended(self.window)
        return Course(
            key,
            None if following is None else following.gbuffer,
            None if older is None else older.gbuffer,
        )

    def beauty(self, shown: Predicted) -> dict[PlaneKey, Plane]:
        """Return the planes of the beauty."""
        wanted = self.content.wanted
        return {
            (wanted.view, ref): Plane(shown.pixels[..., i], self.window)
            for i, ref in enumerate(wanted.colour)
        }

    def planes(self, slot: int, shown: Predicted, needed: set[PlaneKey]) -> dict[PlaneKey, Plane]:
        """Make the layers beside the beauty, one after the other.

        Parameters
        ----------
        slot
            1 or more.
        shown
            The beauty, which they go with.
        needed
            Those that are written: a channel that several views have in common is the first one's.
        """
        view = self.content.wanted.view
        frames = self.inputs.layers
        if frames is None:
            return {}
        maker = _Maker(self, frames, retiming(self.interval, slot, shown), slot)
        found: dict[PlaneKey, Plane] = {}
        for layer in self.content.beside:
            if any((view, ref) in needed for ref in layer.refs):
                for ref, values in maker.layer(layer).items():
                    found[view, ref] = Plane(values, self.window)
        beauty = self.content.wanted.colour
        return {key: plane for key, plane in found.items() if key[1] not in beauty}


@dataclass(frozen=True)
class _Maker:
    """Makes the layers of one slot of a view, each in the type that its file has."""

    view: ViewInterval
    frames: LayerFrames
    how: Retiming
    slot: int

    def layer(self, layer: Layer) -> dict[ChannelRef, np.ndarray]:
        """Make a layer's channels, [H, W] each; all finite, but for infinity in a depth."""
        found = self._made(layer)
        if layer.kind is not Kind.COLOUR:  # which is mended where it is mixed
            nothing = np.inf if layer.kind is Kind.DEPTH else 0.0
            self.how.sources.mend(list(found.values()), nothing)
        return found

    def _made(self, layer: Layer) -> dict[ChannelRef, np.ndarray]:
        """Make a layer's channels from the values of the frames."""
        frames, refs = self.frames, layer.refs
        rendered = frames.slots[self.slot - 1] if frames.slots else {}
        if all(ref in rendered for ref in refs):
            return {ref: np.array(self._placed(rendered[ref])) for ref in refs}
        motion = self.view.content.motion
        if layer.kind is Kind.MOTION and motion:
            return {
                ref: self._vectors[..., motion.index(ref)] if ref in motion else self._copied(ref)
                for ref in refs
            }
        if layer.kind is Kind.COLOUR:
            before = self._light(frames.before, refs)
            after = None if frames.after is None else self._light(frames.after, refs)
            return self._typed(refs, self.how.colour(before, after))
        if layer.kind in POINTS:
            return self._typed(refs, self._points(refs, fixed=layer.kind is Kind.POSITION))
        return {ref: self._copied(ref) for ref in refs}

    def _points(self, refs: tuple[ChannelRef, ...], fixed: bool) -> Float32:
        """Make a layer [H, W, C] whose values change as a point moves."""
        frames, window = self.frames, self.view.window
        # What a key frame does not tell of a point is no change: not that it went to 0.
        before, after, older = (
            None if planes is None else self._stack(planes, refs, np.nan)
            for planes in (frames.before, frames.after, frames.older)
        )
        values = self.how.moved(self.view.course, (before, after, older), fixed)
        for i, ref in enumerate(refs):
            ends = [frame[ref].window for frame in (frames.before, frames.after) if frame]
            if any(not end.covers(window) for end in ends):
                values[self.how.data(*(outside_mask(window, end) for end in ends)), i] = 0
        return values

    @cached_property
    def _vectors(self) -> Float32:
        """All motion channels [H, W, C]."""
        refs, convention = self.view.content.motion, self.view.content.convention
        assert convention is not None
        before = self._stack(self.frames.before, refs)
        after = None if self.frames.after is None else self._stack(self.frames.after, refs)
        return self.how.vectors(convention, before, after)

    def _copied(self, ref: ChannelRef) -> np.ndarray:
        """Copy the sources' values, bit for bit."""
        before, after = self.frames.before[ref], None
        if self.frames.after is not None:
            other = self.frames.after[ref]
            with np.errstate(invalid="ignore", over="ignore"):  # where the type changed on the way
                after = self._placed(other).astype(before.values.dtype, copy=False)
        return self.how.data(self._placed(before), after)

    def _placed(self, plane: Plane, fill: float = 0.0) -> np.ndarray:
        return place_on_canvas(plane.values, plane.window, self.view.window, fill)

    def _stack(self, planes: Planes, refs: tuple[ChannelRef, ...], fill: float = 0.0) -> Float32:
        members = [
            Plane(planes[ref].values.astype(np.float32, copy=False), planes[ref].window)
            for ref in refs
        ]
        return np.stack([self._placed(plane, fill) for plane in members], axis=-1)

    def _light(self, planes: Planes, refs: tuple[ChannelRef, ...]) -> Float32:
        """Return a layer [H, W, C] for warping: what no data tells is unknown, as in the beauty."""
        stack = self._stack(planes, refs)
        display = self.view.interval.key.image.display_window
        for i, ref in enumerate(refs):
            if planes[ref].window != self.view.window:
                window = self.view.window
                unknown = outside_mask(window, planes[ref].window) & outside_mask(window, display)
                stack[unknown, i] = np.nan
        return stack

    def _typed(self, refs: tuple[ChannelRef, ...], values: Float32) -> dict[ChannelRef, np.ndarray]:
        """Split a layer into channels; each is copied, so that half takes its own memory."""
        return {ref: np.ascontiguousarray(values[..., i]) for i, ref in enumerate(refs)}


def named_by_path(shown: Predicted, path: str | None) -> Predicted:
    """Return what is shown with the name of the path that made it, which layers go by."""
    return shown if path is None else replace(shown, method=path.lower())
