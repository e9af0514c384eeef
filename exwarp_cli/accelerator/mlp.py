"""The predictor in integers: its parameters, and its inference as a reference.

The arithmetic, which every faster form must repeat bit for bit:

- The state is int32 [n] in fixed point with 16 fractional bits (Q16.16), where `x` stands for
  `x / 65536`. It is meant for 0 … 1; any int32 gives a defined result.
- Every rounding is to the nearest, and of two equally near to the larger ("half up"), which in
  hardware is one addition and one arithmetic shift.
- Input stage: ``q_j = clamp(requantise_half_up(x_j, m_j, s_j), 0, 127)``. Each input has its own
  multiplier and shift, as the inputs' scales are folded into the first layer.
- A layer: ``a_i = b_i + sum_j w_ij q_j`` in int32. No sum can wrap, in whichever order it is
  formed; see `QuantisedLayer`.
- A hidden layer goes on with ``q_i = clamp(requantise_half_up(a_i, m_i, s_i), 0, 127)``: the clamp
  at 0 is the ReLU. Each neuron has its own multiplier and shift.
- The last layer's accumulators are the outputs: 0 is to warp, 1 to extrapolate. The larger one
  wins, and a tie goes to output 0. This is how the paper's "2x1 output layer" is read.

No floating point takes part, and nothing is compiled; `mlp_kernel` has the compiled form.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels.array_types import I8, I32, I64, U8

ONE = 1 << 16  # 1.0 in Q16.16

# Largest shift of a requantisation. An int32 times a multiplier below 2^31 lies within +-2^62, and
# the rounding term is 2^61 at most, so that no sum leaves int64.
MAX_SHIFT = 62

MAX_MULTIPLIER = 2**31 - 1  # largest multiplier of a requantisation; the least is 1

MAX_ACTIVATION = 127  # activations are int8 in 0 … 127: ReLU and saturation are one clamp

_INT32 = np.iinfo(np.int32)

# Numbers into the paper's network, and out of each of its layers.
PAPER_SIZES = (44, 128, 256, 128, 2)

OUTPUTS = 2  # to warp and to extrapolate

MAX_WEIGHT = 127  # weights are in -127 … 127, so that they are symmetric


def to_fixed(values: npt.ArrayLike) -> I32:
    """Convert float64 numbers of any shape to Q16.16, rounding half up.

    Values beyond +-32768 saturate, infinities included. NaN gives 0; callers that must reject it
    check before.
    """
    scaled = np.asarray(values, np.float64) * ONE
    scaled = np.clip(np.where(np.isnan(scaled), 0.0, scaled), _INT32.min, _INT32.max)
    # Adding a half first would itself round: the double just below 0.5 would become 1.
    whole = np.floor(scaled)
    rounded = whole + (scaled - whole >= 0.5)
    return np.asarray(rounded).astype(np.int32)


def requantise_half_up(
    value: npt.ArrayLike,  # int32
    multiplier: npt.ArrayLike,  # 1 … MAX_MULTIPLIER
    shift: npt.ArrayLike,  # 0 … MAX_SHIFT
) -> I64:
    """Multiply by ``multiplier / 2**shift``, rounding half up; int64, not saturated.

    The result is ``floor((value * multiplier + 2**(shift - 1)) / 2**shift)``, without the rounding
    term for shift 0: a 32x32 bit multiplication, an addition and an arithmetic right shift.
    """
    product = np.asarray(value, np.int64) * np.asarray(multiplier, np.int64)
    places = np.asarray(shift, np.int64)
    half = (np.int64(1) << places) >> np.int64(1)
    return np.asarray((product + half) >> places)


@dataclass(frozen=True, eq=False)
class Requantisation:
    """Factors ``multiplier / 2**shift`` of inputs or neurons; ValueError for wrong arrays."""

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
        return np.clip(scaled, 0, MAX_ACTIVATION).astype(np.int8)


@dataclass(frozen=True, eq=False)
class QuantisedLayer:
    """A fully connected layer; ValueError if types, shapes or ranges are wrong."""

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
        sums = activations[-1].astype(np.int64) @ layer.weights.T.astype(np.int64)
        accumulators.append(np.asarray(sums + layer.biases.astype(np.int64)).astype(np.int32))
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
