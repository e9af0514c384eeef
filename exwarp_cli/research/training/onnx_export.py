"""Networks as ONNX models, for computers without torch: pictures from torch, policies by hand."""

from __future__ import annotations

import inspect
import logging
import warnings
from collections.abc import Sequence
from contextlib import ExitStack
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
import torch
from onnx import NodeProto, TensorProto, helper, numpy_helper
from torch import nn

from exwarp_cli import __version__
from exwarp_cli.accelerator.mlp import MAX_ACTIVATION, OUTPUTS, QuantisedMlp, Requantisation
from exwarp_cli.domain.network_api import TIME_INPUT, NetworkInterface
from exwarp_cli.io.files import atomic_write_bytes
from exwarp_cli.models.model_file import INTERFACE_KEY, STRIDE_KEY

# The exporter's own, so that nothing is converted; onnxruntime runs it since 1.14.
OPSET = 18

# Of the file; onnxruntime reads it since 1.18.
IR_VERSION = 10

# Least height and width of the frame that the network is traced with.
EXAMPLE = 64

AXES = {2: "height", 3: "width"}

# Key of the metadata that says what a model is.
ABOUT = "exwarp.about"

# The input of a policy, [N, 44], and its output, [N, 2]: what it is worth to warp and to
# extrapolate.
STATE = "state"
VALUES = "values"

F32 = npt.NDArray[np.float32]
Array = npt.NDArray[np.generic]


def export_network(
    module: nn.Module, path: Path, interface: NetworkInterface, *, stride: int, about: str
) -> None:
    """Write a network as a self-contained ONNX model of any height and width; raises OutputError.

    The same weights give the same bytes with the same versions of torch and onnxscript. Height and
    width that the network is run with are multiples of `stride`. Its ``forward`` takes tensors by
    the names of the interface's inputs and ``time``, of which it may leave out those that are not
    required, and returns float32 [1, made, H, W]; ValueError where it does not.
    """
    module = deepcopy(module).cpu().eval()
    rows = max(2, -(-EXAMPLE // stride))
    height, width = rows * stride, (rows + 1) * stride
    shapes: dict[str, tuple[int, ...]] = {
        name: (1, channels, height, width) for name, channels in interface.inputs.items()
    }
    shapes[TIME_INPUT] = (1,)
    parameters = list(inspect.signature(module.forward).parameters)
    required = interface.required
    if not set(required) <= set(parameters) <= set(shapes):
        raise ValueError(
            f"forward takes {', '.join(parameters)}; it must take {' and '.join(required)}, and "
            f"may take others out of {', '.join(shapes)}"
        )
    example = {name: torch.full(shapes[name], 0.5) for name in parameters}
    # The exporter warns of absent torchvision, and of its own deprecations.
    with ExitStack() as quiet, warnings.catch_warnings(action="ignore"), torch.no_grad():
        logging.disable(logging.WARNING)
        quiet.callback(logging.disable, logging.NOTSET)
        answer = module(**example)
        if answer.shape != (1, interface.made, height, width) or answer.dtype != torch.float32:
            raise ValueError(
                f"forward returns {answer.dtype} {list(answer.shape)} for {height} rows of {width} "
                f"pixels, not float32 [1, {interface.made}, {height}, {width}]"
            )
        free = {axis: stride * torch.export.Dim(name, min=2) for axis, name in AXES.items()}
        dynamic = {name: None if name == TIME_INPUT else free for name in example}
        # Fails where the network would be tied to the size of the example. Exporting in one step
        # is no choice: where torch.export refuses a size that was made constant, torch.onnx.export
        # falls back to a model of that size without a word.
        program = torch.export.export(module, (), example, dynamic_shapes=dynamic)
        exported = torch.onnx.export(
            program, opset_version=OPSET, output_names=[interface.output], verbose=False
        )
    assert exported is not None
    model = exported.model_proto
    _remove_run_details(model)
    metadata = {INTERFACE_KEY: interface.version, STRIDE_KEY: str(stride), ABOUT: about}
    onnx.helper.set_model_props(model, metadata)
    onnx.checker.check_model(model)
    atomic_write_bytes(path, model.SerializeToString(deterministic=True))


def _remove_run_details(model: onnx.ModelProto) -> None:
    """Remove what differs between runs and machines: paths of the source, names of free sizes."""
    graph = model.graph
    graph.name = graph.output[0].name
    model.ir_version = IR_VERSION
    model.producer_name, model.producer_version = "exwarp", __version__
    del graph.value_info[:]
    parts: list[Any] = [model, graph, *graph.node, *graph.input, *graph.output, *graph.initializer]
    for part in parts:
        del part.metadata_props[:]
        part.doc_string = ""
    for value in (*graph.input, *graph.output):
        if value.name != TIME_INPUT:
            for axis, name in AXES.items():
                value.type.tensor_type.shape.dim[axis].dim_param = name


def export_float(layers: Sequence[tuple[F32, F32]], path: Path) -> None:
    """Write a fully connected ReLU network: ``state`` float32 [N, in] to ``values`` [N, 2].

    Layers are weights float32 [out, in] and biases [out]. Raises OutputError.
    """
    nodes: list[NodeProto] = []
    constants: dict[str, Array] = {}
    last, activations = len(layers) - 1, STATE
    for n, (weights, biases) in enumerate(layers):
        constants |= {f"weights{n}": weights, f"biases{n}": biases}
        inputs = [activations, f"weights{n}", f"biases{n}"]
        sums = VALUES if n == last else f"sums{n}"
        nodes.append(helper.make_node("Gemm", inputs, [sums], transB=1))
        activations = f"activations{n}"
        if n < last:
            nodes.append(helper.make_node("Relu", [sums], [activations]))
    about = "ExWarp's predictor in floating point; input: a state as numbers in 0 to 1"
    _write_policy(path, nodes, constants, (TensorProto.FLOAT, layers[0][0].shape[1]), about)


def export_integer(network: QuantisedMlp, path: Path) -> None:
    """Write the network in integer operators only: ``state`` int32 [N, in] to ``values`` [N, 2].

    The state is Q16.16, any int32; values are int32 and equal `accelerator.mlp.infer_reference`
    in every bit. The accumulators of layer n are ``accumulators{n}``, without biases
    ``products{n}``. Raises OutputError.
    """
    constants: dict[str, Array] = {
        "zero": np.array(0, np.int64),
        "most": np.array(MAX_ACTIVATION, np.int64),
    }
    nodes = _requantise(STATE, "inputs", network.inputs, constants)
    activations, last = "inputs", len(network.layers) - 1
    for n, layer in enumerate(network.layers):
        constants |= {
            f"weights{n}": np.ascontiguousarray(layer.weights.T),
            f"biases{n}": layer.biases,
        }
        sums = VALUES if n == last else f"accumulators{n}"
        nodes += [
            helper.make_node("MatMulInteger", [activations, f"weights{n}"], [f"products{n}"]),
            helper.make_node("Add", [f"products{n}", f"biases{n}"], [sums]),
        ]
        if layer.requantisation is not None:
            activations = f"activations{n}"
            nodes += _requantise(sums, activations, layer.requantisation, constants)
    about = "ExWarp's predictor in integers; input: a state in Q16.16"
    _write_policy(path, nodes, constants, (TensorProto.INT32, network.sizes[0]), about)


def _requantise(
    sums: str, out: str, scale: Requantisation, constants: dict[str, Array]
) -> list[NodeProto]:
    """Return nodes that turn int32 into uint8 activations, and add their constants."""
    shifts = scale.shifts.astype(np.int64)
    constants |= {
        f"{out}_multipliers": scale.multipliers.astype(np.int64),
        f"{out}_halves": (np.int64(1) << shifts) >> np.int64(1),
        f"{out}_divisors": np.int64(1) << shifts,
    }
    # ONNX divides towards zero, so numbers are clamped at 0 first: what is negative would become 0
    # anyway.
    return [
        helper.make_node("Cast", [sums], [f"{out}_wide"], to=TensorProto.INT64),
        helper.make_node("Max", [f"{out}_wide", "zero"], [f"{out}_positive"]),
        helper.make_node("Mul", [f"{out}_positive", f"{out}_multipliers"], [f"{out}_product"]),
        helper.make_node("Add", [f"{out}_product", f"{out}_halves"], [f"{out}_sum"]),
        helper.make_node("Div", [f"{out}_sum", f"{out}_divisors"], [f"{out}_quotient"]),
        helper.make_node("Min", [f"{out}_quotient", "most"], [f"{out}_clamped"]),
        helper.make_node("Cast", [f"{out}_clamped"], [out], to=TensorProto.UINT8),
    ]


def _write_policy(
    path: Path,
    nodes: list[NodeProto],
    constants: dict[str, Array],
    state: tuple[int, int],
    about: str,
) -> None:
    """Put a model together and write it; `state` is the input's type and size."""
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
