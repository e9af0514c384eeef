"""One decision of the integer predictor beside onnxruntime, and beside the network in numpy.

``python -m tests.bench.bench_policy``
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnxruntime

from exwarp_cli.accelerator.mlp import QuantisedMlp, infer_reference
from exwarp_cli.accelerator.mlp_kernel import MlpKernel
from exwarp_cli.research.training.onnx_export import STATE, VALUES, export_float, export_integer
from tests.bench import goals
from tests.bench.timing import ROUNDS, Work, compare
from tests.unit.mlp_cases import network, states

GOALS = {"MlpKernel.decide": 1 / 3}
MANY = 1000


def main(arguments: Sequence[str] | None = None) -> int:
    parser = goals.parser_of("tests.bench.bench_policy", __doc__, 4 * ROUNDS)
    options = parser.parse_args(arguments)
    made, many = network(), states(MANY)
    state, kernel = many[0].copy(), MlpKernel(made)
    with tempfile.TemporaryDirectory() as folder:
        integer, floating = Path(folder) / "integer.onnx", Path(folder) / "float.onnx"
        export_integer(made, integer)
        floats = [(n.weights.astype(np.float32), n.biases.astype(np.float32)) for n in made.layers]
        export_float(floats, floating)
        base = _onnx(integer, state[None])
        works: dict[str, tuple[Work, Work]] = {
            "MlpKernel.decide": (lambda: kernel.decide(state), base),
            "onnxruntime, float32": (_onnx(floating, state[None].astype(np.float32)), base),
            "infer_reference": (lambda: infer_reference(made, state), base),
        }
        batch = _onnx(integer, many)
        works[f"decide_many, {MANY} states"] = (lambda: kernel.decide_many(many), batch)
        _agree(made, kernel, many, base())
        ratios = compare(works, options.rounds)
    title = f"one decision, one thread, {options.rounds} rounds"
    figures = goals.table("policy", title, "onnxruntime, int8", ratios, GOALS)
    return goals.finish(figures, options)


def _onnx(path: Path, given: np.ndarray) -> Work:
    """Return the work of running a model on one thread."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    feeds = {STATE: given}
    return lambda: session.run([VALUES], feeds)


def _agree(made: QuantisedMlp, kernel: MlpKernel, many: np.ndarray, found: object) -> None:
    """Make sure that what is timed computes the same."""
    expected = infer_reference(made, many[0]).outputs
    assert isinstance(found, list)
    np.testing.assert_array_equal(found[0][0], expected)
    np.testing.assert_array_equal(kernel.decide(many[0])[0], expected)


if __name__ == "__main__":
    sys.exit(main())
