"""Whether an interpolation network fits its card, by what it declares; and how a card begins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from exwarp_cli.errors import LayoutError
from exwarp_cli.io.interpolator_card import FIRST, SCHEMA, SECOND, TIME, Card, Part
from exwarp_cli.io.model_checks import written_shape

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
        told = ", ".join(f"{name} {written_shape(node.shape)}" for name, node in inputs.items())
        raise LayoutError(
            f"{path} has the inputs {told}, which are not those of a {shape} export; write its "
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
