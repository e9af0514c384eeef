"""From weights in floating point to the accelerator's integers."""

from __future__ import annotations

import itertools
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exwarp_cli.accelerator.mlp import (
    ONE,
    PAPER_SIZES,
    QuantisedMlp,
    infer_reference,
    to_fixed,
)
from exwarp_cli.research.training.q_learning import factors, quantise
from tests.reference.quantisation import emulate, largest_activations

Network = tuple[list[np.ndarray], list[np.ndarray]]


def random_network(seed: int = 0, sizes: tuple[int, ...] = PAPER_SIZES) -> Network:
    """Weights and biases about as a training leaves them."""
    rng = np.random.default_rng(seed)
    weights, biases = [], []
    for fan_in, neurons in itertools.pairwise(sizes):
        weights.append(rng.normal(0, 1.4 / fan_in**0.5, (neurons, fan_in)))
        biases.append(rng.normal(0, 0.1, neurons))
    return weights, biases


def integers_of(network: Network, states: np.ndarray) -> QuantisedMlp:
    return quantise(tuple(zip(*network, strict=True)), states)


def random_states(count: int, seed: int = 0, size: int = 44) -> np.ndarray:
    return np.random.default_rng(seed).random((count, size))


def floats(network: Network, states: np.ndarray) -> np.ndarray:
    found = states
    for k, (weight, bias) in enumerate(zip(*network, strict=True)):
        found = found @ weight.T + bias
        if k < len(network[0]) - 1:
            found = np.maximum(found, 0)
    return found


def output_unit(network: Network, states: np.ndarray) -> float:
    """What one stands for in the two sums."""
    top = largest_activations(*network, states)[-1]
    return float(np.abs(network[0][-1]).max() / 127 * top / 127)


class TestNetwork:
    def test_weights_have_a_scale_for_each_neuron(self):
        network = random_network()
        made = integers_of(network, random_states(50))
        assert made.sizes == PAPER_SIZES
        for k, layer in enumerate(made.layers[:-1]):
            largest = np.abs(network[0][k]).max(axis=1)
            assert (np.abs(layer.weights).max(axis=1) == 127).all()
            back = layer.weights * (largest / 127)[:, None]
            assert (np.abs(back - network[0][k]) <= largest[:, None] / 127 / 2 * 1.0001).all()
        assert np.std(np.abs(network[0][0]).max(axis=1)) > 0.01

    def test_the_last_layer_has_one_scale(self):
        """Sums are compared there: a small neuron must not be blown up."""
        weights = [np.array([[1.0, 0.0], [0.0, 0.1]])]
        made = integers_of((weights, [np.array([0.0, 0.05])]), random_states(5, size=2))
        assert made.layers[0].weights.tolist() == [[127, 0], [0, 13]]
        assert made.layers[0].biases.tolist() == [0, round(0.05 * 127 * 127)]
        found = infer_reference(made, to_fixed([[0.2, 1.0], [0.1, 1.0]]))
        assert found.choices.tolist() == [0, 1]

    def test_biases_are_in_the_scale_of_the_sums(self):
        network, states = random_network(1), random_states(40, 1)
        made, tops = integers_of(network, states), largest_activations(*network, states)
        for k, layer in enumerate(made.layers):
            largest = np.abs(network[0][k]).max(axis=1)
            if layer is made.layers[-1]:
                largest[:] = largest.max()
            unit = largest / 127 * tops[k] / 127
            assert (np.abs(layer.biases * unit - network[1][k]) <= unit * 0.5001).all()

    def test_inputs_are_a_hundred_and_twentyseventh(self):
        made = integers_of(random_network(0, (3, 4, 2)), random_states(5, size=3))
        for value in (0, 1, 257, 258, 259, 32768, ONE - 259, ONE - 258, ONE):
            exact = Fraction(value * 127, ONE)
            wanted = (exact + Fraction(1, 2)).__floor__()
            assert made.inputs(np.full(3, value, np.int32)).tolist() == [wanted] * 3

    @pytest.mark.parametrize("seed", range(3))
    def test_every_number_is_the_float_twin_s(self, seed):
        """Equal but where a sum lies so near a half that floats cannot tell, and those are few."""
        network, states = random_network(seed, (44, 20, 30, 12, 2)), random_states(60, seed)
        made, tops = integers_of(network, states), largest_activations(*network, states)
        found = infer_reference(made, to_fixed(states))
        unit = output_unit(network, states)
        for k in range(0, 60, 3):
            activations, outputs = emulate(*network, tops, from_q16(states[k]))
            for layer, row in zip((found.inputs, *found.activations), activations, strict=True):
                np.testing.assert_array_equal(layer[k], row)
            np.testing.assert_allclose(found.outputs[k] * unit, outputs, rtol=1e-9, atol=1e-12)

    @pytest.mark.parametrize("seed", [7, 8])
    def test_decisions_agree_with_the_float_network_s(self, seed):
        network, states = random_network(seed), random_states(3000, seed)
        network[1][-1][:] -= floats(network, states).mean(axis=0)  # so that either wins often
        made, wanted = integers_of(network, states[:500]), floats(network, states)
        found = infer_reference(made, to_fixed(states))
        chosen = wanted[:, 1] > wanted[:, 0]
        assert 0.3 < chosen.mean() < 0.7
        gap = found.outputs * output_unit(network, states[:500]) - wanted
        assert np.sqrt(np.square(gap).mean()) < 0.09 * wanted.std()
        assert np.abs(gap).max() < 0.5 * wanted.std()
        margin = np.abs(wanted[:, 1] - wanted[:, 0]) / wanted.std()
        same = found.choices == chosen
        assert same[margin > 0.4].all() and same.mean() > 0.97

    def test_what_calibration_never_saw_saturates(self):
        """Three times the input that it was calibrated on gives 127, not an overflow."""
        network: Network = ([np.eye(2), np.eye(2)], [np.zeros(2), np.zeros(2)])
        states = np.array([[0.25, 0.0], [0.0, 0.125]])
        made = integers_of(network, states)
        given = to_fixed([[0.25, 0.125], [0.75, 0.25], [1.0, 0.0], [0.125, 0.0], [30000, -30000]])
        found = infer_reference(made, given)
        rows = found.activations[0].tolist()
        assert rows == [[127, 64], [127, 127], [127, 0], [64, 0], [127, 0]]

    def test_a_network_that_never_wakes_gives_its_biases(self):
        """All activations 0, and weights 0: nothing is divided by zero."""
        network = random_network(0, (5, 4, 3, 2))
        network[1][1][:] = -100.0
        network[0][0][2] = 0.0
        made = integers_of(network, random_states(20, size=5))
        found = infer_reference(made, to_fixed(random_states(20, 1, 5)))
        assert (found.activations[1] == 0).all()
        assert (found.outputs == made.layers[-1].biases).all()
        assert (found.choices == int(network[1][-1][1] > network[1][-1][0])).all()

    def test_a_neuron_that_is_all_bias_keeps_it(self):
        """A bias a million times the weights must not overflow 32 bits, nor wrap to another."""
        network: Network = (
            [np.array([[1e-7, 0.0], [0.5, 0.5]]), np.eye(2)],
            [np.array([0.5, 0.0]), np.zeros(2)],
        )
        states = np.array([[1.0, 1.0], [0.2, 0.4]])
        made = integers_of(network, states)
        found = infer_reference(made, to_fixed(states))
        np.testing.assert_allclose(found.activations[0], [[64, 127], [64, 38]], atol=1)
        assert found.choices.tolist() == [1, 0]
        large = integers_of(([np.eye(2) * 1e-9], [np.array([3.0, 3.1])]), states)
        assert infer_reference(large, to_fixed(states)).choices.tolist() == [1, 1]


def from_q16(state: np.ndarray) -> np.ndarray:
    """What a state's numbers are once they are Q16.16."""
    return np.floor(state * ONE + 0.5) / ONE


class TestFactors:
    @given(st.lists(st.floats(2.0**-32, 2.0**31 - 1), min_size=1, max_size=5))
    def test_ratios_keep_thirty_bits(self, ratios):
        made = factors(np.array(ratios))
        for ratio, multiplier, shift in zip(ratios, made.multipliers, made.shifts, strict=True):
            assert 2**30 <= multiplier <= 2**31 - 1
            exact = Fraction(int(multiplier), 2 ** int(shift))
            assert abs(exact / Fraction(ratio) - 1) <= Fraction(1, 2**30)

    def test_powers_of_two_are_exact(self):
        ratios = 2.0 ** np.arange(-32, 31)
        made = factors(ratios)
        np.testing.assert_array_equal(made.multipliers, 2**30)
        assert made.shifts.tolist() == [30 - k for k in range(-32, 31)]

    def test_tiny_ratios_lose_bits_and_stay_above_nothing(self):
        made = factors(np.array([2.0**-40, 3 * 2.0**-62, 2.0**-80, 1e-300]))
        assert made.shifts.tolist() == [62] * 4
        assert made.multipliers.tolist() == [2**22, 3, 1, 1]

    def test_huge_ratios_saturate(self):
        made = factors(np.array([2.0**31 - 1, 2.0**31, 2.0**40, 1e300]))
        assert made.shifts.tolist() == [0] * 4
        assert made.multipliers.tolist() == [2**31 - 1] * 4

    def test_just_below_a_power_of_two_rounding_up_does_not_overflow(self):
        made = factors(np.array([np.nextafter(1.0, 0), np.nextafter(2.0**-10, 0)]))
        assert made.multipliers.tolist() == [2**31 - 1] * 2
        assert made.shifts.tolist() == [31, 41]
