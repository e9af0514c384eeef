"""Which of the objects that are shown move in an interval."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from exwarp_cli.domain.frame import GBuffer, KeyFrame, Window
from exwarp_cli.pipeline.interval_builder import Ids, IntervalBuilder
from exwarp_cli.pipeline.interval_inputs import IntervalInputs
from exwarp_cli.pipeline.key_frames import HistoryFrame, over_interval, without_surface
from exwarp_cli.synthesis.interval import Interval
from tests.unit.filled import Filled
from tests.unit.scenes import View, town

SIZE = (64, 40)
DISPLAY = Window(0, 0, *SIZE)
BOX, STILL = 3, 10

pytestmark = pytest.mark.usefixtures("loose_objects")


@functools.cache
def view(time: float) -> View:
    return town(SIZE).view(time)


@functools.cache
def shown(time: float, step: float = 1.0, ident: int = BOX) -> GBuffer:
    """Geometry of an instant with the ids of all it shows: the box's may be another."""
    gbuffer = view(time).gbuffer(step=step)
    objects = np.where(gbuffer.stencil == BOX, ident, STILL + view(time).surface)
    objects = np.where(gbuffer.background, 0, objects).astype(np.int32)
    return replace(gbuffer, stencil=None, objects=objects)


@functools.cache
def key(index: int, setting: str = "key", ident: int = BOX) -> KeyFrame:
    gbuffer = shown(float(index), 1.0 if setting == "key" else 0.25, ident)
    gbuffer = gbuffer if setting == "key" else over_interval(gbuffer, 4)
    return replace(view(float(index)).key(1001 + index), gbuffer=gbuffer)


@functools.cache
def older(index: int, setting: str, ident: int) -> HistoryFrame:
    times = (index + 1.0, *(index + i / 4 for i in (3, 2, 1, 0)))
    way = tuple(without_surface(shown(time, 0.25, ident)) for time in times)
    return HistoryFrame(key(index, setting, ident), way if setting == "slot" else ())


def inputs(
    index: int, setting: str, back: int = 2, idents: Any = None, **changes: Any
) -> IntervalInputs:
    """An interval as read; the box's id may go by the key frame."""
    of = (lambda _: BOX) if idents is None else idents
    slots = [shown(index + i / 4, 0.25, of(index)) for i in (1, 2, 3) if setting == "slot"]
    past = [older(i, setting, of(i)) for i in range(index - 1, max(index - 1 - back, -1), -1)]
    template: Any = None
    frame = key(index, setting, of(index))
    read = IntervalInputs(index, template, frame, None, tuple(slots), tuple(past))
    return replace(read, **changes)


def moving(read: IntervalInputs) -> Ids | None:
    return IntervalBuilder(DISPLAY).find_moving_objects(read, DISPLAY)


SETTINGS = pytest.mark.parametrize("setting", ["key", "slot"])


class TestWhichMove:
    @SETTINGS
    @pytest.mark.parametrize("back", [0, 1, 2])
    def test_it_is_the_box(self, setting, back):
        assert moving(inputs(2, setting, back)) == {BOX}

    def test_in_a_scene_at_rest_nothing_does(self):
        rest = town(SIZE).still().view(0.0)
        at_rest = replace(shown(0.0), to_previous=rest.motion_to(-1.0), to_next=rest.motion_to(1.0))
        frame = replace(key(0), gbuffer=at_rest)
        assert moving(inputs(0, "key", frame=frame)) == set()
        assert moving(inputs(0, "key", frame=frame, following=replace(frame, number=2))) == set()

    def test_whatever_moves_between_any_two_instants(self):
        ids = {1: 51, 2: 52}
        assert moving(inputs(2, "key", 2, lambda i: ids.get(i, BOX))) == {51, 52}
        following = key(3, ident=53)
        assert moving(inputs(2, "key", 0, lambda _: 52, following=following)) == {53}
        # By slots every instant after the oldest has a motion from the one before.
        assert moving(inputs(2, "slot", 2, lambda i: ids.get(i, 50))) == {50, 51, 52}
        slots = tuple(shown(2 + i / 4, 0.25, 60 + i) for i in (1, 2, 3))
        assert moving(inputs(2, "slot", 0, slots=slots)) == {61, 62, 63}

    def test_motion_of_the_next_key_frame_tells_nothing_beside_slots(self):
        following = key(3, "slot", ident=53)
        turned = replace(following.gbuffer, to_previous=following.gbuffer.to_next, to_next=None)
        following = replace(following, gbuffer=turned)
        assert moving(inputs(2, "slot", 0, following=following)) == {BOX}

    def test_without_such_ids_nothing_is_said(self):
        frame = key(2)
        bare = replace(frame, gbuffer=frame.gbuffer.without("objects"))
        for one in (bare, replace(frame, gbuffer=None)):
            read = inputs(2, "key", 0, frame=one)
            assert moving(read) is None

    def test_without_motion_nothing_moves(self):
        frame = key(2)
        fixed = replace(frame, gbuffer=frame.gbuffer.without("to_previous", "to_next"))
        assert moving(inputs(2, "key", 0, frame=fixed)) == set()

    @SETTINGS
    def test_what_is_kept_is_what_is_found_afresh(self, setting):
        found = IntervalBuilder(DISPLAY)
        for index in range(4):
            read = inputs(index, setting, idents=lambda i: 50 + i)
            kept = found.find_moving_objects(read, DISPLAY)
            assert kept == moving(read) and kept is not None
            assert kept <= {50 + i for i in range(max(index - 2, 0), index + 1)}
            assert len(found._moving) <= 11

    @SETTINGS
    def test_each_instant_is_looked_at_once(self, monkeypatch, setting):
        counts: list[int] = []
        module = "exwarp_cli.pipeline.interval_builder"
        true = IntervalBuilder.build.__globals__["find_moving"]
        monkeypatch.setattr(
            f"{module}.find_moving", lambda *given: counts.append(1) or true(*given)
        )
        found = IntervalBuilder(DISPLAY)
        for index in (2, 3):
            before = len(counts)
            found.find_moving_objects(inputs(index, setting), DISPLAY)
        assert len(counts) - before == (1 if setting == "key" else 4)


class TestBuilt:
    def built(self, *indices: int, setting: str = "key", **given: Any) -> Interval:
        builder = IntervalBuilder(DISPLAY, Filled())
        return [builder.build(inputs(i, setting, **given)) for i in indices][-1]

    @SETTINGS
    def test_intervals_have_a_stencil(self, setting):
        found = self.built(2, setting=setting)
        frames = [found.key, *(past.frame for past in found.past)]
        for frame, time in zip(frames, (2.0, 1.0, 0.0), strict=True):
            assert frame.gbuffer is not None and frame.gbuffer.objects is None
            np.testing.assert_array_equal(frame.gbuffer.stencil, view(time).gbuffer().stencil)
        for i, slot in enumerate(found.slots, start=1):
            np.testing.assert_array_equal(slot.stencil, view(2 + i / 4).gbuffer().stencil)

    def test_nothing_moved_between_equal_pictures(self):
        read = inputs(2, "key")
        newer, oldest = read.history
        history = (replace(newer, held=True), oldest)
        past = IntervalBuilder(DISPLAY, Filled()).build(replace(read, history=history)).past
        assert not past[0].motion.any() and np.abs(past[1].motion).max() > 1

    @SETTINGS
    def test_what_moved_before_does_not_count_later(self, setting):
        """An id that the box has in one interval is a wall's in a later one."""

        def read(index: int) -> IntervalInputs:
            back = 2 if index > 2 else 1
            return inputs(index, setting, back, lambda i: STILL if i < 1 else BOX)

        builder, fresh = IntervalBuilder(DISPLAY, Filled()), IntervalBuilder(DISPLAY, Filled())
        kept = [builder.build(read(index)) for index in range(4)]
        for past, expected in zip(kept[3].past, fresh.build(read(3)).past, strict=True):
            np.testing.assert_array_equal(past.motion, expected.motion)
            here, there = past.frame.gbuffer, expected.frame.gbuffer
            np.testing.assert_array_equal(here.stencil, there.stencil)
            np.testing.assert_array_equal(here.to_previous, there.to_previous)
        assert set(np.unique(kept[3].key.gbuffer.stencil)) == {0, BOX}
        assert kept[1].past[0].frame.gbuffer.stencil is not None
