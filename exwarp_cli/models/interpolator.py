"""Run two-frame interpolation networks in ONNX files, as their cards describe them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from exwarp_cli.domain.colour import ShoulderCurve
from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.timeline import MAX_FACTOR
from exwarp_cli.errors import InputError, LayoutError, OutputExistsError
from exwarp_cli.io.files import atomic_write_text
from exwarp_cli.models.interpolator_card import (
    FIRST,
    MODES,
    SCHEMA,
    SECOND,
    TIME,
    Card,
    Part,
    parse_card,
    read_card,
)
from exwarp_cli.models.model_file import read_model, shape_text
from exwarp_cli.models.session import OnnxNetwork
from exwarp_cli.runtime import cores

# Largest encoded colour of an answer, as a multiple of white.
MAX_ENCODED = 4.0

# Least number of pixels of the frame in one of the coarsest scale of such networks.
COARSEST_STRIDE = 32

# The check of a network: least height, and the colour. An answer in another range than the card's
# shows on grey.
CHECK_HEIGHT = 32
GREY = 0.5

# Types of inputs, and of the output, as onnxruntime names them.
INPUT_TYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16}
OUTPUT_TYPES = (*INPUT_TYPES, "tensor(double)", "tensor(uint8)", "tensor(uint16)")
MAX_AXES = 4

# Beginnings of the cards of known exports.
SHAPES: Mapping[str, Mapping[str, Any]] = {
    "rife": {"layout": "NCHW", "padding": {"multiple": 32, "mode": "edge", "place": "end"}},
    "ema-vfi": {"layout": "NCHW", "padding": {"multiple": 32, "mode": "edge", "place": "centre"}},
    "film": {"layout": "NHWC", "padding": {"multiple": 64, "mode": "zero", "place": "centre"}},
}

# Parts of a single picture input by its channels; the last plane is RIFE's scale.
PARTS_BY_CHANNELS: Mapping[int, list[Part]] = {
    6: [FIRST, SECOND],
    7: [FIRST, SECOND, TIME],
    8: [FIRST, SECOND, TIME, 1.0],
}

# Usual names of the frame in exports that have several outputs.
USUAL_OUTPUTS = ("image", "output")


def load_interpolator(path: Path, threads: int | None, device: str) -> OnnxInterpolator:
    """Load a network and the card beside it, and run it once as a check.

    `threads` is a maximum, None for the command's cores; `device` is "cpu" or "cuda".

    Raises InputError if a file is missing or damaged, or the network does not fit its card;
    MissingExtraError if onnxruntime has no CUDA.
    """
    _, data = read_model(path, path.name, "--interpolator")
    network = OnnxInterpolator(read_card(path), path, data, threads or cores.count(), device)
    network.judge()
    return network


@dataclass
class _EncodedPair:
    """Two frames, scene-linear [H, W, C] and encoded [H, W, 3], and the frames between by time."""

    before: Float32
    after: Float32
    curve: ShoulderCurve
    first: Float32
    second: Float32
    between: dict[float, Float32] = field(default_factory=dict)


class OnnxInterpolator(OnnxNetwork):
    """An interpolation network that is ready to run."""

    def __init__(self, card: Card, path: Path, data: bytes, threads: int, device: str) -> None:
        super().__init__(path, data, threads, device)
        self.card, self.name, self.card_checksum = card, card.name, card.checksum
        self._pair: _EncodedPair | None = None

    def __call__(self, before: Float32, after: Float32, time: float) -> Float32:
        """Return the frame at 0 < `time` < 1 between two frames; see `reaches`.

        Frames are float32 [H, W, 3 or 4], scene-linear, finite, of any size. The network sees
        colour encoded by `domain.extrapolator.Curve`; alpha is blended by time.
        """
        if not self.reaches(time):
            raise ValueError(f"a network without an input for the time does not reach {time}")
        pair = self._pair
        if pair is None or pair.before is not before or pair.after is not after:
            colours = (before[..., :3], after[..., :3])
            curve = ShoulderCurve.of(self.card.encoding, *colours)
            first, second = (curve.encode(colour) for colour in colours)
            # Kept for all slots between these frames.
            pair = self._pair = _EncodedPair(before, after, curve, first, second)
        if self.card.timed:
            encoded = self._interpolate(pair.first, pair.second, time)
        else:
            encoded = self._by_halves(pair, time)
        colour = pair.curve.decode(encoded)
        alpha = before[..., 3:] + np.float32(time) * (after[..., 3:] - before[..., 3:])
        return np.ascontiguousarray(np.concatenate([colour, alpha], axis=-1))

    def reaches(self, time: float | Fraction) -> bool:
        """Return True if the network makes a frame at this time.

        A network without an input for the time, used thrice, reaches multiples of 1/8.
        """
        return self.card.timed or MAX_FACTOR * time % 1 == 0

    def judge(self) -> None:
        """Refuse a network that does not fit its card, by what it declares and by running it."""
        _require_nodes(self.card, self.path, self.inputs, self.outputs)
        multiple = self.card.padding.multiple
        # Odd multiples, so that a network which needs more than its card says fails here.
        rows = multiple * (CHECK_HEIGHT // (2 * multiple) * 2 + 3)
        grey = np.full((rows, rows + 2 * multiple, 3), GREY, np.float32)
        self._interpolate(grey, grey, 0.5)

    def _by_halves(self, pair: _EncodedPair, time: float) -> Float32:
        """Bisect the time with a network that makes the middle frame."""
        if time in (0, 1):
            return pair.second if time else pair.first
        if time not in pair.between:
            step = 0.5
            while not (time / step).is_integer():
                step /= 2
            neighbours = (self._by_halves(pair, time - step), self._by_halves(pair, time + step))
            pair.between[time] = self._interpolate(*neighbours, 0.5)
        return pair.between[time]

    def _interpolate(self, first: Float32, second: Float32, time: float) -> Float32:
        """Run the network on two encoded frames [H, W, 3]; return an encoded one."""
        height, width, _ = first.shape
        (above, below), (left, right) = self.card.padding.around(height, width)
        frames = {FIRST: self._padded(first), SECOND: self._padded(second)}
        size = (above + height + below, left + width + right)
        feeds = {name: self._feed(name, frames, size, time) for name in self.inputs}
        stride = max(self.card.padding.multiple, COARSEST_STRIDE)
        advice = f"check the inputs and the padding in its card {self.card.path}"
        answer = self._answer(self.card.output, feeds, size, stride, advice)
        return self._read(answer, size)[above : above + height, left : left + width]

    def _padded(self, encoded: Float32) -> Float32:
        """Return an encoded frame, padded, in the network's order and range; float32 [H, W, 3]."""
        padding, form = self.card.padding, self.card.input_format
        widths = (*padding.around(*encoded.shape[:2]), (0, 0))
        padded: Float32 = np.pad(encoded, widths, mode=MODES[padding.mode])  # type: ignore[call-overload]
        if form.order == "BGR":
            padded = padded[..., ::-1]
        return padded * np.float32(form.high - form.low) + np.float32(form.low)

    def _feed(
        self, name: str, frames: Mapping[str, Float32], size: tuple[int, int], time: float
    ) -> np.ndarray:
        """Return the array of one input."""
        node, parts, layout = (
            self.inputs[name],
            self.card.inputs[name],
            self.card.input_format.layout,
        )
        dtype = INPUT_TYPES[node.type]
        if not _is_plane(node, parts, layout):
            return np.full((1,) * len(node.shape), time if parts[0] == TIME else parts[0], dtype)
        planes = []
        for part in parts:
            if isinstance(part, str) and part in frames:
                planes.append(frames[part])
            else:
                planes.append(np.full((*size, 1), time if part == TIME else part, np.float32))
        picture = np.concatenate(planes, axis=-1)
        if layout == "NCHW":
            picture = picture.transpose(2, 0, 1)
        return np.ascontiguousarray(picture[None], dtype)

    def _read(self, answer: np.ndarray, size: tuple[int, int]) -> Float32:
        """Return the padded frame in an answer: encoded, float32 [H, W, 3]."""
        form, start = self.card.output_format, self.card.first_channel
        pixels = f"{size[1]}x{size[0]} pixels"
        picture = answer
        if answer.ndim == 4:
            picture = answer.transpose(0, 2, 3, 1) if form.layout == "NCHW" else answer
            picture = picture[..., start : start + 3]
        if picture.shape != (1, *size, 3):
            expected = (start + 3, *size) if form.layout == "NCHW" else (*size, start + 3)
            raise LayoutError(
                f"{self.path} gives {shape_text(answer.shape)} for {pixels}, and its card "
                f"{self.card.path} says {shape_text((1, *expected))}; mend the output or the "
                "padding in the card"
            )
        black, white = np.float32(form.low), np.float32(form.high)
        encoded: Float32 = (picture[0].astype(np.float32) - black) / (white - black)
        if not np.abs(encoded).max() <= MAX_ENCODED:
            raise InputError(
                f"{self.path} gives NaN or values far outside of the range in its card "
                f"{self.card.path} for {pixels}; mend the range, or use another model"
            )
        return encoded[..., ::-1] if form.order == "BGR" else encoded


def begin_card(path: Path, shape: str, overwrite: bool = False) -> Path:
    """Write the card of a network whose export is one of `SHAPES`, and return the card's path.

    Raises OutputExistsError if there is a card, InputError if the network is unreadable or does
    not fit, OutputError if the card cannot be written.
    """
    card = path.with_suffix(".json")
    if card.exists() and not overwrite:
        raise OutputExistsError(f"the card {card} exists; remove it, or use --overwrite")
    _, data = read_model(path, path.name, "--interpolator")
    network = OnnxNetwork(path, data, 1, "cpu")
    usual = (name for name in USUAL_OUTPUTS if name in network.outputs)
    document = {
        "schema": SCHEMA,
        "name": path.stem,
        "inputs": _usual_inputs(path, network.inputs, shape),
        "output": next(usual, next(iter(network.outputs))),
        "order": "RGB",
        "range": [0, 1],
        "encoding": "srgb",
        **SHAPES[shape],
    }
    OnnxInterpolator(parse_card(card, document), path, data, 1, "cpu").judge()
    atomic_write_text(card, json.dumps(document, indent=2) + "\n")
    return card


def _usual_inputs(path: Path, nodes: Mapping[str, Any], shape: str) -> dict[str, Any]:
    """Return a card's inputs: pictures in the order of time, and at most one other, the time."""
    channel = 1 if SHAPES[shape]["layout"] == "NCHW" else 3
    counts = {
        name: node.shape[channel]
        for name, node in nodes.items()
        if len(node.shape) == 4 and node.shape[channel] != 1
    }
    inputs: dict[str, Any] = {name: TIME for name in nodes if name not in counts}
    if list(counts.values()) == [3, 3]:
        inputs |= dict(zip(counts, (FIRST, SECOND), strict=True))
    elif len(counts) == 1 and next(iter(counts.values())) in PARTS_BY_CHANNELS:
        inputs |= {name: PARTS_BY_CHANNELS[count] for name, count in counts.items()}
    if len(inputs) != len(nodes) or list(inputs.values()).count(TIME) > 1:
        listed = ", ".join(f"{name} {shape_text(node.shape)}" for name, node in nodes.items())
        raise LayoutError(
            f"{path} has the inputs {listed}, which are not those of a {shape} export; write its "
            "card by hand, as models/README.md tells"
        )
    return {name: inputs[name] for name in nodes}


def _is_plane(node: Any, parts: Sequence[Part], layout: str) -> bool:
    """True if an input is as large as a frame."""
    if len(parts) > 1 or parts[0] in (FIRST, SECOND):
        return True
    sides = node.shape[2:4] if layout == "NCHW" else node.shape[1:3]
    return len(node.shape) == 4 and not any(isinstance(size, int) for size in sides)


def _require_nodes(
    card: Card, path: Path, inputs: Mapping[str, Any], outputs: Mapping[str, Any]
) -> None:
    """Refuse a network whose inputs or output are not those of its card."""
    if foreign := [name for name in inputs if name not in card.inputs]:
        raise LayoutError(
            f"{path} has the input {foreign[0]!r}, which its card {card.path} does not name; say "
            "in the card what it gets"
        )
    if missing := [name for name in card.inputs if name not in inputs]:
        raise LayoutError(
            f"{path} has no input {missing[0]!r}, which its card {card.path} names; its inputs "
            f"are {', '.join(inputs)}"
        )
    if card.output not in outputs:
        raise LayoutError(
            f"{path} has no output {card.output!r}, which its card {card.path} names; its outputs "
            f"are {', '.join(outputs)}"
        )
    if (kind := outputs[card.output].type) not in OUTPUT_TYPES:
        raise LayoutError(
            f"{path} has the output {card.output!r} as {kind}, which is no picture; name another "
            f"one in its card {card.path}, or export the network with a float output"
        )
    for name, parts in card.inputs.items():
        _require_shape(card, path, inputs[name], parts)


def _require_shape(card: Card, path: Path, node: Any, parts: Sequence[Part]) -> None:
    layout = card.input_format.layout
    expected: tuple[Any, ...] = (1,) * min(len(node.shape), MAX_AXES)
    if _is_plane(node, parts, layout):
        channels = sum(3 if part in (FIRST, SECOND) else 1 for part in parts)
        expected = (1, channels, "H", "W") if layout == "NCHW" else (1, "H", "W", channels)
    fits = len(node.shape) == len(expected) and all(
        not isinstance(size, int) or size == wanted
        for size, wanted in zip(node.shape, expected, strict=True)
    )
    if not fits or node.type not in INPUT_TYPES:
        raise LayoutError(
            f"{path} has the input {node.name!r} as {node.type} {shape_text(node.shape)}, and "
            f"its card {card.path} gives it {shape_text(expected)}; mend the card, or export "
            "the network with float inputs of any height and width"
        )
