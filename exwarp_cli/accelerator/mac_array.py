"""The accelerator's machine: how long an inference takes, and what its caches hold.

The paper gives the parts (section IV-C, "Hardware Implementation of the Predictor"): four cores,
each with ten 8-bit multiply-accumulate units, one adder, one multiplier, a pipeline of four stages
and a private cache of 16 KB. How they work together is left open; this is the schedule taken here.

Work. Inputs and neurons are dealt to the cores in turn: number i goes to core ``i % cores``. All
cores take a layer together, and the next one begins when its activations are complete, as every
neuron needs all of them.

Input stage. Each multiplier starts one input a cycle, which the pipeline reads, multiplies, rounds
and shifts, and writes to all cores: ``ceil(n / cores)`` cycles, and ``pipeline_stages - 1`` more
until the last is through ("fill").

Layer. A neuron of fan-in n takes ``ceil(n / macs)`` cycles, in each of which a core starts ten
products; the pipeline reads their operands, multiplies, adds up, and adds to the core's
accumulator. The fullest core has ``ceil(neurons / cores)`` neurons; after its last products the
pipeline fills for ``pipeline_stages - 1`` cycles. A finished sum gets its bias from the adder in
the next cycle and is requantised by the multiplier in the one after that, while the MACs go on
with the next neuron. As neurons take at least a cycle each, neither unit is ever waited for; only
the last neuron's two cycles show (one in the last layer, which is not requantised).

Decision. Core 0's adder compares the two outputs: one cycle.

Caches. A core keeps the weights, biases, multipliers and shifts of its own neurons and inputs (1,
4, 4 and 1 bytes each), its own part of the state (4 bytes a number), and the activations that a
layer reads and writes, of all neurons. What does not fit is fetched again for every inference:
buffers stay, then parameters in the order of their use until the cache is full, and the rest is
streamed past the cache. That is counted in bytes and not in cycles: the paper names no memory, and
the schedule supposes one that keeps up.

Port. With `port_bytes`, one port of that width serves all cores, and its cycles are counted.
Biases, multipliers, shifts and buffers stay in the caches, and as many words of weights as fit the
fullest one, in the order of their use. Of the words that cores start together, the port brings
those that are missing, one after the other, each in ``ceil(macs / port_bytes)`` cycles; the cores
start in the last of them. Between layers the port waits as the MAC units do.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

BIAS_BYTES = 4
SCALE_BYTES = 5  # of a multiplier and a shift

SUM_BYTES = 4  # of a number of the state, or of an output

COMPARE_CYCLES = 1  # of the decision

PAPER_LATENCY_NS = 6.2  # the paper, "Synthesis Results"


@dataclass(frozen=True)
class MacArray:
    """The machine's parts; the defaults are the paper's. ValueError if a number is too small."""

    cores: int = 4  # at least 1
    macs: int = 10  # multiply-accumulate units of a core, at least 1
    pipeline_stages: int = 4  # at least 1
    cache_bytes: int = 16384  # of each core, at least 1
    port_bytes: int = 0  # width of the port that reloads weights, bytes a cycle; 0: memory keeps up

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            least = 0 if name == "port_bytes" else 1
            if value < least:
                raise ValueError(f"{name} is {value}, and {least} is the least")

    def share(self, count: int, core: int) -> int:
        """Return how many of `count` inputs or neurons a core gets."""
        return len(range(core, count, self.cores))

    def words(self, fan_in: int) -> int:
        """Return the cycles that the products of one neuron take."""
        return -(-fan_in // self.macs)

    @property
    def beats(self) -> int:
        """The cycles that a word of weights takes on the port, where there is one."""
        return -(-self.macs // self.port_bytes)


@dataclass(frozen=True)
class InputSchedule:
    """The input stage."""

    numbers: int  # of the state
    multiply_cycles: int  # until the last input is started
    fill_cycles: int  # from there until it is through the pipeline
    parameter_bytes: int  # multipliers and shifts of the fullest core
    refill_bytes: int  # how many of them do not fit its cache
    cycles: int  # all of the stage


@dataclass(frozen=True)
class LayerSchedule:
    """One layer."""

    fan_in: int
    neurons: int
    mac_cycles: int  # cycles in which a MAC unit starts a product
    fill_cycles: int  # until the last products are through the pipeline
    requantise_cycles: int  # adder and multiplier after that, for the last neuron
    refill_cycles: int  # cycles in which MAC units wait for the port
    useful_macs: int  # products that the layer needs
    utilisation: float  # those over what all MAC units could start in the layer's cycles, 0 … 1
    weight_bytes: int  # of the fullest core, which is core 0, as all that follow
    bias_bytes: int
    scale_bytes: int  # multipliers and shifts
    refill_bytes: int  # how much of that does not fit the core's cache
    cycles: int  # all of the layer


@dataclass(frozen=True)
class Schedule:
    """A whole inference."""

    array: MacArray
    sizes: tuple[int, ...]  # numbers into the network, and out of each layer
    inputs: InputSchedule
    layers: tuple[LayerSchedule, ...]
    buffer_bytes: int  # state and activations in the fullest core
    core_bytes: tuple[int, ...]  # parameters and buffers of each core
    core_refill_bytes: tuple[int, ...]  # how much of that it reloads for every inference
    mac_cycles: int  # cycles in which a MAC unit starts a product
    cycles: int  # all cycles from the state to the decision
    # Products needed over what the MAC units could start in all cycles, 0 … 1
    utilisation: float
    refill_bytes: int  # that all cores together fetch again for every inference

    def latency_ns(self, clock_hz: float) -> float:
        """Return the nanoseconds of an inference at a clock rate in hertz."""
        return 1e9 * self.cycles / clock_hz


def schedule(array: MacArray, sizes: Sequence[int]) -> Schedule:
    """Lay out an inference on the machine, as the module describes it.

    `sizes`: numbers into the network, and out of each layer; two or more, each at least 1.

    ValueError: sizes are missing, or a core's cache does not hold the state and activations; with a
    port, biases, multipliers and shifts, too.
    """
    sizes = tuple(sizes)
    if len(sizes) < 2 or min(sizes) < 1:
        raise ValueError(f"sizes are two or more numbers from 1, not {list(sizes)}")
    by_core = [_core_bytes(array, sizes, core) for core in range(array.cores)]
    buffers = [size for size, _ in by_core]
    held = [stages for _, stages in by_core]
    if max(buffers) > array.cache_bytes:
        raise ValueError(
            f"a cache of {array.cache_bytes} bytes does not hold the {max(buffers)} bytes of "
            "state and activations"
        )
    waits, refills = _port_use(array, sizes, buffers, held)
    fill = array.pipeline_stages - 1
    own = array.share(sizes[0], 0)
    inputs = InputSchedule(sizes[0], own, fill, sum(held[0][0]), refills[0][0], own + fill)
    layers = []
    for number, (fan_in, neurons) in enumerate(pairwise(sizes), start=1):
        macs = array.share(neurons, 0) * array.words(fan_in)
        after = 1 if number == len(sizes) - 1 else 2
        useful = fan_in * neurons
        cycles = macs + fill + after + waits[number]
        layers.append(
            LayerSchedule(
                *(fan_in, neurons, macs, fill, after, waits[number], useful),
                useful / (array.cores * array.macs * cycles),
                *held[0][number],
                refills[0][number],
                cycles,
            )
        )
    total = inputs.cycles + sum(layer.cycles for layer in layers) + COMPARE_CYCLES
    useful = sum(layer.useful_macs for layer in layers)
    return Schedule(
        array,
        sizes,
        inputs,
        tuple(layers),
        buffers[0],
        tuple(sum(map(sum, stages)) + kept for stages, kept in zip(held, buffers, strict=True)),
        tuple(map(sum, refills)),
        sum(layer.mac_cycles for layer in layers),
        total,
        useful / (array.cores * array.macs * total),
        sum(map(sum, refills)),
    )


def _port_use(
    array: MacArray,
    sizes: tuple[int, ...],
    buffers: list[int],
    held: list[list[tuple[int, int, int]]],
) -> tuple[list[int], list[list[int]]]:
    """Return how long each stage waits for the port, cycles, and what each core reloads for it.

    `buffers` and `held` are of each core, from `_core_bytes`.
    """
    waits = [0] * len(sizes)
    refills = [[0] * len(sizes) for _ in range(array.cores)]
    if array.port_bytes:
        for number, missing in missing_words(array, sizes):
            waits[number] += max(len(missing) * array.beats - 1, 0)
            for core, _ in missing:
                refills[core][number] += array.macs
    else:
        for core, stages in enumerate(held):
            room = array.cache_bytes - buffers[core]
            for number, needed in enumerate(map(sum, stages)):
                refills[core][number] = max(needed - room, 0)
                room -= min(needed, room)
    return waits, refills


def resident_words(array: MacArray, sizes: Sequence[int]) -> int:
    """Return how many words of weights a core's cache holds beside all else.

    ValueError: it does not hold the rest and one word.
    """
    buffers, stages = _core_bytes(array, tuple(sizes), 0)
    rest = buffers + sum(bias + scale for _, bias, scale in stages)
    if rest + array.macs > array.cache_bytes:
        raise ValueError(
            f"a cache of {array.cache_bytes} bytes does not hold the {rest + array.macs} bytes of "
            "buffers, biases, multipliers, shifts and a word of weights"
        )
    return (array.cache_bytes - rest) // array.macs


def missing_words(
    array: MacArray, sizes: Sequence[int]
) -> Iterator[tuple[int, list[tuple[int, int]]]]:
    """Yield every step of the MAC units: its layer from 1 on, and the words that no cache holds.

    A word is a core and its index among the core's words, in the order in which the port brings
    them. ValueError as `resident_words`.
    """
    room = resident_words(array, sizes)
    at = [0] * array.cores
    for layer, (fan_in, neurons) in enumerate(pairwise(sizes), start=1):
        for first in range(0, neurons, array.cores):
            active = range(min(array.cores, neurons - first))
            for _ in range(array.words(fan_in)):
                yield layer, [(core, at[core]) for core in active if at[core] >= room]
                for core in active:
                    at[core] += 1


def _core_bytes(
    array: MacArray, sizes: tuple[int, ...], core: int
) -> tuple[int, list[tuple[int, int, int]]]:
    """Return the bytes of a core's buffers, and of its parameters by stage.

    The parameters are weights, biases, and multipliers with shifts; the first stage is the input.
    """
    hidden = [before + after for before, after in pairwise(sizes[:-1])]
    last = sizes[-2] + SUM_BYTES * sizes[-1]
    buffers = SUM_BYTES * array.share(sizes[0], core) + max([*hidden, last])
    stages = [(0, 0, SCALE_BYTES * array.share(sizes[0], core))]
    for number in range(1, len(sizes)):
        own = array.share(sizes[number], core)
        scales = 0 if number == len(sizes) - 1 else SCALE_BYTES * own
        stages.append((own * sizes[number - 1], BIAS_BYTES * own, scales))
    return buffers, stages
