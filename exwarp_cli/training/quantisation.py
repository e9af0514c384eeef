"""From a trained network to the accelerator's integers (paper, section IV-C2).

Weights are int8 with a scale for each neuron, symmetric; biases are int32 in the scale of the sums.
Inputs lie in 0 … 1 by definition, so theirs is 1/127; activations are scaled by the largest value
that calibration states bring forth, and saturate there. The last layer has one scale, as its two
sums are compared.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from exwarp_cli.accel.fixed_point import MOST_ACTIVATION, MOST_SHIFT, ONE
from exwarp_cli.accel.quantised_mlp import QuantisedLayer, QuantisedMlp, Requantisation

F64 = npt.NDArray[np.float64]

MULTIPLIER_BITS = 31

MOST_BIAS = 2.0**30
"""Weights are scaled so that no bias is larger, which leaves the sums as much again."""


def quantise(weights: Sequence[F64], biases: Sequence[F64], states: F64) -> QuantisedMlp:
    """Return a network in integers.

    Parameters
    ----------
    weights, biases
        Of every layer, float64 [out, in] and [out].
    states
        float64 [N, in], 0 to 1: what activations are calibrated on.
    """
    unit = 1 / MOST_ACTIVATION
    inputs = factors(np.full(states.shape[1], MOST_ACTIVATION / ONE))
    layers: list[QuantisedLayer] = []
    activations = states
    for number, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        last = number == len(weights) - 1
        largest = np.abs(weight).max(axis=1) / MOST_ACTIVATION
        scale = np.maximum(np.maximum(largest, np.abs(bias) / (MOST_BIAS * unit)), 1e-14)
        if last:
            scale = np.full(bias.shape, scale.max())
        whole = np.rint(weight / scale[:, None]).astype(np.int8)
        offset = np.rint(bias / (scale * unit)).astype(np.int32)
        activations = activations @ weight.T + bias
        if last:
            layers.append(QuantisedLayer(whole, offset))
            break
        activations = np.maximum(activations, 0)
        following = max(float(activations.max()), 1e-12) / MOST_ACTIVATION
        layers.append(QuantisedLayer(whole, offset, factors(scale * unit / following)))
        unit = following
    return QuantisedMlp(inputs, tuple(layers))


def factors(ratios: F64) -> Requantisation:
    """Return positive ratios as int32 multipliers and shifts, to 30 bits where they fit."""
    multipliers, shifts = np.empty(ratios.shape, np.int32), np.empty(ratios.shape, np.uint8)
    for i, ratio in enumerate(ratios):
        _, exponent = math.frexp(float(ratio))
        shift = min(max(MULTIPLIER_BITS - exponent, 0), MOST_SHIFT)
        multiplier = round(float(ratio) * 2.0**shift)
        multipliers[i] = min(max(multiplier, 1), 2**MULTIPLIER_BITS - 1)
        shifts[i] = shift
    return Requantisation(multipliers, shifts)
