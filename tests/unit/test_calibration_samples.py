"""What measuring motion vectors keeps of a frame, and how candidates are tried on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from exwarp_cli.synthesis.calibration_evidence import COARSE, gather_evidence
from exwarp_cli.synthesis.calibration_samples import sample_frame
from tests.unit.motion_pairs import (
    BLENDER,
    COLOUR_ONLY,
    DEPTH_ONLY,
    POSITION_ONLY,
    XYZW,
    instants,
    pairs_of,
)


def evidence(**without: None):
    return gather_evidence(pairs_of(instants(BLENDER, 4, **without)), XYZW)


def test_many_candidates_have_the_errors_that_each_has_alone():
    for without in (POSITION_ONLY, DEPTH_ONLY, COLOUR_ONLY, {}):
        one = evidence(**without)[(0, 1), False]
        candidates = list(one.usual())[::7]
        for count in (COARSE, None):
            alone = [one.errors([candidate], count)[0] for candidate in candidates]
            assert one.errors(candidates, count) == alone
            assert len(set(alone)) > 2  # else one error for all would do


def test_no_candidates_have_no_errors():
    assert evidence()[(0, 1), False].errors([]) == []


def test_channels_that_hold_values_at_the_same_pixels_share_their_samples():
    found = evidence()
    assert all(
        a is b for a, b in zip(found[(0, 1), True].probes, found[(2, 3), True].probes, strict=True)
    )


def test_channels_that_do_not_are_sampled_apart():
    frames = instants(BLENDER, 4)
    for frame in frames:
        frame.motion[::2, :, 2:] = np.nan
    found = gather_evidence(pairs_of(frames), XYZW)
    first, second = found[(0, 1), True].probes[0], found[(2, 3), True].probes[0]
    assert len(first.xy) > len(second.xy)
    assert np.isfinite(second.raw).all() and not np.isfinite(first.raw).all()


def test_a_frame_is_empty_only_without_any_number():
    frame = instants(BLENDER, 4)[0]
    nothing = np.full_like(frame.motion, np.nan)
    assert sample_frame(replace(frame, motion=nothing)).empty
    nothing[0, 1, 3] = 0  # no sample lies there
    assert not sample_frame(replace(frame, motion=nothing)).empty
    assert not sample_frame(frame).empty


def test_positions_alone_are_kept_where_there_are_some():
    frame = instants(BLENDER, 4)[0]
    kept = sample_frame(frame)
    assert kept.position is frame.gbuffer.position
    assert kept.depth is None and kept.perceived is None
    depth = sample_frame(replace(frame, gbuffer=frame.gbuffer.without("position")))
    assert depth.depth is frame.gbuffer.depth and depth.perceived is not None
