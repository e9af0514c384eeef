"""What a slot takes over from other frames: against naive loops, and in known cases."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.synthesis.camera import Scene, standing
from tests.reference import gather as naive_gather
from tests.reference import project as naive_project
from tests.reference import slot_planes as naive
from tests.reference.follow import follow
from tests.unit import kernel_calls as plain
from tests.unit import slot_kernel_calls as calls
from tests.unit.kernel_cases import SHAPE, depth, field, ids, vectors, wide


@pytest.mark.parametrize("blanks", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_surfaces_are_those_at_the_end_of_the_field(seed, blanks):
    motion, parts = field(seed), calls.parts(seed + 10)
    colours, unknown = calls.colours(seed + 20), calls.seen(seed + 30)
    *found, rest = calls.taken_over(motion, parts, colours, unknown, blanks=blanks)
    smooth = [naive_gather.gather_bilinear(colour, motion)[0] for colour in colours]
    led = {place: there for place, there in naive.ends(motion) if unknown[place]}
    for place in np.ndindex(SHAPE):
        assert rest[place] == (unknown[place] and place not in led)
        kept = 0 if blanks and rest[place] else -9
        for made, part in zip(found[:4], parts, strict=True):
            other = np.nan if kept == 0 and made is found[0] else kept
            expected = part[led[place]] if place in led else np.full_like(made[place], other)
            np.testing.assert_array_equal(made[place], expected)
        for made, colour in zip(found[4:], smooth, strict=True):
            expected = colour[place] if place in led else np.full(3, kept)
            np.testing.assert_allclose(made[place], expected, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_points_follow_what_is_shown_where_they_are(seed):
    step, moved = field(seed), field(seed + 5)
    stencil, gone, lost = ids(seed), calls.seen(seed + 6), calls.seen(seed + 7)
    found, missed = calls.shown_followed(step, stencil, gone, moved, lost)
    own, expected = np.zeros(SHAPE, np.int32), np.ones(SHAPE, bool)
    for place, there in naive.ends(moved):
        own[place], expected[place] = stencil[there], lost[place] or gone[there]
    np.testing.assert_array_equal(missed, expected)
    unforeseen = np.full_like(moved, np.nan)
    twin = follow(step, unforeseen, moved, (stencil, own))
    np.testing.assert_allclose(found, twin, atol=2e-4)
    (same,) = plain.followed(step, np.zeros((0, 0, 2), np.float32), moved, (stencil, own))
    np.testing.assert_array_equal(found, same)


@pytest.mark.parametrize("placed", [True, False])
def test_what_stands_still_moves_as_the_cameras_do(placed):
    position = wide(vectors(1, 0.3)) if placed else None
    motion = naive_project.rigid(position, depth(2), *calls.cameras(3))
    step = (motion + np.random.default_rng(4).normal(0, 0.3, motion.shape)).astype(np.float32)
    camera, at_infinity = calls.cameras(3)
    positions = np.zeros((0, 0, 3), np.float32) if position is None else position
    to_ray = np.linalg.inv(camera[:, :3]) @ at_infinity
    found = standing(Scene(positions, depth(2), to_ray), camera, step, 0.25)
    away = np.abs(step - motion).max(axis=-1)
    clear = np.abs(away - 0.25) > 1e-4
    np.testing.assert_array_equal(found[clear], (away <= 0.25)[clear])
    assert 0.1 < found.mean() < 0.9


@pytest.mark.parametrize("kept", [True, False])
def test_only_what_stands_still_is_placed(kept):
    position = wide(vectors(1, 0.3))
    position[20:, :, 2] = -50  # behind the camera
    still, cameras = calls.seen(5), calls.cameras(3)
    near = np.where(np.isinf(depth(2)), np.float32(4), depth(2))
    (whole,) = plain.projected(position, near, *cameras)
    (found,) = plain.projected(position, near, *cameras, still=still, kept=kept)
    lost = np.isnan(whole).any(axis=-1)
    written = still & ~lost if kept else still
    assert (still & lost).any() and (still & ~lost).any()
    np.testing.assert_array_equal(found[written], whole[written])
    assert (found[~written] == 7).all()
