"""Small ONNX networks for tests, built by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from exwarp_cli.domain.network_api import EXTRAPOLATOR_INTERFACE, TIME_INPUT

OPSET = 17
IR = 8


def picture(name: str, channels: int | str, kind: int = TensorProto.FLOAT) -> onnx.ValueInfoProto:
    """A picture input or output of any height and width."""
    return helper.make_tensor_value_info(name, kind, [1, channels, "H", "W"])


def inputs(names: Sequence[str]) -> list[onnx.ValueInfoProto]:
    """The inputs of these names as the interface has them."""
    time = helper.make_tensor_value_info(TIME_INPUT, TensorProto.FLOAT, [1])
    return [
        time if name == TIME_INPUT else picture(name, EXTRAPOLATOR_INTERFACE.inputs[name])
        for name in names
    ]


def model(
    nodes: Sequence[onnx.NodeProto],
    takes: Sequence[onnx.ValueInfoProto],
    gives: Sequence[onnx.ValueInfoProto] | None = None,
    weights: Mapping[str, np.ndarray] | None = None,
    metadata: Mapping[str, str] | None = None,
) -> onnx.ModelProto:
    """Put a graph together."""
    constants = [numpy_helper.from_array(array, name) for name, array in (weights or {}).items()]
    graph = helper.make_graph(
        nodes, "tiny", takes, gives or [picture(EXTRAPOLATOR_INTERFACE.output, 3)], constants
    )
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR)
    helper.set_model_props(made, dict(metadata or {}))
    return made


def save(path: Path, made: onnx.ModelProto) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(made, str(path))
    return path


def filled_warp(gain: float = 1.0, **metadata: str) -> onnx.ModelProto:
    """Give the filled warp back, times `gain`."""
    weights = {
        "start": np.array([3], np.int64),
        "end": np.array([6], np.int64),
        "axis": np.array([1], np.int64),
        "gain": np.array(gain, np.float32),
    }
    nodes = [
        helper.make_node("Slice", ["warped", "start", "end", "axis"], ["filled"]),
        helper.make_node("Mul", ["filled", "gain"], [EXTRAPOLATOR_INTERFACE.output]),
    ]
    stated = {key.replace("__", "."): value for key, value in metadata.items()}
    return model(nodes, inputs(["warped", "mask"]), weights=weights, metadata=stated)


def endless() -> onnx.ModelProto:
    """Give the filled warp back, after a loop of 2^62 rounds."""
    flags = {"i": TensorProto.INT64, "on": TensorProto.BOOL, "still": TensorProto.BOOL}
    scalar = {name: helper.make_tensor_value_info(name, kind, []) for name, kind in flags.items()}
    open_ = {name: helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in "vw"}
    body = helper.make_graph(
        [
            helper.make_node("Identity", ["on"], ["still"]),
            helper.make_node("Identity", ["v"], ["w"]),
        ],
        "round",
        [scalar["i"], scalar["on"], open_["v"]],
        [scalar["still"], open_["w"]],
    )
    made = filled_warp()
    made.graph.node[-1].output[0] = "once"
    rounds = {"rounds": np.array(1 << 62, np.int64), "begin": np.array(True)}
    made.graph.initializer.extend(numpy_helper.from_array(a, name) for name, a in rounds.items())
    made.graph.node.append(
        helper.make_node(
            "Loop", ["rounds", "begin", "once"], [EXTRAPOLATOR_INTERFACE.output], body=body
        )
    )
    return made


def blur(side: int = 9) -> onnx.ModelProto:
    """Blur the filled warp by a box, which spreads colour over what is empty beside it."""
    weights = {
        "start": np.array([3], np.int64),
        "end": np.array([6], np.int64),
        "axis": np.array([1], np.int64),
    }
    box = {"kernel_shape": [side, side], "pads": [side // 2] * 4}
    nodes = [
        helper.make_node("Slice", ["warped", "start", "end", "axis"], ["filled"]),
        helper.make_node("AveragePool", ["filled"], [EXTRAPOLATOR_INTERFACE.output], **box),
    ]
    return model(nodes, inputs(["warped", "mask"]), weights=weights)


def convolution(
    channels: int = 18, seed: int = 0, time: bool = True, scale: int = 1, **metadata: str
) -> onnx.ModelProto:
    """Sum the filled warp and two convolutions of everything there is, the coarse one doubled back.

    Parameters
    ----------
    channels
        Of the hidden layer. Those that are no multiple of 4 take onnxruntime's general path.
    seed
        Of the weights.
    time
        Whether the slot's time brightens the picture.
    scale
        Factor between the picture and the hidden layer, 1 or 2.
    """
    rng = np.random.default_rng(seed)

    def kernel(out: int, into: int) -> np.ndarray:
        return (rng.standard_normal((out, into, 3, 3)) / (10 * into**0.5)).astype(np.float32)

    weights = {
        "start": np.array([3], np.int64),
        "end": np.array([6], np.int64),
        "axis": np.array([1], np.int64),
        "first": kernel(channels, sum(EXTRAPOLATOR_INTERFACE.inputs.values())),
        "second": kernel(channels, channels),
        "third": kernel(3, channels),
        "scales": np.array([1, 1, scale, scale], np.float32),
    }
    same = {"kernel_shape": [3, 3], "pads": [1, 1, 1, 1]}
    nodes = [
        helper.make_node("Concat", list(EXTRAPOLATOR_INTERFACE.inputs), ["all"], axis=1),
        helper.make_node("Conv", ["all", "first"], ["a"], strides=[scale, scale], **same),
        helper.make_node("Relu", ["a"], ["b"]),
        helper.make_node("Conv", ["b", "second"], ["c"], **same),
        helper.make_node("Resize", ["c", "", "scales"], ["d"], mode="nearest"),
        helper.make_node("Conv", ["d", "third"], ["e"], **same),
        helper.make_node("Slice", ["warped", "start", "end", "axis"], ["filled"]),
        helper.make_node("Add", ["e", "filled"], ["f" if time else EXTRAPOLATOR_INTERFACE.output]),
    ]
    names = (
        [*EXTRAPOLATOR_INTERFACE.inputs, TIME_INPUT]
        if time
        else list(EXTRAPOLATOR_INTERFACE.inputs)
    )
    if time:
        weights["hundredth"] = np.array(0.01, np.float32)
        nodes.append(helper.make_node("Mul", [TIME_INPUT, "hundredth"], ["g"]))
        nodes.append(helper.make_node("Add", ["f", "g"], [EXTRAPOLATOR_INTERFACE.output]))
    stated = {key.replace("__", "."): value for key, value in metadata.items()}
    return model(nodes, inputs(names), weights=weights, metadata=stated)
