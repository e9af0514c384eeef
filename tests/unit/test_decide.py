"""What a policy sees of a run: ids from motion, and features that are computed once."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from exwarp_cli.domain.frame import GBuffer, Window
from exwarp_cli.pipeline import decide
from exwarp_cli.pipeline.decide import Observer, with_ids
from exwarp_cli.pipeline.interval_inputs import PolicyObservation
from exwarp_cli.policy.state import observe
from exwarp_cli.synthesis.motion_fields import settle_motion
from tests.unit.scenes import SKY, town

BOX = 3
"""Id of the only thing that moves of itself in the town."""

SIZE = (96, 60)
DISPLAY = Window(0, 0, *SIZE)


@functools.cache
def raw(time: float, step: float = 1.0) -> GBuffer:
    return town(SIZE).view(time).gbuffer(step=step)


@functools.cache
def settled(time: float, step: float = 1.0) -> GBuffer:
    return settle_motion(raw(time, step))


class TestIds:
    def test_its_own_stay(self):
        assert with_ids(settled(1.0)) is settled(1.0)

    @pytest.mark.parametrize("left_out", [("stencil",), ("stencil", "position", "normal")])
    @pytest.mark.parametrize(("time", "step"), [(1.0, 1.0), (2.0, 1.0), (1.25, 0.25)])
    def test_without_any_it_is_what_moves_otherwise_than_the_camera(self, time, step, left_out):
        found = with_ids(settle_motion(raw(time, step).without(*left_out)))
        assert found.stencil is not None and found.stencil.dtype == np.int32
        true = raw(time, step).stencil == BOX
        moving = found.stencil > 0
        assert (moving & true).sum() > 0.9 * (moving | true).sum()
        assert set(np.unique(found.stencil)) == {0, 1}
        assert observe(found, None, 1).objects == 1

    def test_of_objects_whole_ones_move(self):
        true = raw(1.0).stencil
        shown = replace(raw(1.0).without("stencil"), objects=np.where(true == BOX, 77, 5))
        found = with_ids(settle_motion(shown), raw(0.0), shown)
        assert found.objects is None
        np.testing.assert_array_equal(found.stencil, np.where(true == BOX, 77, 0))

    def test_the_sky_never_moves(self):
        bare = settle_motion(raw(1.0).without("stencil"))
        sky = town(SIZE).view(1.0).surface == SKY
        wild = np.where(sky[..., None], np.float32(40), bare.to_next)
        found = with_ids(replace(bare, to_next=wild))
        assert sky.sum() > 300 and not found.stencil[sky].any() and found.stencil.any()

    @pytest.mark.parametrize("left_out", [("depth", "position"), ("to_previous", "to_next")])
    def test_where_no_camera_tells_nothing_is_made_up(self, left_out):
        bare = raw(1.0).without("stencil", *left_out)
        assert with_ids(bare) is bare

    def test_a_still_has_no_objects(self):
        still = settle_motion(town(SIZE).still().view(0.0).gbuffer().without("stencil"))
        assert observe(with_ids(still), None, 1).objects == 0


def keys(*indices: int, window: Window = DISPLAY) -> list[PolicyObservation]:
    """Instants in the key setting, as they are read."""
    return [
        PolicyObservation(i, raw(float(i)).on(window), raw(i - 1.0).on(window) if i else None)
        for i in indices
    ]


def slots(index: int) -> list[PolicyObservation]:
    """The instant of a key frame in the slot setting."""
    return [
        PolicyObservation(
            index, raw(float(index), 0.25), raw(index - 0.25, 0.25) if index else None
        )
    ]


class TestKeySetting:
    def test_all_nodes_see_the_key_frame(self):
        found = Observer(DISPLAY, "key").surroundings(1, keys(0, 1), ())
        expected = observe(settled(1.0), raw(0.0), 4)
        assert found.now == (expected,) * 3
        assert found.before == (observe(settled(0.0), None, 4),)

    def test_in_a_row_each_is_looked_at_once(self, monkeypatch):
        counted = []
        monkeypatch.setattr(decide.state, "observe", lambda *a: counted.append(a) or observe(*a))
        row = Observer(DISPLAY, "key")
        found = [row.surroundings(k, keys(k), ()) for k in range(5)]
        assert len(counted) == 5
        assert [len(one.before) for one in found] == [0, 1, 2, 3, 3]
        fresh = Observer(DISPLAY, "key").surroundings(4, keys(1, 2, 3, 4), ())
        assert fresh == found[4]
        assert fresh.before == (found[3].now[0], found[2].now[0], found[1].now[0])

    def test_it_keeps_no_more_in_a_long_run(self):
        row = Observer(DISPLAY, "key")
        for k in range(6):
            row.surroundings(k, [replace(keys(1)[0], key=k)], ())
            assert len(row._at_keys) == min(k + 1, 3)

    def test_what_lies_outside_the_display_does_not_count(self):
        inside = Window(10, 8, 64, 40)
        wide = Observer(inside, "key").surroundings(1, keys(0, 1), ())
        cut = Observer(inside, "key").surroundings(1, keys(0, 1, window=inside), ())
        assert wide == cut and wide.now[0].values[-1] == 64 * 40

    def test_a_key_frame_settled_elsewhere_is_not_settled_again(self, monkeypatch):
        monkeypatch.setattr(decide, "settle_motion", lambda gbuffer: pytest.fail("settled"))
        found = Observer(DISPLAY, "key").surroundings(0, keys(0), (), settled(0.0))
        assert found.now[0] == observe(settled(0.0), None, 4)


class TestSlotSetting:
    def test_each_node_sees_its_own_instant(self):
        now = [settled(1 + i / 4, 0.25) for i in (1, 2, 3)]
        found = Observer(DISPLAY, "slot").surroundings(1, [*slots(0), *slots(1)], now)
        assert found.now == (
            observe(settled(1.0, 0.25), raw(0.75, 0.25), 1),
            observe(now[0], raw(1.0, 0.25), 1),
            observe(now[1], raw(1.25, 0.25), 1),
        )
        assert found.before == (observe(settled(0.0, 0.25), None, 1),)
        assert len({f.emd_position for f in found.now}) == 3

    def test_after_the_last_slot_all_nodes_see_the_key_frame(self):
        found = Observer(DISPLAY, "slot").surroundings(1, [*slots(0), *slots(1)], ())
        assert found.now == (observe(settled(1.0, 0.25), raw(0.75, 0.25), 1),) * 3

    def test_without_ids_every_instant_gets_them_from_motion(self):
        bare = [settle_motion(raw(1 + i / 4, 0.25).without("stencil")) for i in (1, 2, 3)]
        seen = [replace(o, now=o.now.without("stencil")) for o in (*slots(0), *slots(1))]
        found = Observer(DISPLAY, "slot").surroundings(1, seen, bare)
        assert [f.objects for f in (*found.now, *found.before)] == [1, 1, 1, 1]
