"""Networks as ONNX models, for computers without torch."""

from __future__ import annotations

import inspect
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from pathlib import Path
from typing import Any

import onnx
import torch
from torch import Tensor, nn

from exwarp_cli import __version__
from exwarp_cli.domain.network_api import EXTRAPOLATOR_INTERFACE, TIME_INPUT, NetworkInterface
from exwarp_cli.io.atomic import atomic_write_bytes
from exwarp_cli.io.model_files import INTERFACE_KEY, STRIDE_KEY

OPSET = 18
"""The exporter's own, so that nothing is converted; onnxruntime runs it since 1.14."""

IR_VERSION = 10
"""Of the file; onnxruntime reads it since 1.18."""

EXAMPLE = 64
"""Least height and width of the frame that the network is traced with."""

AXES = {2: "height", 3: "width"}

ABOUT = "exwarp.about"
"""Key of the metadata that says what a model is."""


def export_extrapolator(module: nn.Module, path: Path, *, stride: int, about: str) -> None:
    """Write a network that extrapolates; see `export_network`."""
    export_network(module, path, EXTRAPOLATOR_INTERFACE, stride=stride, about=about)


def export_network(
    module: nn.Module, path: Path, interface: NetworkInterface, *, stride: int, about: str
) -> None:
    """Write a network as a self-contained ONNX model of any height and width.

    The module itself is left as it is, its mode and device included. The same weights give the same
    bytes with the same versions of torch and onnxscript.

    Parameters
    ----------
    module
        Its ``forward`` takes tensors by the names of the interface's inputs and ``time``, of which
        it may leave out those that are not required; it returns float32 [1, made, H, W].
    path
        The file to write, whole or not at all.
    interface
        What it takes and gives.
    stride
        Height and width that the network is run with are multiples of this.
    about
        One line for readers of the file.

    Raises
    ------
    ValueError
        When forward's parameters or its answer are not those of the interface.
    OutputError
        When the file cannot be written.
    """
    module = deepcopy(module).cpu().eval()
    rows = max(2, -(-EXAMPLE // stride))
    size = (rows * stride, (rows + 1) * stride)
    shapes: dict[str, tuple[int, ...]] = {
        name: (1, channels, *size) for name, channels in interface.inputs.items()
    }
    shapes[TIME_INPUT] = (1,)
    wanted = list(inspect.signature(module.forward).parameters)
    required = interface.required
    if not set(required) <= set(wanted) <= set(shapes):
        raise ValueError(
            f"forward takes {', '.join(wanted)}; it must take {' and '.join(required)}, and may "
            f"take others out of {', '.join(shapes)}"
        )
    example = {name: torch.full(shapes[name], 0.5) for name in wanted}
    with _quiet(), torch.no_grad():
        _check_answer(module(**example), size, interface.made)
        model = _trace(module, example, stride, interface.output)
    _tidy(model)
    facts = {INTERFACE_KEY: interface.version, STRIDE_KEY: str(stride), ABOUT: about}
    onnx.helper.set_model_props(model, facts)
    onnx.checker.check_model(model)
    atomic_write_bytes(path, model.SerializeToString(deterministic=True))


def _check_answer(answer: Tensor, size: tuple[int, int], made: int) -> None:
    height, width = size
    if answer.shape != (1, made, height, width) or answer.dtype != torch.float32:
        raise ValueError(
            f"forward returns {answer.dtype} {list(answer.shape)} for {height} rows of {width} "
            f"pixels, not float32 [1, {made}, {height}, {width}]"
        )


def _trace(
    module: nn.Module, example: dict[str, Tensor], stride: int, output: str
) -> onnx.ModelProto:
    """Return the model; fails where the network would be tied to the size of the example.

    Exporting in one step is no choice: where torch.export refuses a size that was made constant,
    torch.onnx.export falls back to a model of that size without a word.
    """
    free = {axis: stride * torch.export.Dim(name, min=2) for axis, name in AXES.items()}
    shapes = {name: None if name == TIME_INPUT else free for name in example}
    program = torch.export.export(module, (), example, dynamic_shapes=shapes)
    exported = torch.onnx.export(program, opset_version=OPSET, output_names=[output], verbose=False)
    assert exported is not None
    return exported.model_proto


def _tidy(model: onnx.ModelProto) -> None:
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


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence the exporter, which tells of absent torchvision, and of its own deprecations."""
    loggers = [logging.getLogger(name) for name in ("torch", "torch.onnx", "onnxscript", "onnx_ir")]
    levels = [logger.level for logger in loggers]
    try:
        for logger in loggers:
            logger.setLevel(logging.ERROR)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
