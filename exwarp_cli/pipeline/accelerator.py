"""The work behind ``exwarp policy``: the accelerator's schedule, inferences, and test vectors."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from exwarp_cli.accelerator.fixed_point import ONE
from exwarp_cli.accelerator.mac_array import MacArray, Schedule, schedule
from exwarp_cli.accelerator.mlp import (
    PAPER_SIZES,
    Inference,
    MlpKernel,
    QuantisedMlp,
    infer_reference,
)
from exwarp_cli.errors import OutputExistsError, UsageError
from exwarp_cli.io.atomic import atomic_write_text, make_folder
from exwarp_cli.io.policy_files import StateRow, load_policy, read_states
from exwarp_cli.kernels.array_types import I32
from exwarp_cli.pipeline.hardware import design

_CLOCK = re.compile(r"([0-9.]+(?:e[+-]?[0-9]+)?)\s*([kmg]?)(?:hz)?", re.IGNORECASE)
_BYTES = re.compile(r"([0-9]+)\s*([kmg]?)i?b?", re.IGNORECASE)
_HERTZ = {"": 1.0, "k": 1e3, "m": 1e6, "g": 1e9}
_UNITS = {"": 1, "k": 1 << 10, "m": 1 << 20, "g": 1 << 30}


@dataclass(frozen=True)
class Decided:
    """A row of a table, and what the policy says to it.

    Attributes
    ----------
    row
        With the state.
    outputs
        Of warping and of extrapolating, int32.
    choice
        0 to warp, 1 to extrapolate.
    """

    row: StateRow
    outputs: tuple[int, int]
    choice: int


@dataclass(frozen=True)
class Trace:
    """One inference with everything on the way.

    Attributes
    ----------
    row
        Whose state it is.
    network, inference, schedule
        What ran, what it computed, and how long the paper's machine takes.
    """

    row: StateRow
    network: QuantisedMlp
    inference: Inference
    schedule: Schedule


def clock_of(text: str, option: str = "--clock") -> float:
    """Read a clock rate, as ``500MHz``, ``1.5GHz`` or ``1e9``, in hertz; errors name the option.

    Raises
    ------
    UsageError
        When it is none, or not above 0.
    """
    match = _CLOCK.fullmatch(text.strip())
    try:
        hertz = float(match[1]) * _HERTZ[match[2].lower()] if match else math.nan
    except ValueError:
        hertz = math.nan
    if not (math.isfinite(hertz) and hertz > 0):
        raise UsageError(f"{option} {text} is no clock rate; give one as 500MHz, 1.5GHz or 1e9")
    return hertz


def bytes_of(text: str) -> int:
    """Read a size, as ``16KB`` or ``16384``; K is 1024.

    Raises
    ------
    UsageError
        When it is none.
    """
    match = _BYTES.fullmatch(text.strip())
    if match is None or len(match[1]) > 15:
        raise UsageError(f"--cache {text} is no size; give one as 16KB or 16384")
    return int(match[1]) * _UNITS[match[2].lower()]


def machine(cores: int, macs: int, cache: str, port: int) -> MacArray:
    """Return a machine; UsageError for a cache that is no size, or 0.

    Parameters
    ----------
    cores, macs
        At least 1.
    cache
        Of each core; see :func:`bytes_of`.
    port
        Bytes a cycle, see `MacArray`.
    """
    try:
        return MacArray(cores, macs, cache_bytes=bytes_of(cache), port_bytes=port)
    except ValueError as error:
        raise UsageError(f"--cache {cache} does not do: {error}; give a larger one") from error


def cycles(policy: Path | None, cores: int, macs: int, cache: str, port: int = 0) -> Schedule:
    """Lay out an inference on a machine.

    Parameters
    ----------
    policy
        File whose network is taken; None for the paper's sizes.
    cores, macs, cache, port
        Of the machine, see :func:`machine`.

    Raises
    ------
    UsageError
        When the cache is no size, or too small.
    InputError
        When the policy cannot be read.
    """
    sizes = PAPER_SIZES if policy is None else load_policy(policy).network.sizes
    try:
        return schedule(machine(cores, macs, cache, port), sizes)
    except ValueError as error:
        raise UsageError(f"--cache {cache} does not do: {error}; give a larger one") from error


def decide_rows(table: Path, policy: Path | None, number: int | None) -> list[Decided]:
    """Run the policy on the states of a table.

    Parameters
    ----------
    table
        CSV file; see `exwarp_cli.io.states.read_states`.
    policy
        File of the policy; None for the one that comes with ExWarp.
    number
        Row to take; None for all.

    Raises
    ------
    InputError
        When a file cannot be used.
    UsageError
        When there is no such row.
    """
    network = load_policy(policy).network
    rows = _chosen(table, read_states(table, network.sizes[0]), number)
    outputs, choices = MlpKernel(network).decide_many(np.stack([row.state for row in rows]))
    return [
        Decided(row, (int(both[0]), int(both[1])), int(choice))
        for row, both, choice in zip(rows, outputs, choices, strict=True)
    ]


def trace_row(table: Path, policy: Path | None, number: int | None) -> Trace:
    """Run the policy on one state, the first where no row is named, and keep every number.

    Parameters and errors are those of :func:`decide_rows`.
    """
    network = load_policy(policy).network
    row = _chosen(table, read_states(table, network.sizes[0]), number)[0]
    inference = infer_reference(network, row.state)
    return Trace(row, network, inference, schedule(MacArray(), network.sizes))


def sample_states(size: int, count: int, seed: int) -> I32:
    """Return states to test an implementation with, int32 [count, size] in Q16.16.

    By turns: within 0 … 1, as they are meant; of any size, small ones as often as large ones; and
    values at which bits carry and saturate.
    """
    rng = np.random.default_rng(seed)
    shape = (count, size)
    meant = rng.integers(0, ONE, shape, np.int64, endpoint=True)
    powers = np.int64(1) << rng.integers(0, 32, shape, np.int64)
    signs = rng.choice(np.array([-1, 1]), shape)
    anything = (rng.random(shape) * powers).astype(np.int64) * signs
    edges = powers * signs + rng.integers(-2, 3, shape)
    turn = np.arange(count)[:, None] % 3
    states = np.where(turn == 0, meant, np.where(turn == 1, anything, edges))
    return np.clip(states, -(2**31), 2**31 - 1).astype(np.int32)


def _chosen(table: Path, rows: tuple[StateRow, ...], number: int | None) -> tuple[StateRow, ...]:
    """Return the row of a number, or all."""
    if number is None:
        return rows
    found = tuple(row for row in rows if row.row == number)
    if not found:
        raise UsageError(
            f"--row {number}: {table} has no state in that row; its states are in rows "
            f"{rows[0].row} to {rows[-1].row}"
        )
    return found


PAPER = MacArray()
"""The paper's machine."""

FORMAT = "exwarp.policy-hex/1"
MANIFEST = "manifest.json"
README = "README.txt"

Integers = npt.NDArray[np.integer[Any]]

ABOUT = """\
ExWarp's predictor for a Verilog test bench. Read every .hex file with $readmemh: one word a line,
hexadecimal, two's complement. manifest.json holds the sizes, and where each layer begins.

Machine: {cores} cores with {macs} MAC units each. Inputs and neurons are dealt in turn: number i
belongs to core i % {cores} and is its number i / {cores}, rounded down.

core<c>_weights.hex     {macs} weights of 8 bits a word, in the order in which core c reads them:
                        layer after layer, neuron after neuron, ceil(fan-in / {macs}) words a
                        neuron. The first weight is in the lowest 8 bits, that is, at the end of
                        the line. A neuron's last word is filled up with zeros. Word k of a core's
                        neuron t in a layer is at weights_at + t * words + k.
core<c>_bias.hex        32 bits a neuron, at bias_at + t.
core<c>_multiplier.hex  32 bits a neuron of the hidden layers, at scale_at + t; never negative.
core<c>_shift.hex       8 bits, at the same places.
input_multiplier.hex    32 bits an input, in the order of the inputs.
input_shift.hex         8 bits an input.

vectors_input.hex       {inputs} words of 32 bits a vector: Q16.16.
vectors_input_q.hex     {inputs} words of 8 bits a vector: after the input stage.
vectors_layer<k>_accumulator.hex  32 bits a neuron, vector after vector, biases included.
vectors_layer<k>_activation.hex   8 bits a neuron of the hidden layers, after requantisation.
vectors_output.hex      3 words of 32 bits a vector: output 0 (warp), output 1 (extrapolate), and
                        the decision, 0 or 1; a tie is 0.

Arithmetic: an input or a hidden neuron becomes floor((value * multiplier + half) / 2^shift),
clamped to 0 ... 127, where half is 2^(shift - 1), or 0 for shift 0; 64 bits hold it. An accumulator
is the bias plus the sum of weight times activation, and fits 32 bits in any order of adding.
"""

DESIGN = """
exwarp_predictor.v      The top module; its head says how it is used.
exwarp_core.v           One core.
exwarp_parameters.vh    Cores, MAC units, layers and sizes of the memories.
exwarp_predictor_tb.v   Test bench: runs all test vectors, compares outputs, decision and cycles.
exwarp_vectors.vh       Its numbers.
Makefile                'make' simulates with Icarus Verilog, 'make verilator' with Verilator; both
                        fail on any difference. 'make lint' checks the text.
memory<c>_weights.hex   What core c's memories hold: words of weights, as above;
memory<c>_scales.hex    shift (8 bits) and multiplier (32 bits) of its inputs, then of its hidden
                        neurons;
memory<c>_biases.hex    biases.
refill.hex              What the port brings in an inference, a beat a word; 0 where all fits.
"""


def export(
    folder: Path,
    policy: Path | None,
    *,
    vectors: int,
    seed: int,
    overwrite: bool,
    array: MacArray = PAPER,
    verilog: bool = False,
) -> list[Path]:
    """Write a policy's parameters and test vectors as hex files.

    Parameters
    ----------
    folder
        Where to; it is made where there is none.
    policy
        File of the policy; None for the one that comes with ExWarp.
    vectors, seed
        How many test vectors, and of which random numbers.
    overwrite
        Whether files of these names may be there.
    array
        The machine.
    verilog
        Whether to write its design, too, with a test bench.

    Returns
    -------
    The files.

    Raises
    ------
    InputError
        When the policy cannot be used.
    OutputExistsError, OutputError
        When files are there, or cannot be written.
    UsageError
        When the design cannot be such a machine.
    """
    source = load_policy(policy)
    network = source.network
    about = ABOUT + DESIGN if verilog else ABOUT
    texts = {README: about.format(cores=array.cores, macs=array.macs, inputs=network.sizes[0])}
    texts |= hex_files(array, network, sample_states(network.sizes[0], vectors, seed))
    if verilog:
        texts |= design(array, network.sizes, texts, vectors)
    facts = {"policy": source.path.name, "sha256": source.checksum, "vectors": vectors}
    document = {
        "schema": FORMAT,
        **facts,
        "seed": seed,
        "sizes": network.sizes,
        "cores": array.cores,
        "macs": array.macs,
        "addresses": [_addresses(array, network, core) for core in range(array.cores)],
        "files": list(texts),
    }
    # Last, so that a folder with a manifest is complete.
    texts[MANIFEST] = json.dumps(document, indent=2) + "\n"
    taken = [name for name in texts if (folder / name).exists()]
    if taken and not overwrite:
        raise OutputExistsError(
            f"{folder / taken[0]} exists; choose another folder, or add --overwrite"
        )
    make_folder(folder)
    for name, text in texts.items():
        atomic_write_text(folder / name, text)
    return [folder / name for name in texts]


def hex_files(array: MacArray, network: QuantisedMlp, states: I32) -> dict[str, str]:
    """Return the files of a network, and of test vectors from states int32 [N, n], by name."""
    return _parameters(array, network) | _vectors(network, states)


def _parameters(array: MacArray, network: QuantisedMlp) -> dict[str, str]:
    """Return the hex files of the network by name."""
    texts = {
        "input_multiplier.hex": _hex(network.inputs.multipliers),
        "input_shift.hex": _hex(network.inputs.shifts),
    }
    scales = [layer.requantisation for layer in network.layers]
    known = [scale for scale in scales if scale is not None]
    for core in range(array.cores):
        own = slice(core, None, array.cores)
        texts[f"core{core}_weights.hex"] = _lines(_weight_words(array, network, core))
        texts[f"core{core}_bias.hex"] = "".join(_hex(la.biases[own]) for la in network.layers)
        texts[f"core{core}_multiplier.hex"] = "".join(_hex(s.multipliers[own]) for s in known)
        texts[f"core{core}_shift.hex"] = "".join(_hex(s.shifts[own]) for s in known)
    return texts


def _weight_words(array: MacArray, network: QuantisedMlp, core: int) -> Iterator[str]:
    """Yield a core's words of weights, the first weight in the lowest bits."""
    for layer in network.layers:
        own = layer.weights[core :: array.cores]
        filled = np.pad(own, ((0, 0), (0, -layer.fan_in % array.macs)))
        for word in filled.reshape(-1, array.macs):
            yield word[::-1].tobytes().hex()


def _vectors(network: QuantisedMlp, states: I32) -> dict[str, str]:
    """Return the hex files of the test vectors by name."""
    found: Inference = infer_reference(network, states)
    texts = {
        "vectors_input.hex": _hex(states),
        "vectors_input_q.hex": _hex(found.inputs),
        "vectors_output.hex": _hex(
            np.column_stack([found.outputs, found.choices.astype(np.int32)])
        ),
    }
    for k, sums in enumerate(found.accumulators):
        texts[f"vectors_layer{k}_accumulator.hex"] = _hex(sums)
    for k, activations in enumerate(found.activations):
        texts[f"vectors_layer{k}_activation.hex"] = _hex(activations)
    return texts


def _addresses(array: MacArray, network: QuantisedMlp, core: int) -> list[dict[str, int | None]]:
    """Return where each layer begins in a core's files."""
    weights_at = bias_at = 0
    places: list[dict[str, int | None]] = []
    for layer in network.layers:
        neurons, words = array.share(layer.neurons, core), array.words(layer.fan_in)
        places.append(
            {
                "neurons": neurons,
                "words": words,
                "weights_at": weights_at,
                "bias_at": bias_at,
                "scale_at": None if layer.requantisation is None else bias_at,
            }
        )
        weights_at, bias_at = weights_at + neurons * words, bias_at + neurons
    return places


def _hex(values: Integers) -> str:
    """Write a word a line, with the digits of the type, two's complement."""
    bits = 8 * values.dtype.itemsize
    mask = (1 << bits) - 1
    return _lines(f"{value & mask:0{bits // 4}x}" for value in values.ravel().tolist())


def _lines(words: Iterable[str]) -> str:
    return "".join(f"{word}\n" for word in words)
