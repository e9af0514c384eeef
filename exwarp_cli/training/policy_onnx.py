"""The predictor as ONNX models: in floating point, and in integers bit for bit."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import onnx
from onnx import NodeProto, TensorProto, helper, numpy_helper

from exwarp_cli import __version__
from exwarp_cli.accelerator.fixed_point import MAX_ACTIVATION
from exwarp_cli.accelerator.mlp import OUTPUTS, QuantisedMlp, Requantisation
from exwarp_cli.io.atomic import atomic_write_bytes
from exwarp_cli.training.export import ABOUT, IR_VERSION, OPSET

F32 = npt.NDArray[np.float32]

STATE = "state"
"""The input: [N, 44]."""

VALUES = "values"
"""The output: [N, 2], what it is worth to warp and to extrapolate."""

Array = npt.NDArray[np.generic]


def export_float(weights: Sequence[F32], biases: Sequence[F32], path: Path) -> None:
    """Write a fully connected ReLU network: ``state`` float32 [N, in] to ``values`` [N, 2].

    Parameters
    ----------
    weights
        float32 [out, in] of each layer.
    biases
        float32 [out] of each layer.
    path
        The file to write, whole or not at all.

    Raises
    ------
    OutputError
        When the file cannot be written.
    """
    nodes: list[NodeProto] = []
    constants: dict[str, Array] = {}
    last, given = len(weights) - 1, STATE
    for n, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        constants[f"weights{n}"] = np.asarray(weight, np.float32)
        constants[f"biases{n}"] = np.asarray(bias, np.float32)
        names, out = [given, f"weights{n}", f"biases{n}"], VALUES if n == last else f"sums{n}"
        nodes.append(helper.make_node("Gemm", names, [out], transB=1))
        given = f"activations{n}"
        if n < last:
            nodes.append(helper.make_node("Relu", [out], [given]))
    about = "ExWarp's predictor in floating point; input: a state as numbers in 0 to 1"
    _write(path, nodes, constants, (TensorProto.FLOAT, weights[0].shape[1]), about)


def export_integer(network: QuantisedMlp, path: Path) -> None:
    """Write the network in integer operators only: ``state`` int32 [N, in] to ``values`` [N, 2].

    The state is Q16.16, any int32; values are int32 and equal `accel.quantised_mlp.infer_reference`
    in every bit. ONNX divides towards zero, so numbers are clamped at 0 before they are
    requantised: what is negative would become 0 anyway. The accumulators of layer n are
    ``accumulators{n}``, without biases ``products{n}``.

    Raises
    ------
    OutputError
        When the file cannot be written.
    """
    constants: dict[str, Array] = {
        "zero": np.array(0, np.int64),
        "most": np.array(MAX_ACTIVATION, np.int64),
    }
    nodes = _requantise(STATE, "inputs", network.inputs, constants)
    given, last = "inputs", len(network.layers) - 1
    for n, layer in enumerate(network.layers):
        constants |= {
            f"weights{n}": np.ascontiguousarray(layer.weights.T),
            f"biases{n}": layer.biases,
        }
        sums = VALUES if n == last else f"accumulators{n}"
        nodes += [
            helper.make_node("MatMulInteger", [given, f"weights{n}"], [f"products{n}"]),
            helper.make_node("Add", [f"products{n}", f"biases{n}"], [sums]),
        ]
        if layer.requantisation is not None:
            given = f"activations{n}"
            nodes += _requantise(sums, given, layer.requantisation, constants)
    about = "ExWarp's predictor in integers; input: a state in Q16.16"
    _write(path, nodes, constants, (TensorProto.INT32, network.sizes[0]), about)


def _requantise(
    given: str, out: str, scale: Requantisation, constants: dict[str, Array]
) -> list[NodeProto]:
    """Return nodes that turn int32 into uint8 activations, and add their constants."""
    shifts = scale.shifts.astype(np.int64)
    constants |= {
        f"{out}_multipliers": scale.multipliers.astype(np.int64),
        f"{out}_halves": (np.int64(1) << shifts) >> np.int64(1),
        f"{out}_divisors": np.int64(1) << shifts,
    }
    return [
        helper.make_node("Cast", [given], [f"{out}_wide"], to=TensorProto.INT64),
        helper.make_node("Max", [f"{out}_wide", "zero"], [f"{out}_positive"]),
        helper.make_node("Mul", [f"{out}_positive", f"{out}_multipliers"], [f"{out}_product"]),
        helper.make_node("Add", [f"{out}_product", f"{out}_halves"], [f"{out}_sum"]),
        helper.make_node("Div", [f"{out}_sum", f"{out}_divisors"], [f"{out}_quotient"]),
        helper.make_node("Min", [f"{out}_quotient", "most"], [f"{out}_clamped"]),
        helper.make_node("Cast", [f"{out}_clamped"], [out], to=TensorProto.UINT8),
    ]


def _write(
    path: Path,
    nodes: list[NodeProto],
    constants: dict[str, Array],
    state: tuple[int, int],
    about: str,
) -> None:
    """Put a model together, check it and write it; `state` is the input's type and size."""
    kind, size = state
    graph = helper.make_graph(
        nodes,
        VALUES,
        [helper.make_tensor_value_info(STATE, kind, ["N", size])],
        [helper.make_tensor_value_info(VALUES, kind, ["N", OUTPUTS])],
        [numpy_helper.from_array(array, name) for name, array in constants.items()],
    )
    operators = [helper.make_opsetid("", OPSET)]
    model = helper.make_model(graph, opset_imports=operators, ir_version=IR_VERSION)
    model.producer_name, model.producer_version = "exwarp", __version__
    helper.set_model_props(model, {ABOUT: about})
    onnx.checker.check_model(model)
    atomic_write_bytes(path, model.SerializeToString(deterministic=True))
