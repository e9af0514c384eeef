"""The machine of `mac_array`, cycle by cycle.

It computes what the cores compute, with what lies in their registers, and counts as it goes: a
schedule that did not lead to the reference's outputs, or took other cycles, would show.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from exwarp_cli.accel.fixed_point import (
    I32,
    MOST_ACTIVATION,
    requantise_half_up,
    saturate,
)
from exwarp_cli.accel.mac_array import MacArray
from exwarp_cli.accel.quantised_mlp import (
    I8,
    QuantisedLayer,
    QuantisedMlp,
    Requantisation,
    checked_states,
)


@dataclass(frozen=True)
class LayerCount:
    """What was counted in a layer; the names are those of `mac_array.LayerSchedule`."""

    mac_cycles: int
    fill_cycles: int
    requantise_cycles: int
    useful_macs: int
    weight_bytes: int


@dataclass(frozen=True, eq=False)
class Simulation:
    """One inference on the machine.

    Attributes
    ----------
    outputs
        int32 [2].
    choice
        0 to warp, 1 to extrapolate.
    input_cycles
        Multiply and fill cycles of the input stage.
    layers
        Counts of each layer.
    cycles
        All of them, the decision's included.
    """

    outputs: I32
    choice: int
    input_cycles: tuple[int, int]
    layers: tuple[LayerCount, ...]
    cycles: int


@dataclass(frozen=True)
class _Products:
    """The operands of one core's MAC units, on their way through the pipeline."""

    neuron: int
    weights: list[int]
    activations: list[int]
    first: bool
    last: bool


class _Core:
    """A core at work on a layer.

    Each cycle goes from the end to the front, so that a unit takes what the one before it left in
    the cycle before.
    """

    def __init__(self, array: MacArray, layer: QuantisedLayer, activations: I8, core: int) -> None:
        self.layer = layer
        self.todo = deque(_words(array, layer, activations, core))
        self.pipeline: deque[_Products | None] = deque([None] * array.pipeline_stages)
        self.accumulator = 0
        self.summed: tuple[int, int] | None = None  # neuron and sum, for the adder
        self.biased: tuple[int, int] | None = None  # neuron and sum, for the multiplier
        self.results: dict[int, int] = {}
        self.weight_bytes = 0

    def cycle(self) -> tuple[bool, bool]:
        """Go one cycle on; return whether products were started, and any were in the pipeline."""
        self._multiplier()
        self._adder()
        started = bool(self.todo)
        self.pipeline.appendleft(self.todo.popleft() if started else None)
        self.pipeline.pop()
        busy = any(stage is not None for stage in self.pipeline)
        if started and self.pipeline[0] is not None:
            self.weight_bytes += len(self.pipeline[0].weights)
        self._accumulate(self.pipeline[-1])
        return started, busy

    @property
    def waits(self) -> bool:
        """Whether nothing is left to do."""
        empty = all(stage is None for stage in self.pipeline)
        return not self.todo and empty and self.summed is None and self.biased is None

    def _accumulate(self, products: _Products | None) -> None:
        """Let the last stage add a word's products."""
        if products is None:
            return
        pairs = zip(products.weights, products.activations, strict=True)
        total = sum(weight * activation for weight, activation in pairs)
        self.accumulator = total if products.first else self.accumulator + total
        if products.last:
            self.summed = (products.neuron, self.accumulator)

    def _adder(self) -> None:
        """Add the bias to what the pipeline finished."""
        if self.summed is None:
            return
        neuron, total = self.summed
        self.summed = None
        biased = (neuron, total + int(self.layer.biases[neuron]))
        if self.layer.requantisation is None:
            self.results[neuron] = biased[1]
        else:
            self.biased = biased

    def _multiplier(self) -> None:
        """Requantise what the adder finished."""
        if self.biased is None:
            return
        assert self.layer.requantisation is not None
        neuron, total = self.biased
        self.biased = None
        self.results[neuron] = _scaled(self.layer.requantisation, neuron, total)


def simulate(array: MacArray, network: QuantisedMlp, fixed_state: I32) -> Simulation:
    """Run one inference cycle by cycle.

    Parameters
    ----------
    array
        The machine; its caches do not matter here.
    network
        Any.
    fixed_state
        int32 [n] in Q16.16.

    Raises
    ------
    ValueError
        When the state is not int32 [n].
    """
    state = checked_states(network, fixed_state).reshape(network.sizes[0])
    activations, input_cycles = _input_stage(array, network.inputs, state)
    counts = []
    outputs: list[int] = []
    for layer in network.layers:
        outputs, count = _layer(array, layer, activations)
        if layer.requantisation is not None:
            activations = np.array(outputs, np.int8)
        counts.append(count)
    cycles = sum(input_cycles) + 1  # the decision
    cycles += sum(c.mac_cycles + c.fill_cycles + c.requantise_cycles for c in counts)
    choice = int(outputs[1] - outputs[0] > 0)
    return Simulation(np.array(outputs, np.int32), choice, input_cycles, tuple(counts), cycles)


def _input_stage(array: MacArray, scale: Requantisation, state: I32) -> tuple[I8, tuple[int, int]]:
    """Requantise the state; return activations, and the cycles that multiply and that fill."""
    todo = [deque(range(core, state.size, array.cores)) for core in range(array.cores)]
    pipelines: list[deque[int | None]] = [deque([None] * array.pipeline_stages) for _ in todo]
    activations = np.zeros(state.size, np.int8)
    multiplying, filling, left = 0, 0, state.size
    while left:
        multiplying, filling = (
            (multiplying + 1, filling) if any(todo) else (multiplying, filling + 1)
        )
        for queue, pipeline in zip(todo, pipelines, strict=True):
            pipeline.appendleft(queue.popleft() if queue else None)
            pipeline.pop()
            done = pipeline[-1]
            if done is not None:
                activations[done] = _scaled(scale, done, int(state[done]))
                left -= 1
    return activations, (multiplying, filling)


def _layer(array: MacArray, layer: QuantisedLayer, activations: I8) -> tuple[list[int], LayerCount]:
    """Run a layer on all cores; return the neurons' results and what was counted."""
    cores = [_Core(array, layer, activations, core) for core in range(array.cores)]
    starting = filling = after = 0
    while not all(core.waits for core in cores):
        states = [core.cycle() for core in cores]
        if any(started for started, _ in states):
            starting += 1
        elif any(busy for _, busy in states):
            filling += 1
        else:
            after += 1
    results: dict[int, int] = {}
    for core in cores:
        results |= core.results
    useful = sum(core.weight_bytes for core in cores)
    count = LayerCount(starting, filling, after, useful, cores[0].weight_bytes)
    return [results[neuron] for neuron in range(layer.neurons)], count


def _words(array: MacArray, layer: QuantisedLayer, activations: I8, core: int) -> list[_Products]:
    """Return all that a core's MAC units start in a layer, in order."""
    words = []
    for neuron in range(core, layer.neurons, array.cores):
        for at in range(0, layer.fan_in, array.macs):
            last = at + array.macs >= layer.fan_in
            row = layer.weights[neuron, at : at + array.macs].tolist()
            values = activations[at : at + array.macs].tolist()
            words.append(_Products(neuron, row, values, at == 0, last))
    return words


def _scaled(scale: Requantisation, place: int, value: int) -> int:
    """Requantise one number."""
    wide = requantise_half_up(value, scale.multipliers[place], scale.shifts[place])
    return int(saturate(wide, 0, MOST_ACTIVATION))
