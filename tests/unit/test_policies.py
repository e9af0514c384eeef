"""The learned policy with networks made by hand: which path, and what is kept of the decisions."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.accelerator.mlp import QuantisedMlp, infer_reference
from exwarp_cli.accelerator.mlp_kernel import MlpKernel
from exwarp_cli.domain.decision import Decision, Features, Plan
from exwarp_cli.policy.state import PRECEDING_NODES, StateHistory, plan_slots
from tests.reference.decisions import PATHS
from tests.unit.mlp_cases import network
from tests.unit.tiny_policies import always, layer, taking

CALM = Features(0, 0.0, 0.0, 0.0, 0.0, 640, 360, 5.0)
WILD = Features(200, 0.4, 4.0, 900.0, 900.0, 640, 360, 5.0)
INSTANT = {"d1": 0, "d2": 1, "d3": 2, "d4": 2, "d5": 2}


def plan(made: QuantisedMlp, *now: Features, before: tuple[Features, ...] = ()) -> Plan:
    first, second, third = now or (CALM, CALM, CALM)
    return plan_slots(MlpKernel(made), StateHistory((first, second, third), before))


@pytest.mark.parametrize("path", PATHS)
def test_a_network_that_knows_its_path_takes_it(path):
    found = plan(taking(path), CALM, WILD, CALM, before=(WILD,))
    assert found.path == path
    assert {d.node: d.choice for d in found.decisions} == PATHS[path]


def test_the_larger_output_wins():
    assert plan(always("warp")).path == "S6"
    assert plan(always("extrapolate")).path == "S1"
    assert plan(layer({}, (-5, -4))).path == "S1"
    assert plan(layer({}, (-4, -5))).path == "S6"


def test_a_tie_goes_to_warping():
    for bias in (0, 7, -7):
        found = plan(layer({}, (bias, bias)))
        assert found.path == "S6"
        assert {d.outputs for d in found.decisions} == {(bias, bias)}


@pytest.mark.parametrize("seed", range(4))
def test_decisions_keep_what_was_seen_and_weighed(seed):
    """With a random network of the paper's size."""
    made, now = network(seed), (CALM, WILD, Features(3, 0.1, 0.5, 9.0, 4.0, 640, 360, 5.0))
    surroundings = StateHistory(now, (WILD, CALM))
    found = plan_slots(MlpKernel(made), surroundings)
    assert {d.node: d.choice for d in found.decisions} == PATHS[found.path]
    passed: list[str] = []
    for decision in found.decisions:
        assert decision.features == now[INSTANT[decision.node]]
        assert tuple(passed) == PRECEDING_NODES[decision.node]
        expected = np.floor(surroundings.inputs(decision.node) * 65536 + 0.5)
        assert decision.inputs == tuple(expected.astype(int))
        inferred = infer_reference(made, np.array([decision.inputs], np.int32))
        assert decision.outputs == tuple(inferred.outputs[0])
        assert decision.choice == ("warp", "extrapolate")[int(inferred.choices[0])]
        passed.append(decision.node)


def test_they_are_plain_numbers_that_json_takes():
    (first, *_) = plan(network(1)).decisions
    assert isinstance(first, Decision) and first.outputs is not None
    assert {type(value) for value in (*first.inputs, *first.outputs)} == {int}


@pytest.mark.parametrize(("slot", "path"), [(0, "S1"), (1, "S4"), (2, "S5")])
def test_each_node_looks_at_its_own_instant(slot, path):
    """The network extrapolates where many objects are in the newest state."""
    seeing = layer({("extrapolate", 0): 1}, (50, 0))
    now = [CALM, CALM, CALM]
    now[slot] = WILD
    expected = {"S1": "S2", "S4": "S4", "S5": "S5"}[path]
    assert plan(seeing, *now).path == expected


def test_older_key_frames_count():
    seeing = layer({("extrapolate", 33): 1}, (50, 0))  # the objects of the oldest state
    assert plan(seeing, before=(CALM, CALM, WILD)).decisions[0].choice == "extrapolate"
    assert plan(seeing, before=(WILD, WILD, CALM)).decisions[0].choice == "warp"
    assert plan(seeing, before=(CALM, WILD)).decisions[0].choice == "extrapolate"  # repeated
