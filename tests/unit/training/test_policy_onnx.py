"""The predictor as ONNX models: onnxruntime gives the same numbers."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest

from exwarp_cli.accelerator.mlp import QuantisedMlp, infer_reference
from exwarp_cli.accelerator.mlp_kernel import MlpKernel
from exwarp_cli.research.training.onnx_export import STATE, VALUES, export_float, export_integer
from tests.unit.mlp_cases import edges, network, states


@pytest.fixture(scope="module")
def made() -> QuantisedMlp:
    return network(11)


@pytest.fixture(scope="module")
def model(made, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("onnx") / "policy.onnx"
    export_integer(made, path)
    return path


def test_the_integer_model_gives_the_kernel_s_outputs(made, model):
    many = np.concatenate([states(2000, 11), edges()])
    (found,) = session(model).run(None, {STATE: many})
    assert found.dtype == np.int32
    np.testing.assert_array_equal(found, MlpKernel(made).decide_many(many)[0])


def test_matmulinteger_gives_the_accumulators(made, model, tmp_path):
    names = [f"products{k}" for k in range(4)]
    opened = onnx.load(model)
    for name in names:
        kind = onnx.TensorProto.INT32
        opened.graph.output.append(onnx.helper.make_tensor_value_info(name, kind, None))
    onnx.save(opened, tmp_path / "open.onnx")
    many = np.concatenate([states(1000, 12), edges()])
    products = session(tmp_path / "open.onnx").run(names, {STATE: many})
    found = infer_reference(made, many)
    for layer, sums, product in zip(made.layers, found.accumulators, products, strict=True):
        np.testing.assert_array_equal(product + layer.biases, sums)


def test_it_is_all_integers(model):
    opened = onnx.load(model)
    kinds = {tensor.data_type for tensor in opened.graph.initializer}
    kinds |= {a.i for node in opened.graph.node for a in node.attribute if a.name == "to"}
    assert kinds == {
        *(onnx.TensorProto.INT8, onnx.TensorProto.UINT8),
        *(onnx.TensorProto.INT32, onnx.TensorProto.INT64),
    }


def test_the_float_model(tmp_path):
    rng = np.random.default_rng(3)
    sizes = (44, 16, 8, 2)
    weights = [
        rng.standard_normal((b, a)).astype(np.float32) / a**0.5
        for a, b in itertools.pairwise(sizes)
    ]
    biases = [rng.standard_normal(size).astype(np.float32) for size in sizes[1:]]
    export_float(list(zip(weights, biases, strict=True)), tmp_path / "float.onnx")
    state = rng.random((20, 44), np.float32)
    (found,) = session(tmp_path / "float.onnx").run([VALUES], {STATE: state})
    expected = state.astype(np.float64)
    for k, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        expected = expected @ weight.T + bias
        expected = np.maximum(expected, 0) if k < 2 else expected
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_the_same_network_gives_the_same_bytes(made, model, tmp_path):
    export_integer(made, tmp_path / "again.onnx")
    assert (tmp_path / "again.onnx").read_bytes() == model.read_bytes()


def session(path: Path) -> onnxruntime.InferenceSession:
    return onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
