"""Making the frame of a slot: from its interval to the file, and what is recorded of it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from exwarp_cli import __version__
from exwarp_cli.domain.decision import Plan
from exwarp_cli.domain.frame import Bool, Image, Window, place
from exwarp_cli.domain.maker import step_of
from exwarp_cli.domain.results import FrameKind, FrameRecord
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.io.authorship import KEY_FRAMES, REQUESTED_METHOD
from exwarp_cli.io.decisions import decision_text
from exwarp_cli.io.exr.template import Plane, PlaneKey, Template
from exwarp_cli.io.frame_files import FrameTemplate, quantised
from exwarp_cli.io.output import PREFIX, compression_of
from exwarp_cli.pipeline.layers import Beside, named_by_path
from exwarp_cli.pipeline.loaded import Loaded
from exwarp_cli.pipeline.sink import Sink
from exwarp_cli.pipeline.source import Source
from exwarp_cli.pipeline.staged import Staged, hole_fraction
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import Method, Predicted, repeat_held, take


@dataclass(frozen=True)
class Made:
    """A slot's frame on its way to its file, or there.

    Attributes
    ----------
    record
        Without scores, and without the time that writing took.
    image
        The frame; None where it has to be read from its file.
    rounded
        Whether it is as its file has it.
    mask
        bool [H, W]: its holes on the display window; None where nothing tells.
    """

    record: FrameRecord
    image: Image | None = None
    rounded: bool = True
    mask: Bool | None = None


class SlotMaker:
    """Makes the frames of slots; several threads may, where nothing is written beside the beauty.

    Parameters
    ----------
    settings, source, method
        Of the run.
    sink
        Where frames go.
    beside
        What is written beside the beauty.
    """

    def __init__(
        self,
        settings: UpsampleSettings,
        source: Source,
        method: Method,
        sink: Sink,
        beside: Beside,
    ) -> None:
        self._settings = settings
        self._source = source
        self._method = method
        self._sink = sink
        self._beside = beside

    def make(self, staged: Staged, loaded: Loaded, slot: Slot, here: bool = False) -> Made:
        """Make the frame of a slot, and have it written.

        Parameters
        ----------
        staged, loaded
            Its interval, of which not everything is there.
        slot
            Which one.
        here
            Whether this thread writes it, and does not return before.
        """
        interval, plan = staged.interval, staged.plan
        assert interval is not None
        begin = time.perf_counter()
        predicted = self._predict(interval, plan, slot.index)
        elapsed = 1e3 * (time.perf_counter() - begin)
        image = Image(predicted.pixels, interval.key.image.data_window, self._display)
        begin = time.perf_counter()
        beside = self._layers(slot, predicted, loaded, plan)
        layers_ms = 1e3 * (time.perf_counter() - begin)
        mask = self.mask(interval, slot)
        record = FrameRecord(
            number=self._source.timeline.number(slot),
            file=self._sink.name(self._source.timeline.number(slot)),
            key=interval.key.number,
            slot=slot.index,
            kind=self._kind(predicted, slot, loaded.after_hold),
            method=predicted.method,
            sources=predicted.sources,
            hole_fraction=hole_fraction(mask),
            nonfinite_pixels=sum(staged.broken.get(number, 0) for number in predicted.sources),
            timing_ms=staged.shares
            | {step_of(predicted.made_by): elapsed}
            | ({"layers": layers_ms} if beside else {}),
            made_by=predicted.made_by,
            path=None if plan is None else plan.path,
            decision=None if plan is None else plan.decision_of(slot.index),
            replaced=self._sink.is_in_the_way(self._source.timeline.number(slot)),
        )
        if here:
            interval.forget(slot.index)
        attributes = self._attributes(record, loaded)
        self._sink.write(record.number, image, mask, loaded.template, attributes, beside, here)
        if loaded.truth or self._sink.shows:
            return Made(record, rounded(image, loaded.template), mask=mask)
        if here:  # who asks for it finds it in its file
            return Made(record, mask=mask)
        return Made(record, image, rounded=False, mask=mask)

    def mask(self, interval: Interval, slot: Slot) -> Bool | None:
        """Return the hole mask of a slot on the display window."""
        mask = interval.hole_mask(slot.index)
        if mask is None:
            return None
        return place(mask, interval.key.image.data_window, self._display)

    @property
    def _display(self) -> Window:
        return self._source.keys.display

    def _predict(self, interval: Interval, plan: Plan | None, slot: int) -> Predicted:
        """Make a slot's frame: by the interval's path, or by the method itself."""
        if interval.held:
            return repeat_held(interval)
        if self._method.predict is not None:
            return self._method.predict(interval, slot)
        assert plan is not None
        return replace(take(plan.path, interval, slot), method=self._method.name)

    def _layers(
        self, slot: Slot, predicted: Predicted, loaded: Loaded, plan: Plan | None
    ) -> Mapping[PlaneKey, Plane]:
        """Make what is written with a slot's beauty: further layers, and other views."""
        if not self._beside.anything:
            return {}
        path = None if plan is None else plan.path

        def predict(interval: Interval) -> Predicted:
            return named_by_path(self._predict(interval, plan, slot.index), path)

        shown = named_by_path(predicted, path)
        assert isinstance(loaded.template, Template)  # layers are for EXR
        return self._beside.make(slot.index, shown, predict, loaded.template)

    def _kind(self, predicted: Predicted, slot: Slot, after_hold: bool) -> FrameKind:
        """Return a frame's kind: who repeats a key frame that was not shown shows it first."""
        shown = after_hold or self._source.timeline.shows(slot.key)
        first = slot.index == 1 and not shown
        return FrameKind.GENERATED if first else predicted.kind

    def _attributes(self, record: FrameRecord, loaded: Loaded) -> dict[str, Any]:
        """Header attributes of a generated frame."""
        out: dict[str, Any] = {
            **rate_attribute(self._source),
            f"{PREFIX}version": __version__,
            f"{PREFIX}method": record.method,
            f"{PREFIX}kind": record.kind.value,
            f"{PREFIX}sources": ",".join(str(n) for n in record.sources),
            f"{PREFIX}key": record.key,
            f"{PREFIX}slot": record.slot,
            f"{PREFIX}setting": self._source.setting,
            f"{PREFIX}recipe": loaded.recipes[record.slot],
            f"{PREFIX}{REQUESTED_METHOD}": self._method.name,
        }
        if loaded.key_digests:
            named = (f"{number}:{digest}" for number, digest in loaded.key_digests.items())
            out[f"{PREFIX}{KEY_FRAMES}"] = ",".join(named)
        if record.made_by is not None:
            out[f"{PREFIX}madeBy"] = record.made_by
        if record.path is not None:
            out[f"{PREFIX}path"] = record.path
        if record.decision is not None:
            out[f"{PREFIX}decision"] = decision_text(record.decision)
        if record.hole_fraction is not None:
            out[f"{PREFIX}holeFraction"] = record.hole_fraction
        if self._beside.moves_vectors:
            # Those of a key frame, too, lead over a key interval, which is so many output frames.
            out[f"{PREFIX}vectorSpan"] = float(self._source.timeline.factor)
        compression = compression_of(self._settings.compression)
        if compression is not None:
            out["compression"] = compression
        return out


def rate_attribute(source: Source) -> dict[str, Any]:
    """Return the header attribute for the rate of the output; none where the rate is assumed."""
    return {} if source.written_fps is None else {"framesPerSecond": source.written_fps}


def rounded(image: Image, template: FrameTemplate) -> Image:
    """Return a frame as its file has it."""
    return replace(image, pixels=quantised(image.pixels, template))
