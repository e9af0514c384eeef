"""The card of an interpolation network: the JSON beside ``NAME.onnx``, called ``NAME.json``.

Two-frame networks differ in what they take and give. models/README.md describes the keys of a card,
with an example for RIFE. ``schema``, ``inputs`` and ``output`` are needed. The defaults are: the
model's file name, NCHW, RGB, range [0, 1], srgb, and padding with edge pixels at the right and
bottom to a multiple of 1.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from exwarp_cli.domain.colour import ENCODINGS
from exwarp_cli.errors import DamagedFileError, InputError, LayoutError
from exwarp_cli.models.model_file import read_file_bytes

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

    def around(self, height: int, width: int) -> tuple[tuple[int, int], tuple[int, int]]:
        """Return the rows above and below, and the columns left and right, to add."""
        rows, columns = -height % self.multiple, -width % self.multiple
        above, left = (rows // 2, columns // 2) if self.centred else (0, 0)
        return (above, rows - above), (left, columns - left)


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
    # Name of the output, and the channel in it that the frame starts with.
    output: str
    first_channel: int
    # The encoding that the network was trained on, out of `ENCODINGS`.
    encoding: str
    padding: Padding

    @property
    def timed(self) -> bool:
        """True if the network has an input for the time; else it makes the middle frame only."""
        return any(TIME in parts for parts in self.inputs.values())


def read_card(model: Path) -> Card:
    """Read the card beside a model; InputError if it is missing, unreadable or senseless."""
    path = model.with_suffix(".json")
    try:
        data = read_file_bytes(path)
    except FileNotFoundError as error:
        raise InputError(
            f"{model} has no card {path.name} beside it, which says what its inputs are; write one "
            "as models/README.md tells, or have 'exwarp models interpolator-card' begin it"
        ) from error
    except OSError as error:
        raise InputError(
            f"cannot read the card {path}: {error.strerror}; check the path and its rights"
        ) from error
    try:
        document = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise DamagedFileError(f"the card {path} is no JSON ({error}); mend it") from error
    return parse_card(path, document, hashlib.sha256(data).hexdigest())


def parse_card(path: Path, document: Any, checksum: str = "") -> Card:
    """Turn the content of a card's file into a card; LayoutError for what makes no sense."""
    keys = _object(path, "the card", document, KEYS)
    if keys.get("schema") != SCHEMA:
        _refuse(path, "schema", keys.get("schema"), f'"{SCHEMA}"')
    output = keys.get("output")
    output = {"name": output} if isinstance(output, str) else output
    output = _object(path, "output", output, OUTPUT_KEYS)
    padding = _object(path, "padding", keys.get("padding", {}), PADDING_KEYS)
    place = _choice(path, "place", padding, ("end", "centre"))
    return Card(
        path=path,
        checksum=checksum,
        name=_text(path, "name", keys.get("name", path.stem)),
        inputs=_inputs(path, keys.get("inputs")),
        input_format=_picture_format(path, keys),
        output_format=_picture_format(path, {**keys, **output}),
        output=_text(path, "the output's name", output.get("name")),
        first_channel=_integer(path, "first_channel", output.get("first_channel", 0), 0),
        encoding=_choice(path, "encoding", keys, ENCODINGS),
        padding=Padding(
            _integer(path, "multiple", padding.get("multiple", 1), 1),
            _choice(path, "mode", padding, tuple(MODES)),
            place == "centre",
        ),
    )


def _inputs(path: Path, value: Any) -> dict[str, tuple[Part, ...]]:
    wanted = "an object that gives each input first, second, time, a number, or a list of them"
    if not isinstance(value, dict) or not value:
        _refuse(path, "inputs", value, wanted)
    inputs: dict[str, tuple[Part, ...]] = {}
    for name, content in value.items():
        parts = content if isinstance(content, list) else [content]
        if not 0 < len(parts) <= MAX_PARTS or not all(
            part in (FIRST, SECOND, TIME) or _is_finite(part) for part in parts
        ):
            _refuse(
                path,
                f"input {name!r}",
                content,
                f"first, second, time, a number, or a list of 1 to {MAX_PARTS} of them",
            )
        inputs[name] = tuple(part if isinstance(part, str) else float(part) for part in parts)
    for frame in (FIRST, SECOND):
        if not any(frame in parts for parts in inputs.values()):
            raise LayoutError(f"the card {path} gives no input the {frame} frame; name one")
    return inputs


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


def _text(path: Path, item: str, value: Any) -> str:
    if not isinstance(value, str) or not value.isprintable() or not value.strip():
        _refuse(path, item, value, "a text")
    return value


def _integer(path: Path, item: str, value: Any, least: int) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= MAX_INTEGER:
        _refuse(path, item, value, f"a whole number from {least} to {MAX_INTEGER}")
    return value


def _is_finite(value: Any) -> bool:
    """True for a number that float32 holds."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e38


def _refuse(path: Path, item: str, value: Any, wanted: str) -> NoReturn:
    text = json.dumps(value)
    text = text if len(text) <= 60 else text[:57] + "..."
    raise LayoutError(f"the card {path} has {text} as {item}; write {wanted}")
