"""The predictor of ``exwarp policy``: its schedule and decisions, and its files for hardware."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from exwarp_cli import accelerator
from exwarp_cli.accelerator import mac_array
from exwarp_cli.accelerator.mac_array import MacArray, Schedule
from exwarp_cli.accelerator.mlp import ONE, PAPER_SIZES, Inference, QuantisedMlp, infer_reference
from exwarp_cli.accelerator.mlp_kernel import MlpKernel
from exwarp_cli.domain.decision import CHOICES
from exwarp_cli.errors import OutputExistsError, UsageError
from exwarp_cli.io.files import atomic_write_text, make_folder
from exwarp_cli.kernels.array_types import I32
from exwarp_cli.models.policy_files import StateRow, load_policy, read_states

DECISIONS_SCHEMA = "exwarp.policy-decisions/1"
FORMAT = "exwarp.policy-hex/1"
MANIFEST = "manifest.json"
README = "README.txt"
README_DESIGN = "README_design.txt"  # the end of that file, where it has the design
VERILOG = resources.files(accelerator) / "verilog"  # the folder of texts and sources
SOURCES = ("exwarp_predictor.v", "exwarp_core.v", "exwarp_predictor_tb.v", "Makefile")

MOST_CORES = 10  # a core's files have its number as one digit

Integers = npt.NDArray[np.integer[Any]]

_CLOCK = re.compile(
    r"((?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:e[+-]?[0-9]+)?)\s*([kmg]?)(?:hz)?", re.IGNORECASE
)
_BYTES = re.compile(r"([0-9]+)\s*([kmg]?)i?b?", re.IGNORECASE)
_HERTZ = {"": 1.0, "k": 1e3, "m": 1e6, "g": 1e9}
_UNITS = {"": 1, "k": 1 << 10, "m": 1 << 20, "g": 1 << 30}


@dataclass(frozen=True)
class Trace:
    """One inference with all intermediate values, and its schedule on the paper's machine."""

    row: StateRow
    inference: Inference
    schedule: Schedule


def clock_of(text: str, option: str = "--clock") -> float:
    """Parse a clock rate, as ``500MHz``, ``1.5GHz`` or ``1e9``, in hertz.

    Raises UsageError with the name of the option, when it is no rate, or not above 0.
    """
    match = _CLOCK.fullmatch(text.strip())
    hertz = float(match[1]) * _HERTZ[match[2].lower()] if match else 0.0
    if not 0 < hertz < math.inf:
        raise UsageError(f"{option} {text} is no clock rate; give one as 500MHz, 1.5GHz or 1e9")
    return hertz


def machine(cores: int, macs: int, cache: str, port: int) -> MacArray:
    """Return a machine with a port of some bytes a cycle; see `MacArray`.

    `cache` is that of each core, as ``16KB`` or ``16384``; K is 1024. Raises UsageError for a cache
    that is no size, or 0.
    """
    match = _BYTES.fullmatch(cache.strip())
    if match is None or len(match[1]) > 15:
        raise UsageError(f"--cache {cache} is no size; give one as 16KB or 16384")
    size = int(match[1]) * _UNITS[match[2].lower()]
    try:
        return MacArray(cores, macs, cache_bytes=size, port_bytes=port)
    except ValueError as error:
        raise UsageError(f"--cache {cache} does not do: {error}; give a larger one") from error


def cycles(policy: Path | None, cores: int, macs: int, cache: str, port: int = 0) -> Schedule:
    """Schedule an inference of a policy, or of the paper's sizes for None, on a :func:`machine`.

    Raises UsageError when the cache is no size, or too small; InputError when the policy cannot be
    read.
    """
    sizes = PAPER_SIZES if policy is None else load_policy(policy).network.sizes
    try:
        return mac_array.schedule(machine(cores, macs, cache, port), sizes)
    except ValueError as error:
        raise UsageError(f"--cache {cache} does not do: {error}; give a larger one") from error


def decide_rows(table: Path, policy: Path | None, number: int | None) -> list[dict[str, Any]]:
    """Run a policy, or the one of ExWarp for None, on a row of a table, or all rows for None.

    The table is a CSV file; see `exwarp_cli.models.policy_files.read_states`. The result names the
    row, the network's outputs, int32, and the choice, by column.

    Raises InputError when a file cannot be used; UsageError when there is no such row.
    """
    network = load_policy(policy).network
    rows = _select(table, network, number)
    outputs, choices = MlpKernel(network).decide_many(np.stack([row.state for row in rows]))
    return [
        {
            "row": row.row,
            **row.identity,
            "output_warp": int(warp),
            "output_extrapolate": int(extrapolate),
            "decision": CHOICES[choice],
        }
        for row, (warp, extrapolate), choice in zip(rows, outputs, choices, strict=True)
    ]


def trace_row(table: Path, policy: Path | None, number: int | None) -> Trace:
    """Run the policy on one state, the first by default, and keep all intermediate values.

    Parameters and errors are those of :func:`decide_rows`.
    """
    network = load_policy(policy).network
    row = _select(table, network, number)[0]
    inference = infer_reference(network, row.state)
    return Trace(row, inference, mac_array.schedule(MacArray(), network.sizes))


def _select(table: Path, network: QuantisedMlp, number: int | None) -> tuple[StateRow, ...]:
    rows = read_states(table, network.sizes[0])
    if number is None:
        return rows
    selected = tuple(row for row in rows if row.row == number)
    if not selected:
        raise UsageError(
            f"--row {number}: {table} has no state in that row; its states are in rows "
            f"{rows[0].row} to {rows[-1].row}"
        )
    return selected


def sample_states(size: int, count: int, seed: int) -> I32:
    """Return states to test an implementation with, int32 [count, size] in Q16.16.

    By turns: within 0 … 1, as they are meant; of any magnitude, small ones as often as large ones;
    and values at which bits carry and saturate.
    """
    rng = np.random.default_rng(seed)
    shape = (count, size)
    valid = rng.integers(0, ONE, shape, np.int64, endpoint=True)
    powers = np.int64(1) << rng.integers(0, 32, shape, np.int64)
    signs = rng.choice(np.array([-1, 1]), shape)
    any_size = (rng.random(shape) * powers).astype(np.int64) * signs
    edges = powers * signs + rng.integers(-2, 3, shape)
    turn = np.arange(count)[:, None] % 3
    states = np.where(turn == 0, valid, np.where(turn == 1, any_size, edges))
    return np.clip(states, -(2**31), 2**31 - 1).astype(np.int32)


def export(
    folder: Path,
    policy: Path | None,
    *,
    vectors: int,
    seed: int,
    overwrite: bool,
    array: MacArray,
    verilog: bool,
) -> list[Path]:
    """Write a policy's parameters and test vectors as hex files; return the files.

    None is the policy that comes with ExWarp. `vectors` says how many test vectors, `seed` of which
    random numbers. With `verilog` its design comes too, with a test bench.

    Raises InputError when the policy cannot be used; OutputExistsError or OutputError when files
    exist or cannot be written; UsageError when the design cannot be such a machine.
    """
    source = load_policy(policy)
    network = source.network
    names = (README, README_DESIGN) if verilog else (README,)
    about = "".join((VERILOG / name).read_text(encoding="utf-8") for name in names)
    texts = {README: about.format(cores=array.cores, macs=array.macs, inputs=network.sizes[0])}
    texts |= hex_files(array, network, sample_states(network.sizes[0], vectors, seed))
    if verilog:
        texts |= design(array, network.sizes, texts, vectors)
    manifest = {
        "schema": FORMAT,
        "policy": source.path.name,
        "sha256": source.checksum,
        "vectors": vectors,
        "seed": seed,
        "sizes": network.sizes,
        "cores": array.cores,
        "macs": array.macs,
        "addresses": [_addresses(array, network, core) for core in range(array.cores)],
        "files": list(texts),
    }
    # Last, so that a folder with a manifest is complete.
    texts[MANIFEST] = json.dumps(manifest, indent=2) + "\n"
    existing = [name for name in texts if (folder / name).exists()]
    if existing and not overwrite:
        raise OutputExistsError(
            f"{folder / existing[0]} exists; choose another folder, or add --overwrite"
        )
    make_folder(folder)
    for name, text in texts.items():
        atomic_write_text(folder / name, text)
    return [folder / name for name in texts]


def hex_files(array: MacArray, network: QuantisedMlp, states: I32) -> dict[str, str]:
    """Return the files of a network, and of test vectors from states int32 [N, n], by name."""
    texts = {
        "input_multiplier.hex": _hex(network.inputs.multipliers),
        "input_shift.hex": _hex(network.inputs.shifts),
    }
    scales = [la.requantisation for la in network.layers if la.requantisation is not None]
    for core in range(array.cores):
        own = slice(core, None, array.cores)
        texts[f"core{core}_weights.hex"] = _lines(
            word[::-1].tobytes().hex()  # the first weight in the lowest bits
            for layer in network.layers
            for word in np.pad(
                layer.weights[own], ((0, 0), (0, -layer.fan_in % array.macs))
            ).reshape(-1, array.macs)
        )
        texts[f"core{core}_bias.hex"] = "".join(_hex(la.biases[own]) for la in network.layers)
        texts[f"core{core}_multiplier.hex"] = "".join(_hex(s.multipliers[own]) for s in scales)
        texts[f"core{core}_shift.hex"] = "".join(_hex(s.shifts[own]) for s in scales)
    inference = infer_reference(network, states)
    outputs = np.column_stack([inference.outputs, inference.choices.astype(np.int32)])
    texts["vectors_input.hex"] = _hex(states)
    texts["vectors_input_q.hex"] = _hex(inference.inputs)
    texts["vectors_output.hex"] = _hex(outputs)
    for k, sums in enumerate(inference.accumulators):
        texts[f"vectors_layer{k}_accumulator.hex"] = _hex(sums)
    for k, activations in enumerate(inference.activations):
        texts[f"vectors_layer{k}_activation.hex"] = _hex(activations)
    return texts


def _addresses(array: MacArray, network: QuantisedMlp, core: int) -> list[dict[str, int | None]]:
    """Return where each layer begins in a core's files."""
    weights_at = bias_at = 0
    addresses: list[dict[str, int | None]] = []
    for layer in network.layers:
        neurons, words = array.share(layer.neurons, core), array.words(layer.fan_in)
        addresses.append(
            {
                "neurons": neurons,
                "words": words,
                "weights_at": weights_at,
                "bias_at": bias_at,
                "scale_at": None if layer.requantisation is None else bias_at,
            }
        )
        weights_at, bias_at = weights_at + neurons * words, bias_at + neurons
    return addresses


def _hex(values: Integers) -> str:
    """Write one word a line, with the digits of the type, two's complement."""
    bits = 8 * values.dtype.itemsize
    mask = (1 << bits) - 1
    return _lines(f"{value & mask:0{bits // 4}x}" for value in values.ravel().tolist())


def _lines(words: Iterable[str]) -> str:
    return "".join(f"{word}\n" for word in words)


def _resident_words(array: MacArray, sizes: Sequence[int], needed: int) -> int:
    """Return how many of the fullest core's `needed` words of weights its cache holds.

    Raises UsageError for a machine that the design cannot implement.
    """
    if array.cores > MOST_CORES or array.cores > array.macs:
        raise UsageError(
            f"--cores {array.cores} --macs {array.macs}: the design has at most {MOST_CORES} "
            "cores, and no more than MAC units in each; give other numbers"
        )
    try:
        room = mac_array.resident_words(array, sizes)
    except ValueError as error:
        raise UsageError(f"--cache does not do: {error}; give a larger one") from error
    if room < needed and not array.port_bytes:
        raise UsageError(
            f"a cache of {array.cache_bytes} bytes holds {room} of {needed} words of weights; give "
            "a larger --cache, or the width of a --port that brings the rest"
        )
    return min(room, needed)


def design(
    array: MacArray, sizes: Sequence[int], texts: Mapping[str, str], vectors: int
) -> dict[str, str]:
    """Return the files of a machine's design by name; its pipeline has four stages.

    `sizes` are the network's, and `texts` its hex files, see `hex_files`; `vectors` says how many
    test vectors there are.

    Raises UsageError for a machine that the design cannot implement: more than 10 cores, more cores
    than MAC units in each, a cache that is too small, and weights that do not fit without a port.
    """
    cores = range(array.cores)
    weights = [texts[f"core{core}_weights.hex"].split() for core in cores]
    resident = _resident_words(array, sizes, len(weights[0]))
    # Where all fits, the port is not used, and as wide as a word.
    array = replace(array, port_bytes=array.port_bytes or array.macs)
    scales = []  # of each core: shift and multiplier of its inputs, then of its hidden neurons
    for core in cores:
        shifts, multipliers = (
            texts[f"input_{part}.hex"].split()[core :: array.cores]
            + texts[f"core{core}_{part}.hex"].split()
            for part in ("shift", "multiplier")
        )
        scales.append([s + m for s, m in zip(shifts, multipliers, strict=True)])
    memories = {
        "weights": [own[:resident] for own in weights],
        "scales": scales,
        "biases": [texts[f"core{core}_bias.hex"].split() for core in cores],
    }
    files = {name: (VERILOG / name).read_text(encoding="utf-8") for name in SOURCES}
    for core in cores:
        for name, words in memories.items():  # all as deep as the fullest core's, the first
            filled = words[core] + ["0" * len(words[0][0])] * (len(words[0]) - len(words[core]))
            files[f"memory{core}_{name}.hex"] = _lines(filled)
    # What the port brings in an inference, a beat a line, the lowest bytes first.
    digits, beats = 2 * array.port_bytes, []
    for _, missing in mac_array.missing_words(array, sizes):
        for core, index in missing:
            word = weights[core][index].zfill(digits * array.beats)
            beats += [word[end - digits : end] for end in range(len(word), 0, -digits)]
    files["refill.hex"] = _lines(beats or ["0"])
    depths = {
        "RESIDENT": resident,
        "WEIGHT_WORDS": len(weights[0]),
        "SCALES": len(scales[0]),
        "BIASES": len(memories["biases"][0]),
    }
    files["exwarp_parameters.vh"] = _parameters(array, sizes, depths)
    values = {
        "VECTORS": vectors,
        "INPUTS": sizes[0],
        "PORT": array.port_bytes,
        "REFILLS": max(1, len(beats)),
        "CYCLES": mac_array.schedule(array, sizes).cycles,
    }
    files["exwarp_vectors.vh"] = _lines(f"localparam {k} = {v};" for k, v in values.items())
    return files


def _parameters(array: MacArray, sizes: Sequence[int], depths: Mapping[str, int]) -> str:
    """Write the parameters of the top module; `depths` are those of its memories, in words."""
    slots = [-(-size // array.cores) for size in sizes]
    last = [size - (count - 1) * array.cores for size, count in zip(sizes, slots, strict=True)]
    words = [array.words(size) for size in sizes[:-1]]
    numbers = {
        "CORES": array.cores,
        "MACS": array.macs,
        "LAYERS": len(sizes) - 1,
        "DEPTH": max(2, *words),
        **depths,
        "STATES": slots[0],
        "PORT": array.port_bytes,
        "BEATS": array.beats,
    }
    # By stage: the inputs, then each layer. A slot is one number of each core.
    tables = {"SLOTS": slots, "REMAINDERS": last, "WORDS": words}
    lines = [f"parameter {name} = {value}," for name, value in numbers.items()]
    for name, values in tables.items():  # 16-bit numbers in one constant, the first lowest
        packed = ", ".join(f"16'd{value}" for value in reversed(values))
        lines.append(f"parameter [{16 * len(values) - 1}:0] {name} = {{{packed}}},")
    return "\n".join(lines)[:-1] + "\n"
