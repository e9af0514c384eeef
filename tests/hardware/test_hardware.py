"""The predictor in Verilog against the integer network and the cycle model."""

from __future__ import annotations

import pytest

from exwarp_cli.accelerator.mac_array import MacArray, schedule
from exwarp_cli.accelerator.mlp import PAPER_SIZES, infer_reference
from exwarp_cli.models.policy_files import load_policy
from exwarp_cli.pipeline.predictor import sample_states
from tests.hardware import designs
from tests.hardware.designs import CACHE, DEFAULT, REFILLED, extreme, result, run, tied, write
from tests.matrix import FULL
from tests.unit.mlp_cases import network

pytestmark = [
    pytest.mark.skipif(
        bool(designs.missing_tools()),
        reason=f"wants {', '.join(designs.missing_tools())}; install Debian's packages",
    ),
]

VECTORS = 4 if FULL else 1
"""Of the shipped network, each of which takes a second or two."""

MACHINES = {
    "paper": DEFAULT,
    "refilled": REFILLED,
    "a word a beat": MacArray(port_bytes=10),
    "a narrow port": MacArray(port_bytes=3),
}


def expected(array: MacArray, sizes: tuple[int, ...], vectors: int) -> str:
    return f"passed: {vectors} vectors, {schedule(array, sizes).cycles} cycles each"


@pytest.mark.parametrize("name", MACHINES)
def test_the_shipped_network_equals_the_integer_kernel_and_the_cycle_model(tmp_path, name):
    array, shipped = MACHINES[name], load_policy(None).network
    write(tmp_path, shipped, array, VECTORS)
    assert result(tmp_path, "make") == expected(array, PAPER_SIZES, VECTORS)


SHAPES = {
    "one unit": (MacArray(1, 1), (5, 3, 2)),
    "one core": (MacArray(1, 8), (9, 17, 4, 2)),
    "one layer": (MacArray(3, 3), (7, 2)),
    "more cores than neurons": (MacArray(10, 16), (4, 3, 2)),
    "cores as units": (MacArray(7, 7), (30, 23, 9, 2)),
    "refilled, uneven": (MacArray(3, 5, cache_bytes=260, port_bytes=2), (11, 13, 10, 2)),
    "hardly more than refills": (MacArray(2, 4, cache_bytes=100, port_bytes=3), (6, 9, 2)),
}


@pytest.mark.parametrize("name", SHAPES)
def test_other_machines_and_networks(tmp_path, name):
    array, sizes = SHAPES[name]
    write(tmp_path, extreme(network(len(name), sizes)), array, 60)
    assert result(tmp_path, "make") == expected(array, sizes, 60)


def test_a_tie_is_a_warp(tmp_path):
    made = tied(network(3, (12, 9, 2)))
    found = infer_reference(made, sample_states(12, 60, 0))
    assert (found.outputs[:, 0] == found.outputs[:, 1]).all() and not found.choices.any()
    write(tmp_path, made, MacArray(4, 10), 60)
    assert result(tmp_path, "make").startswith("passed")


def test_vectors_reach_the_ends_of_activations_and_sums(tmp_path):
    made = load_policy(None).network
    found = infer_reference(made, sample_states(made.sizes[0], 200, 0))
    for activations in (found.inputs, *found.activations[:1]):
        assert activations.min() == 0 and activations.max() == 127
    assert {0, 1} == set(found.choices.tolist())


def test_a_port_that_stalls_changes_nothing_but_the_time(tmp_path):
    array, sizes = SHAPES["refilled, uneven"]
    write(tmp_path, network(8, sizes), array, 40)
    assert result(tmp_path, "make").startswith("passed")
    assert result(tmp_path, "vvp", "predictor.vvp", "+stall").startswith("passed: 40")


@pytest.mark.parametrize("file", ["vectors_output.hex", "memory0_weights.hex", "refill.hex"])
def test_make_fails_on_any_difference(tmp_path, file):
    array, sizes = SHAPES["hardly more than refills"]
    write(tmp_path, network(2, sizes), array, 30)
    path = tmp_path / file
    words = path.read_text().split()
    path.write_text("".join(f"{'7f' * (len(word) // 2)}\n" for word in words))
    done = run(tmp_path, "make")
    assert done.returncode != 0 and "failed: " in done.stdout


def test_make_fails_on_other_cycles(tmp_path):
    array, sizes = SHAPES["cores as units"]
    write(tmp_path, network(2, sizes), array, 3)
    path = tmp_path / "exwarp_vectors.vh"
    cycles = schedule(array, sizes).cycles
    path.write_text(path.read_text().replace(f"= {cycles};", f"= {cycles - 1};"))
    done = run(tmp_path, "make")
    assert done.returncode != 0 and "failed: 3 of 3" in done.stdout


@pytest.mark.parametrize("array", [DEFAULT, REFILLED], ids=["paper", "refilled"])
def test_the_text_has_no_lint(tmp_path, array):
    write(tmp_path, load_policy(None).network, array, 1)
    done = run(tmp_path, "make", "lint")
    assert done.returncode == 0 and "%Warning" not in done.stdout, done.stdout


def test_verilator_says_the_same(tmp_path):
    array, sizes = (DEFAULT, PAPER_SIZES) if FULL else SHAPES["refilled, uneven"]
    write(tmp_path, load_policy(None).network if FULL else network(4, sizes), array, 100)
    assert result(tmp_path, "make", "verilator") == expected(array, sizes, 100)


def test_memories_become_block_ram(tmp_path):
    """A machine with the paper's memories and few units, which is quickly synthesised."""
    sizes = (44, 64, 64, 2)
    write(tmp_path, network(1, sizes), MacArray(1, 1, cache_bytes=CACHE), 1)
    script = (
        "read_verilog -I. exwarp_predictor.v exwarp_core.v; "
        # Up to the flip-flops: logic, which is mapped after them, takes half of the time.
        "synth_ecp5 -top exwarp_predictor -run begin:map_luts; tee -o cells.txt stat"
    )
    done = run(tmp_path, "yosys", "-q", "-p", script)
    assert done.returncode == 0, done.stdout
    cells = (tmp_path / "cells.txt").read_text().split()
    assert "DP16KD" in cells and "MULT18X18D" in cells
    assert "$_DLATCH_P_" not in cells and "inferring latch" not in done.stdout.lower()
