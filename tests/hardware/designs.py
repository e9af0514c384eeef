"""Designs of the predictor in a folder, and what tools say of them."""

from __future__ import annotations

import shutil
import subprocess
from itertools import pairwise
from pathlib import Path

import numpy as np

from exwarp_cli.accel.kernel import MlpKernel
from exwarp_cli.accel.mac_array import MacArray
from exwarp_cli.accel.quantised_mlp import (
    QuantisedLayer,
    QuantisedMlp,
    Requantisation,
    infer_reference,
)
from exwarp_cli.io.atomic import atomic_write_text
from exwarp_cli.pipeline.accelerator import sample_states, vectors_of
from exwarp_cli.pipeline.hardware import CACHE, design

DEFAULT = MacArray(cache_bytes=CACHE)
REFILLED = MacArray(port_bytes=8)
"""With 16 KB a core, as in the paper."""

TOOLS = ("iverilog", "verilator", "yosys", "make")


def missing_tools() -> list[str]:
    return [tool for tool in TOOLS if shutil.which(tool) is None]


def network(sizes: tuple[int, ...], seed: int, tied: bool = False) -> QuantisedMlp:
    """Return a network of random numbers; with `tied` its outputs are equal."""
    rng = np.random.default_rng(seed)

    def scale(count: int) -> Requantisation:
        """Return factors by which most numbers stay within 0 to 127, and the ends of all others."""
        shifts = rng.integers(12, 37, count)
        multipliers = (2.0 ** (shifts - rng.uniform(6, 11, count))).astype(np.int64)
        for at, (shift, multiplier) in enumerate(
            ((62, 2**31 - 1), (0, 1), (1, 1), (31, 2**31 - 1))
        ):
            shifts[7 * at + 6 :: 35], multipliers[7 * at + 6 :: 35] = shift, multiplier
        return Requantisation(multipliers.astype(np.int32), shifts.astype(np.uint8))

    layers = []
    for number, (before, after) in enumerate(pairwise(sizes)):
        last = number == len(sizes) - 2
        weights = rng.integers(-127, 128, (after, before)).astype(np.int8)
        biases = rng.integers(-20_000, 20_000, after).astype(np.int32)
        if last and tied:
            weights[1], biases[1] = weights[0], biases[0]
        layers.append(QuantisedLayer(weights, biases, None if last else scale(after)))
    return QuantisedMlp(scale(sizes[0]), tuple(layers))


def write(folder: Path, made: QuantisedMlp, array: MacArray, vectors: int, seed: int = 0) -> Path:
    """Write a design with its test vectors, which are what the integer kernel answers."""
    folder.mkdir(parents=True, exist_ok=True)
    states = sample_states(made.sizes[0], vectors, seed)
    outputs, choices = MlpKernel(made).decide_many(states)
    expected = infer_reference(made, states)
    np.testing.assert_array_equal(outputs, expected.outputs)
    np.testing.assert_array_equal(choices, expected.choices)
    for name, text in (vectors_of(made, states) | design(array, made, vectors)).items():
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
    told = [line for line in done.stdout.splitlines() if line.startswith(("passed", "failed"))]
    assert done.returncode == 0, done.stdout
    return told[-1]
