"""A look-ahead network of one step, built by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper

from exwarp_cli.domain.network_api import CANDIDATES, LOOKAHEAD_INTERFACE
from tests.unit import tiny_models


def nearer_side(gain: float = 1.0) -> onnx.ModelProto:
    """Weigh by softmax over a mean of 3x3 pixels of the inputs; the weights' sum is `gain`."""
    taps = np.zeros((CANDIDATES, LOOKAHEAD_INTERFACE.inputs["colour"], 3, 3), np.float32)
    rng = np.random.default_rng(3)
    taps[:] = rng.normal(size=taps.shape) / 4
    nodes = [
        helper.make_node("Conv", ["colour", "taps"], ["logits"], pads=[1, 1, 1, 1]),
        helper.make_node("Softmax", ["logits"], ["soft"], axis=1),
        helper.make_node("Mul", ["soft", "gain"], ["weights of all"]),
    ]
    return _answering(nodes, {"taps": taps, "gain": np.array(gain, np.float32)})


def one_candidate(index: int) -> onnx.ModelProto:
    """Give all weight to one candidate: 0 is what `softsplat` makes, 1 the key frame before."""
    chosen = np.zeros((1, CANDIDATES, 1, 1), np.float32)
    chosen[0, index] = 1
    return _answering([], {"weights of all": chosen})


def _answering(nodes: list[onnx.NodeProto], weights: dict[str, np.ndarray]) -> onnx.ModelProto:
    """Answer with ``weights of all``, at the size of the inputs."""
    nodes = [
        *nodes,
        helper.make_node("Mul", ["masks", "none"], ["nothing"]),
        helper.make_node("ReduceSum", ["nothing", "channels"], ["zero"], keepdims=1),
        helper.make_node("Add", ["weights of all", "zero"], [LOOKAHEAD_INTERFACE.output]),
    ]
    weights = {
        **weights,
        "none": np.array(0, np.float32),
        "channels": np.array([1], np.int64),
    }
    takes = [
        tiny_models.picture(name, LOOKAHEAD_INTERFACE.inputs[name]) for name in ("colour", "masks")
    ]
    gives = [tiny_models.picture(LOOKAHEAD_INTERFACE.output, CANDIDATES, TensorProto.FLOAT)]
    return tiny_models.model(nodes, takes, gives, weights)


def save(path: Path, made: onnx.ModelProto) -> Path:
    return tiny_models.save(path, made)
