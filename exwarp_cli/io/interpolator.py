"""Two-frame interpolation networks in ONNX files, by what the card beside them says."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from exwarp_cli.domain import cores
from exwarp_cli.domain.colour import ShoulderCurve
from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.timeline import MAX_FACTOR
from exwarp_cli.errors import InputError, LayoutError, OutputExistsError
from exwarp_cli.io.atomic import atomic_write_text
from exwarp_cli.io.interpolator_card import (
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
from exwarp_cli.io.model_files import written_shape
from exwarp_cli.io.models import OnnxNetwork, read_model

MOST_SHOWN = 4.0
"""Largest answer that is taken for colour, as a multiple of white."""

COARSEST = 32
"""Pixels of the frame in one of the coarsest scale of such networks, at least."""

TRIED = 32
"""Height, at least, of what a network is tried on."""

GREY = 0.5
"""What a network is tried with: an answer in another range than the card's shows on it."""

OUTPUTS = ("image", "output")
"""What exports usually call the frame, where they give more than that."""


def load_interpolator(path: Path, threads: int | None, device: str) -> OnnxInterpolator:
    """Load a network and its card, and try it once.

    Parameters
    ----------
    path
        ONNX file, with its card beside it.
    threads
        At most; None for as many as the command has cores.
    device
        "cpu" or "cuda".

    Raises
    ------
    InputError
        When a file is missing or damaged, or the network does not fit its card.
    MissingExtraError
        When the device is "cuda" and onnxruntime cannot use it.
    """
    _, data = read_model(path, path.name, "--interpolator")
    network = OnnxInterpolator(read_card(path), path, data, threads or cores.count(), device)
    network.judge()
    return network


@dataclass
class Seen:
    """Two frames as a network sees them, and what it has made between them.

    Attributes
    ----------
    before, after
        The frames themselves, float32 [H, W, C], scene-linear.
    curve
        Between them and what follows.
    first, second
        float32 [H, W, 3], encoded.
    made
        The same of frames between them, by time, that a network without an input for
        the time has made.
    """

    before: Float32
    after: Float32
    curve: ShoulderCurve
    first: Float32
    second: Float32
    made: dict[float, Float32] = field(default_factory=dict)


class OnnxInterpolator(OnnxNetwork):
    """An interpolation network that is ready to run."""

    def __init__(self, card: Card, path: Path, data: bytes, threads: int, device: str) -> None:
        super().__init__(path, data, threads, device)
        self.card = card
        self._seen: Seen | None = None

    @property
    def name(self) -> str:
        """As tables show it."""
        return self.card.name

    @property
    def card_checksum(self) -> str:
        """SHA-256 of its card."""
        return self.card.checksum

    def __call__(self, before: Float32, after: Float32, time: float) -> Float32:
        """Return the frame at a time, 0 < time < 1, between two frames.

        Parameters
        ----------
        before, after
            float32 [H, W, 3 or 4], scene-linear, finite, of any size. The network sees colour by
            `domain.extrapolator.Curve`; alpha is blended by time.
        time
            See `reaches`.
        """
        if not self.reaches(time):
            raise ValueError(f"a network without an input for the time does not reach {time}")
        seen = self._see(before, after)
        if self.card.timed:
            shown = self._make(seen.first, seen.second, time)
        else:
            shown = self._by_halves(seen, time)
        colour = seen.curve.decode(shown)
        alpha = before[..., 3:] + np.float32(time) * (after[..., 3:] - before[..., 3:])
        return np.ascontiguousarray(np.concatenate([colour, alpha], axis=-1))

    def reaches(self, time: float | Fraction) -> bool:
        """Whether it makes a frame at this time.

        A network without an input for the time reaches multiples of 1/8 only, by using it thrice.
        """
        return self.card.timed or MAX_FACTOR * time % 1 == 0

    def judge(self) -> None:
        """Refuse a network that does not fit its card, by what it declares and by running it."""
        require_nodes(self.card, self.path, self.inputs, self.outputs)
        multiple = self.card.padding.multiple
        # Odd multiples, so that a network which needs more than its card says fails here.
        rows = multiple * (TRIED // (2 * multiple) * 2 + 3)
        blank = np.full((rows, rows + 2 * multiple, 3), GREY, np.float32)
        self._make(blank, blank, 0.5)

    def _see(self, before: Float32, after: Float32) -> Seen:
        """Encode two frames; once for all slots between them."""
        seen = self._seen
        if seen is None or seen.before is not before or seen.after is not after:
            colours = (before[..., :3], after[..., :3])
            curve = ShoulderCurve.of(self.card.encoding, *colours)
            first, second = (curve.encode(colour) for colour in colours)
            seen = self._seen = Seen(before, after, curve, first, second)
        return seen

    def _by_halves(self, seen: Seen, time: float) -> Float32:
        """Reach a time with a network that makes the middle frame: between frames it has made."""
        if time in (0, 1):
            return seen.second if time else seen.first
        if time not in seen.made:
            step = 0.5
            while not (time / step).is_integer():
                step /= 2
            pair = (self._by_halves(seen, time - step), self._by_halves(seen, time + step))
            seen.made[time] = self._make(*pair, 0.5)
        return seen.made[time]

    def _make(self, first: Float32, second: Float32, time: float) -> Float32:
        """Run the network on two encoded frames; return an encoded one, float32 [H, W, 3]."""
        height, width, _ = first.shape
        (above, below), (left, right) = self.card.padding.around(height, width)
        frames = {FIRST: self._given(first), SECOND: self._given(second)}
        size = (above + height + below, left + width + right)
        feeds = {name: self._feed(name, frames, size, time) for name in self.inputs}
        stride = max(self.card.padding.multiple, COARSEST)
        advice = f"check the inputs and the padding in its card {self.card.path}"
        out = self._answer(self.card.output, feeds, size, stride, advice)
        return self._read(out, size)[above : above + height, left : left + width]

    def _given(self, encoded: Float32) -> Float32:
        """Pad an encoded frame and write it as the network wants it; float32 [H, W, 3]."""
        padding, given = self.card.padding, self.card.given
        added = (*padding.around(*encoded.shape[:2]), (0, 0))
        padded = np.pad(encoded, added, mode=MODES[padding.mode])  # type: ignore[call-overload]
        ordered: Float32 = padded[..., ::-1] if given.order == "BGR" else padded
        return ordered * np.float32(given.high - given.low) + np.float32(given.low)

    def _feed(
        self, name: str, frames: Mapping[str, Float32], size: tuple[int, int], time: float
    ) -> np.ndarray:
        """Return what an input gets."""
        node, parts, layout = self.inputs[name], self.card.inputs[name], self.card.given.layout
        dtype = DTYPES[node.type]
        if not is_plane(node, parts, layout):
            return np.full((1,) * len(node.shape), _number(parts[0], time), dtype)
        planes = [
            frames[part]
            if isinstance(part, str) and part in frames
            else np.full((*size, 1), _number(part, time), np.float32)
            for part in parts
        ]
        joined = np.concatenate(planes, axis=-1)
        laid = joined.transpose(2, 0, 1) if layout == "NCHW" else joined
        return np.ascontiguousarray(laid[None], dtype)

    def _read(self, out: np.ndarray, size: tuple[int, int]) -> Float32:
        """Return the frame in what the network gave: encoded, float32 [H, W, 3], padded."""
        made, start = self.card.made, self.card.first_channel
        across = f"{size[1]}x{size[0]} pixels"
        stands = out.ndim == 4 and made.layout == "NCHW"
        laid = out.transpose(0, 2, 3, 1) if stands else out
        taken = laid[..., start : start + 3] if laid.ndim == 4 else laid
        if taken.shape != (1, *size, 3):
            expected = (start + 3, *size) if made.layout == "NCHW" else (*size, start + 3)
            raise LayoutError(
                f"{self.path} gives {written_shape(out.shape)} for {across}, and its card "
                f"{self.card.path} says {written_shape((1, *expected))}; mend the output or the "
                "padding in the card"
            )
        black, white = np.float32(made.low), np.float32(made.high)
        shown: Float32 = (taken[0].astype(np.float32) - black) / (white - black)
        if not np.abs(shown).max() <= MOST_SHOWN:
            raise InputError(
                f"{self.path} gives NaN or values far outside of the range in its card "
                f"{self.card.path} for {across}; mend the range, or use another model"
            )
        return shown[..., ::-1] if made.order == "BGR" else shown


def begin_card(path: Path, shape: str, overwrite: bool = False) -> Path:
    """Write the card of a network whose export has a known shape, and try it.

    Parameters
    ----------
    path
        ONNX file.
    shape
        Out of `io.interpolator_nodes.SHAPES`.
    overwrite
        Whether to replace a card.

    Returns
    -------
    Path
        Of the card.

    Raises
    ------
    OutputExistsError
        When there is a card.
    InputError
        When the network cannot be read, or does not fit.
    OutputError
        When the card cannot be written.
    """
    card = path.with_suffix(".json")
    if card.exists() and not overwrite:
        raise OutputExistsError(f"the card {card} exists; remove it, or use --overwrite")
    _, data = read_model(path, path.name, "--interpolator")
    network = OnnxNetwork(path, data, 1, "cpu")
    output = next(
        (name for name in OUTPUTS if name in network.outputs), next(iter(network.outputs))
    )
    document = begun(path, network.inputs, output, shape)
    OnnxInterpolator(parse_card(card, document), path, data, 1, "cpu").judge()
    atomic_write_text(card, json.dumps(document, indent=2) + "\n")
    return card


def _number(part: Part, time: float) -> float:
    """Return what a plane or a scalar holds."""
    return time if part == TIME else float(part)


DTYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16}
"""What inputs may hold, as onnxruntime names it."""

MADE = (*DTYPES, "tensor(double)", "tensor(uint8)", "tensor(uint16)")
"""What the output may hold."""

MOST_AXES = 4

SHAPES: Mapping[str, Mapping[str, Any]] = {
    "rife": {"layout": "NCHW", "padding": {"multiple": 32, "mode": "edge", "place": "end"}},
    "ema-vfi": {"layout": "NCHW", "padding": {"multiple": 32, "mode": "edge", "place": "centre"}},
    "film": {"layout": "NHWC", "padding": {"multiple": 64, "mode": "zero", "place": "centre"}},
}
"""What the cards of known exports begin with."""

BY_CHANNELS: Mapping[int, list[Part]] = {
    6: [FIRST, SECOND],
    7: [FIRST, SECOND, TIME],
    8: [FIRST, SECOND, TIME, 1.0],
}
"""What a single picture input of so many channels gets; the last plane is RIFE's scale."""


def is_plane(node: Any, parts: Sequence[Part], layout: str) -> bool:
    """Whether an input is as large as a frame.

    Parameters
    ----------
    node
        The input, as onnxruntime tells it.
    parts
        What the card gives it.
    layout
        "NCHW" or "NHWC".
    """
    if len(parts) > 1 or parts[0] in (FIRST, SECOND):
        return True
    return len(node.shape) == 4 and not any(isinstance(s, int) for s in _sides(node, layout))


def require_nodes(
    card: Card, path: Path, inputs: Mapping[str, Any], outputs: Mapping[str, Any]
) -> None:
    """Refuse a network whose inputs and output are not those of its card.

    Parameters
    ----------
    card
        What it should take.
    path
        Of the network.
    inputs, outputs
        By name, each with `name`, `type` and `shape` as onnxruntime tells them.

    Raises
    ------
    LayoutError
        Which tells the first thing that does not fit.
    """
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
    if (kind := outputs[card.output].type) not in MADE:
        raise LayoutError(
            f"{path} has the output {card.output!r} as {kind}, which is no picture; name another "
            f"one in its card {card.path}, or export the network with a float output"
        )
    for name, parts in card.inputs.items():
        _require_shape(card, path, inputs[name], parts)


def begun(path: Path, inputs: Mapping[str, Any], output: str, shape: str) -> dict[str, Any]:
    """Return the content of a card for a network whose export has a known shape.

    Parameters
    ----------
    path
        Of the network.
    inputs
        By name, as onnxruntime tells them: pictures in the order of time, and at most one other.
    output
        Name of the output.
    shape
        Out of `SHAPES`.

    Raises
    ------
    LayoutError
        When the inputs are none of those.
    """
    layout = SHAPES[shape]["layout"]
    channel = 1 if layout == "NCHW" else 3
    counts = {
        name: node.shape[channel]
        for name, node in inputs.items()
        if len(node.shape) == 4 and node.shape[channel] != 1
    }
    given: dict[str, Any] = {name: TIME for name in inputs if name not in counts}
    if list(counts.values()) == [3, 3]:
        given |= dict(zip(counts, (FIRST, SECOND), strict=True))
    elif len(counts) == 1 and next(iter(counts.values())) in BY_CHANNELS:
        given |= {name: BY_CHANNELS[count] for name, count in counts.items()}
    if len(given) != len(inputs) or list(given.values()).count(TIME) > 1:
        listed = ", ".join(f"{name} {written_shape(node.shape)}" for name, node in inputs.items())
        raise LayoutError(
            f"{path} has the inputs {listed}, which are not those of a {shape} export; write its "
            "card by hand, as models/README.md tells"
        )
    return {
        "schema": SCHEMA,
        "name": path.stem,
        "inputs": {name: given[name] for name in inputs},
        "output": output,
        "order": "RGB",
        "range": [0, 1],
        "encoding": "srgb",
        **SHAPES[shape],
    }


def _require_shape(card: Card, path: Path, node: Any, parts: Sequence[Part]) -> None:
    """Refuse an input that cannot hold its parts."""
    layout = card.given.layout
    if is_plane(node, parts, layout):
        channels = sum(3 if part in (FIRST, SECOND) else 1 for part in parts)
        expected: tuple[Any, ...]
        expected = (1, channels, "H", "W") if layout == "NCHW" else (1, "H", "W", channels)
    else:
        expected = (1,) * min(len(node.shape), MOST_AXES)
    fits = len(node.shape) == len(expected) and all(
        not isinstance(have, int) or have == want
        for have, want in zip(node.shape, expected, strict=True)
    )
    if not fits or node.type not in DTYPES:
        raise LayoutError(
            f"{path} has the input {node.name!r} as {node.type} {written_shape(node.shape)}, and "
            f"its card {card.path} gives it {written_shape(expected)}; mend the card, or export "
            "the network with float inputs of any height and width"
        )


def _sides(node: Any, layout: str) -> tuple[Any, ...]:
    """Return the declared height and width of an input with four axes."""
    return tuple(node.shape[2:4] if layout == "NCHW" else node.shape[1:3])
