"""A little of what `make faults` does with spoilt shots; see `tests.faults.fuzz`."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.faults.fuzz.cases import drawn, in_process
from tests.faults.fuzz.damage import DAMAGES, draw_shot
from tests.faults.running import run
from tests.matrix import FULL

CALM = tuple(HealthCheck)


@settings(max_examples=120 if FULL else 30, derandomize=True, suppress_health_check=CALM)
@given(st.data())
def test_in_process(data):
    with drawn(data.draw) as case:
        case.judge(in_process(case))


@settings(max_examples=6 if FULL else 2, derandomize=True, suppress_health_check=CALM)
@given(st.data())
def test_through_the_command(data):
    with drawn(data.draw) as case:
        case.judge(run(*case.arguments))


@pytest.mark.parametrize("damage", DAMAGES)
def test_every_damage_changes_the_shot(damage, tmp_path):
    """Else nothing is tried by it."""
    changed = []

    @settings(max_examples=12, derandomize=True, suppress_health_check=CALM)
    @given(st.data())
    def spoil(data: st.DataObject) -> None:
        folder = tmp_path / str(len(changed))
        draw_shot(data.draw, folder)
        before = {path.name: path.read_bytes() for path in folder.iterdir()}
        damage(data.draw, folder)
        after = {p.name: p.read_bytes() if p.is_file() else b"" for p in folder.iterdir()}
        changed.append(before != after)

    spoil()
    assert any(changed)
