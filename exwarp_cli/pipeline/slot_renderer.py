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
from exwarp_cli.domain.decision import TIMING_STEPS, Decision, Features, Plan, Trial, infer_maker
from exwarp_cli.domain.frame import Bool, Image, place_on_canvas
from exwarp_cli.domain.results import FrameKind, FrameRecord
from exwarp_cli.domain.tiles import Risk, TileMakers, TilePlan
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.errors import OutputError
from exwarp_cli.io.exr.writer import PREFIX, Plane, PlaneKey, Template
from exwarp_cli.io.generated_frames import (
    KEY_FRAMES,
    REQUESTED_METHOD,
    FrameTemplate,
    quantise_picture,
)
from exwarp_cli.io.layers import LayerKind
from exwarp_cli.metrics.temporal import mean_gradient
from exwarp_cli.pipeline.extra_layers import ExtraLayers, named_by_path
from exwarp_cli.pipeline.frame_writer import FrameWriter
from exwarp_cli.pipeline.interval_builder import PreparedInterval
from exwarp_cli.pipeline.interval_inputs import IntervalInputs
from exwarp_cli.pipeline.scheduling import record_time
from exwarp_cli.pipeline.source import Source
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import Method, Predicted, predict_path, predict_tiles, repeat_held
from exwarp_cli.synthesis.sub_intervals import SubSlot

# Attribute of generated frames; their tiles are in the one named risk.
PREDICTED_ERROR = "predictedError"

# Attribute of generated frames: numbers of those of ``--rendered`` that they are made from.
RENDERED_SOURCES = "renderedSources"


@dataclass(frozen=True)
class RenderedSlot:
    """A slot's frame on its way to its file, or there."""

    record: FrameRecord  # without scores, and without the time that writing took
    image: Image | None = None  # None where it has to be read from its file
    rounded: bool = True  # True if `image` is as its file has it
    mask: Bool | None = None  # [H, W]: its holes on the display window; None without motion
    # Its mean gradient, where that is compared with those of its key frames; None elsewhere.
    gradient: float | None = None


class SlotRenderer:
    """Renders the frames of slots; in several threads, where only the beauty is written.

    With `gradients`, new frames without ground truth come with their mean gradient.
    """

    def __init__(
        self,
        source: Source,
        method: Method,
        writer: FrameWriter,
        layers: ExtraLayers,
        gradients: bool = False,
    ) -> None:
        self._source = source
        self._method = method
        self._writer = writer
        self._layers = layers
        self._gradients = gradients

    def render(
        self, prepared: PreparedInterval, inputs: IntervalInputs, slot: Slot, in_pool: bool = False
    ) -> RenderedSlot:
        """Render the frame of a slot, and have it written.

        With `in_pool`, this thread writes it, and does not return before.
        """
        interval, plan, writer = prepared.interval, prepared.plan, self._writer
        assert interval is not None
        part = prepared.parts.get(slot.index)
        around, index = (interval, slot.index) if part is None else (part.interval, part.index)
        timing = dict(prepared.timing_ms)
        layers_timing: dict[str, float] = {}
        with record_time(timing, "render"):
            predicted = self._predict(around, plan, index)
        if part is not None:
            around.forget(index)
        timing[TIMING_STEPS.get(predicted.made_by, predicted.made_by)] = timing.pop("render")
        image = Image(predicted.pixels, interval.key.image.data_window, self._source.keys.display)
        with record_time(layers_timing, "layers"):
            layers = self._make_layers(slot, predicted, inputs, plan)
        mask = self._mask(interval, slot)
        # The first repeat of a key frame that is not shown itself is no repeat.
        is_shown = inputs.after_hold or self._source.timeline.shows(slot.key)
        is_first = slot.index == 1 and not is_shown
        kind = FrameKind.GENERATED if is_first else predicted.kind
        measures = self._measures_gradient(kind, slot, inputs)
        shows = bool(inputs.truth.frames) or writer.shows
        template = inputs.metadata.template
        as_written = rounded(image, template) if shows or measures else None
        gradient = None
        if as_written is not None and measures:
            with record_time(timing, "pulse"):
                gradient = self._gradient(as_written)
        record = self._new_record(slot, prepared, inputs, predicted, part)
        record = replace(
            record,
            kind=kind,
            # Rounded to float32 as the header of the frame keeps it.
            hole_fraction=(
                None if mask is None else float(np.float32(np.count_nonzero(mask) / mask.size))
            ),
            timing_ms=timing | (layers_timing if layers else {}),
            risk=predicted.risk if kind is FrameKind.GENERATED else None,
        )
        if in_pool:
            interval.forget(slot.index)
        attributes = self._attributes(record, inputs)
        writer.write(record.number, image, mask, template, attributes, layers, inline=in_pool)
        if shows:
            return RenderedSlot(record, as_written, mask=mask, gradient=gradient)
        if in_pool:  # what else needs it reads its file
            return RenderedSlot(record, mask=mask, gradient=gradient)
        return RenderedSlot(record, image, rounded=False, mask=mask, gradient=gradient)

    def resume(
        self, slot: Slot, interval: Interval | None, inputs: IntervalInputs, masked: bool
    ) -> RenderedSlot:
        """Return a frame that an earlier run wrote; with its holes if `masked` or scored."""
        number, writer = self._source.timeline.number(slot), self._writer
        try:
            record = self._read_record(slot, writer.written(number))
        except (LookupError, TypeError, ValueError, AttributeError, RecursionError) as error:
            raise OutputError(
                f"what {writer.name(number)} says of itself was changed by hand; remove it, or "
                "give --overwrite to replace all frames"
            ) from error
        scored = interval is not None and slot.index in inputs.truth.frames
        measures = self._measures_gradient(record.kind, slot, inputs)
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
            writer.write_decoded(number, frame.frame.image, inputs.metadata.template, attributes)
        record = FrameRecord(
            number, writer.name(number), key, slot.index, FrameKind.RENDERED,
            FrameKind.RENDERED.value, (number,), resumed=resumed, replaced=replaced,
        )  # fmt: skip
        return RenderedSlot(record, frame.frame.image)

    def _measures_gradient(self, kind: FrameKind, slot: Slot, inputs: IntervalInputs) -> bool:
        """Return True if a frame's gradient is compared with those of its key frames."""
        is_new = kind is FrameKind.GENERATED
        return self._gradients and is_new and slot.index not in inputs.truth.frames

    def _gradient(self, image: Image) -> float:
        return mean_gradient(image.on(self._source.keys.display).pixels)

    def _mask(self, interval: Interval, slot: Slot) -> Bool | None:
        """Return the hole mask of a slot on the display window."""
        mask = interval.hole_mask(slot.index)
        if mask is None:
            return None
        return place_on_canvas(mask, interval.key.image.data_window, self._source.keys.display)

    def _predict(self, interval: Interval, plan: Plan | TilePlan | None, slot: int) -> Predicted:
        if interval.held:
            return repeat_held(interval)
        if isinstance(plan, TilePlan):
            return predict_tiles(plan, interval, slot)
        if self._method.predict is not None:
            return self._method.predict(interval, slot)
        assert plan is not None
        return replace(predict_path(plan.path, interval, slot), method=self._method.name)

    def _make_layers(
        self, slot: Slot, predicted: Predicted, inputs: IntervalInputs, plan: Plan | TilePlan | None
    ) -> Mapping[PlaneKey, Plane]:
        """Make what is written with a slot's beauty: further layers, and other views."""
        if not self._layers.any:
            return {}
        path = plan.path if isinstance(plan, Plan) else None

        def predict(interval: Interval) -> Predicted:
            return named_by_path(self._predict(interval, plan, slot.index), path)

        template = inputs.metadata.template
        assert isinstance(template, Template)  # layers are for EXR
        return self._layers.make(slot.index, named_by_path(predicted, path), predict, template)

    def _new_record(
        self,
        slot: Slot,
        prepared: PreparedInterval,
        inputs: IntervalInputs,
        predicted: Predicted,
        part: SubSlot | None,
    ) -> FrameRecord:
        """Record what a frame is and what it was made from."""
        timeline, plan = self._source.timeline, prepared.plan
        number = timeline.number(slot)
        rendered = () if part is None else part.rendered
        sources = predicted.sources if part is None else part.keys
        broken = sum(prepared.broken.get(source, 0) for source in sources)
        broken += sum(inputs.rendered.frames[index].broken for index in rendered)
        return FrameRecord(
            number=number,
            file=self._writer.name(number),
            key=timeline.numbers[slot.key],
            slot=slot.index,
            kind=predicted.kind,
            method=predicted.method,
            sources=sources,
            rendered_sources=tuple(timeline.number(Slot(slot.key, i)) for i in rendered),
            nonfinite_pixels=broken,
            made_by=predicted.made_by,
            path=plan.path if isinstance(plan, Plan) else None,
            decision=plan.decision_of(slot.index) if isinstance(plan, Plan) else None,
            replaced=self._writer.is_in_the_way(number),
            trial=prepared.trial,
            tiles=plan.makers(slot.index) if isinstance(plan, TilePlan) else predicted.tiles,
        )

    def _read_record(self, slot: Slot, header: Mapping[str, Any]) -> FrameRecord:
        """Return the record of a frame from what its header says."""
        number, holes = self._source.timeline.number(slot), header.get("holeFraction")
        error, gate, tiles = (header.get(name) for name in (PREDICTED_ERROR, "gate", "tiles"))
        return FrameRecord(
            number=number,
            file=self._writer.name(number),
            key=self._source.timeline.numbers[slot.key],
            slot=slot.index,
            kind=FrameKind(header["kind"]),
            method=str(header["method"]),
            sources=_parse_numbers(str(header["sources"])),
            rendered_sources=_parse_numbers(str(header.get(RENDERED_SOURCES, ""))),
            hole_fraction=None if holes is None else float(holes),
            resumed=True,
            made_by=infer_maker(header.get("madeBy"), str(header["method"])),
            path=header.get("path"),
            decision=parse_decision(header.get("decision")),
            risk=None if error is None else Risk.parsed(float(error), str(header["risk"])),
            trial=None if gate is None else Trial.parsed(str(gate)),
            tiles=None if tiles is None else TileMakers.parsed(str(tiles)),
        )

    def _attributes(self, record: FrameRecord, inputs: IntervalInputs) -> dict[str, Any]:
        """Return the header attributes of a generated frame."""
        digests = inputs.metadata.key_digests.items()
        # Those of a key frame, too, lead over a key interval, which is so many output frames.
        span = self._source.timeline.factor if LayerKind.MOTION in self._layers.kinds else None
        decision = None if record.decision is None else decision_text(record.decision)
        facts: dict[str, Any] = {
            "version": __version__,
            "method": record.method,
            "kind": record.kind.value,
            "sources": ",".join(map(str, record.sources)),
            "key": record.key,
            "slot": record.slot,
            "setting": self._source.setting,
            "recipe": inputs.metadata.recipes[record.slot],
            REQUESTED_METHOD: self._method.name,
            RENDERED_SOURCES: ",".join(map(str, record.rendered_sources)) or None,
            KEY_FRAMES: ",".join(f"{number}:{digest}" for number, digest in digests) or None,
            "madeBy": record.made_by,
            "path": record.path,
            "decision": decision,
            "holeFraction": record.hole_fraction,
            "gate": None if record.trial is None else record.trial.text,
            "tiles": None if record.tiles is None else record.tiles.text,
            PREDICTED_ERROR: None if record.risk is None else record.risk.error,
            "risk": None if record.risk is None else record.risk.text,
            "vectorSpan": None if span is None else float(span),
        }
        own = {f"{PREFIX}{name}": value for name, value in facts.items() if value is not None}
        return {**rate_attribute(self._source), **own}


def _parse_numbers(text: str) -> tuple[int, ...]:
    return tuple(int(number) for number in text.split(",") if number)


def rate_attribute(source: Source) -> dict[str, Any]:
    """Return the header attribute for the rate of the output; none where the rate is assumed."""
    return {} if source.written_fps is None else {"framesPerSecond": source.written_fps}


def rounded(image: Image, template: FrameTemplate) -> Image:
    """Return a frame as its file has it."""
    return replace(image, pixels=quantise_picture(image.pixels, template))


def decision_text(decision: Decision) -> str:
    """Write a decision as JSON on one line."""
    document: dict[str, Any] = {"node": decision.node, "choice": decision.choice}
    if decision.outputs is not None:
        document["outputs"] = decision.outputs
    if decision.features is not None:
        document["features"] = astuple(decision.features)
    if decision.inputs:
        document["inputs"] = decision.inputs
    return json.dumps(document, separators=(",", ":"))


def parse_decision(text: str | None) -> Decision | None:
    """Read what `decision_text` wrote; None for nothing."""
    if text is None:
        return None
    document = json.loads(text)
    warp, extrapolate = document.get("outputs", (None, None))
    features = document.get("features")
    return Decision(
        document["node"],
        document["choice"],
        None if features is None else Features(*features),
        tuple(document.get("inputs", ())),
        None if warp is None else (warp, extrapolate),
    )
