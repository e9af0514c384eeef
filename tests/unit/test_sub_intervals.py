"""Slots beside rendered frames, in a scene whose pictures and motion are known at all times."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from exwarp_cli.domain.frame import KeyFrame
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import METHODS
from exwarp_cli.synthesis.motion_fields import settle_motion
from exwarp_cli.synthesis.sub_intervals import sub_slots, vector_spans
from tests.matrix import combinations
from tests.unit.scenes import View, town

STEP = 0.25
make = METHODS["softsplat"].predict


@cache
def view(time: float) -> View:
    return town().view(time)


def frame(time: float, span: float = 1.0, number: int = 0) -> KeyFrame:
    """A rendered frame with settled vectors that lead over a span."""
    key = view(time).key(number)
    return replace(key, gbuffer=settle_motion(view(time).gbuffer(step=span)))


def interval(*slots: int, span: float = 1.0, ends: bool = False) -> Interval:
    """The first key interval, with rendered frames at some slots."""
    rendered = {slot: frame(slot * STEP, span, number=100 + slot) for slot in slots}
    following = None if ends else frame(1.0, number=2)
    return Interval(frame(0.0, number=1), following, rendered=rendered)


def error(pixels: np.ndarray, slot: int) -> float:
    """RMS error of a slot's colour."""
    return float(np.sqrt(np.mean((pixels - view(slot * STEP).colour)[..., :3] ** 2)))


@pytest.mark.parametrize("slot", [1, 2, 3])
@pytest.mark.parametrize("span", [1.0, STEP])
def test_the_span_of_vectors_is_measured(slot, span):
    assert vector_spans(interval(slot, span=span), STEP) == {slot: span}


@pytest.mark.parametrize("share", [-1.0, 0.5, 3.0])
def test_vectors_that_lead_over_another_time_are_not_used(share):
    found = interval(2)
    gbuffer = found.rendered[2].gbuffer
    assert gbuffer is not None and gbuffer.to_next is not None and gbuffer.to_previous is not None
    other = replace(
        gbuffer, to_next=share * gbuffer.to_next, to_previous=share * gbuffer.to_previous
    )
    found = replace(found, rendered={2: replace(found.rendered[2], gbuffer=other)})
    assert vector_spans(found, STEP) == {} and sub_slots(found, {}) == {}


def test_vectors_that_stand_still_may_lead_over_any_time():
    still = town().still().view(0.0)
    key = replace(still.key(1), gbuffer=settle_motion(still.gbuffer()))
    found = Interval(key, replace(key, number=2), rendered={2: key})
    assert vector_spans(found, STEP) == {2: 1.0}


@pytest.mark.parametrize(("span", "slots"), combinations([1.0, STEP], [(1,), (2,), (3,), (1, 3)]))
def test_slots_beside_a_rendered_one_are_better(slots, span):
    found = interval(*slots, span=span)
    subs = sub_slots(found, vector_spans(found, STEP))
    assert set(subs) == {1, 2, 3} - set(slots)
    for slot, sub in subs.items():
        assert make is not None
        near = error(make(sub.interval, sub.index).pixels, slot)
        assert near < 0.93 * error(make(found, slot).pixels, slot)


def test_what_a_slot_is_made_from():
    subs = sub_slots(interval(1, 3), {1: 1.0, 3: 1.0})
    assert (subs[2].keys, subs[2].rendered, subs[2].interval.times) == ((), (1, 3), (0.5,))
    subs = sub_slots(interval(1), {1: 1.0})
    assert {slot: (sub.keys, sub.rendered, sub.index) for slot, sub in subs.items()} == {
        2: ((2,), (1,), 1),
        3: ((2,), (1,), 2),
    }
    assert subs[2].interval.times == pytest.approx((1 / 3, 2 / 3))


def test_after_the_last_key_frame_slots_before_a_rendered_one_look_ahead():
    found = interval(2, ends=True)
    assert set(sub_slots(found, {2: 1.0})) == {1}
    assert sub_slots(replace(found, held=True), {2: 1.0}) == {}
