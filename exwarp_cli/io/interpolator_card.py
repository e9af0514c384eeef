"""The card of an interpolation network: the JSON beside ``NAME.onnx``, called ``NAME.json``.

Two-frame networks differ in what they take and give. A card says it, for example for RIFE::

    {
        "schema": "exwarp.interpolator/1",
        "name": "RIFE 4.25",
        "inputs": {"img0": "first", "img1": "second", "timestep": "time"},
        "output": "output",
        "layout": "NCHW",
        "order": "RGB",
        "range": [0, 1],
        "encoding": "srgb",
        "padding": {"multiple": 32, "mode": "edge", "place": "end"},
    }

``schema``, ``inputs`` and ``output`` are needed. The others default to what stands here; ``name``
is the model's file name without its suffix, and ``padding`` is to a multiple of 1.

``name``
    As tables show it.
``inputs``
    What each input of the network gets: ``first`` and ``second`` (the two frames), ``time`` (0 to
    1 from the first to the second) or a number; or a list of those, joined on the channels. Beside
    a frame, or where the network declares an input with a free height and width, time and numbers
    are planes; elsewhere they have the declared shape: a scalar, [1], [1, 1] or [1, 1, 1, 1]. A
    network without ``time`` makes the middle frame; slots 1 and 3 come from using it twice.
``output``
    Name of the output; or an object with its ``name`` and, where they differ from those of the
    inputs, ``layout``, ``order``, ``range``, and ``first_channel``, the one that the frame starts
    with where the output has more than three channels.
``layout``
    ``NCHW`` or ``NHWC``.
``order``
    ``RGB`` or ``BGR``.
``range``
    What black and white are for the network: [0, 1], [-1, 1], [0, 255].
``encoding``
    What the network was trained on: ``srgb``, ``linear`` or ``log``, see `domain.extrapolator`.
``padding``
    ``multiple``: what height and width have to be multiples of; ``mode``: what is added, ``edge``,
    ``reflect`` or ``zero`` (black); ``place``: at the right and bottom (``end``) or on all sides
    (``centre``).
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
from exwarp_cli.io.model_files import read_whole

SCHEMA = "exwarp.interpolator/1"

FIRST, SECOND, TIME = "first", "second", "time"
Part = str | float
"""FIRST, SECOND, TIME or a number."""

MOST_MULTIPLE = 512
MOST_PARTS = 64
MODES = {"edge": "edge", "reflect": "reflect", "zero": "constant"}
"""Ways to pad, and numpy's names of them."""

KEYS = ("schema", "name", "inputs", "output", "layout", "order", "range", "encoding", "padding")
OUTPUT_KEYS = ("name", "layout", "order", "range", "first_channel")
PADDING_KEYS = ("multiple", "mode", "place")


@dataclass(frozen=True)
class Picture:
    """How a frame is written for a network.

    Attributes
    ----------
    layout
        "NCHW" or "NHWC".
    order
        "RGB" or "BGR".
    low, high
        What encoded 0 and 1 are.
    """

    layout: str
    order: str
    low: float
    high: float


@dataclass(frozen=True)
class Padding:
    """How frames are brought to a size that a network takes.

    Attributes
    ----------
    multiple
        Of height and width.
    mode
        Out of `MODES`.
    centred
        Whether all sides get some; else the right and the bottom.
    """

    multiple: int
    mode: str
    centred: bool

    def around(self, height: int, width: int) -> tuple[tuple[int, int], tuple[int, int]]:
        """Return the rows above and below and the columns left and right to add."""
        missing = [-size % self.multiple for size in (height, width)]
        before = [size // 2 if self.centred else 0 for size in missing]
        (above, left), (rows, columns) = before, missing
        return (above, rows - above), (left, columns - left)


@dataclass(frozen=True)
class Card:
    """What a network takes and gives; the module's text tells the keys.

    Attributes
    ----------
    path
        The card's file.
    checksum
        SHA-256 of it, in hexadecimal digits.
    name
        As tables show it.
    inputs
        The parts of each input.
    given, made
        How frames are written for the network, and by it.
    output
        Name of the output.
    first_channel
        Where the frame starts in it.
    encoding
        Out of `ENCODINGS`.
    padding
        Of the frames.
    """

    path: Path
    checksum: str
    name: str
    inputs: Mapping[str, tuple[Part, ...]]
    given: Picture
    made: Picture
    output: str
    first_channel: int
    encoding: str
    padding: Padding

    @property
    def timed(self) -> bool:
        """Whether the network has an input for the time; else it makes the middle frame."""
        return any(TIME in parts for parts in self.inputs.values())


def read_card(model: Path) -> Card:
    """Read the card beside a model.

    Raises
    ------
    InputError
        When there is none, it cannot be read, or it says what no network can be given.
    """
    path = model.with_suffix(".json")
    try:
        data = read_whole(path)
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
    """Turn the content of a card's file into a card; InputError for what makes no sense."""
    keys = _object(path, "the card", document, KEYS)
    if keys.get("schema") != SCHEMA:
        _refuse(path, "schema", keys.get("schema"), f'"{SCHEMA}"')
    made = keys.get("output")
    made = {"name": made} if isinstance(made, str) else made
    made = _object(path, "output", made, OUTPUT_KEYS)
    padding = _object(path, "padding", keys.get("padding", {}), PADDING_KEYS)
    place = _choice(path, "place", padding, ("end", "centre"))
    return Card(
        path=path,
        checksum=checksum,
        name=_text(path, "name", keys.get("name", path.stem)),
        inputs=_inputs(path, keys.get("inputs")),
        given=_picture(path, keys),
        made=_picture(path, {**keys, **made}),
        output=_text(path, "the output's name", made.get("name")),
        first_channel=_whole(path, "first_channel", made.get("first_channel", 0), 0),
        encoding=_choice(path, "encoding", keys, ENCODINGS),
        padding=Padding(
            _whole(path, "multiple", padding.get("multiple", 1), 1),
            _choice(path, "mode", padding, tuple(MODES)),
            place == "centre",
        ),
    )


def _inputs(path: Path, value: Any) -> dict[str, tuple[Part, ...]]:
    """Read what each input gets; both frames have to be among it."""
    wanted = "an object that gives each input first, second, time, a number, or a list of them"
    if not isinstance(value, dict) or not value:
        _refuse(path, "inputs", value, wanted)
    found: dict[str, tuple[Part, ...]] = {}
    for name, given in value.items():
        parts = given if isinstance(given, list) else [given]
        if not 0 < len(parts) <= MOST_PARTS or not all(
            part in (FIRST, SECOND, TIME) or _finite(part) for part in parts
        ):
            _refuse(
                path,
                f"input {name!r}",
                given,
                f"first, second, time, a number, or a list of 1 to {MOST_PARTS} of them",
            )
        found[name] = tuple(part if isinstance(part, str) else float(part) for part in parts)
    for frame in (FIRST, SECOND):
        if not any(frame in parts for parts in found.values()):
            raise LayoutError(f"the card {path} gives no input the {frame} frame; name one")
    return found


def _picture(path: Path, keys: Mapping[str, Any]) -> Picture:
    span = keys.get("range", [0, 1])
    if (
        not isinstance(span, list)
        or len(span) != 2
        or not all(map(_finite, span))
        or span[0] == span[1]
    ):
        _refuse(path, "range", span, "two numbers, black and white, for example [0, 1]")
    layout = _choice(path, "layout", keys, ("NCHW", "NHWC"))
    order = _choice(path, "order", keys, ("RGB", "BGR"))
    return Picture(layout, order, float(span[0]), float(span[1]))


def _object(path: Path, what: str, value: Any, known: tuple[str, ...]) -> dict[str, Any]:
    if not isinstance(value, dict):
        _refuse(path, what, value, f"an object with keys out of {', '.join(known)}")
    if foreign := [key for key in value if key not in known]:
        raise LayoutError(
            f"the card {path} has the unknown key {foreign[0]!r}; use {', '.join(known)}"
        )
    return value


def _choice(path: Path, what: str, keys: Mapping[str, Any], known: tuple[str, ...]) -> str:
    """Read one of some words; the first is the default."""
    value = keys.get(what, known[0])
    if not isinstance(value, str) or value not in known:
        _refuse(path, what, value, f"one of {', '.join(known)}")
    return value


def _text(path: Path, what: str, value: Any) -> str:
    if not isinstance(value, str) or not value.isprintable() or not value.strip():
        _refuse(path, what, value, "a text")
    return value


def _whole(path: Path, what: str, value: Any, least: int) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= MOST_MULTIPLE:
        _refuse(path, what, value, f"a whole number from {least} to {MOST_MULTIPLE}")
    return value


def _finite(value: Any) -> bool:
    """Whether a value is a number that float32 holds."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e38


def _refuse(path: Path, what: str, value: Any, wanted: str) -> NoReturn:
    written = json.dumps(value)
    written = written if len(written) <= 60 else written[:57] + "..."
    raise LayoutError(f"the card {path} has {written} as {what}; write {wanted}")
