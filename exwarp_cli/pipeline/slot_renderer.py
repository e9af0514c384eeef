"""Rendering the frame of a slot: from its interval to the writer, and what is recorded of it.

A decision is text in the header of the frame that it led to, so that a later run reads it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import astuple, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from exwarp_cli import __version__
from exwarp_cli.domain.decision import (
    NODE_SLOTS,
    TIMING_STEPS,
    Decision,
    Features,
    Plan,
    Trial,
    infer_maker,
)
from exwarp_cli.domain.frame import Bool, Image, place_on_canvas
from exwarp_cli.domain.results import FrameKind, FrameRecord
from exwarp_cli.domain.tiles import Risk, TileMakers, TilePlan
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.errors import OutputError
from exwarp_cli.io import generated_frames
from exwarp_cli.io.exr.writer import PREFIX, Template
from exwarp_cli.io.layers import LayerKind
from exwarp_cli.pipeline.extra_layers import ExtraLayers
from exwarp_cli.pipeline.frame_writer import FrameWriter
from exwarp_cli.pipeline.interval_builder import PreparedInterval
from exwarp_cli.pipeline.interval_inputs import IntervalInputs
from exwarp_cli.pipeline.scheduling import record_time
from exwarp_cli.pipeline.scoring import KeyedPulses
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
    image: Image | None = None  # as its file has it; None where it has to be read from there
    mask: Bool | None = None  # [H, W]: its holes on the display window; None without motion


@dataclass(frozen=True)
class SlotRenderer:
    """Renders the frames of slots; in several threads, where only the beauty is written."""

    source: Source
    method: Method
    writer: FrameWriter
    layers: ExtraLayers
    pulses: KeyedPulses | None  # of new frames without ground truth; None where not measured
    listens: bool  # whether a `FrameListener` may want frames

    def render(
        self, prepared: PreparedInterval, inputs: IntervalInputs, slot: Slot, in_pool: bool = False
    ) -> RenderedSlot:
        """Render the frame of a slot, and have it written.

        With `in_pool`, this thread writes it, and does not return before.
        """
        interval, plan, writer = prepared.interval, prepared.plan, self.writer
        assert interval is not None
        part = prepared.parts.get(slot.index)
        around, index = (interval, slot.index) if part is None else (part.interval, part.index)
        timing = dict(prepared.timing_ms)
        with record_time(timing, "render"):
            predicted = self._predict(around, plan, index)
        if part is not None:
            around.forget(index)
        timing[TIMING_STEPS.get(predicted.made_by, predicted.made_by)] = timing.pop("render")
        image = Image(predicted.pixels, interval.key.image.data_window, self.source.keys.display)
        template, layers = inputs.template, {}
        if self.layers.any:
            assert isinstance(template, Template)  # layers are for EXR
            with record_time(timing, "layers"):
                predict = partial(self._predict, plan=plan, slot=slot.index)
                layers = self.layers.make(slot.index, predicted, predict, template)
        mask = self._mask(interval, slot)
        # The first repeat of a key frame that is not shown itself is no repeat.
        is_shown = inputs.after_hold or self.source.timeline.shows(slot.key)
        is_first = slot.index == 1 and not is_shown
        kind = FrameKind.GENERATED if is_first else predicted.kind
        has_pulse = kind is FrameKind.GENERATED and slot.index not in inputs.truth.frames
        pulses = self.pulses if has_pulse else None
        # What a listener wants of a frame from the pool is read from its file.
        listens = self.listens and not in_pool
        shows = bool(inputs.truth.frames) or writer.output.video is not None or listens
        as_written = None
        if shows or pulses is not None:
            pixels = generated_frames.quantise_picture(image.pixels, template)
            as_written = replace(image, pixels=pixels)
            if pulses is not None:
                with record_time(timing, "pulse"):
                    pulses.add(slot, as_written)
        predicted = replace(predicted, kind=kind)
        record = self._new_record(slot, prepared, inputs, predicted, part, mask, timing)
        if in_pool:
            interval.forget(slot.index)
        attributes = self._attributes(record, inputs)
        writer.write(record.number, image, template, attributes, mask, layers, inline=in_pool)
        return RenderedSlot(record, as_written if shows else None, mask)

    def resume(
        self, slot: Slot, interval: Interval | None, inputs: IntervalInputs, masked: bool
    ) -> RenderedSlot:
        """Return a frame that an earlier run wrote; with its holes if `masked` or scored."""
        number, writer = self.source.timeline.number(slot), self.writer
        try:
            header = generated_frames.read_facts(writer.path(number))
            sources, rendered_sources = (
                tuple(int(source) for source in str(text).split(",") if source)
                for text in (header["sources"], header.get(RENDERED_SOURCES, ""))
            )
            holes, risk = header.get("holeFraction"), header.get(PREDICTED_ERROR)
            gate, tiles = header.get("gate"), header.get("tiles")
            record = FrameRecord(
                number=number,
                file=writer.name(number),
                key=self.source.timeline.numbers[slot.key],
                slot=slot.index,
                kind=FrameKind(header["kind"]),
                method=str(header["method"]),
                sources=sources,
                rendered_sources=rendered_sources,
                hole_fraction=None if holes is None else float(holes),
                resumed=True,
                made_by=infer_maker(header.get("madeBy"), str(header["method"])),
                path=header.get("path"),
                decision=parse_decision(header.get("decision")),
                risk=None if risk is None else Risk.parsed(float(risk), str(header["risk"])),
                trial=None if gate is None else Trial.parsed(str(gate)),
                tiles=None if tiles is None else TileMakers.parsed(str(tiles)),
            )
        except (LookupError, TypeError, ValueError, AttributeError, RecursionError) as error:
            raise OutputError(
                f"what {writer.name(number)} says of itself was changed by hand; remove it, or "
                "give --overwrite to replace all frames"
            ) from error
        has_truth = slot.index in inputs.truth.frames
        scored = interval is not None and has_truth
        pulses = None if has_truth or record.kind is not FrameKind.GENERATED else self.pulses
        image = writer.read(number) if scored or pulses is not None else None
        if image is not None and pulses is not None:
            pulses.add(slot, image)
        mask = None if interval is None or not (scored or masked) else self._mask(interval, slot)
        return RenderedSlot(record, image, mask)

    def pass_rendered(self, slot: Slot, inputs: IntervalInputs) -> RenderedSlot:
        """Pass a frame through that was rendered in the place of a generated one."""
        frame, writer = inputs.rendered.frames[slot.index], self.writer
        timeline = self.source.timeline
        number, key = timeline.number(slot), timeline.numbers[slot.key]
        resumed = writer.has_rendered(number, frame.path, frame.recipe)
        replaced = not resumed and writer.is_in_the_way(number)
        marks: dict[str, str | int] = {
            "method": FrameKind.RENDERED.value,
            "kind": FrameKind.RENDERED.value,
            "sources": frame.path.name,
            "key": key,
            "slot": slot.index,
            "recipe": frame.recipe,
        }
        if not resumed and writer.copies(frame.path):
            writer.pass_frame(number, frame.path, {"version": __version__, **marks})
        elif not resumed and writer.output.frames is not None:
            attributes = header_attributes(self.source, marks)
            writer.write(number, frame.frame.image, inputs.template, attributes)
        record = FrameRecord(
            number,
            writer.name(number),
            key,
            slot.index,
            FrameKind.RENDERED,
            FrameKind.RENDERED.value,
            (number,),
            resumed=resumed,
            replaced=replaced,
        )
        return RenderedSlot(record, frame.frame.image)

    def _mask(self, interval: Interval, slot: Slot) -> Bool | None:
        """Return the hole mask of a slot on the display window."""
        mask = interval.hole_mask(slot.index)
        if mask is None:
            return None
        return place_on_canvas(mask, interval.key.image.data_window, self.source.keys.display)

    def _predict(self, interval: Interval, plan: Plan | TilePlan | None, slot: int) -> Predicted:
        if interval.held:
            return repeat_held(interval)
        if isinstance(plan, TilePlan):
            return predict_tiles(plan, interval, slot)
        if self.method.predict is not None:
            return self.method.predict(interval, slot)
        assert plan is not None
        return predict_path(plan.path, interval, slot)

    def _new_record(
        self,
        slot: Slot,
        prepared: PreparedInterval,
        inputs: IntervalInputs,
        predicted: Predicted,
        part: SubSlot | None,
        mask: Bool | None,
        timing_ms: dict[str, float],
    ) -> FrameRecord:
        timeline, plan = self.source.timeline, prepared.plan
        # What a path made that was decided is of the method that decides.
        decided = isinstance(plan, Plan) and self.method.predict is None
        decisions = plan.decisions if isinstance(plan, Plan) else ()
        number = timeline.number(slot)
        rendered = () if part is None else part.rendered
        sources = predicted.sources if part is None else part.keys
        broken = sum(prepared.broken.get(source, 0) for source in sources)
        broken += sum(inputs.rendered.frames[index].broken for index in rendered)
        return FrameRecord(
            number=number,
            file=self.writer.name(number),
            key=timeline.numbers[slot.key],
            slot=slot.index,
            kind=predicted.kind,
            method=self.method.name if decided else predicted.method,
            sources=sources,
            rendered_sources=tuple(timeline.number(Slot(slot.key, i)) for i in rendered),
            # Rounded to float32 as the header of the frame keeps it.
            hole_fraction=(
                None if mask is None else float(np.float32(np.count_nonzero(mask) / mask.size))
            ),
            nonfinite_pixels=broken,
            timing_ms=timing_ms,
            made_by=predicted.made_by,
            path=plan.path if isinstance(plan, Plan) else None,
            # None about slot 2 after d1 = E
            decision=next((d for d in decisions if NODE_SLOTS[d.node] == slot.index), None),
            replaced=self.writer.is_in_the_way(number),
            risk=predicted.risk if predicted.kind is FrameKind.GENERATED else None,
            trial=prepared.trial,
            tiles=plan.makers(slot.index) if isinstance(plan, TilePlan) else predicted.tiles,
        )

    def _attributes(self, record: FrameRecord, inputs: IntervalInputs) -> dict[str, Any]:
        digests = (f"{number}:{digest}" for number, digest in inputs.key_digests.items())
        # Those of a key frame, too, lead over a key interval, which is so many output frames.
        span = self.source.timeline.factor if LayerKind.MOTION in self.layers.kinds else None
        decision = None if record.decision is None else decision_text(record.decision)
        facts: dict[str, Any] = {
            "method": record.method,
            "kind": record.kind.value,
            "sources": ",".join(map(str, record.sources)),
            "key": record.key,
            "slot": record.slot,
            "setting": self.source.setting,
            "recipe": inputs.recipes[record.slot],
            generated_frames.REQUESTED_METHOD: self.method.name,
            RENDERED_SOURCES: ",".join(map(str, record.rendered_sources)) or None,
            generated_frames.KEY_FRAMES: ",".join(digests) or None,
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
        attributes = header_attributes(self.source, facts)
        compression = self.writer.output.compression
        return attributes if compression is None else attributes | {"compression": compression}


def header_attributes(source: Source, facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return ExWarp's own header attributes, and the output's rate, but for what is None.

    The rate is none where it is assumed.
    """
    own = {f"{PREFIX}{name}": value for name, value in {"version": __version__, **facts}.items()}
    attributes = {"framesPerSecond": source.written_fps, **own}
    return {name: value for name, value in attributes.items() if value is not None}


def decision_text(decision: Decision) -> str:
    """Write a decision as JSON on one line."""
    document = {
        "node": decision.node,
        "choice": decision.choice,
        "outputs": decision.outputs,
        "features": decision.features and astuple(decision.features),
        "inputs": decision.inputs,
    }
    known = {name: value for name, value in document.items() if value}
    return json.dumps(known, separators=(",", ":"))


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
