"""Two-frame interpolation networks in ONNX files, as their cards describe them.

Such networks differ in what they take and give. The card is the JSON beside ``NAME.onnx``, called
``NAME.json``; models/README.md describes its keys, with an example for RIFE. ``schema``, ``inputs``
and ``output`` are needed. The defaults are: the model's file name, NCHW, RGB, range [0, 1], srgb,
and padding with edge pixels at the right and bottom to a multiple of 1.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from exwarp_cli.domain.colour import ENCODINGS, ShoulderCurve
from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.timeline import MAX_FACTOR
from exwarp_cli.errors import DamagedFileError, InputError, LayoutError, OutputExistsError
from exwarp_cli.io.files import atomic_write_text
from exwarp_cli.models.model_file import read_file_bytes, read_model, shape_text
from exwarp_cli.models.session import OnnxNetwork
from exwarp_cli.runtime import cores

SCHEMA = "exwarp.interpolator/1"

FIRST, SECOND, TIME = "first", "second", "time"
# FIRST, SECOND, TIME or a number.
Part = str | float

MAX_INTEGER = 512
MAX_PARTS = 64
# Padding modes, and numpy's names of them.
MODES = {"edge": "edge", "reflect": "reflect", "zero": "constant"}

KEYS = ("schema", "name", "inputs", "output", "layout", "order", "range", "encoding", "padding")
OUTPUT_KEYS = ("name", "layout", "order", "range", "first_channel")
PADDING_KEYS = ("multiple", "mode", "place")

MAX_ENCODED = 4.0  # largest encoded colour of an answer, as a multiple of white

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

USUAL_OUTPUTS = ("image", "output")  # usual names of the frame in exports that have several outputs


@dataclass(frozen=True)
class PictureFormat:
    """How a network stores a frame; `low` and `high` stand for the encoded values 0 and 1."""

    layout: str  # "NCHW" or "NHWC"
    order: str  # "RGB" or "BGR"
    low: float
    high: float


@dataclass(frozen=True)
class Padding:
    """How frames get a size that a network takes; not centred: at the right and bottom only."""

    multiple: int
    mode: str
    centred: bool


@dataclass(frozen=True)
class Card:
    """What a network takes and gives."""

    path: Path
    checksum: str  # SHA-256, hexadecimal
    name: str  # in tables
    # Parts of each input, joined on the channels. Beside a frame, or where the network declares an
    # input with a free height and width, time and numbers are planes; elsewhere they have the
    # declared shape: a scalar, [1], [1, 1] or [1, 1, 1, 1].
    inputs: Mapping[str, tuple[Part, ...]]
    input_format: PictureFormat
    output_format: PictureFormat
    output: str  # its name
    first_channel: int  # of the output, with which the frame starts
    encoding: str  # the encoding that the network was trained on, out of `ENCODINGS`
    padding: Padding

    @property
    def timed(self) -> bool:
        """True if the network has an input for the time; else it makes the middle frame only."""
        return any(TIME in parts for parts in self.inputs.values())


def parse_card(path: Path, document: Any, checksum: str = "") -> Card:
    """Turn the content of a card's file into a card; LayoutError for what makes no sense."""
    keys = _object(path, "the card", document, KEYS)
    if keys.get("schema") != SCHEMA:
        _refuse(path, "schema", keys.get("schema"), f'"{SCHEMA}"')
    output = keys.get("output")
    output = {"name": output} if isinstance(output, str) else output
    output = _object(path, "output", output, OUTPUT_KEYS)
    padding = _object(path, "padding", keys.get("padding", {}), PADDING_KEYS)
    name = keys.get("name", path.stem)
    output_name: Any = output.get("name")
    for item, text in (("name", name), ("the output's name", output_name)):
        if not isinstance(text, str) or not text.isprintable() or not text.strip():
            _refuse(path, item, text, "a text")
    contents = keys.get("inputs")
    part_texts = "first, second, time, a number, or a list of"
    if not isinstance(contents, dict) or not contents:
        _refuse(path, "inputs", contents, f"an object that gives each input {part_texts} them")
    inputs: dict[str, tuple[Part, ...]] = {}
    for input_name, content in contents.items():
        parts = content if isinstance(content, list) else [content]
        is_known = all(part in (FIRST, SECOND, TIME) or _is_finite(part) for part in parts)
        if not 0 < len(parts) <= MAX_PARTS or not is_known:
            wanted = f"{part_texts} 1 to {MAX_PARTS} of them"
            _refuse(path, f"input {input_name!r}", content, wanted)
        inputs[input_name] = tuple(p if isinstance(p, str) else float(p) for p in parts)
    used = {part for parts in inputs.values() for part in parts}
    if absent := [frame for frame in (FIRST, SECOND) if frame not in used]:
        raise LayoutError(f"the card {path} gives no input the {absent[0]} frame; name one")
    first_channel, multiple = output.get("first_channel", 0), padding.get("multiple", 1)
    for item, number, least in (("first_channel", first_channel, 0), ("multiple", multiple, 1)):
        is_whole = isinstance(number, int) and not isinstance(number, bool)
        if not is_whole or not least <= number <= MAX_INTEGER:
            _refuse(path, item, number, f"a whole number from {least} to {MAX_INTEGER}")
    formats = (_picture_format(path, keys), _picture_format(path, {**keys, **output}))
    encoding = _choice(path, "encoding", keys, ENCODINGS)
    mode = _choice(path, "mode", padding, tuple(MODES))
    is_centred = _choice(path, "place", padding, ("end", "centre")) == "centre"
    fitting = Padding(multiple, mode, is_centred)
    return Card(
        path, checksum, name, inputs, *formats, output_name, first_channel, encoding, fitting
    )


def _picture_format(path: Path, keys: Mapping[str, Any]) -> PictureFormat:
    span = keys.get("range", [0, 1])
    is_pair = isinstance(span, list) and len(span) == 2 and all(map(_is_finite, span))
    if not is_pair or span[0] == span[1]:
        _refuse(path, "range", span, "two numbers, black and white, for example [0, 1]")
    layout = _choice(path, "layout", keys, ("NCHW", "NHWC"))
    order = _choice(path, "order", keys, ("RGB", "BGR"))
    return PictureFormat(layout, order, float(span[0]), float(span[1]))


def _object(path: Path, item: str, value: Any, keys: tuple[str, ...]) -> dict[str, Any]:
    if not isinstance(value, dict):
        _refuse(path, item, value, f"an object with keys out of {', '.join(keys)}")
    if foreign := [key for key in value if key not in keys]:
        raise LayoutError(
            f"the card {path} has the unknown key {foreign[0]!r}; use {', '.join(keys)}"
        )
    return value


def _choice(path: Path, key: str, keys: Mapping[str, Any], choices: tuple[str, ...]) -> str:
    value = keys.get(key, choices[0])
    if not isinstance(value, str) or value not in choices:
        _refuse(path, key, value, f"one of {', '.join(choices)}")
    return value


def _is_finite(value: Any) -> bool:
    """True for a number that float32 holds."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e38


def _refuse(path: Path, item: str, value: Any, wanted: str) -> NoReturn:
    text = json.dumps(value)
    text = text if len(text) <= 60 else text[:57] + "..."
    raise LayoutError(f"the card {path} has {text} as {item}; write {wanted}")


def load_interpolator(path: Path, threads: int | None, device: str) -> OnnxInterpolator:
    """Load a network and the card beside it, and run it once as a check.

    `threads` is a maximum, None for the command's cores; `device` is "cpu" or "cuda".

    Raises InputError if a file is missing or damaged, or the network does not fit its card;
    MissingExtraError if onnxruntime has no CUDA.
    """
    _, data = read_model(path, path.name, "--interpolator")
    card_path = path.with_suffix(".json")
    try:
        card_data = read_file_bytes(card_path)
    except FileNotFoundError as error:
        raise InputError(
            f"{path} has no card {card_path.name} beside it, which says what its inputs are; write "
            "one as models/README.md tells, or have 'exwarp models interpolator-card' begin it"
        ) from error
    except OSError as error:
        raise InputError(
            f"cannot read the card {card_path}: {error.strerror}; check the path and its rights"
        ) from error
    try:
        document = json.loads(card_data)
    except (ValueError, RecursionError) as error:
        raise DamagedFileError(f"the card {card_path} is no JSON ({error}); mend it") from error
    card = parse_card(card_path, document, hashlib.sha256(card_data).hexdigest())
    return OnnxInterpolator(card, path, data, threads or cores.count(), device)


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
    """An interpolation network that is ready to run; LayoutError if it does not fit its card."""

    def __init__(self, card: Card, path: Path, data: bytes, threads: int, device: str) -> None:
        super().__init__(path, data, threads, device)
        self.card, self.name, self.card_checksum = card, card.name, card.checksum
        self._pair: _EncodedPair | None = None
        # A network that does not fit its card is refused by what it declares, then by a run.
        layout = card.input_format.layout
        if foreign := [name for name in self.inputs if name not in card.inputs]:
            raise LayoutError(
                f"{path} has the input {foreign[0]!r}, which its card {card.path} does not name; "
                "say in the card what it gets"
            )
        if missing := [name for name in card.inputs if name not in self.inputs]:
            raise LayoutError(
                f"{path} has no input {missing[0]!r}, which its card {card.path} names; its inputs "
                f"are {', '.join(self.inputs)}"
            )
        if card.output not in self.outputs:
            raise LayoutError(
                f"{path} has no output {card.output!r}, which its card {card.path} names; its "
                f"outputs are {', '.join(self.outputs)}"
            )
        if (kind := self.outputs[card.output].type) not in OUTPUT_TYPES:
            raise LayoutError(
                f"{path} has the output {card.output!r} as {kind}, which is no picture; name "
                f"another one in its card {card.path}, or export the network with a float output"
            )
        for name, parts in card.inputs.items():
            node = self.inputs[name]
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
                    f"{path} has the input {name!r} as {node.type} {shape_text(node.shape)}, and "
                    f"its card {card.path} gives it {shape_text(expected)}; mend the card, or "
                    "export the network with float inputs of any height and width"
                )
        multiple = card.padding.multiple
        # Odd multiples, so that a network which needs more than its card says fails here.
        rows = multiple * (CHECK_HEIGHT // (2 * multiple) * 2 + 3)
        grey = np.full((rows, rows + 2 * multiple, 3), GREY, np.float32)
        self._interpolate(grey, grey, 0.5)

    def __call__(self, before: Float32, after: Float32, time: float) -> Float32:
        """Return the frame at 0 < `time` < 1 between two frames; see `reaches`.

        Frames are float32 [H, W, 3 or 4], scene-linear, finite, of any size. The network sees
        colour encoded by `domain.colour.ShoulderCurve`; alpha is blended by time.
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
        padding, form = self.card.padding, self.card.input_format
        height, width, _ = first.shape
        rows, columns = -height % padding.multiple, -width % padding.multiple
        above, left = (rows // 2, columns // 2) if padding.centred else (0, 0)
        around = ((above, rows - above), (left, columns - left), (0, 0))
        size = (height + rows, width + columns)
        frames: dict[Part, Float32] = {}
        for frame, colour in ((FIRST, first), (SECOND, second)):
            mode: Any = MODES[padding.mode]
            padded = np.pad(colour, around, mode=mode)
            if form.order == "BGR":
                padded = padded[..., ::-1]
            frames[frame] = padded * np.float32(form.high - form.low) + np.float32(form.low)
        feeds: dict[str, np.ndarray] = {}
        for name, node in self.inputs.items():
            parts, dtype = self.card.inputs[name], INPUT_TYPES[node.type]
            values = [time if part == TIME else part for part in parts]
            if not _is_plane(node, parts, form.layout):
                feeds[name] = np.full((1,) * len(node.shape), values[0], dtype)
                continue
            planes = [
                frames[value] if value in frames else np.full((*size, 1), value, np.float32)
                for value in values
            ]
            picture = np.concatenate(planes, axis=-1)
            if form.layout == "NCHW":
                picture = picture.transpose(2, 0, 1)
            feeds[name] = np.ascontiguousarray(picture[None], dtype)
        stride = max(padding.multiple, COARSEST_STRIDE)
        advice = f"check the inputs and the padding in its card {self.card.path}"
        answer = self._answer(self.card.output, feeds, size, stride, advice)
        return self._read(answer, size)[above : above + height, left : left + width]

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
    nodes = network.inputs
    channel = 1 if SHAPES[shape]["layout"] == "NCHW" else 3
    counts = {
        name: node.shape[channel]
        for name, node in nodes.items()
        if len(node.shape) == 4 and node.shape[channel] != 1
    }
    # Pictures in the order of time, and at most one other input, the time.
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
    usual = (name for name in USUAL_OUTPUTS if name in network.outputs)
    document = {
        "schema": SCHEMA,
        "name": path.stem,
        "inputs": {name: inputs[name] for name in nodes},
        "output": next(usual, next(iter(network.outputs))),
        "order": "RGB",
        "range": [0, 1],
        "encoding": "srgb",
        **SHAPES[shape],
    }
    OnnxInterpolator(parse_card(card, document), path, data, 1, "cpu")  # refuses what does not fit
    atomic_write_text(card, json.dumps(document, indent=2) + "\n")
    return card


def _is_plane(node: Any, parts: Sequence[Part], layout: str) -> bool:
    """True if an input is as large as a frame."""
    if len(parts) > 1 or parts[0] in (FIRST, SECOND):
        return True
    sides = node.shape[2:4] if layout == "NCHW" else node.shape[1:3]
    return len(node.shape) == 4 and not any(isinstance(size, int) for size in sides)
