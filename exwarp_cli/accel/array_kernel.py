"""The MAC array's arithmetic for many states: its sums in its order, without its clock.

Core by core, neuron by neuron, as many products a cycle as a core has MAC units, added up and then
added to the accumulator. `simulation` does the same cycle by cycle, for one state.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.accel.fixed_point import I32
from exwarp_cli.accel.mac_array import MacArray
from exwarp_cli.accel.quantised_mlp import I8, QuantisedMlp, checked_states
from exwarp_cli.kernels._compile import compiled

BATCH = 64
"""States that are computed side by side."""


def accumulate_text(
    weights: I8, biases: I32, activations: I32, cores: int, macs: int, partial: I32, sums: I32
) -> None:
    """Compute a layer's accumulators.

    Parameters
    ----------
    weights
        int8 [out, in].
    biases
        int32 [out].
    activations
        int32 [in, states], 0 … 127.
    cores, macs
        Of the machine.
    partial
        int32 [states], overwritten: the sum of one cycle's products.
    sums
        int32 [out, states], written.
    """
    neurons, fan_in = weights.shape
    for core in range(cores):
        for neuron in range(core, neurons, cores):
            total = sums[neuron]
            total[:] = np.int32(0)
            for at in range(0, fan_in, macs):
                partial[:] = np.int32(0)
                for j in range(at, min(at + macs, fan_in)):
                    weight, row = np.int32(weights[neuron, j]), activations[j]
                    for k in range(partial.size):
                        partial[k] = np.int32(partial[k] + np.int32(weight * np.int32(row[k])))
                for k in range(partial.size):
                    total[k] = np.int32(total[k] + partial[k])
            for k in range(partial.size):
                total[k] = np.int32(total[k] + biases[neuron])


accumulate = compiled(accumulate_text)


def infer_as_array(
    array: MacArray, network: QuantisedMlp, fixed_states: npt.ArrayLike
) -> tuple[I32, I8]:
    """Run the network on every state as the machine would.

    Parameters
    ----------
    array
        The machine.
    network
        Any.
    fixed_states
        int32 [N, n] in Q16.16.

    Returns
    -------
    outputs
        int32 [N, 2].
    choices
        int8 [N]: 0 to warp, 1 to extrapolate.

    Raises
    ------
    ValueError
        When the states are not int32 [N, n].
    """
    states = checked_states(network, fixed_states)
    if states.ndim != 2:
        raise ValueError(f"states are int32 [N, {network.sizes[0]}], not {states.shape}")
    outputs = np.empty((states.shape[0], 2), np.int32)
    for at in range(0, states.shape[0], BATCH):
        outputs[at : at + BATCH] = _infer(array, network, states[at : at + BATCH]).T
    return outputs, np.asarray(outputs[:, 1] > outputs[:, 0]).astype(np.int8)


def _infer(array: MacArray, network: QuantisedMlp, states: I32) -> I32:
    """Return outputs int32 [2, states] of a few states."""
    values, scale = np.ascontiguousarray(states.T), network.inputs
    partial = np.empty(states.shape[0], np.int32)
    for layer in network.layers:
        activations = np.ascontiguousarray(scale(values.T).T, np.int32)
        sums = np.empty((layer.neurons, states.shape[0]), np.int32)
        accumulate(
            *(layer.weights, layer.biases, activations, array.cores, array.macs), partial, sums
        )
        values, scale = sums, layer.requantisation or scale
    return values
