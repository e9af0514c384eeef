"""Intervals made of what was read, on a scene whose motion is known between all instants."""

from __future__ import annotations

import functools
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from exwarp_cli.domain.frame import SURFACE_PARTS, GBuffer, KeyFrame, Window
from exwarp_cli.pipeline import interval_builder
from exwarp_cli.pipeline.interval_builder import IntervalBuilder
from exwarp_cli.pipeline.interval_inputs import IntervalInputs
from exwarp_cli.pipeline.key_frames import HistoryFrame, over_interval, without_surface
from exwarp_cli.synthesis.interval import Interval
from tests.matrix import combinations, spread
from tests.unit.filled import Filled
from tests.unit.scenes import View, town

DISPLAY = Window(0, 0, 128, 80)

pytestmark = pytest.mark.usefixtures("loose_objects")


@functools.cache
def view(time: float) -> View:
    return town().view(time)


def raw_key(index: int, setting: str = "key") -> KeyFrame:
    """A key frame as the loader reads it; with slot G-buffers its vectors are four slots long."""
    frame = view(float(index)).key(1001 + index)
    return frame if setting == "key" else replace(frame, gbuffer=over_interval(slot(index, 0), 4))


def slot(index: int, i: int) -> GBuffer:
    return view(index + i / 4).gbuffer(step=0.25)


def way_back(index: int) -> tuple[GBuffer, ...]:
    instants = (slot(index + 1, 0), *(slot(index, i) for i in (3, 2, 1, 0)))
    return tuple(without_surface(gbuffer) for gbuffer in instants)


def inputs(index: int, setting: str, **changes: Any) -> IntervalInputs:
    slots = tuple(slot(index, i) for i in (1, 2, 3)) if setting == "slot" else ()
    history = tuple(
        HistoryFrame(raw_key(j, setting), way_back(j) if setting == "slot" else ())
        for j in range(index - 1, max(index - 3, -1), -1)
    )
    template: Any = None
    read = IntervalInputs(index, template, raw_key(index, setting), None, slots, history)
    return replace(read, **changes)


def built(*indices: int, setting: str = "key") -> Interval:
    """The last of some intervals made in order."""
    builder = IntervalBuilder(DISPLAY, Filled())
    return [builder.build(inputs(index, setting)) for index in indices][-1]


@pytest.fixture
def settled(monkeypatch) -> list[GBuffer]:
    """Every G-buffer whose motion was settled."""
    seen: list[GBuffer] = []
    true = interval_builder.settle_motion

    def settle(gbuffer: GBuffer) -> GBuffer:
        seen.append(gbuffer)
        return true(gbuffer)

    monkeypatch.setattr(interval_builder, "settle_motion", settle)
    return seen


@pytest.mark.parametrize("setting", ["key", "slot"])
def test_motion_leads_to_the_key_frame_before(setting):
    found = built(2, setting=setting)
    assert [past.frame.number for past in found.past] == [1002, 1001]
    for newer, past in ((2, found.past[0]), (1, found.past[1])):
        seen = view(float(newer))
        inside = seen.inside(4) & (seen.source_surface(view(newer - 1.0)) == seen.surface)
        assert inside.mean() > 0.3
        error = np.abs(past.motion - seen.motion_to(newer - 1.0)).max(axis=-1)
        assert np.percentile(error[inside], 99) < 0.1
        assert np.abs(past.motion[inside]).max() > 3  # the scene moves


@pytest.mark.parametrize(("setting", "before"), combinations(["key", "slot"], [(2,), (0, 1, 2)]))
def test_what_is_shared_is_what_is_made_afresh(setting, before):
    kept, fresh = built(*before, 3, setting=setting), built(3, setting=setting)
    np.testing.assert_array_equal(kept.key.image.pixels, fresh.key.image.pixels)
    for a, b in zip(kept.past, fresh.past, strict=True):
        assert a.frame.number == b.frame.number
        np.testing.assert_array_equal(a.motion, b.motion)
        assert a.frame.gbuffer is not None and b.frame.gbuffer is not None
        for name in ("to_previous", "to_next"):
            x, y = getattr(a.frame.gbuffer, name), getattr(b.frame.gbuffer, name)
            assert (x is None) == (y is None)
            assert x is None or np.array_equal(x, y, equal_nan=True)


@pytest.mark.parametrize(("setting", "each"), [("key", 1), ("slot", 5)])
def test_in_a_row_nothing_is_settled_twice(settled, setting, each):
    """With slot G-buffers, a key frame is settled for its interval and for the slot before."""
    builder = IntervalBuilder(DISPLAY, Filled())
    counts = []
    for index in range(4):
        before = len(settled)
        builder.build(inputs(index, setting))
        counts.append(len(settled) - before)
    assert counts[2:] == [each] * 2


@pytest.mark.parametrize("setting", ["key", "slot"])
def test_it_keeps_no_more_in_a_long_run(setting):
    builder = IntervalBuilder(DISPLAY, Filled())
    sizes = []
    for index in range(4):
        builder.build(inputs(index, setting))
        kept = (builder._frames, builder._instants, builder._past)
        sizes.append(tuple(len(part) for part in kept))
    assert sizes[1:] == [sizes[1]] * 3
    assert sizes[1] == (2, 3 if setting == "slot" else 0, 1)


def test_methods_without_a_network_keep_nothing_of_the_past():
    builder = IntervalBuilder(DISPLAY)
    for index in range(3):
        found = builder.build(inputs(index, "slot", history=()))
        assert found.past == () and found.extrapolator is None
    assert not (builder._frames or builder._instants or builder._past)


def test_an_interpolator_is_handed_on_and_keeps_nothing():
    network: Any = object()
    builder = IntervalBuilder(DISPLAY, None, network)
    for index in range(2):
        found = builder.build(inputs(index, "key", history=()))
        assert found.interpolator is network and found.extrapolator is None
    assert not (builder._frames or builder._past)


def test_a_following_frame_is_kept_for_its_own_interval(settled):
    builder = IntervalBuilder(DISPLAY)
    for index in range(3):
        builder.build(inputs(index, "key", history=(), following=raw_key(index + 1)))
    assert len(settled) == 4


@pytest.mark.parametrize("extrapolated", spread([(), (0,), (1,), (0, 1, 2)], 3))
def test_an_interval_that_is_completed_is_one_that_was_read_whole(extrapolated, settled):
    """Whichever before it were completed; what no interval has a use for is not kept."""

    def surfaced(frame: KeyFrame | None) -> KeyFrame:
        assert frame is not None and frame.gbuffer is not None
        planes = np.full((80, 128, 3), frame.number, np.float32)
        surface: dict[str, Any] = dict.fromkeys(SURFACE_PARTS, planes)
        return replace(frame, gbuffer=replace(frame.gbuffer, **surface))

    def whole(index: int) -> IntervalInputs:
        given = inputs(index, "key")
        history = [replace(older, frame=surfaced(older.frame)) for older in given.history]
        return replace(given, frame=surfaced(given.frame), history=tuple(history))

    def bare(index: int) -> IntervalInputs:
        given = inputs(index, "key", lacks_history=True)
        return replace(given, history=given.history[:1])

    builder = IntervalBuilder(DISPLAY, Filled())
    for index in range(3):
        builder.build(bare(index))
        if index in extrapolated:
            builder.build(whole(index))
    made = builder.build(bare(3))
    assert len(made.past) == 1 and made.past[0].frame.gbuffer.albedo is None
    assert {index for index, *_ in builder._frames} <= {3, *extrapolated}
    before = len(settled)
    found = builder.build(whole(3))
    # The key frame's own motion is settled already.
    assert len(settled) - before == 2 - (2 in extrapolated)
    expected = IntervalBuilder(DISPLAY, Filled()).build(whole(3))
    assert len(found.past) == 2
    for one, other in zip(
        (found.key, *(past.frame for past in found.past)),
        (expected.key, *(past.frame for past in expected.past)),
        strict=True,
    ):
        for field in fields(GBuffer):
            a, b = (getattr(frame.gbuffer, field.name) for frame in (one, other))
            np.testing.assert_array_equal(a, b, err_msg=field.name)
    for past, other in zip(found.past, expected.past, strict=True):
        np.testing.assert_array_equal(past.motion, other.motion)


def test_every_part_lies_on_the_key_frame_s_window():
    """The data windows of older frames may be larger or smaller."""

    def cropped(frame: KeyFrame, window: Window) -> KeyFrame:
        return frame.on(window)

    small, large = Window(10, 5, 70, 60), Window(-8, -4, 150, 90)
    given = inputs(2, "key")
    assert given.frame is not None
    newer, older = given.history
    builder = IntervalBuilder(DISPLAY, Filled())
    found = builder.build(
        replace(
            given,
            frame=cropped(given.frame, small),
            history=(
                replace(newer, frame=cropped(newer.frame, large)),
                replace(older, frame=cropped(older.frame, small)),
            ),
        )
    )
    assert found.key.image.data_window == DISPLAY
    for past in found.past:
        assert past.frame.image.data_window == DISPLAY
        assert past.motion.shape == (80, 128, 2)
        assert past.frame.gbuffer is not None and past.frame.gbuffer.window == DISPLAY
    # on another window nothing is shared
    again = builder.build(replace(inputs(3, "key"), frame=cropped(raw_key(3), large)))
    assert again.past[0].motion.shape == (90, 150, 2)


@pytest.mark.parametrize("lost", [(), ("depth",)], ids=["all", "no depth"])
def test_a_bare_interval_warps_as_a_whole_one(lost):
    """Without a depth pass positions tell what is background, and stay."""
    made = replace(inputs(2, "key"), frame=raw_key(2).without(*lost), history=())
    whole, bare = (IntervalBuilder(DISPLAY, bare=wish).build(made) for wish in (False, True))
    assert (bare.key.gbuffer.position is None) == (not lost)
    for interval in (bare, whole.bare()):
        found, expected = interval.back(2), whole.back(2)
        np.testing.assert_array_equal(found.field, expected.field)
        np.testing.assert_array_equal(found.depth, expected.depth)
