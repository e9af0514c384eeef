"""The accelerator's machine: its schedule by hand, and by simulation cycle by cycle."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exwarp_cli.accelerator.mac_array import (
    MacArray,
    resident_words,
    schedule,
)
from exwarp_cli.accelerator.mlp import PAPER_SIZES, QuantisedMlp, infer_reference
from tests.reference.mac_array import Machine, Simulation, simulate
from tests.unit.mlp_cases import edges, network, parts, states

ARRAYS = st.builds(
    MacArray,
    cores=st.integers(1, 7),
    macs=st.integers(1, 12),
    pipeline_stages=st.integers(1, 6),
    cache_bytes=st.integers(1000, 3000),
)
SIZES = st.lists(st.integers(1, 30), min_size=1, max_size=4).map(lambda sizes: (*sizes, 2))


class TestPaper:
    """The paper's network on the paper's machine, worked out by hand."""

    @pytest.fixture
    def plan(self):
        return schedule(MacArray(), PAPER_SIZES)

    def test_cycles(self, plan):
        assert [layer.mac_cycles for layer in plan.layers] == [160, 832, 832, 13]
        assert [layer.cycles for layer in plan.layers] == [165, 837, 837, 17]
        assert plan.inputs.cycles == 11 + 3
        assert (plan.mac_cycles, plan.cycles) == (1837, 1871)

    def test_latency_and_utilisation(self, plan):
        assert plan.latency_ns(1e9) == 1871.0 and plan.latency_ns(5e8) == 3742.0
        assert [layer.useful_macs for layer in plan.layers] == [5632, 32768, 32768, 256]
        assert plan.utilisation == pytest.approx(71424 / (40 * 1871))
        assert plan.layers[3].utilisation == pytest.approx(256 / (40 * 17))

    def test_it_does_not_fit_its_caches(self, plan):
        weights = 32 * 44 + 64 * 128 + 32 * 256 + 128
        biases, scales = 4 * (32 + 64 + 32 + 1), 5 * (11 + 32 + 64 + 32)
        buffers = 4 * 11 + 128 + 256
        assert sum(layer.weight_bytes for layer in plan.layers) == weights == 17920
        assert plan.buffer_bytes == buffers
        assert plan.core_bytes[0] == weights + biases + scales + buffers == 19559
        # Cores 2 and 3 have no output neuron.
        assert plan.core_bytes == (19559, 19559, 19559 - 132, 19559 - 132)
        assert plan.core_refill_bytes == tuple(held - 16384 for held in plan.core_bytes)
        assert [layer.refill_bytes for layer in plan.layers] == [0, 0, 3175 - 132, 132]

    def test_larger_caches_hold_it(self):
        fits = schedule(MacArray(cache_bytes=19559), PAPER_SIZES)
        assert fits.refill_bytes == 0
        assert schedule(MacArray(cache_bytes=19558), PAPER_SIZES).refill_bytes == 2

    def test_the_simulation(self):
        made = network(1)
        for state in (*states(3, 1), *edges()[::150]):
            agrees(MacArray(), made, state)


def agrees(array: MacArray, made: QuantisedMlp, state: np.ndarray) -> Simulation:
    """Outputs are the reference's, and every count is the schedule's."""
    machine = Machine(array.cores, array.macs, array.pipeline_stages)
    found, expected = simulate(machine, parts(made), state.tolist()), infer_reference(made, state)
    plan = schedule(array, made.sizes)
    assert found.outputs == expected.outputs.tolist()
    assert found.choice == expected.choices
    assert found.cycles == plan.cycles
    assert found.input_cycles == (plan.inputs.multiply_cycles, plan.inputs.fill_cycles)
    for counted, layer in zip(found.layers, plan.layers, strict=True):
        for name, count in vars(counted).items():
            assert getattr(layer, name) == count, name
        assert layer.utilisation == pytest.approx(
            counted.useful_macs / (array.cores * array.macs * layer.cycles)
        )
    return found


class TestAnyMachine:
    @settings(max_examples=150)
    @given(ARRAYS, SIZES, st.integers(0, 10**6))
    def test_simulation_and_schedule_agree(self, array, sizes, seed):
        made = network(seed, sizes)
        for state in states(2, seed, sizes[0]):
            agrees(array, made, state)

    @settings(max_examples=100)
    @given(ARRAYS, SIZES)
    def test_caches(self, array, sizes):
        plan = schedule(array, sizes)
        weights = sum(a * b for a, b in itertools.pairwise(sizes))
        parameters = weights + 4 * sum(sizes[1:]) + 5 * sum(sizes[:-1])
        largest = max([a + b for a, b in itertools.pairwise(sizes)] + [sizes[-2] + 8])
        buffers = 4 * sizes[0] + array.cores * largest
        assert sum(plan.core_bytes) == parameters + buffers
        assert plan.core_bytes[0] == max(plan.core_bytes)
        for held, refill in zip(plan.core_bytes, plan.core_refill_bytes, strict=True):
            assert refill == max(0, held - array.cache_bytes)
        first = plan.inputs.refill_bytes + sum(layer.refill_bytes for layer in plan.layers)
        assert first == plan.core_refill_bytes[0]

    @given(ARRAYS, SIZES)
    def test_no_machine_is_faster_than_its_macs(self, array, sizes):
        plan = schedule(array, sizes)
        assert 0 < plan.utilisation < 1
        assert all(0 < layer.utilisation <= 1 for layer in plan.layers)

    def test_one_core_with_one_mac_and_no_pipeline(self):
        plan = schedule(MacArray(1, 1, 1), (3, 4, 2))
        assert [layer.cycles for layer in plan.layers] == [3 * 4 + 2, 4 * 2 + 1]
        assert plan.cycles == 3 + 14 + 9 + 1


class TestPort:
    def test_what_fits_costs_nothing(self):
        array = MacArray(cache_bytes=20480, port_bytes=1)
        assert schedule(array, PAPER_SIZES).cycles == schedule(MacArray(), PAPER_SIZES).cycles
        assert schedule(array, PAPER_SIZES).refill_bytes == 0

    def test_a_step_waits_for_each_missing_word(self):
        """Of 1,837 words a core keeps 1,474: 350 of the third layer and 13 of the last are missing.

        Two beats a word bring those of four cores in 8 cycles, the last of which is the step's own;
        in the last layer two cores have a neuron.
        """
        plan = schedule(MacArray(port_bytes=8), PAPER_SIZES)
        assert [layer.refill_cycles for layer in plan.layers] == [0, 0, 350 * 7, 13 * 3]
        assert plan.cycles == 1871 + 350 * 7 + 13 * 3
        assert plan.refill_bytes == 10 * (350 * 4 + 13 * 2)
        assert resident_words(MacArray(), PAPER_SIZES) == 1474

    @given(ARRAYS, SIZES, st.integers(1, 20))
    def test_wider_ports_and_larger_caches_never_wait_longer(self, array, sizes, port):
        def cycles(port: int, more: int) -> int:
            cache = least_cache(array, sizes) + more
            return schedule(replace(array, cache_bytes=cache, port_bytes=port), sizes).cycles

        free = schedule(replace(array, cache_bytes=10**9), sizes).cycles
        assert free <= cycles(port + 1, 0) <= cycles(port, 0)
        assert free <= cycles(port, 3 * array.macs) <= cycles(port, 0)
        assert cycles(port, 10**9) == free

    def test_a_cache_without_room_for_a_word(self):
        least = least_cache(MacArray(), PAPER_SIZES)
        assert resident_words(MacArray(cache_bytes=least), PAPER_SIZES) == 1
        with pytest.raises(ValueError, match="and a word of weights"):
            resident_words(MacArray(cache_bytes=least - 1), PAPER_SIZES)


def least_cache(array: MacArray, sizes: tuple[int, ...]) -> int:
    """Bytes of buffers, biases, multipliers, shifts and one word of weights in the fullest core."""
    share = [-(-size // array.cores) for size in sizes]
    largest = max([a + b for a, b in itertools.pairwise(sizes[:-1])] + [sizes[-2] + 4 * sizes[-1]])
    return 4 * share[0] + largest + 4 * sum(share[1:]) + 5 * sum(share[:-1]) + array.macs


class TestRefusals:
    @pytest.mark.parametrize("name", ["cores", "macs", "pipeline_stages", "cache_bytes"])
    def test_nothing_of_a_part(self, name):
        with pytest.raises(ValueError, match=f"{name} is 0"):
            MacArray(**{name: 0})

    @pytest.mark.parametrize("sizes", [(), (4,), (4, 0, 2)])
    def test_sizes(self, sizes):
        with pytest.raises(ValueError, match="sizes are"):
            schedule(MacArray(), sizes)

    def test_a_cache_without_room_for_activations(self):
        schedule(MacArray(cache_bytes=428), PAPER_SIZES)
        with pytest.raises(ValueError, match="427 bytes does not hold the 428 bytes"):
            schedule(MacArray(cache_bytes=427), PAPER_SIZES)
