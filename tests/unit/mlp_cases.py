"""Networks and states to run the predictor with; as a script, writes what they give.

``python -m tests.unit.mlp_cases OUT.npz`` with NUMBA_DISABLE_JIT=1 runs the plain Python text.
"""

from __future__ import annotations

import itertools
import sys

import numpy as np

from exwarp_cli.accelerator.mlp import PAPER_SIZES, QuantisedLayer, QuantisedMlp, Requantisation
from exwarp_cli.accelerator.mlp_kernel import MlpKernel
from tests.reference.mlp import Parts

FEW = 3
"""States that the interpreted text is run on with the paper's network; each takes half a second."""

MANY = 1000
"""The same with small networks, beside all edge values."""


def network(seed: int = 0, sizes: tuple[int, ...] = PAPER_SIZES) -> QuantisedMlp:
    """A random network whose activations are neither all 0 nor all 127."""
    rng = np.random.default_rng(seed)
    layers = []
    for k, (fan_in, neurons) in enumerate(itertools.pairwise(sizes)):
        weights = rng.integers(-127, 128, (neurons, fan_in)).astype(np.int8)
        biases = rng.integers(-9999, 10000, neurons).astype(np.int32)
        spread = 73 * 50 * fan_in**0.5
        last = k == len(sizes) - 2
        layers.append(
            QuantisedLayer(weights, biases, None if last else _scales(rng, neurons, spread))
        )
    return QuantisedMlp(_scales(rng, sizes[0], 2**16 / 1.5), tuple(layers))


def _scales(rng: np.random.Generator, count: int, spread: float) -> Requantisation:
    """Factors that take `spread` to some 70, with shifts of all sizes that can do so."""
    factors = 70 / spread * rng.uniform(0.5, 1.5, count)
    shifts = np.floor(rng.uniform(np.log2(1 / factors) + 1, np.log2(2.0**30 / factors)))
    multipliers = np.maximum(1, np.round(factors * 2.0**shifts))
    return Requantisation(multipliers.astype(np.int32), shifts.astype(np.uint8))


def parts(network: QuantisedMlp) -> Parts:
    """The network as the naive twin takes it."""
    scales = [network.inputs, *(layer.requantisation for layer in network.layers)]
    pairs = [
        list(zip(scale.multipliers.tolist(), scale.shifts.tolist(), strict=True))
        for scale in scales
        if scale is not None
    ]
    return Parts(
        pairs[0],
        [layer.weights for layer in network.layers],
        [layer.biases for layer in network.layers],
        pairs[1:],
    )


def states(count: int, seed: int = 0, size: int = 44) -> np.ndarray:
    """Half within 0 … 1, a quarter of any size, a quarter of any int32."""
    rng = np.random.default_rng(seed)
    found = rng.integers(0, 2**16 + 1, (count, size)).astype(np.int32)
    wide = rng.integers(-(2**31), 2**31, (count // 2, size))
    wide[::2] >>= rng.integers(0, 31, wide[::2].shape)
    found[1::2] = wide
    return found


def edges(size: int = 44, seed: int = 0) -> np.ndarray:
    """0, ±1, ±2^i, ±2^i ± 2, and the least and the most: each alone, throughout, and mixed."""
    powers = [sign * 2**i + off for i in range(32) for sign in (-1, 1) for off in (-2, -1, 0, 1, 2)]
    inside = sorted({value for value in powers if -(2**31) <= value < 2**31} | {0, 2**31 - 1})
    values = np.array(inside, np.int32)
    uniform = np.repeat(values[:, None], size, axis=1)
    alone = np.full((len(values), size), 2**15, np.int32)
    alone[np.arange(len(values)), np.arange(len(values)) % size] = values
    mixed = np.random.default_rng(seed).choice(values, (len(values), size))
    return np.concatenate([uniform, alone, mixed])


def run_all() -> dict[str, np.ndarray]:
    """Outputs of the compiled, or interpreted, texts by name."""
    found = {}
    for name, sizes in {"paper": PAPER_SIZES, "odd": (5, 7, 3, 2), "plain": (9, 2)}.items():
        made = network(3, sizes)
        given = np.concatenate([states(MANY, size=sizes[0]), edges(sizes[0])])
        if sizes == PAPER_SIZES:
            given = given[:: len(given) // FEW]
        kernel = MlpKernel(made)
        one = [kernel.decide(state)[0] for state in given]
        assert {type(output) for both in one for output in both} == {int}  # JSON takes no others
        found[f"{name} one"] = np.array(one)
        found[f"{name} many"] = kernel.decide_many(given)[0]
    return found


if __name__ == "__main__":
    np.savez(sys.argv[1], **run_all())
