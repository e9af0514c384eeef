"""Naive twin of the quantised predictor in floating point: what every integer stands for.

It knows weights, biases and the rule of the scales, and nothing of multipliers and shifts.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

MOST = 127


def largest_activations(
    weights: Sequence[np.ndarray], biases: Sequence[np.ndarray], states: np.ndarray
) -> list[float]:
    """Largest value of the inputs, which is 1 by definition, and of each hidden layer."""
    found = [1.0]
    for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
        rows = []
        for state in states:
            rows.append([max(0.0, float(w @ state + b)) for w, b in zip(weight, bias, strict=True)])
        states = np.array(rows)
        found.append(float(states.max()))
    return found


def emulate(
    weights: Sequence[np.ndarray],
    biases: Sequence[np.ndarray],
    tops: Sequence[float],
    state: np.ndarray,
) -> tuple[list[list[int]], list[float]]:
    """Run one state in floats that are rounded wherever the accelerator has a whole number.

    Returns
    -------
    activations
        Whole numbers 0 to 127, of the inputs and of each hidden layer.
    outputs
        What the two sums stand for.
    """
    row = [rounded(value * MOST) for value in state]
    activations = [row]
    for k, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        unit, last = tops[k] / MOST, k == len(weights) - 1
        sums = []
        for neuron, offset in zip(weight, bias, strict=True):
            scale = np.abs(weight if last else neuron).max() / MOST
            total = sum(
                float(np.rint(w / scale)) * q for w, q in zip(neuron, row, strict=True)
            ) + float(np.rint(offset / (scale * unit)))
            sums.append(total * scale * unit)
        if last:
            return activations, sums
        row = [rounded(value * MOST / tops[k + 1]) for value in sums]
        activations.append(row)
    raise AssertionError("there are no layers")


def rounded(value: float) -> int:
    """Round half up, within 0 to 127."""
    return int(min(max(np.floor(value + 0.5), 0), MOST))
