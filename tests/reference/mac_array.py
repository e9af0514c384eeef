"""Naive twin of the accelerator's schedule: an inference on its registers, cycle by cycle.

It computes with what the registers hold and counts cycles. Caches do not matter here.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from tests.reference.mlp import Parts, clamp, requantise


@dataclass(frozen=True)
class Machine:
    """The machine's parts."""

    cores: int
    macs: int  # multiply-accumulate units of a core
    pipeline_stages: int


@dataclass(frozen=True)
class LayerCount:
    """What was counted in a layer; named as in the schedule."""

    mac_cycles: int
    fill_cycles: int
    requantise_cycles: int
    useful_macs: int
    weight_bytes: int  # of core 0


@dataclass(frozen=True)
class Simulation:
    """One inference on the machine."""

    outputs: list[int]
    choice: int  # 0 to warp, 1 to extrapolate
    input_cycles: tuple[int, int]  # multiply and fill cycles of the input stage
    layers: tuple[LayerCount, ...]
    cycles: int  # all of them, including the decision


@dataclass(frozen=True)
class Products:
    """The operands of one core's MAC units, on their way through the pipeline."""

    neuron: int
    weights: list[int]
    activations: list[int]
    first: bool
    last: bool


def simulate(machine: Machine, parts: Parts, state: Sequence[int]) -> Simulation:
    activations, input_cycles = simulate_input_stage(machine, parts.inputs, state)
    counts = []
    for k in range(len(parts.weights)):
        activations, count = simulate_layer(machine, parts, k, activations)
        counts.append(count)
    cycles = sum(input_cycles) + 1  # the decision
    cycles += sum(c.mac_cycles + c.fill_cycles + c.requantise_cycles for c in counts)
    choice = int(activations[1] > activations[0])
    return Simulation(activations, choice, input_cycles, tuple(counts), cycles)


def simulate_input_stage(
    machine: Machine, scales: Sequence[tuple[int, int]], state: Sequence[int]
) -> tuple[list[int], tuple[int, int]]:
    todo = [deque(range(core, len(state), machine.cores)) for core in range(machine.cores)]
    pipelines: list[deque[int | None]] = [deque([None] * machine.pipeline_stages) for _ in todo]
    activations = [0] * len(state)
    multiplying, filling, left = 0, 0, len(state)
    while left:
        if any(todo):
            multiplying += 1
        else:
            filling += 1
        for queue, pipeline in zip(todo, pipelines, strict=True):
            pipeline.appendleft(queue.popleft() if queue else None)
            pipeline.pop()
            done = pipeline[-1]
            if done is not None:
                activations[done] = clamp(requantise(int(state[done]), *scales[done]))
                left -= 1
    return activations, (multiplying, filling)


class Core:
    """A core at work on a layer."""

    def __init__(
        self, machine: Machine, parts: Parts, layer: int, activations: list[int], number: int
    ) -> None:
        self.biases = parts.biases[layer].tolist()
        self.scales = parts.scales[layer] if layer < len(parts.scales) else None
        self.todo: deque[Products] = deque()
        for neuron, row in enumerate(parts.weights[layer].tolist()):
            if neuron % machine.cores != number:
                continue
            for at in range(0, len(row), machine.macs):
                own = slice(at, at + machine.macs)
                last = at + machine.macs >= len(row)
                self.todo.append(Products(neuron, row[own], activations[own], at == 0, last))
        self.pipeline: deque[Products | None] = deque([None] * machine.pipeline_stages)
        self.accumulator = 0
        self.summed: tuple[int, int] | None = None  # neuron and sum, for the adder
        self.biased: tuple[int, int] | None = None  # neuron and sum, for the multiplier
        self.results: dict[int, int] = {}
        self.weight_bytes = 0

    @property
    def is_idle(self) -> bool:
        """True if nothing is left to do."""
        empty = all(stage is None for stage in self.pipeline)
        return not self.todo and empty and self.summed is None and self.biased is None

    def cycle(self) -> tuple[bool, bool]:
        """Advance by a cycle; return whether products started, and whether the pipeline is busy."""
        # From the end to the front, so that a unit takes the result of the cycle before.
        if self.biased is not None and self.scales is not None:  # the multiplier
            neuron, total = self.biased
            self.results[neuron] = clamp(requantise(total, *self.scales[neuron]))
        self.biased = None
        if self.summed is not None:  # the adder
            neuron, total = self.summed
            biased = (neuron, total + self.biases[neuron])
            if self.scales is None:
                self.results[neuron] = biased[1]
            else:
                self.biased = biased
        self.summed = None
        started = bool(self.todo)
        self.pipeline.appendleft(self.todo.popleft() if started else None)
        self.pipeline.pop()
        busy = any(stage is not None for stage in self.pipeline)
        if self.pipeline[0] is not None and started:
            self.weight_bytes += len(self.pipeline[0].weights)
        self.accumulate(self.pipeline[-1])
        return started, busy

    def accumulate(self, products: Products | None) -> None:
        if products is None:
            return
        pairs = zip(products.weights, products.activations, strict=True)
        total = sum(weight * activation for weight, activation in pairs)
        self.accumulator = total if products.first else self.accumulator + total
        if products.last:
            self.summed = (products.neuron, self.accumulator)


def simulate_layer(
    machine: Machine, parts: Parts, layer: int, activations: list[int]
) -> tuple[list[int], LayerCount]:
    cores = [Core(machine, parts, layer, activations, number) for number in range(machine.cores)]
    starting = filling = after = 0
    while not all(core.is_idle for core in cores):
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
    return [results[neuron] for neuron in range(len(parts.biases[layer]))], count
