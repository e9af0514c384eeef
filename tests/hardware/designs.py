"""Designs of the predictor in a folder, and what tools say of them."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from itertools import cycle
from pathlib import Path

import numpy as np

from exwarp_cli.accelerator.mac_array import MacArray
from exwarp_cli.accelerator.mlp import QuantisedMlp, Requantisation, infer_reference
from exwarp_cli.accelerator.mlp_kernel import MlpKernel
from exwarp_cli.io.files import atomic_write_text
from exwarp_cli.pipeline.predictor import design, hex_files, sample_states

CACHE = 20 * 1024
"""Bytes of a core, as `exwarp policy export` has them by default."""
DEFAULT = MacArray(cache_bytes=CACHE)
REFILLED = MacArray(port_bytes=8)
"""With 16 KB a core, as in the paper."""

TOOLS = ("iverilog", "verilator", "yosys", "make")


def missing_tools() -> list[str]:
    return [tool for tool in TOOLS if shutil.which(tool) is None]


SCALES = ((62, 2**31 - 1), (0, 1), (1, 1), (31, 2**31 - 1))
"""Shifts and multipliers at the ends of what there may be."""


def extreme(made: QuantisedMlp) -> QuantisedMlp:
    """Return a network of which every seventh input and hidden neuron has a scale of `SCALES`."""

    def changed(scale: Requantisation) -> Requantisation:
        shifts, multipliers = scale.shifts.copy(), scale.multipliers.copy()
        for place, (shift, multiplier) in zip(
            range(6, len(shifts), 7), cycle(SCALES), strict=False
        ):
            shifts[place], multipliers[place] = shift, multiplier
        return Requantisation(multipliers, shifts)

    layers = tuple(
        layer
        if layer.requantisation is None
        else replace(layer, requantisation=changed(layer.requantisation))
        for layer in made.layers
    )
    return QuantisedMlp(changed(made.inputs), layers)


def tied(made: QuantisedMlp) -> QuantisedMlp:
    """Return a network whose two outputs are always equal."""
    *hidden, last = made.layers
    equal = replace(last, weights=last.weights[[0, 0]], biases=last.biases[[0, 0]])
    return QuantisedMlp(made.inputs, (*hidden, equal))


def write(folder: Path, made: QuantisedMlp, array: MacArray, vectors: int, seed: int = 0) -> Path:
    """Write a design with its test vectors, which are what the integer kernel answers."""
    folder.mkdir(parents=True, exist_ok=True)
    states = sample_states(made.sizes[0], vectors, seed)
    outputs, choices = MlpKernel(made).decide_many(states)
    expected = infer_reference(made, states)
    np.testing.assert_array_equal(outputs, expected.outputs)
    np.testing.assert_array_equal(choices, expected.choices)
    texts = hex_files(array, made, states)
    for name, text in (texts | design(array, made.sizes, texts, vectors)).items():
        atomic_write_text(folder / name, text)
    return folder


def run(folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    """Run a tool in a folder; its messages are together in `stdout`."""
    return subprocess.run(
        command, cwd=folder, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        check=False,
    )  # fmt: skip


def result(folder: Path, *command: str) -> str:
    """Run a simulation; return its last line of results."""
    done = run(folder, *command)
    lines = done.stdout.splitlines()
    assert done.returncode == 0, done.stdout
    return [line for line in lines if line.startswith(("passed", "failed"))][-1]
