"""Naive twin of the integer predictor: plain Python integers, straight from the definition.

`infer_many` says the same in matrices, for states by the hundred thousand; `infer` judges it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Parts:
    """A network as plain arrays: scales are (multiplier, shift) pairs."""

    inputs: Sequence[tuple[int, int]]
    weights: Sequence[np.ndarray]
    biases: Sequence[np.ndarray]
    scales: Sequence[Sequence[tuple[int, int]]]


def requantise(value: int, multiplier: int, shift: int) -> int:
    """Round half up, by exact division."""
    half = 2 ** (shift - 1) if shift else 0
    return (value * multiplier + half) // 2**shift


def clamp(value: int) -> int:
    return min(max(value, 0), 127)


def infer(parts: Parts, state: Sequence[int]) -> dict[str, list[list[int]]]:
    """Return ``inputs``, and of each layer ``accumulators`` and ``activations``."""
    row = [clamp(requantise(x, *scale)) for x, scale in zip(state, parts.inputs, strict=True)]
    found: dict[str, list[list[int]]] = {"inputs": [row], "accumulators": [], "activations": []}
    for k, (weights, biases) in enumerate(zip(parts.weights, parts.biases, strict=True)):
        sums = []
        for neuron, bias in zip(weights.tolist(), biases.tolist(), strict=True):
            sums.append(bias + sum(w * q for w, q in zip(neuron, row, strict=True)))
        found["accumulators"].append(sums)
        if k < len(parts.scales):
            pairs = zip(sums, parts.scales[k], strict=True)
            row = [clamp(requantise(a, *scale)) for a, scale in pairs]
            found["activations"].append(row)
    return found


def infer_many(parts: Parts, states: np.ndarray, batch: int = 512) -> np.ndarray:
    """Return outputs int64 [N, 2].

    Sums of products are whole numbers below 2^24, which float32 holds exactly, whatever the order.
    """
    assert all(127 * 127 * weights.shape[1] < 2**24 for weights in parts.weights)
    outputs = np.empty((len(states), 2), np.int64)
    matrices = [weights.T.astype(np.float32) for weights in parts.weights]
    scales = [np.array(scale, np.int64).T for scale in (parts.inputs, *parts.scales)]
    for at in range(0, len(states), batch):
        values = states[at : at + batch].astype(np.int64)
        for matrix, biases, (multipliers, shifts) in zip(
            matrices, parts.biases, scales, strict=True
        ):
            values *= multipliers
            values += 2**shifts // 2
            values >>= shifts
            np.clip(values, 0, 127, out=values)
            values = (values.astype(np.float32) @ matrix).astype(np.int64) + biases
        outputs[at : at + batch] = values
    return outputs
