"""The decision tree, plans, and decisions as text in a frame's header."""

from __future__ import annotations

import json
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exwarp_cli.domain.decision import (
    CHOICES,
    EXTRAPOLATE,
    HOLD,
    NEXT_NODE,
    NODE_SLOTS,
    NODES,
    PATHS,
    REPEATING_CHOICES,
    WARP,
    Decision,
    Features,
    Plan,
    walk_tree,
)
from exwarp_cli.pipeline.slot_renderer import decision_text, parse_decision
from exwarp_cli.policy.state import PRECEDING_NODES
from tests.reference import decisions as paper

SLOT_OF = {"d1": 1, "d2": 2, "d3": 3, "d4": 3, "d5": 3}
SEEN = Features(2, 0.1 + 0.2, 1 / 3, 1e-300, 12345.678, 640, 360, math.pi)


class TestTree:
    def test_names_and_slots(self):
        assert tuple(SLOT_OF) == NODES and NODE_SLOTS == SLOT_OF
        assert CHOICES == (WARP, EXTRAPOLATE) == ("warp", "extrapolate")
        assert tuple(PATHS) == tuple(paper.PATHS)

    @pytest.mark.parametrize("name", paper.PATHS)
    def test_choices_and_makers_are_the_paper_s(self, name):
        path = PATHS[name]
        assert list(path.choices.items()) == list(paper.PATHS[name].items())
        for slot, step in enumerate(paper.SHOWN[name], start=1):
            repeats = step in paper.DROPS
            assert path.made_by[slot - 1] == (HOLD if repeats else step[1])
        assert path.generated == paper.NEW[name]

    @pytest.mark.parametrize("name", paper.PATHS)
    def test_walking_by_its_choices_leads_along_it(self, name):
        asked: list[str] = []

        def choose(node: str) -> str:
            asked.append(node)
            return paper.PATHS[name][node]

        assert walk_tree(choose) == name
        assert asked == list(paper.PATHS[name])  # each once, and none beside the path

    def test_every_way_to_choose_is_one_of_six_paths(self):
        taken = set()
        for bits in range(32):
            chosen = {node: CHOICES[bits >> i & 1] for i, node in enumerate(NODES)}
            taken.add(walk_tree(chosen.__getitem__))
        assert taken == set(PATHS)

    def test_slots_come_in_their_order(self):
        for name in PATHS:
            slots = [NODE_SLOTS[node] for node in PATHS[name].choices]
            assert slots in ([1, 2, 3], [1, 3])

    def test_what_repeats_a_frame(self):
        assert REPEATING_CHOICES == paper.DROPS
        assert set(NEXT_NODE) == {(node, choice) for node in ("d1", "d2") for choice in CHOICES}

    def test_nodes_before_a_node(self):
        assert PRECEDING_NODES == {
            "d1": (), "d2": ("d1",), "d3": ("d1",), "d4": ("d1", "d2"), "d5": ("d1", "d2")
        }  # fmt: skip


class TestPlan:
    @pytest.mark.parametrize("name", paper.PATHS)
    def test_a_fixed_path_decides_by_nothing(self, name):
        plan = Plan.fixed(name)
        assert plan.path == name
        assert {d.node: d.choice for d in plan.decisions} == paper.PATHS[name]
        for decision in plan.decisions:
            assert (decision.features, decision.inputs, decision.outputs) == (None, (), None)

    @pytest.mark.parametrize("name", paper.PATHS)
    def test_which_decision_a_slot_is_of(self, name):
        nodes = {NODE_SLOTS[step.node]: step.node for step in Plan.fixed(name).decisions}
        assert tuple(nodes.get(slot, "") for slot in (1, 2, 3)) == tuple(paper.NODES_OF[name])


numbers = st.floats(min_value=0, allow_infinity=False, allow_nan=False)
features = st.builds(
    Features,
    st.integers(0, 10**6), numbers, numbers, numbers, numbers,
    st.integers(1, 20000), st.integers(1, 20000), numbers,
)  # fmt: skip
integers = st.integers(-(2**31), 2**31 - 1)
outputs = st.tuples(integers, integers) | st.tuples(numbers, numbers)


class TestText:
    @settings(deadline=None)
    @given(
        st.builds(
            Decision,
            st.sampled_from(NODES),
            st.sampled_from(CHOICES),
            st.none() | features,
            st.lists(integers, max_size=44).map(tuple),
            st.none() | outputs,
        )
    )
    def test_it_comes_back_bit_for_bit(self, decision):
        found = parse_decision(decision_text(decision))
        assert found == decision and repr(found) == repr(decision)

    def test_what_it_looks_like(self):
        text = decision_text(Decision("d1", "warp", SEEN, (1, -2), (3, 4)))
        assert "\n" not in text and " " not in text
        assert json.loads(text) == {
            "node": "d1",
            "choice": "warp",
            "outputs": [3, 4],
            "features": [2, 0.1 + 0.2, 1 / 3, 1e-300, 12345.678, 640, 360, math.pi],
            "inputs": [1, -2],
        }
        assert json.loads(decision_text(Decision("d3", "extrapolate"))) == {
            "node": "d3", "choice": "extrapolate"
        }  # fmt: skip

    def test_nothing_is_nothing(self):
        assert parse_decision(None) is None
