"""A slot's surfaces and where they were, against a scene whose content is known exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from exwarp_cli.io.channels import Role
from exwarp_cli.io.shot import Shot
from exwarp_cli.research.training.scene_clip import SceneClip
from exwarp_cli.synthesis.history import step_back
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.motion_fields import SlotField
from tests.matrix import spread
from tests.unit.analytic_scene import STEP, surface
from tests.unit.reading import changed_planes
from tests.unit.scenes import SKY, View, town

K = 3
SETTINGS = ("key", "slot")
SLOTS = (1, 2, 3)


@pytest.fixture(scope="module", params=SETTINGS)
def interval(request, footage) -> Interval:
    return footage.causal(K, request.param)


def view(k: int, slot: int = 0) -> View:
    return town().view(STEP * (4 * k + slot))


def seen_in(here: View, there: View) -> np.ndarray:
    """bool [H, W]: the other view shows this one's surface point, well inside the frame."""
    shown = (here.source_surface(there) == here.surface) & here.inside(3)
    return np.asarray(shown & np.isfinite(here.motion_to(there.time)).all(axis=-1))


@pytest.mark.parametrize("slot", SLOTS)
def test_the_past_is_where_the_scene_says(interval, slot):
    found, here = interval.look_back(slot), view(K, slot)
    assert len(found.fields) == len(found.hidden) == 2
    for count, (field, hidden) in enumerate(zip(found.fields, found.hidden, strict=True), 1):
        there = view(K - count)
        through_key = seen_in(here, view(K)) & seen_in(here, view(K - 1))
        known = seen_in(here, there) & through_key & ~hidden
        assert known.mean() > 0.5
        gap = np.linalg.norm(field - here.motion_to(there.time), axis=-1)[known]
        assert np.percentile(gap, 99) < 0.3
        truly = seen_in(here, there)
        assert (hidden & truly & through_key).mean() < 0.03
        elsewhere = here.inside(3) & (here.source_surface(there) != here.surface)
        assert (hidden & elsewhere).sum() > 0.7 * elsewhere.sum()


@pytest.mark.parametrize("slot", SLOTS)
def test_the_surfaces_are_those_of_the_slot(interval, slot):
    found, here = interval.look_back(slot), view(K, slot)
    assert found.unknown.mean() < 0.1
    known = ~found.unknown & here.inside(2)
    same = (found.surface.roughness == surface(here)["roughness"]) & known
    assert same.sum() > 0.97 * known.sum()
    solid = same & (here.surface != SKY) & np.isfinite(found.surface.depth)
    # Key G-buffers tell the depth that a surface had at the key frame.
    np.testing.assert_allclose(found.surface.depth[solid], here.depth[solid], rtol=0.35)
    for name, plane in surface(here).items():
        made = getattr(found.surface, name)
        assert np.mean(np.abs(made - plane)[solid]) < 0.02, name


def test_holes_are_looked_for_in_the_frame_before(footage):
    with_past = footage.causal(K, "key")
    without = replace(with_past, past=())
    slot = 3
    before, after = without.look_back(slot), with_past.look_back(slot)
    gained = before.unknown & ~after.unknown
    assert gained.sum() >= 10
    here = view(K, slot)
    right = after.surface.roughness == surface(here)["roughness"]
    assert right[gained].mean() > 0.7
    assert not after.hidden[0][gained].any()
    gap = np.linalg.norm(after.fields[0] - here.motion_to(view(K - 1).time), axis=-1)
    assert np.median(gap[gained]) < 1.0


@pytest.mark.parametrize("slot", spread(SLOTS[::-1], 1))
def test_noise_of_one_slot_s_vectors_does_not_add_up(footage, monkeypatch, slot):
    """A forecast by a slot's own vectors, over the 11 slots back to F_k-2, missed it by 5 px."""
    rng = np.random.default_rng(0)

    def noisy(_shot: Shot, _number: int, role: Role, planes: np.ndarray) -> np.ndarray:
        if role is not Role.MOTION:
            return planes
        return (planes + rng.normal(0, 0.02, planes.shape)).astype(planes.dtype)

    changed_planes(monkeypatch, noisy)
    found = SceneClip(footage.scene).causal(K, "slot").look_back(slot)
    here, there = view(K, slot), view(K - 2)
    moving = (here.gbuffer().stencil > 0) & ~found.hidden[1]
    for between in (there, view(K - 1), view(K)):
        moving &= seen_in(here, between)
    assert moving.sum() > 100
    gap = np.linalg.norm(found.fields[1] - here.motion_to(there.time), axis=-1)[moving]
    assert np.percentile(gap, 99) < 0.5


@pytest.mark.parametrize("setting", SETTINGS)
def test_history_ends_where_the_render_begins(footage, setting):
    for k, older in ((0, 0), (1, 1), (2, 2), (3, 2)):
        found = footage.causal(k, setting).look_back(2)
        assert len(found.fields) == len(found.hidden) == older


@pytest.mark.parametrize("setting", SETTINGS)
def test_history_ends_at_a_frame_without_geometry(footage, setting):
    interval = footage.causal(K, setting)
    newer, older = interval.past
    blind = replace(older, frame=replace(older.frame, gbuffer=None))
    found = replace(interval, past=(newer, blind)).look_back(2)
    assert len(found.fields) == 1


@pytest.mark.parametrize("slot", [2, 3])
def test_the_slot_before_is_where_the_scene_says(interval, slot):
    here, there = view(K, slot), view(K, slot - 1)
    found = interval.step_back(slot)
    shown = seen_in(here, there) & seen_in(here, view(K)) & ~found.hole
    gap = np.linalg.norm(found.field - here.motion_to(there.time), axis=-1)[shown]
    assert shown.mean() > 0.6
    assert np.percentile(gap, 99) < 0.3


def test_what_the_slot_before_hides_is_a_hole():
    """A disc of 20 columns moves by 6 over a background that stands still."""
    shape = (24, 48)
    at = {slot: slice(6 + 6 * slot, 26 + 6 * slot) for slot in (0, 2, 3)}

    def back(slot: int) -> SlotField:
        field = np.zeros((*shape, 2), np.float32)
        field[:, at[slot], 0] = -6 * slot
        gone = np.zeros(shape, bool)
        gone[:, at[0]] = True
        gone[:, at[slot]] = False
        field[gone] = np.nan
        return SlotField(field, np.where(gone, np.nan, 1).astype("f4"), gone)

    there = np.zeros((*shape, 2), np.float32)
    there[:, at[0], 0] = 12
    found = step_back(back(3), there, back(2))
    right = np.zeros(shape, bool)
    right[:, at[3]] = True
    np.testing.assert_array_equal(found.field[right], np.broadcast_to([-6, 0], (24 * 20, 2)))
    assert not found.hole[right].any()
    shown = np.zeros(shape, bool)
    shown[:, : at[0].start] = shown[:, at[3].stop :] = True
    assert not found.hole[shown].any()
    assert found.hole[~(right | shown)].all()


@pytest.mark.parametrize("slot", [0, 1, 4])
def test_there_is_no_slot_before_the_first(interval, slot):
    with pytest.raises(ValueError, match=f"before slot {slot} there is no slot"):
        interval.step_back(slot)
