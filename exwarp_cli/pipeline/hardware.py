"""The predictor in Verilog: a machine's design, the images of its memories, and a test bench."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib import resources
from itertools import pairwise

from exwarp_cli.accelerator import verilog
from exwarp_cli.accelerator.mac_array import MacArray, missing_words, resident_words, schedule
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
    shares = (array.share(after, 0) * array.words(before) for before, after in pairwise(sizes))
    needed = sum(shares)
    if room < needed and not array.port_bytes:
        raise UsageError(
            f"a cache of {array.cache_bytes} bytes holds {room} of {needed} words of weights; give "
            "a larger --cache, or the width of a --port that brings the rest"
        )


def design(
    array: MacArray, sizes: Sequence[int], texts: Mapping[str, str], vectors: int
) -> dict[str, str]:
    """Return the files of the design by name.

    Parameters
    ----------
    array
        The machine; see :func:`require_buildable`.
    sizes
        Of the network.
    texts
        The network's hex files, see `accelerator.hex_files`.
    vectors
        How many test vectors there are.

    Raises
    ------
    UsageError
        For a machine that the design cannot be.
    """
    require_buildable(array, sizes)
    # Where all fits, nothing is asked of the port; it is as wide as a word then.
    array = replace(array, port_bytes=array.port_bytes or array.macs)
    cores = range(array.cores)
    weights = [texts[f"core{core}_weights.hex"].split() for core in cores]
    resident = min(resident_words(array, sizes), len(weights[0]))
    memories = {
        "weights": [own[:resident] for own in weights],
        "scales": [_scales(texts, array, core) for core in cores],
        "biases": [texts[f"core{core}_bias.hex"].split() for core in cores],
    }
    made = {name: _source(name) for name in SOURCES}
    for core in cores:
        for name, words in memories.items():  # all as deep as the fullest core's, the first
            filled = words[core] + ["0" * len(words[0][0])] * (len(words[0]) - len(words[core]))
            made[f"memory{core}_{name}.hex"] = "".join(f"{word}\n" for word in filled)
    beats = list(_refill(array, sizes, weights)) or ["0"]
    made["refill.hex"] = "".join(f"{beat}\n" for beat in beats)
    depths = {
        "RESIDENT": resident,
        "WEIGHT_WORDS": len(weights[0]),
        "SCALES": len(memories["scales"][0]),
        "BIASES": len(memories["biases"][0]),
    }
    made["exwarp_parameters.vh"] = _parameters(array, sizes, depths)
    made["exwarp_vectors.vh"] = _localparams(
        VECTORS=vectors,
        INPUTS=sizes[0],
        PORT=array.port_bytes,
        REFILLS=len(beats),
        CYCLES=schedule(array, sizes).cycles,
    )
    return made


def _source(name: str) -> str:
    return resources.files(verilog).joinpath(name).read_text(encoding="utf-8")


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
    lines += [
        f"parameter [{16 * len(t) - 1}:0] {name} = {_packed(t)}," for name, t in tables.items()
    ]
    return "\n".join(lines)[:-1] + "\n"


def _packed(values: Sequence[int]) -> str:
    """Write 16-bit numbers as one constant, the first in the lowest bits."""
    return "{" + ", ".join(f"16'd{value}" for value in reversed(values)) + "}"


def _localparams(**values: int) -> str:
    return "".join(f"localparam {name} = {value};\n" for name, value in values.items())


def _scales(texts: Mapping[str, str], array: MacArray, core: int) -> list[str]:
    """Return shift and multiplier of a core's inputs, then of its hidden neurons."""
    shifts, multipliers = (
        texts[f"input_{part}.hex"].split()[core :: array.cores]
        + texts[f"core{core}_{part}.hex"].split()
        for part in ("shift", "multiplier")
    )
    return [shift + multiplier for shift, multiplier in zip(shifts, multipliers, strict=True)]


def _refill(
    array: MacArray, sizes: Sequence[int], weights: Sequence[Sequence[str]]
) -> Iterator[str]:
    """Yield what the port brings in an inference, a beat a line, the lowest bytes first."""
    digits = 2 * array.port_bytes
    for _, missing in missing_words(array, sizes):
        for core, index in missing:
            word = weights[core][index].zfill(digits * array.beats)
            yield from (word[end - digits : end] for end in range(len(word), 0, -digits))
