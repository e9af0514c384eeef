"""The integer predictor: every form of it gives the same bits."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exwarp_cli.accelerator.mlp import QuantisedLayer, QuantisedMlp, Requantisation, infer_reference
from exwarp_cli.accelerator.mlp_kernel import MlpKernel
from tests.matrix import FULL
from tests.reference.mlp import infer, infer_many
from tests.unit.interpreted import same_when_interpreted
from tests.unit.mlp_cases import edges, network, parts, run_all, states

SIZES = st.lists(st.integers(1, 40), min_size=1, max_size=4).map(lambda sizes: (*sizes, 2))


def same_everywhere(made: QuantisedMlp, given: np.ndarray) -> None:
    """The vectorised twin, and the kernel agree on all outputs and choices."""
    outputs = infer_many(parts(made), given)
    choices = outputs[:, 1] > outputs[:, 0]
    found, chosen = MlpKernel(made).decide_many(given)
    assert found.dtype == np.int32 and chosen.dtype == np.int8
    np.testing.assert_array_equal(found, outputs)
    np.testing.assert_array_equal(chosen, choices)


class TestSameBits:
    @pytest.mark.parametrize("seed", range(3))
    def test_every_number_is_the_naive_twin_s(self, seed):
        made = network(seed)
        given = np.concatenate([states(6, seed), edges(seed=seed)[seed::60]])
        found = infer_reference(made, given)
        for k, state in enumerate(given):
            naive = infer(parts(made), state.tolist())
            np.testing.assert_array_equal(found.inputs[k], naive["inputs"][0])
            for layer, sums in enumerate(naive["accumulators"]):
                np.testing.assert_array_equal(found.accumulators[layer][k], sums)
            for layer, values in enumerate(naive["activations"]):
                np.testing.assert_array_equal(found.activations[layer][k], values)
            warp, extrapolate = naive["accumulators"][-1]
            assert found.choices[k] == (extrapolate > warp)
        assert [a.dtype for a in found.accumulators] == [np.int32] * 4
        assert [a.dtype for a in found.activations] == [np.int8] * 3
        np.testing.assert_array_equal(infer_many(parts(made), given), found.outputs)

    def test_the_random_networks_use_their_range(self):
        found = infer_reference(network(), states(200)[::2])
        for values in found.activations:
            assert 0.2 < (values == 0).mean() < 0.8 and (values == 127).mean() < 0.4
        assert 0.2 < found.choices.mean() < 0.8

    @pytest.mark.parametrize("seed", range(2))
    def test_on_random_states_and_edges(self, seed):
        count = 500_000 if FULL else 10_000
        same_everywhere(network(seed), np.concatenate([states(count, seed), edges(seed=seed)]))

    @settings(max_examples=40)
    @given(SIZES, st.integers(0, 10**6))
    def test_any_size(self, sizes, seed):
        made, many = network(seed, sizes), states(70, seed, sizes[0])
        same_everywhere(made, many)
        kernel, found = MlpKernel(made), infer_reference(made, many[:5])
        np.testing.assert_array_equal(infer_many(parts(made), many)[:5], found.outputs)
        for state, outputs, choice in zip(many[:5], found.outputs, found.choices, strict=True):
            assert kernel.decide(state) == (tuple(outputs), choice)

    def test_one_decision_is_one_of_many(self):
        made, many = network(5), np.concatenate([states(50, 5), edges()])
        outputs, choices = MlpKernel(made).decide_many(many)
        kernel = MlpKernel(made)
        for state, both, choice in zip(many, outputs, choices, strict=True):
            assert kernel.decide(state) == (tuple(both), choice)

    def test_compiled_and_interpreted_agree(self, tmp_path):
        same_when_interpreted("tests.unit.mlp_cases", tmp_path / "found.npz", run_all())

    def test_views_of_any_layout_give_the_same(self):
        made, many = network(2), states(40, 2)
        wide = np.zeros((80, 90), np.int32)
        wide[::2, 1:89:2] = many
        expected, _ = MlpKernel(made).decide_many(many)
        for view in (wide[::2, 1:89:2], np.asfortranarray(many)):
            np.testing.assert_array_equal(MlpKernel(made).decide_many(view)[0], expected)
            assert MlpKernel(made).decide(view[3])[0] == tuple(expected[3])


def scale(count: int, multiplier: int = 1, shift: int = 0) -> Requantisation:
    return Requantisation(np.full(count, multiplier, np.int32), np.full(count, shift, np.uint8))


class TestDefinition:
    def test_a_tie_is_to_warp(self):
        for biases, choice in (([5, 5], 0), ([5, 6], 1), ([6, 5], 0), ([-7, -7], 0), ([-8, -7], 1)):
            layer = QuantisedLayer(np.ones((2, 3), np.int8), np.int32(biases))
            made, state = QuantisedMlp(scale(3), (layer,)), np.zeros(3, np.int32)
            assert infer_reference(made, state).choices == choice
            assert MlpKernel(made).decide(state) == (tuple(biases), choice)
            assert MlpKernel(made).decide_many(state[None])[1].tolist() == [choice]

    def test_the_input_stage_saturates(self):
        layer = QuantisedLayer(np.eye(2, dtype=np.int8), np.zeros(2, np.int32))
        made = QuantisedMlp(scale(2, 127, 16), (layer,))
        given = np.int32([[65536, 0], [65537, -1], [2**31 - 1, -(2**31)], [259, 258]])
        found = infer_reference(made, given)
        assert found.inputs.tolist() == [[127, 0], [127, 0], [127, 0], [1, 0]]
        np.testing.assert_array_equal(found.outputs, found.inputs)

    def test_the_largest_sums_do_not_wrap(self):
        fan_in = 300
        bias = 2**31 - 1 - 127 * 127 * fan_in
        layer = QuantisedLayer(
            np.stack([np.full(fan_in, 127), np.full(fan_in, -127)]).astype(np.int8),
            np.int32([bias, -bias]),
        )
        made = QuantisedMlp(scale(fan_in), (layer,))
        full = np.full(fan_in, 127, np.int32)
        assert infer_reference(made, full).outputs.tolist() == [2**31 - 1, 1 - 2**31]
        assert MlpKernel(made).decide(full) == ((2**31 - 1, 1 - 2**31), 0)

    def test_parameters_cannot_be_changed_afterwards(self):
        weights = np.ones((2, 3), np.int8)
        layer = QuantisedLayer(weights, np.zeros(2, np.int32))
        weights[:] = -128
        assert (layer.weights == 1).all()
        with pytest.raises(ValueError, match="read-only"):
            layer.weights[0, 0] = 3


class TestRefusals:
    def test_weights_of_minus_128(self):
        with pytest.raises(ValueError, match="-128"):
            QuantisedLayer(np.int8([[1, -128]]), np.zeros(1, np.int32))

    @pytest.mark.parametrize("sign", [1, -1])
    def test_sums_that_could_wrap(self, sign):
        weights, room = np.int8([[127, -127]]), 2**31 - 1 - 127 * 254
        QuantisedLayer(weights, np.int32([sign * room]))
        with pytest.raises(ValueError, match=f"{2**31}, which does not fit 32 bits"):
            QuantisedLayer(weights, np.int32([sign * (room + 1)]))

    @pytest.mark.parametrize(("multiplier", "shift"), [(0, 0), (-1, 5), (1, 63), (1, 255)])
    def test_factors_out_of_range(self, multiplier, shift):
        with pytest.raises(ValueError, match=r"is the (least|most)"):
            scale(3, multiplier, shift)

    @pytest.mark.parametrize(
        ("weights", "biases"),
        [
            (np.ones((2, 3), np.int16), np.zeros(2, np.int32)),
            (np.ones((2, 3), np.int8), np.zeros(2, np.int64)),
            (np.ones((2, 3), np.int8), np.zeros(3, np.int32)),
            (np.ones(6, np.int8), np.zeros(2, np.int32)),
            (np.ones((0, 3), np.int8), np.zeros(0, np.int32)),
        ],
    )
    def test_other_types_and_shapes(self, weights, biases):
        with pytest.raises(ValueError, match=r"are|biases"):
            QuantisedLayer(weights, biases)

    def test_layers_that_do_not_fit_together(self):
        first = QuantisedLayer(np.ones((4, 3), np.int8), np.zeros(4, np.int32), scale(4))
        last = QuantisedLayer(np.ones((2, 4), np.int8), np.zeros(2, np.int32))
        three = QuantisedLayer(np.ones((3, 4), np.int8), np.zeros(3, np.int32))
        QuantisedMlp(scale(3), (first, last))
        for inputs, layers in (
            (scale(4), (first, last)),
            (scale(3), (first, first)),
            (scale(3), (first, three)),
            (scale(3), (first,)),
            (scale(4), (last, last)),
            (scale(3), ()),
        ):
            with pytest.raises(ValueError, match=r"layer"):
                QuantisedMlp(inputs, layers)
        with pytest.raises(ValueError, match="5 multipliers for 4 neurons"):
            QuantisedLayer(first.weights, first.biases, scale(5))
        with pytest.raises(ValueError, match="3 multipliers for 2 shifts"):
            Requantisation(np.ones(3, np.int32), np.ones(2, np.uint8))

    def test_other_states(self):
        made = network(0, (5, 2))
        for state in (np.zeros(5, np.int64), np.zeros(5), np.zeros(4, np.int32)):
            for refuse in (
                lambda given: infer_reference(made, given),
                lambda given: MlpKernel(made).decide(given),
                lambda given: MlpKernel(made).decide_many(given[None]),
            ):
                with pytest.raises(ValueError, match="int32"):
                    refuse(state)
        three = np.zeros((1, 1, 5), np.int32)
        with pytest.raises(ValueError, match="int32"):
            MlpKernel(made).decide_many(three)
        with pytest.raises(ValueError, match="int32"):
            MlpKernel(made).decide(three)


def test_the_specification_does_without_numba():
    code = (
        "import sys; from exwarp_cli.accelerator import mac_array, mlp; "
        "print([name for name in sys.modules if name.split('.')[0] == 'numba'])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout == "[]\n", result.stderr
