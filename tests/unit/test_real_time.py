"""The real-time clock, against schedules that are computed by hand."""

from __future__ import annotations

from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from exwarp_cli.domain.decision import PATHS
from exwarp_cli.research.bench.real_time import (
    BUSY,
    BY_PATH,
    LATE,
    SLOT_MS,
    Latencies,
    play,
    play_interval,
)

W, E, HOLD = "warp", "extrapolate", "hold"

AT_480P = {path: row.made_by for path, row in PATHS.items()}
"""E takes 1 slot: every frame comes in time, as offline."""

AT_720P = {
    "S1": (BY_PATH, E, BY_PATH),  # E(F) runs from 0 to 2
    "S2": (BY_PATH, E, W),
    "S3": (W, LATE, BUSY),  # E(F) from 1 to 3; E(P1) is requested at 2
    "S4": (W, LATE, W),
    "S5": (W, W, LATE),  # E(P1) from 2 to 4
    "S6": (W, W, W),
}
"""E takes 2 slots."""

AT_1080P = {
    "S1": (BY_PATH, LATE, BY_PATH),  # E(F) from 0 to 3
    "S2": (BY_PATH, LATE, W),
    "S3": (W, LATE, BUSY),  # E(F) from 1 to 4
    "S4": (W, LATE, W),
    "S5": (W, W, LATE),  # E(P1) from 2 to 5
    "S6": (W, W, W),
}
"""E takes 3 slots."""

SCHEDULES = [
    (slots, path, expected)
    for slots, table in ((1, AT_480P), (2, AT_720P), (3, AT_1080P))
    for path, expected in table.items()
]


def latencies(extrapolate: float, warp: float = 0.5) -> Latencies:
    """Latencies in slots."""
    return Latencies(warp * SLOT_MS, extrapolate * SLOT_MS)


@pytest.mark.parametrize(("slots", "path", "expected"), SCHEDULES)
def test_each_path_shows_what_is_ready(slots, path, expected):
    played = play_interval(path, latencies(slots))
    shown = tuple(d or m for m, d in zip(played.made_by, played.dropped, strict=True))
    assert shown == tuple(BY_PATH if maker == HOLD else maker for maker in expected)
    assert played.generated == sum(maker in (W, E) for maker in expected)
    repeats = [maker == HOLD for maker in played.made_by]
    assert repeats == [maker not in (W, E) for maker in expected]


@pytest.mark.parametrize(
    ("slots", "new"),
    [
        (1, {"S1": 1, "S2": 2, "S3": 3, "S4": 3, "S5": 3, "S6": 3}),
        (2, {"S1": 1, "S2": 2, "S3": 1, "S4": 2, "S5": 2, "S6": 3}),
        (3, {"S1": 0, "S2": 1, "S3": 1, "S4": 2, "S5": 2, "S6": 3}),
    ],
)
def test_new_frames_of_intervals_that_follow_each_other(slots, new):
    for path, count in new.items():
        played = play([path] * 5, latencies(slots))
        assert sum(each.generated for each in played) == 5 * count


def test_extrapolating_first_is_the_only_way_to_have_two_slots():
    """So d1 gives up slot 1 for E(F) in time at slot 2."""
    assert play_interval("S2", latencies(2)).made_by[1] == E
    assert play_interval("S4", latencies(2)).made_by[1] == HOLD
    assert play_interval("S4", latencies(1)).made_by[1] == E


def test_engine_works_on_after_the_next_key_frame():
    """E(P1) of S5 runs from slot 2 to 5, one slot into the next interval."""
    first, second, third = play(["S5", "S1", "S1"], latencies(3))
    assert first.busy_slots == 1
    assert second.dropped == (BY_PATH, BUSY, BY_PATH) and second.busy_slots == 0
    assert third.dropped == (BY_PATH, LATE, BY_PATH)


def test_slow_warps_are_late_and_need_no_engine():
    assert play_interval("S6", latencies(1, warp=1.01)).dropped == (LATE,) * 3
    assert play_interval("S4", latencies(1, warp=1.01)).dropped == (LATE, None, LATE)
    assert play_interval("S3", latencies(40)).made_by == (W, HOLD, HOLD)


def test_without_a_network_nothing_is_extrapolated():
    assert play_interval("S4", latencies(inf)).dropped == (None, LATE, None)
    assert latencies(inf).extrapolate_slots is None
    assert [latencies(n).extrapolate_slots for n in (0.2, 1, 1.2, 3)] == [1, 1, 2, 3]


@given(st.lists(st.sampled_from(list(PATHS)), min_size=1, max_size=8), st.floats(0.01, 12))
def test_an_engine_busy_from_before_changes_reasons_alone(paths, slots):
    """So a request that is refused would have been late as well."""
    alone = [play_interval(path, latencies(slots)).made_by for path in paths]
    assert [one.made_by for one in play(paths, latencies(slots))] == alone
