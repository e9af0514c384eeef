"""The predictor compiled with numba: one decision, or many.

Equal to `quantised_mlp.infer_reference` in every bit. Every operand and every sum is cast, as
interpreted int8 products wrap where compiled ones do not, and a compiled int32 + int32 is int64.
"""

from __future__ import annotations

import numpy as np

from exwarp_cli.accel.fixed_point import I32, I64, MOST_ACTIVATION
from exwarp_cli.accel.quantised_mlp import I8, QuantisedMlp, checked_states
from exwarp_cli.kernels._compile import compiled, inlined

COLUMNS = 4
"""Inputs whose products are added at a time: sums are fetched and stored a quarter as often.

One after the other took 2.0 times as long. Products along a neuron's row, summed at the end of the
row, took 1.5 times as long as this.
"""

MULTIPLIER, SHIFT, BIAS = 0, 1, 2
"""Rows of the kernels' constants."""


@inlined
def requantised(value: np.int32, multiplier: np.int32, shift: np.int32) -> np.int32:
    """Requantise half up, and clamp to 0 … 127."""
    places = np.int64(shift)
    half = (np.int64(1) << places) >> np.int64(1)
    scaled = (np.int64(value) * np.int64(multiplier) + half) >> places
    return np.int32(min(max(scaled, np.int64(0)), np.int64(MOST_ACTIVATION)))


@inlined
def product(weight: np.int8, activation: np.int32) -> np.int32:
    """Multiply in 32 bits."""
    return np.int32(np.int32(weight) * np.int32(activation))


@inlined
def add_columns(weights: I8, activations: I32, sums: I32) -> None:
    """Add the products of `COLUMNS` inputs to every neuron's sum; weights are [column, neuron]."""
    size = sums.size
    # Slices of their own: an index that may be negative keeps the loop from being vectorised.
    first, second = weights[:size], weights[size : 2 * size]
    third, fourth = weights[2 * size : 3 * size], weights[3 * size :]
    q0, q1, q2, q3 = activations[0], activations[1], activations[2], activations[3]
    for i in range(size):
        pair = np.int32(product(first[i], q0) + product(second[i], q1))
        other = np.int32(product(third[i], q2) + product(fourth[i], q3))
        sums[i] = np.int32(sums[i] + np.int32(pair + other))


@inlined
def run(
    weights: I8, constants: I32, sizes: I64, state: I32, room: I32
) -> tuple[np.int32, np.int32]:
    """Run one inference; see `decide_all` for the arrays, `room` is for activations and sums."""
    row, at = sizes[0], np.int64(0)
    activations = room[0]
    for j in range(row):
        activations[j] = requantised(state[j], constants[MULTIPLIER, j], constants[SHIFT, j])
    for layer in range(sizes.size - 1):
        neurons = sizes[layer + 1]
        sums = room[1, :neurons]
        for i in range(neurons):
            sums[i] = constants[BIAS, row + i]
        # What lies beyond the activations is multiplied by the zeros that fill up the weights.
        for j in range(0, sizes[layer], COLUMNS):
            block = weights[at : at + COLUMNS * neurons]
            add_columns(block, activations[j : j + COLUMNS], sums)
            at += block.size
        if layer < sizes.size - 2:
            for i in range(neurons):
                multiplier, shift = constants[MULTIPLIER, row + i], constants[SHIFT, row + i]
                activations[i] = requantised(sums[i], multiplier, shift)
        row += neurons
    return room[1, 0], room[1, 1]


@compiled
def decide_all(
    weights: I8, constants: I32, sizes: I64, states: I32, width: int, outputs: I32
) -> None:
    """Run the network on every state.

    Parameters
    ----------
    weights
        int8 [...]: of each layer [in, out], with rows of zeros up to a multiple of `COLUMNS`.
    constants
        int32 [3, rows]: multipliers, shifts and biases of the inputs, then of every layer's
        neurons; 0 where there are none.
    sizes
        int64 [layers + 1].
    states
        int32 [N, n] in Q16.16.
    width
        The largest size, as a multiple of `COLUMNS`.
    outputs
        int32 [N, 2], written.
    """
    room = np.zeros((2, width), np.int32)
    for k in range(states.shape[0]):
        warp, other = run(weights, constants, sizes, states[k], room)
        outputs[k, 0], outputs[k, 1] = warp, other


class MlpKernel:
    """A network that is ready to run; may be used from several threads at once.

    Parameters
    ----------
    network
        Any.
    """

    def __init__(self, network: QuantisedMlp) -> None:
        self.network = network
        self._packed = _pack(network)
        self._shape = (network.sizes[0],)
        self._width = max(size + -size % COLUMNS for size in network.sizes)

    def decide(self, state: I32) -> tuple[tuple[int, int], int]:
        """Run one inference.

        Parameters
        ----------
        state
            int32 [n] in Q16.16.

        Returns
        -------
        outputs
            Of warping and of extrapolating, each within int32.
        choice
            0 to warp, 1 to extrapolate.

        Raises
        ------
        ValueError
            When the state is not int32 [n].
        """
        if state.dtype != np.int32 or state.shape != self._shape:
            raise ValueError(f"a state is int32 {self._shape}, not {state.dtype} {state.shape}")
        outputs, choices = self.decide_many(state[None])
        return (int(outputs[0, 0]), int(outputs[0, 1])), int(choices[0])

    def decide_many(self, states: I32) -> tuple[I32, I8]:
        """Run many inferences: of states int32 [N, n], return outputs [N, 2] and choices [N].

        Raises
        ------
        ValueError
            When the states are not int32 [N, n].
        """
        states = checked_states(self.network, states)
        if states.ndim != 2:
            raise ValueError(f"states are int32 [N, {self._shape[0]}], not {states.shape}")
        outputs = np.empty((states.shape[0], 2), np.int32)
        decide_all(*self._packed, np.ascontiguousarray(states), self._width, outputs)
        return outputs, np.asarray(outputs[:, 1] > outputs[:, 0]).astype(np.int8)


def _pack(network: QuantisedMlp) -> tuple[I8, I32, I64]:
    """Lay out weights, constants and sizes as the kernels take them."""
    weights = [
        np.pad(layer.weights.T, ((0, -layer.fan_in % COLUMNS), (0, 0))).ravel()
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
