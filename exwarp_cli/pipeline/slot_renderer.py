"""Rendering the frame of a slot: from its interval to the writer, and what is recorded of it.

A decision is text in the header of the frame that it led to, so that a later run reads it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import astuple, dataclass, replace
from typing import Any

import numpy as np

from exwarp_cli import __version__
from exwarp_cli.domain.decision import Decision, Features, Plan, Trial, infer_maker, timing_step
from exwarp_cli.domain.frame import Bool, Image, place_on_canvas
from exwarp_cli.domain.results import FrameKind, FrameRecord
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.tiles import Risk, TileMakers, TilePlan
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.errors import OutputError
from exwarp_cli.io.exr.template import Plane, PlaneKey, Template
from exwarp_cli.io.output import (
    KEY_FRAMES,
    PREFIX,
    REQUESTED_METHOD,
    FrameTemplate,
    compression_of,
    quantised,
)
from exwarp_cli.metrics.temporal import mean_gradient
from exwarp_cli.pipeline.frame_writer import FrameWriter
from exwarp_cli.pipeline.interval_builder import PreparedInterval
from exwarp_cli.pipeline.interval_inputs import IntervalInputs
from exwarp_cli.pipeline.layers import ExtraLayers, named_by_path
from exwarp_cli.pipeline.scheduling import record_time
from exwarp_cli.pipeline.source import Source
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import Method, Predicted, repeat_held, take, take_tiles
from exwarp_cli.synthesis.sub_intervals import SubSlot

PREDICTED_ERROR = "predictedError"
"""Attribute of generated frames; their tiles are in the one named risk."""

RENDERED_SOURCES = "renderedSources"
"""Attribute of generated frames: numbers of those of ``--rendered`` that they are made from."""


@dataclass(frozen=True)
class RenderedSlot:
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
        bool [H, W]: its holes on the display window; None without motion.
    gradient
        Its mean gradient, where that is compared with those of its key frames; None elsewhere.
    """

    record: FrameRecord
    image: Image | None = None
    rounded: bool = True
    mask: Bool | None = None
    gradient: float | None = None


class SlotRenderer:
    """Renders the frames of slots; in several threads, where only the beauty is written.

    With `gradients`, new frames without ground truth come with their mean gradient.
    """

    def __init__(
        self,
        settings: UpsampleSettings,
        source: Source,
        method: Method,
        writer: FrameWriter,
        layers: ExtraLayers,
        gradients: bool = False,
    ) -> None:
        self._settings = settings
        self._source = source
        self._method = method
        self._writer = writer
        self._layers = layers
        self._gradients = gradients

    def render(
        self,
        prepared: PreparedInterval,
        inputs: IntervalInputs,
        slot: Slot,
        in_pool: bool = False,
    ) -> RenderedSlot:
        """Render the frame of a slot, and have it written.

        With `in_pool`, this thread writes it, and does not return before.
        """
        interval, plan = prepared.interval, prepared.plan
        assert interval is not None
        part = prepared.parts.get(slot.index)
        around, index = (interval, slot.index) if part is None else (part.interval, part.index)
        timing = dict(prepared.timing_ms)
        layers_timing: dict[str, float] = {}
        with record_time(timing, "render"):
            predicted = self._predict(around, plan, index)
        if part is not None:
            around.forget(index)
        timing[timing_step(predicted.made_by)] = timing.pop("render")
        image = Image(predicted.pixels, interval.key.image.data_window, self._source.keys.display)
        with record_time(layers_timing, "layers"):
            layers = self._make_layers(slot, predicted, inputs, plan)
        mask = self._mask(interval, slot)
        number, template = self._source.timeline.number(slot), inputs.metadata.template
        kind = self._kind(predicted, slot, inputs.after_hold)
        measures = self._measures(kind, slot, inputs)
        shows = bool(inputs.truth.frames) or self._writer.shows
        kept = rounded(image, template) if shows or measures else None
        gradient = None
        if kept is not None and measures:
            with record_time(timing, "pulse"):
                gradient = self._gradient(kept)
        record = FrameRecord(
            number=number,
            file=self._writer.name(number),
            key=interval.key.number,
            slot=slot.index,
            kind=kind,
            method=predicted.method,
            sources=predicted.sources if part is None else part.keys,
            rendered_sources=self._rendered_sources(slot, part),
            # Rounded to float32 as the header of the frame keeps it.
            hole_fraction=(
                None if mask is None else float(np.float32(np.count_nonzero(mask) / mask.size))
            ),
            nonfinite_pixels=_broken(prepared, inputs, predicted, part),
            timing_ms=timing | (layers_timing if layers else {}),
            made_by=predicted.made_by,
            path=plan.path if isinstance(plan, Plan) else None,
            decision=plan.decision_of(slot.index) if isinstance(plan, Plan) else None,
            replaced=self._writer.is_in_the_way(number),
            risk=predicted.risk if kind is FrameKind.GENERATED else None,
            trial=prepared.trial,
            tiles=plan.makers(slot.index) if isinstance(plan, TilePlan) else None,
        )
        if in_pool:
            interval.forget(slot.index)
        attributes = self._attributes(record, inputs)
        self._writer.write(number, image, mask, template, attributes, layers, inline=in_pool)
        if shows:
            return RenderedSlot(record, kept, mask=mask, gradient=gradient)
        if in_pool:  # what else needs it reads its file
            return RenderedSlot(record, mask=mask, gradient=gradient)
        return RenderedSlot(record, image, rounded=False, mask=mask, gradient=gradient)

    def resume(
        self, slot: Slot, interval: Interval | None, inputs: IntervalInputs, masked: bool
    ) -> RenderedSlot:
        """Return a frame that an earlier run wrote; with its holes if `masked` or scored."""
        number, writer = self._source.timeline.number(slot), self._writer
        try:
            record = self._recorded(slot, writer.written(number))
        except (LookupError, TypeError, ValueError, AttributeError, RecursionError) as error:
            raise OutputError(
                f"what {writer.name(number)} says of itself was changed by hand; remove it, or "
                "give --overwrite to replace all frames"
            ) from error
        scored = interval is not None and slot.index in inputs.truth.frames
        measures = self._measures(record.kind, slot, inputs)
        image = writer.read(number) if scored or measures else None
        gradient = self._gradient(image) if image is not None and measures else None
        mask = None if interval is None or not (scored or masked) else self._mask(interval, slot)
        return RenderedSlot(record, image, mask=mask, gradient=gradient)

    def pass_rendered(self, slot: Slot, inputs: IntervalInputs) -> RenderedSlot:
        """Pass a frame through that was rendered in the place of a generated one."""
        frame, writer = inputs.rendered.frames[slot.index], self._writer
        timeline = self._source.timeline
        number, key = timeline.number(slot), timeline.numbers[slot.key]
        resumed = writer.has_rendered(number, frame.path, frame.recipe)
        replaced = not resumed and writer.is_in_the_way(number)
        marks: dict[str, str | int] = {
            "version": __version__,
            "method": FrameKind.RENDERED.value,
            "kind": FrameKind.RENDERED.value,
            "sources": frame.path.name,
            "key": key,
            "slot": slot.index,
            "recipe": frame.recipe,
        }
        if not resumed and writer.copies(frame.path):
            writer.pass_rendered(number, frame.path, marks)
        elif not resumed and writer.keeps_frames:
            own = {f"{PREFIX}{name}": value for name, value in marks.items()}
            attributes = {**rate_attribute(self._source), **own}
            writer.write(number, frame.frame.image, None, inputs.metadata.template, attributes)
        record = FrameRecord(
            number, writer.name(number), key, slot.index, FrameKind.RENDERED,
            FrameKind.RENDERED.value, (number,), resumed=resumed, replaced=replaced,
        )  # fmt: skip
        return RenderedSlot(record, frame.frame.image)

    def _measures(self, kind: FrameKind, slot: Slot, inputs: IntervalInputs) -> bool:
        """Return True if a frame's gradient is compared with those of its key frames."""
        is_new = kind is FrameKind.GENERATED
        return self._gradients and is_new and slot.index not in inputs.truth.frames

    def _gradient(self, image: Image) -> float:
        """Return the mean gradient of a frame as its file has it."""
        return mean_gradient(image.on(self._source.keys.display).pixels)

    def _recorded(self, slot: Slot, header: Mapping[str, Any]) -> FrameRecord:
        """Return the record of a frame from what its header says."""
        number, holes = self._source.timeline.number(slot), header.get("holeFraction")
        return FrameRecord(
            number=number,
            file=self._writer.name(number),
            key=self._source.timeline.numbers[slot.key],
            slot=slot.index,
            kind=FrameKind(header["kind"]),
            method=str(header["method"]),
            sources=_numbers(str(header["sources"])),
            rendered_sources=_numbers(str(header.get(RENDERED_SOURCES, ""))),
            hole_fraction=None if holes is None else float(holes),
            resumed=True,
            made_by=infer_maker(header.get("madeBy"), str(header["method"])),
            path=header.get("path"),
            decision=parse_decision(header.get("decision")),
            risk=parse_risk(header),
            trial=None if header.get("gate") is None else Trial.parsed(str(header["gate"])),
            tiles=None if header.get("tiles") is None else TileMakers.parsed(str(header["tiles"])),
        )

    def _rendered_sources(self, slot: Slot, part: SubSlot | None) -> tuple[int, ...]:
        """Return the output numbers of rendered frames that a slot's colour comes from."""
        if part is None:
            return ()
        return tuple(self._source.timeline.number(Slot(slot.key, i)) for i in part.rendered)

    def _mask(self, interval: Interval, slot: Slot) -> Bool | None:
        """Return the hole mask of a slot on the display window."""
        mask = interval.hole_mask(slot.index)
        if mask is None:
            return None
        return place_on_canvas(mask, interval.key.image.data_window, self._source.keys.display)

    def _predict(self, interval: Interval, plan: Plan | TilePlan | None, slot: int) -> Predicted:
        if interval.held:
            return repeat_held(interval)
        if self._method.predict is not None:
            return self._method.predict(interval, slot)
        assert plan is not None
        if isinstance(plan, TilePlan):
            return take_tiles(plan, interval, slot)
        return replace(take(plan.path, interval, slot), method=self._method.name)

    def _make_layers(
        self,
        slot: Slot,
        predicted: Predicted,
        inputs: IntervalInputs,
        plan: Plan | TilePlan | None,
    ) -> Mapping[PlaneKey, Plane]:
        """Make what is written with a slot's beauty: further layers, and other views."""
        if not self._layers.any:
            return {}
        path = plan.path if isinstance(plan, Plan) else None

        def predict(interval: Interval) -> Predicted:
            return named_by_path(self._predict(interval, plan, slot.index), path)

        shown = named_by_path(predicted, path)
        template = inputs.metadata.template
        assert isinstance(template, Template)  # layers are for EXR
        return self._layers.make(slot.index, shown, predict, template)

    def _kind(self, predicted: Predicted, slot: Slot, after_hold: bool) -> FrameKind:
        # The first repeat of a key frame that is not shown itself is no repeat.
        shown = after_hold or self._source.timeline.shows(slot.key)
        first = slot.index == 1 and not shown
        return FrameKind.GENERATED if first else predicted.kind

    def _attributes(self, record: FrameRecord, inputs: IntervalInputs) -> dict[str, Any]:
        """Header attributes of a generated frame."""
        rendered = ",".join(map(str, record.rendered_sources))
        out: dict[str, Any] = {
            **rate_attribute(self._source),
            f"{PREFIX}version": __version__,
            f"{PREFIX}method": record.method,
            f"{PREFIX}kind": record.kind.value,
            f"{PREFIX}sources": ",".join(str(n) for n in record.sources),
            f"{PREFIX}key": record.key,
            f"{PREFIX}slot": record.slot,
            f"{PREFIX}setting": self._source.setting,
            f"{PREFIX}recipe": inputs.metadata.recipes[record.slot],
            f"{PREFIX}{REQUESTED_METHOD}": self._method.name,
            **({f"{PREFIX}{RENDERED_SOURCES}": rendered} if rendered else {}),
        }
        if inputs.metadata.key_digests:
            named = (f"{number}:{digest}" for number, digest in inputs.metadata.key_digests.items())
            out[f"{PREFIX}{KEY_FRAMES}"] = ",".join(named)
        out |= {f"{PREFIX}{name}": value for name, value in _facts(record).items()}
        if record.risk is not None:
            out[f"{PREFIX}{PREDICTED_ERROR}"] = record.risk.error
            out[f"{PREFIX}risk"] = record.risk.text
        if self._layers.moves_vectors:
            # Those of a key frame, too, lead over a key interval, which is so many output frames.
            out[f"{PREFIX}vectorSpan"] = float(self._source.timeline.factor)
        compression = compression_of(self._settings.compression)
        if compression is not None:
            out["compression"] = compression
        return out


def _facts(record: FrameRecord) -> dict[str, Any]:
    """Return what a frame's header says of how it was made, as far as that is known."""
    found = {
        "madeBy": record.made_by,
        "path": record.path,
        "decision": None if record.decision is None else decision_text(record.decision),
        "holeFraction": record.hole_fraction,
        "gate": None if record.trial is None else record.trial.text,
        "tiles": None if record.tiles is None else record.tiles.text,
    }
    return {name: value for name, value in found.items() if value is not None}


def _broken(
    prepared: PreparedInterval, inputs: IntervalInputs, predicted: Predicted, part: SubSlot | None
) -> int:
    """Count the pixels that are NaN or infinite in the frames that a slot is made from."""
    if part is None:
        return sum(prepared.broken.get(number, 0) for number in predicted.sources)
    rendered = (inputs.rendered.frames[slot].broken for slot in part.rendered)
    return sum(prepared.broken.get(number, 0) for number in part.keys) + sum(rendered)


def _numbers(text: str) -> tuple[int, ...]:
    return tuple(int(number) for number in text.split(",") if number)


def rate_attribute(source: Source) -> dict[str, Any]:
    """Return the header attribute for the rate of the output; none where the rate is assumed."""
    return {} if source.written_fps is None else {"framesPerSecond": source.written_fps}


def rounded(image: Image, template: FrameTemplate) -> Image:
    """Return a frame as its file has it."""
    return replace(image, pixels=quantised(image.pixels, template))


def parse_risk(header: Mapping[str, Any]) -> Risk | None:
    """Read how wrong a frame is expected to be from its header; None where that does not say."""
    error = header.get(PREDICTED_ERROR)
    return None if error is None else Risk.parsed(float(error), str(header["risk"]))


def decision_text(decision: Decision) -> str:
    """Write a decision as JSON on one line."""
    found: dict[str, Any] = {"node": decision.node, "choice": decision.choice}
    if decision.outputs is not None:
        found["outputs"] = decision.outputs
    if decision.features is not None:
        found["features"] = astuple(decision.features)
    if decision.inputs:
        found["inputs"] = decision.inputs
    return json.dumps(found, separators=(",", ":"))


def parse_decision(text: str | None) -> Decision | None:
    """Read what `decision_text` wrote; None for nothing."""
    if text is None:
        return None
    found = json.loads(text)
    warp, extrapolate = found.get("outputs", (None, None))
    features = found.get("features")
    return Decision(
        found["node"],
        found["choice"],
        None if features is None else Features(*features),
        tuple(found.get("inputs", ())),
        None if warp is None else (warp, extrapolate),
    )
