"""The predictor in integers: its parameters, its inference as a reference, and compiled.

The arithmetic, which every faster form must repeat bit for bit:

- The state is int32 [n] in Q16.16, meant for 0 … 1; any int32 gives a defined result.
- Input stage: ``q_j = clamp(requantise_half_up(x_j, m_j, s_j), 0, 127)``. Each input has its own
  multiplier and shift, as the inputs' scales are folded into the first layer.
- A layer: ``a_i = b_i + sum_j w_ij q_j`` in int32. No sum can wrap, in whichever order it is
  formed; see `QuantisedLayer`.
- A hidden layer goes on with ``q_i = clamp(requantise_half_up(a_i, m_i, s_i), 0, 127)``: the clamp
  at 0 is the ReLU. Each neuron has its own multiplier and shift.
- The last layer's accumulators are the outputs: 0 is to warp, 1 to extrapolate. The larger one
  wins, and a tie goes to output 0. This is how the paper's "2x1 output layer" is read.

No floating point takes part. In the compiled form every operand and every sum is cast, as
interpreted int8 products wrap where compiled ones do not, and a compiled int32 + int32 is int64.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from exwarp_cli.accelerator.fixed_point import (
    MAX_ACTIVATION,
    MAX_SHIFT,
    requantise_half_up,
    saturate,
)
from exwarp_cli.kernels._compile import inline, kernel
from exwarp_cli.kernels.array_types import I8, I32, I64, U8

# Numbers into the paper's network, and out of each of its layers.
PAPER_SIZES = (44, 128, 256, 128, 2)

OUTPUTS = 2  # to warp and to extrapolate

MAX_WEIGHT = 127  # weights are in -127 … 127, so that they are symmetric


@dataclass(frozen=True, eq=False)
class Requantisation:
    """Factors ``multiplier / 2**shift``, one for every input or neuron.

    ValueError: types, shapes or ranges are wrong.
    """

    multipliers: I32  # int32 [n], 1 … 2^31 - 1
    shifts: U8  # uint8 [n], 0 … 62

    def __post_init__(self) -> None:
        _freeze_array(self, "multipliers", np.int32, 1)
        _freeze_array(self, "shifts", np.uint8, 1)
        if self.multipliers.shape != self.shifts.shape:
            raise ValueError(
                f"there are {self.multipliers.size} multipliers for {self.shifts.size} shifts"
            )
        if (self.multipliers < 1).any():
            raise ValueError(f"a multiplier is {self.multipliers.min()}, and 1 is the least")
        if (self.shifts > MAX_SHIFT).any():
            raise ValueError(f"a shift is {self.shifts.max()}, and {MAX_SHIFT} is the most")

    def __call__(self, values: I32) -> I8:
        """Return activations: the values [..., n] times the factors, within 0 … 127."""
        scaled = requantise_half_up(values, self.multipliers, self.shifts)
        return saturate(scaled, 0, MAX_ACTIVATION).astype(np.int8)


@dataclass(frozen=True, eq=False)
class QuantisedLayer:
    """A fully connected layer.

    ValueError: types, shapes or ranges are wrong.
    """

    weights: I8  # int8 [out, in], -127 … 127
    # int32 [out]; ``|b_i| + 127 * sum_j |w_ij|`` is below 2^31 for every neuron, so that no partial
    # sum wraps.
    biases: I32
    requantisation: Requantisation | None = None  # None in the last layer

    def __post_init__(self) -> None:
        _freeze_array(self, "weights", np.int8, 2)
        _freeze_array(self, "biases", np.int32, 1)
        if self.biases.size != self.neurons:
            raise ValueError(f"there are {self.biases.size} biases for {self.neurons} neurons")
        if self.requantisation is not None and self.requantisation.shifts.size != self.neurons:
            raise ValueError(
                f"there are {self.requantisation.shifts.size} multipliers for "
                f"{self.neurons} neurons"
            )
        if (self.weights < -MAX_WEIGHT).any():
            raise ValueError("a weight is -128, and -127 is the least")
        sums = np.abs(self.weights.astype(np.int64)).sum(axis=1) * MAX_ACTIVATION
        most = int((np.abs(self.biases.astype(np.int64)) + sums).max())
        if most >= 2**31:
            raise ValueError(f"a sum can reach {most}, which does not fit 32 bits")

    @property
    def neurons(self) -> int:
        """Number of outputs."""
        return int(self.weights.shape[0])

    @property
    def fan_in(self) -> int:
        """Number of inputs."""
        return int(self.weights.shape[1])

    def accumulate(self, activations: I8) -> I32:
        """Return biases plus weighted sums, int32 [..., out], of activations [..., in]."""
        sums = activations.astype(np.int64) @ self.weights.T.astype(np.int64)
        return np.asarray(sums + self.biases.astype(np.int64)).astype(np.int32)


@dataclass(frozen=True, eq=False)
class QuantisedMlp:
    """The whole network; ValueError if its layers do not fit together."""

    inputs: Requantisation  # requantisation of the state's numbers
    # All but the last have a requantisation; the last has `OUTPUTS` neurons.
    layers: tuple[QuantisedLayer, ...]

    def __post_init__(self) -> None:
        if not self.layers:
            raise ValueError("there are no layers")
        size_in = self.inputs.shifts.size
        for number, layer in enumerate(self.layers):
            if layer.fan_in != size_in:
                raise ValueError(f"layer {number} takes {layer.fan_in} numbers, and gets {size_in}")
            last = layer is self.layers[-1]
            if last != (layer.requantisation is None):
                raise ValueError("all layers but the last must have multipliers and shifts")
            size_in = layer.neurons
        if size_in != OUTPUTS:
            raise ValueError(f"the last layer gives {size_in} numbers, not {OUTPUTS}")

    @property
    def sizes(self) -> tuple[int, ...]:
        """Numbers into the network, and out of each layer; `PAPER_SIZES` for the paper's."""
        return (self.layers[0].fan_in, *(layer.neurons for layer in self.layers))


@dataclass(frozen=True, eq=False)
class Inference:
    """All numbers of one or more inferences; leading axes are those of the states."""

    inputs: I8  # int8 [..., n]: the state after the input stage
    accumulators: tuple[I32, ...]  # int32 [..., out] of each layer, biases included
    activations: tuple[I8, ...]  # int8 [..., out] of each hidden layer
    choices: I8  # int8 [...]: 0 to warp, 1 to extrapolate

    @property
    def outputs(self) -> I32:
        """int32 [..., 2]: the last layer's accumulators."""
        return self.accumulators[-1]


def infer_reference(network: QuantisedMlp, fixed_states: npt.ArrayLike) -> Inference:
    """Run the network as this module defines it, and keep every intermediate number.

    ValueError: the states are not int32 [..., n].
    """
    states = check_states(network, fixed_states)
    activations = [network.inputs(states)]
    accumulators = []
    for layer in network.layers:
        accumulators.append(layer.accumulate(activations[-1]))
        if layer.requantisation is not None:
            activations.append(layer.requantisation(accumulators[-1]))
    outputs = accumulators[-1]
    choices = np.asarray(outputs[..., 1] > outputs[..., 0]).astype(np.int8)
    return Inference(activations[0], tuple(accumulators), tuple(activations[1:]), choices)


def check_states(network: QuantisedMlp, fixed_states: npt.ArrayLike) -> I32:
    """Return the states as an array, int32 [..., n]; ValueError for anything else."""
    states = np.asarray(fixed_states)
    if states.dtype != np.int32 or states.shape[-1:] != network.sizes[:1]:
        raise ValueError(
            f"states are int32 [..., {network.sizes[0]}], not {states.dtype} {states.shape}"
        )
    return states


def _freeze_array(holder: Any, name: str, dtype: type, axes: int) -> None:
    """Replace an array by a read-only copy; ValueError if its type or shape is wrong."""
    array = np.asarray(getattr(holder, name))
    if array.dtype != dtype or array.ndim != axes or array.size == 0:
        raise ValueError(
            f"{name} are {np.dtype(dtype)} with {axes} axes and not empty, "
            f"not {array.dtype} {array.shape}"
        )
    copy = np.array(array, order="C")
    copy.setflags(write=False)
    object.__setattr__(holder, name, copy)


# Inputs whose products are added together: sums are loaded and stored a quarter as often. One by
# one took 2.0 times as long; products along a neuron's row, summed at its end, 1.5 times.
BLOCK_INPUTS = 4

MULTIPLIER, SHIFT, BIAS = 0, 1, 2  # rows of the kernels' constants


@inline
def _requantise(value: np.int32, multiplier: np.int32, shift: np.int32) -> np.int32:
    places = np.int64(shift)
    half = (np.int64(1) << places) >> np.int64(1)
    scaled = (np.int64(value) * np.int64(multiplier) + half) >> places
    return np.int32(min(max(scaled, np.int64(0)), np.int64(MAX_ACTIVATION)))


@inline
def _product(weight: np.int8, activation: np.int32) -> np.int32:
    return np.int32(np.int32(weight) * np.int32(activation))


@inline
def _add_columns(weights: I8, activations: I32, sums: I32) -> None:
    """Add the products of BLOCK_INPUTS inputs to the sums; weights are [column, neuron]."""
    size = sums.size
    # Slices, as an index that may be negative prevents vectorisation.
    first, second = weights[:size], weights[size : 2 * size]
    third, fourth = weights[2 * size : 3 * size], weights[3 * size :]
    q0, q1, q2, q3 = activations[0], activations[1], activations[2], activations[3]
    for i in range(size):
        early = np.int32(_product(first[i], q0) + _product(second[i], q1))
        late = np.int32(_product(third[i], q2) + _product(fourth[i], q3))
        sums[i] = np.int32(sums[i] + np.int32(early + late))


@inline
def _infer_state(
    weights: I8, constants: I32, sizes: I64, state: I32, scratch: I32
) -> tuple[np.int32, np.int32]:
    row, offset = sizes[0], np.int64(0)
    activations = scratch[0]
    for j in range(row):
        activations[j] = _requantise(state[j], constants[MULTIPLIER, j], constants[SHIFT, j])
    for layer in range(sizes.size - 1):
        neurons = sizes[layer + 1]
        sums = scratch[1, :neurons]
        for i in range(neurons):
            sums[i] = constants[BIAS, row + i]
        # What lies beyond the activations is multiplied by the zeros that fill up the weights.
        for j in range(0, sizes[layer], BLOCK_INPUTS):
            block = weights[offset : offset + BLOCK_INPUTS * neurons]
            _add_columns(block, activations[j : j + BLOCK_INPUTS], sums)
            offset += block.size
        if layer < sizes.size - 2:
            for i in range(neurons):
                multiplier, shift = constants[MULTIPLIER, row + i], constants[SHIFT, row + i]
                activations[i] = _requantise(sums[i], multiplier, shift)
        row += neurons
    return scratch[1, 0], scratch[1, 1]


@kernel
def run_network(
    weights: I8,  # [...]: of each layer [in, out], zero-padded to a multiple of BLOCK_INPUTS
    # constants: [3, rows]: multipliers, shifts, biases of the inputs, then of every layer; 0 for
    # none
    constants: I32,
    sizes: I64,  # [layers + 1]
    states: I32,  # [N, n] in Q16.16
    width: int,  # the largest size, as a multiple of BLOCK_INPUTS
    outputs: I32,  # [N, 2], written
) -> None:
    """Run the network on every state."""
    scratch = np.zeros((2, width), np.int32)
    for k in range(states.shape[0]):
        warp, extrapolate = _infer_state(weights, constants, sizes, states[k], scratch)
        outputs[k, 0], outputs[k, 1] = warp, extrapolate


class MlpKernel:
    """A network that is ready to run; safe for several threads at once."""

    def __init__(self, network: QuantisedMlp) -> None:
        self.network = network
        self._packed = _pack_parameters(network)
        self._shape = (network.sizes[0],)
        self._width = max(size + -size % BLOCK_INPUTS for size in network.sizes)

    def decide(self, state: I32) -> tuple[tuple[int, int], int]:
        """Run one inference, of a state [n] in Q16.16; ValueError if it is not int32 [n].

        Return the outputs for warping and for extrapolating, and the choice: 0 to warp, 1 to
        extrapolate.
        """
        if state.dtype != np.int32 or state.shape != self._shape:
            raise ValueError(f"a state is int32 {self._shape}, not {state.dtype} {state.shape}")
        outputs, choices = self.decide_many(state[None])
        return (int(outputs[0, 0]), int(outputs[0, 1])), int(choices[0])

    def decide_many(self, states: I32) -> tuple[I32, I8]:
        """Run inferences on states [N, n]; return outputs [N, 2] and choices [N].

        ValueError: the states are not int32 [N, n].
        """
        states = check_states(self.network, states)
        if states.ndim != 2:
            raise ValueError(f"states are int32 [N, {self._shape[0]}], not {states.shape}")
        outputs = np.empty((states.shape[0], 2), np.int32)
        run_network(*self._packed, np.ascontiguousarray(states), self._width, outputs)
        return outputs, np.asarray(outputs[:, 1] > outputs[:, 0]).astype(np.int8)


def _pack_parameters(network: QuantisedMlp) -> tuple[I8, I32, I64]:
    weights = [
        np.pad(layer.weights.T, ((0, -layer.fan_in % BLOCK_INPUTS), (0, 0))).ravel()
        for layer in network.layers
    ]
    constants = np.zeros((3, sum(network.sizes)), np.int32)
    scales = [network.inputs, *(layer.requantisation for layer in network.layers)]
    for name, values in (
        (MULTIPLIER, [scale.multipliers for scale in scales if scale is not None]),
        (SHIFT, [scale.shifts for scale in scales if scale is not None]),
        (BIAS, [np.zeros(network.sizes[0], np.int32), *(layer.biases for layer in network.layers)]),
    ):
        row = np.concatenate(values)
        constants[name, : row.size] = row
    return np.concatenate(weights), constants, np.array(network.sizes, np.int64)
