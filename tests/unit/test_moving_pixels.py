"""What moves of itself, by world positions; and of what is shown the objects that do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from exwarp_cli.domain.frame import GBuffer, Window
from exwarp_cli.synthesis.motion_fields import (
    MOVING_SHARE,
    SLOW_TOLERANCE,
    find_moving,
    moving_ids,
    select_ids,
    settle_motion,
)
from tests.unit.scenes import town

BOX = 3
SIZE = (96, 60)


def moving_stencil(ids: np.ndarray, moves: np.ndarray) -> np.ndarray:
    return select_ids(ids, moving_ids(ids, moves))


def bare(time: float, step: float = 1.0) -> GBuffer:
    return town(SIZE).view(time).gbuffer(step=step).without("stencil")


def box(time: float) -> np.ndarray:
    return town(SIZE).view(time).gbuffer().stencil == BOX


def agreement(found: np.ndarray, true: np.ndarray) -> float:
    return float((found & true).sum() / (found | true).sum())


class TestMoving:
    @pytest.mark.parametrize(("time", "step"), [(1.0, 1.0), (2.0, 1.0), (1.25, 0.25)])
    def test_it_is_the_box(self, time, step):
        now = bare(time, step)
        found = find_moving(settle_motion(now), bare(time - step, step), now)
        assert agreement(found, box(time)) > 0.9

    def test_however_much_of_the_frame_moves(self):
        """All vectors but a few are those of another camera: none fits them."""
        now, before = bare(1.0), bare(0.0)
        rng = np.random.default_rng(0)
        wild = rng.uniform(-9, 9, now.to_previous.shape).astype(np.float32)
        still = np.zeros(now.window.shape, bool)
        still[:20] = True
        shown = replace(now, to_previous=np.where(still[..., None], now.to_previous, wild))
        found = find_moving(settle_motion(shown), before, shown)
        assert found[~still & ~now.background].mean() > 0.95
        assert found[still & ~box(1.0)].mean() < 0.05

    def test_what_moves_slowly_is_found_as_read(self):
        now, before = town(SIZE).still().view(0.0).gbuffer(), town(SIZE).still().view(0.0).gbuffer()
        mine = now.stencil == BOX
        for speed, wanted in ((2 * SLOW_TOLERANCE, True), (SLOW_TOLERANCE / 2, False)):
            moved = np.where(mine[..., None], np.float32(speed), now.to_previous)
            raw = replace(now, to_previous=moved).without("stencil")
            found = find_moving(settle_motion(raw), before, raw)
            assert bool(found[mine].mean() > 0.6) is wanted
            assert not found[~mine].any()
            assert not find_moving(settle_motion(raw), before, None).any()

    def test_wrongly_settled_vectors_do_not_count(self):
        now, before = bare(1.0), bare(0.0)
        spoilt = replace(settle_motion(now), to_previous=now.to_previous + np.float32(1))
        assert agreement(find_moving(spoilt, before, now), box(1.0)) > 0.8
        assert agreement(find_moving(spoilt, before, None), box(1.0)) < 0.5

    def test_mixtures_at_silhouettes_do_not_count(self):
        now, before = bare(1.0), bare(0.0)
        inside = box(1.0)
        around = inside.copy()
        for axis in (0, 1):
            around |= np.roll(inside, 1, axis) | np.roll(inside, -1, axis)
        around &= ~inside & ~now.background
        assert around.sum() > 30
        mixed = np.where(around[..., None], now.to_previous + np.float32(2), now.to_previous)
        found = find_moving(settle_motion(now), before, replace(now, to_previous=mixed))
        assert found[around].mean() < 0.2

    @pytest.mark.parametrize("lost", ["position", "to_previous", "both"])
    def test_without_two_cameras_the_vectors_tell(self, lost):
        now, before = bare(1.0), bare(0.0)
        if lost == "to_previous":
            now = now.without("to_previous")
        else:
            before = before.without("position")
            now = now.without("position") if lost == "both" else now
        settled = settle_motion(now)
        found = find_moving(settled, before, now)
        np.testing.assert_array_equal(found, find_moving(settled, None, None))
        assert agreement(found, box(1.0)) > 0.9

    def test_background_never_moves_and_nothing_is_made_up(self):
        now = settle_motion(bare(1.0))
        assert not find_moving(now, bare(0.0), None)[now.background].any()
        assert find_moving(now.without("depth", "position"), None, None) is None


class TestOfMoving:
    IDS = np.array([[5, 5, 5, 5, 5, 0], [7, 7, 7, 7, 7, -1], [5, 5, 5, 5, 5, 0]], np.int32)

    def test_objects_are_whole(self):
        moves = np.zeros(self.IDS.shape, bool)
        moves[0, 0] = moves[1, 5] = moves[2, 5] = True  # one pixel in ten; mixed; background
        found = moving_stencil(self.IDS, moves)
        assert MOVING_SHARE == 0.1 and found.dtype == np.int32
        np.testing.assert_array_equal(found, np.where(self.IDS == 7, 0, self.IDS))

    def test_fewer_do_not_count(self):
        ids = np.repeat(self.IDS, 2, axis=0)
        moves = np.zeros(ids.shape, bool)
        moves[0, 0] = True
        assert set(np.unique(moving_stencil(ids, moves))) == {-1, 0}

    def test_background_and_mixtures_are_no_objects(self):
        moves = np.ones(self.IDS.shape, bool)
        assert moving_ids(self.IDS, moves) == {5, 7} and moving_ids(self.IDS, ~moves) == set()
        assert select_ids(self.IDS, {7}).tolist() == np.where(self.IDS == 5, 0, self.IDS).tolist()
        assert (
            moving_ids(self.IDS[:0], moves[:0]) == set() and select_ids(self.IDS[:0], {7}).size == 0
        )

    def test_it_agrees_with_counting_each(self):
        rng = np.random.default_rng(1)
        ids = np.repeat(rng.integers(-1, 6, (9, 8)), 3, axis=1).astype(np.int32)
        moves = rng.random(ids.shape) < 0.1
        expected = np.where(ids < 0, -1, 0)
        for one in range(1, 6):
            if moves[ids == one].mean() >= MOVING_SHARE:
                expected[ids == one] = one
        np.testing.assert_array_equal(moving_stencil(ids, moves), expected)
        assert len(np.unique(expected)) > 2 and moving_stencil(ids[:0], moves[:0]).size == 0


def test_a_gbuffer_carries_what_it_shows():
    ids = np.arange(6, dtype=np.int32).reshape(2, 3)
    here = GBuffer(Window(0, 0, 3, 2), objects=ids)
    moved = here.on(Window(-1, 0, 4, 3)).objects
    assert moved is not None and moved.dtype == np.int32
    assert moved.tolist() == [[0, 0, 1, 2], [0, 3, 4, 5], [0, 0, 0, 0]]
    assert here.without("depth").objects is ids and here.without("objects").objects is None
