"""The predictor's inference compiled, equal in every bit to `mlp.infer_reference`.

Every operand and every sum is cast, as interpreted int8 products wrap where compiled ones do not,
and a compiled int32 + int32 is int64.
"""

from __future__ import annotations

import numpy as np

from exwarp_cli.accelerator.mlp import MAX_ACTIVATION, QuantisedMlp, check_states
from exwarp_cli.kernels._compile import inline, kernel
from exwarp_cli.kernels.array_types import I8, I32, I64

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
    activations = scratch[0]
    for k in range(states.shape[0]):
        row, offset = sizes[0], np.int64(0)
        for j in range(row):
            multiplier, shift = constants[MULTIPLIER, j], constants[SHIFT, j]
            activations[j] = _requantise(states[k, j], multiplier, shift)
        for layer in range(sizes.size - 1):
            neurons = sizes[layer + 1]
            sums = scratch[1, :neurons]
            for i in range(neurons):
                sums[i] = constants[BIAS, row + i]
            # What lies beyond the activations is multiplied by the zeros that fill up the weights.
            for j in range(0, sizes[layer], BLOCK_INPUTS):
                block = weights[offset : offset + BLOCK_INPUTS * neurons]
                # Slices, as an index that may be negative prevents vectorisation.
                first, second = block[:neurons], block[neurons : 2 * neurons]
                third, fourth = block[2 * neurons : 3 * neurons], block[3 * neurons :]
                q0, q1 = activations[j], activations[j + 1]
                q2, q3 = activations[j + 2], activations[j + 3]
                for i in range(neurons):
                    early = np.int32(np.int32(first[i]) * q0) + np.int32(np.int32(second[i]) * q1)
                    late = np.int32(np.int32(third[i]) * q2) + np.int32(np.int32(fourth[i]) * q3)
                    sums[i] = np.int32(sums[i] + np.int32(np.int32(early) + np.int32(late)))
                offset += block.size
            if layer < sizes.size - 2:
                for i in range(neurons):
                    multiplier, shift = constants[MULTIPLIER, row + i], constants[SHIFT, row + i]
                    activations[i] = _requantise(sums[i], multiplier, shift)
            row += neurons
        outputs[k, 0], outputs[k, 1] = scratch[1, 0], scratch[1, 1]


class MlpKernel:
    """A network that is ready to run; safe for several threads at once."""

    def __init__(self, network: QuantisedMlp) -> None:
        self.network = network
        self._width = max(size + -size % BLOCK_INPUTS for size in network.sizes)
        weights = [
            np.pad(layer.weights.T, ((0, -layer.fan_in % BLOCK_INPUTS), (0, 0))).ravel()
            for layer in network.layers
        ]
        constants = np.zeros((3, sum(network.sizes)), np.int32)
        hidden = (layer.requantisation for layer in network.layers)
        scales = [network.inputs, *(scale for scale in hidden if scale is not None)]
        biases = np.concatenate([layer.biases for layer in network.layers])
        constants[BIAS, network.sizes[0] :] = biases
        multipliers = np.concatenate([scale.multipliers for scale in scales])
        shifts = np.concatenate([scale.shifts for scale in scales])
        constants[MULTIPLIER, : multipliers.size] = multipliers
        constants[SHIFT, : shifts.size] = shifts
        self._packed = np.concatenate(weights), constants, np.array(network.sizes, np.int64)

    def decide(self, state: I32) -> tuple[tuple[int, int], int]:
        """Run one inference, of a state [n] in Q16.16; ValueError as `decide_many`.

        Return the outputs for warping and for extrapolating, and the choice: 0 to warp, 1 to
        extrapolate.
        """
        outputs, choices = self.decide_many(state[None])
        return (int(outputs[0, 0]), int(outputs[0, 1])), int(choices[0])

    def decide_many(self, states: I32) -> tuple[I32, I8]:
        """Run inferences on states [N, n]; return outputs [N, 2] and choices [N].

        ValueError: the states are not int32 [N, n].
        """
        states = check_states(self.network, states)
        if states.ndim != 2:
            raise ValueError(f"states are int32 [N, {self.network.sizes[0]}], not {states.shape}")
        outputs = np.empty((states.shape[0], 2), np.int32)
        run_network(*self._packed, np.ascontiguousarray(states), self._width, outputs)
        return outputs, np.asarray(outputs[:, 1] > outputs[:, 0]).astype(np.int8)
