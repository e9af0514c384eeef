"""The predictor in Verilog: a machine's design, the images of its memories, and test vectors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib import resources
from itertools import pairwise

import numpy as np

from exwarp_cli.accel import verilog
from exwarp_cli.accel.mac_array import MacArray, resident_words, schedule
from exwarp_cli.accel.quantised_mlp import QuantisedMlp
from exwarp_cli.errors import UsageError

CACHE = 20 * 1024
"""Bytes of a core's memory that the shipped network fits: 16 KB do not hold its weights."""

MOST_CORES = 10
"""A core's files have its number as one digit."""

SOURCES = ("exwarp_predictor.v", "exwarp_core.v", "exwarp_predictor_tb.v", "Makefile")


def require_buildable(array: MacArray, sizes: Sequence[int]) -> None:
    """Refuse a machine that the design cannot be.

    Raises
    ------
    UsageError
        For more than 10 cores, more cores than MAC units in each, another pipeline than of four
        stages, a cache that is too small, and weights that do not fit without a port.
    """
    if array.cores > MOST_CORES or array.cores > array.macs:
        raise UsageError(
            f"--cores {array.cores} --macs {array.macs}: the design has at most {MOST_CORES} "
            "cores, and no more than MAC units in each; give other numbers"
        )
    if array.pipeline_stages != MacArray.pipeline_stages:
        raise UsageError(f"the design's pipeline has {MacArray.pipeline_stages} stages")
    try:
        room = resident_words(array, sizes)
    except ValueError as error:
        raise UsageError(f"--cache does not do: {error}; give a larger one") from error
    needed = _words(array, sizes, 0)
    if room < needed and not array.port_bytes:
        raise UsageError(
            f"a cache of {array.cache_bytes} bytes holds {room} of {needed} words of weights; give "
            "a larger --cache, or the width of a --port that brings the rest"
        )


def design(array: MacArray, network: QuantisedMlp, vectors: int) -> dict[str, str]:
    """Return the files of the design by name, beside those of the test vectors.

    Parameters
    ----------
    array
        The machine; see :func:`require_buildable`.
    network
        Any.
    vectors
        How many test vectors there are.

    Raises
    ------
    UsageError
        For a machine that the design cannot be.
    """
    sizes = network.sizes
    require_buildable(array, sizes)
    total = _words(array, sizes, 0)
    resident = min(resident_words(array, sizes), total)
    words = [list(weight_words(array, network, core)) for core in range(array.cores)]
    texts = {name: _source(name) for name in SOURCES}
    for core, own in enumerate(words):
        texts[f"memory{core}_weights.hex"] = _image(own[:resident], resident, 2 * array.macs)
        scales = list(_scales(array, network, core))
        texts[f"memory{core}_scales.hex"] = _image(scales, _scale_count(array, sizes), 10)
        biases = [f"{b & 0xFFFFFFFF:08x}" for b in _biases(array, network, core)]
        texts[f"memory{core}_biases.hex"] = _image(biases, _bias_count(array, sizes), 8)
    beats = list(_refill(array, sizes, words, resident)) or ["0"]
    texts["refill.hex"] = "".join(f"{beat}\n" for beat in beats)
    texts["exwarp_parameters.vh"] = _parameters(array, sizes, resident)
    texts["exwarp_vectors.vh"] = _localparams(
        VECTORS=vectors,
        INPUTS=sizes[0],
        PORT=_port(array),
        REFILLS=len(beats),
        CYCLES=schedule(array, sizes).cycles,
    )
    return texts


def _source(name: str) -> str:
    return resources.files(verilog).joinpath(name).read_text(encoding="utf-8")


def _port(array: MacArray) -> int:
    return array.port_bytes or array.macs


def _beats(array: MacArray) -> int:
    return -(-array.macs // _port(array))


def _parameters(array: MacArray, sizes: Sequence[int], resident: int) -> str:
    """Write the parameters of the top module."""
    slots = [-(-size // array.cores) for size in sizes]
    last = [size - (count - 1) * array.cores for size, count in zip(sizes, slots, strict=True)]
    words = [array.words(size) for size in sizes[:-1]]
    numbers = {
        "CORES": array.cores,
        "MACS": array.macs,
        "LAYERS": len(sizes) - 1,
        "DEPTH": max(2, *words),
        "RESIDENT": resident,
        "WEIGHT_WORDS": _words(array, sizes, 0),
        "SCALES": _scale_count(array, sizes),
        "BIASES": _bias_count(array, sizes),
        "STATES": slots[0],
        "PORT": _port(array),
        "BEATS": _beats(array),
    }
    # By stage: the inputs, then each layer. A slot is one number of each core.
    tables = {"SLOTS": slots, "REMAINDERS": last, "WORDS": words}
    lines = [f"parameter {name} = {value}," for name, value in numbers.items()]
    lines += [
        f"parameter [{16 * len(t) - 1}:0] {name} = {_packed(t)}," for name, t in tables.items()
    ]
    return "\n".join(lines)[:-1] + "\n"


def _packed(values: Sequence[int]) -> str:
    """Write 16-bit numbers as one constant, the first in the lowest bits."""
    return "{" + ", ".join(f"16'd{value}" for value in reversed(values)) + "}"


def _localparams(**values: int) -> str:
    return "".join(f"localparam {name} = {value};\n" for name, value in values.items())


def _words(array: MacArray, sizes: Sequence[int], core: int) -> int:
    """Return how many words of weights a core reads."""
    return sum(array.share(after, core) * array.words(before) for before, after in pairwise(sizes))


def _scale_count(array: MacArray, sizes: Sequence[int]) -> int:
    return sum(array.share(size, 0) for size in sizes[:-1])


def _bias_count(array: MacArray, sizes: Sequence[int]) -> int:
    return sum(array.share(size, 0) for size in sizes[1:])


def weight_words(array: MacArray, network: QuantisedMlp, core: int) -> Iterator[str]:
    """Yield a core's words of weights, the first weight in the lowest bits."""
    for layer in network.layers:
        own = layer.weights[core :: array.cores]
        filled = np.pad(own, ((0, 0), (0, -layer.fan_in % array.macs)))
        for word in filled.reshape(-1, array.macs):
            yield word[::-1].tobytes().hex()


def _scales(array: MacArray, network: QuantisedMlp, core: int) -> Iterator[str]:
    """Yield shift and multiplier of a core's inputs, then of its hidden neurons."""
    for scale in (network.inputs, *(layer.requantisation for layer in network.layers)):
        if scale is not None:
            own = slice(core, None, array.cores)
            pairs = zip(scale.shifts[own].tolist(), scale.multipliers[own].tolist(), strict=True)
            yield from (f"{shift:02x}{multiplier:08x}" for shift, multiplier in pairs)


def _biases(array: MacArray, network: QuantisedMlp, core: int) -> Iterator[int]:
    for layer in network.layers:
        yield from layer.biases[core :: array.cores].tolist()


def _refill(
    array: MacArray, sizes: Sequence[int], words: Sequence[Sequence[str]], resident: int
) -> Iterator[str]:
    """Yield what the port brings in an inference, a beat a line."""
    port, at = _port(array), [0] * array.cores
    for fan_in, neurons in pairwise(sizes):
        for first in range(0, neurons, array.cores):
            active = range(min(array.cores, neurons - first))
            for _ in range(array.words(fan_in)):
                for core in active:
                    if at[core] >= resident:
                        word = words[core][at[core]].zfill(2 * port * _beats(array))
                        cuts = range(len(word), 0, -2 * port)
                        yield from (word[end - 2 * port : end] for end in cuts)
                    at[core] += 1


def _image(words: Sequence[str], depth: int, digits: int) -> str:
    """Write a memory's words, filled up with zeros."""
    filled = [*words, *["0" * digits] * (depth - len(words))]
    return "".join(f"{word}\n" for word in filled)
