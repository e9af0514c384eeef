"""Small interpolation networks in the shapes that RIFE, EMA-VFI and FILM are exported in."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper

from exwarp_cli.models.interpolator import SCHEMA
from tests.unit.tiny_models import model, save

FLOAT = TensorProto.FLOAT
TIMES: Mapping[str, Sequence[int | str]] = {
    "scalar": [],
    "[1]": [1],
    "[1, 1]": [1, 1],
    "[1, 1, 1, 1]": [1, 1, 1, 1],
    "plane": [1, 1, "H", "W"],
}
"""Shapes of the time input."""

PAIR = {"img0": "first", "img1": "second"}


def value(name: str, shape: Sequence[int | str], kind: int = FLOAT) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, kind, list(shape))


def nchw(name: str, channels: int, kind: int = FLOAT) -> onnx.ValueInfoProto:
    return value(name, [1, channels, "H", "W"], kind)


def blend(first: str, second: str, time: str, out: str) -> list[onnx.NodeProto]:
    """Nodes that cross-fade."""
    return [
        helper.make_node("Sub", [second, first], ["gap"]),
        helper.make_node("Mul", ["gap", time], ["step"]),
        helper.make_node("Add", [first, "step"], [out]),
    ]


def split(name: str, parts: Mapping[str, int]) -> tuple[onnx.NodeProto, dict[str, np.ndarray]]:
    """A node that takes channels apart, and its constant."""
    sizes = {"sizes": np.array(list(parts.values()), np.int64)}
    return helper.make_node("Split", [name, "sizes"], list(parts), axis=1), sizes


def rife(time: str = "[1]", kind: int = FLOAT) -> onnx.ModelProto:
    """img0, img1 and timestep."""
    takes = [nchw("img0", 3, kind), nchw("img1", 3, kind), value("timestep", TIMES[time], kind)]
    return model(blend("img0", "img1", "timestep", "out"), takes, [nchw("out", 3, kind)])


def stacked(channels: int = 8) -> onnx.ModelProto:
    """One input: two frames, a plane of the time and, of 8 channels, one of the scale."""
    parts = {"a": 3, "b": 3, "t": 1, "scale": 1} if channels == 8 else {"a": 3, "b": 3, "t": 1}
    node, sizes = split("input", parts)
    nodes = [node, *blend("a", "b", "t", "made" if channels == 8 else "output")]
    if channels == 8:
        nodes.append(helper.make_node("Mul", ["made", "scale"], ["output"]))
    return model(nodes, [nchw("input", channels)], [nchw("output", 3)], sizes)


def ema_vfi() -> onnx.ModelProto:
    """Both frames on the channels of one input, and the time as a scalar."""
    node, sizes = split("x", {"a": 3, "b": 3})
    takes = [nchw("x", 6), value("timestep", [])]
    return model([node, *blend("a", "b", "timestep", "pred")], takes, [nchw("pred", 3)], sizes)


def film() -> onnx.ModelProto:
    """time, x0 and x1 with channels last; the frame is one output of several."""
    size = [1, "H", "W", 3]
    nodes = [
        *blend("x0", "x1", "time", "image"),
        helper.make_node("Identity", ["x0"], ["x0_warped"]),
    ]
    takes = [value("time", [1, 1]), value("x0", size), value("x1", size)]
    return model(nodes, takes, [value("x0_warped", size), value("image", size)])


def untimed() -> onnx.ModelProto:
    """The mean of img0 and img1."""
    half = {"half": np.array(0.5, np.float32)}
    nodes = blend("img0", "img1", "half", "out")
    return model(nodes, [nchw("img0", 3), nchw("img1", 3)], [nchw("out", 3)], half)


def first_frame(gain: Sequence[float] = (1, 1, 1), copies: int = 1) -> onnx.ModelProto:
    """The first frame times a gain by channel, after `copies` - 1 black ones on the channels."""
    weights = {
        "gain": np.array(gain, np.float32).reshape(1, 3, 1, 1),
        "none": np.zeros((1, 3, 1, 1), np.float32),
    }
    nodes = [
        helper.make_node("Mul", ["img1", "none"], ["black"]),
        helper.make_node("Mul", ["img0", "gain"], ["gained"]),
        helper.make_node("Concat", [*["black"] * (copies - 1), "gained"], ["out"], axis=1),
    ]
    takes = [nchw("img0", 3), nchw("img1", 3)]
    return model(nodes, takes, [nchw("out", 3 * copies)], weights)


def box_blur(side: int = 3) -> onnx.ModelProto:
    """The first frame, averaged over a box in which zeros lie outside of what it is given."""
    box = {"kernel_shape": [side, side], "pads": [side // 2] * 4, "count_include_pad": 1}
    nodes = [
        helper.make_node("AveragePool", ["img0"], ["blurred"], **box),
        helper.make_node("Sub", ["img1", "img1"], ["nothing"]),
        helper.make_node("Add", ["blurred", "nothing"], ["out"]),
    ]
    return model(nodes, [nchw("img0", 3), nchw("img1", 3)], [nchw("out", 3)])


def convolution(hidden: int = 18, seed: int = 0, scale: int = 1) -> onnx.ModelProto:
    """A cross-fade and what three convolutions add to it, the middle one at 1/`scale`."""
    rng = np.random.default_rng(seed)

    def kernel(out: int, into: int) -> np.ndarray:
        return (rng.standard_normal((out, into, 3, 3)) / (20 * into**0.5)).astype(np.float32)

    weights = {
        "one": kernel(hidden, 6),
        "two": kernel(hidden, hidden),
        "three": kernel(3, hidden),
        "scales": np.array([1, 1, scale, scale], np.float32),
    }
    same = {"kernel_shape": [3, 3], "pads": [1, 1, 1, 1]}
    nodes = [
        helper.make_node("Concat", ["img0", "img1"], ["both"], axis=1),
        helper.make_node("Conv", ["both", "one"], ["p"], strides=[scale, scale], **same),
        helper.make_node("Relu", ["p"], ["q"]),
        helper.make_node("Conv", ["q", "two"], ["r"], **same),
        helper.make_node("Resize", ["r", "", "scales"], ["s"], mode="nearest"),
        helper.make_node("Conv", ["s", "three"], ["more"], **same),
        *blend("img0", "img1", "timestep", "faded"),
        helper.make_node("Add", ["faded", "more"], ["out"]),
    ]
    takes = [nchw("img0", 3), nchw("img1", 3), value("timestep", [1])]
    return model(nodes, takes, [nchw("out", 3)], weights)


CARDS: Mapping[str, tuple[Any, dict[str, Any]]] = {
    **{
        f"rife, time {time}": (
            rife(time),
            {"inputs": PAIR | {"timestep": "time"}, "padding": {"multiple": 32}},
        )
        for time in TIMES
    },
    "rife of 7 channels": (
        stacked(7),
        {"inputs": {"input": ["first", "second", "time"]}, "output": "output"},
    ),
    "rife of 8 channels": (
        stacked(8),
        {"inputs": {"input": ["first", "second", "time", 1]}, "output": "output"},
    ),
    "ema-vfi": (
        ema_vfi(),
        {
            "inputs": {"x": ["first", "second"], "timestep": "time"},
            "output": "pred",
            "padding": {"multiple": 32, "place": "centre"},
        },
    ),
    "film": (
        film(),
        {
            "inputs": {"x0": "first", "x1": "second", "time": "time"},
            "output": "image",
            "layout": "NHWC",
            "padding": {"multiple": 64, "mode": "zero", "place": "centre"},
        },
    ),
    "untimed": (untimed(), {"inputs": PAIR}),
}
"""Networks that cross-fade what they are shown, and their cards, by what they resemble."""


def card(**keys: Any) -> dict[str, Any]:
    """The content of a card; without more, for `first_frame` and `untimed`."""
    return {"schema": SCHEMA, "inputs": PAIR, "output": "out"} | keys


def put(path: Path, made: onnx.ModelProto, keys: Mapping[str, Any]) -> Path:
    """Write a network, and its card beside it."""
    save(path, made)
    path.with_suffix(".json").write_text(json.dumps(card(**keys)), encoding="utf-8")
    return path
