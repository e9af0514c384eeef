"""Flows between key frames: each pair once, on the frames' own windows, and what is dropped."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.domain.frame import Image, KeyFrame, Window
from exwarp_cli.pipeline import key_frames
from exwarp_cli.pipeline.key_frames import MotionEstimates
from exwarp_cli.synthesis.optical_flow import Flow

DISPLAY = Window(0, 0, 8, 6)


@pytest.fixture
def seen(monkeypatch) -> list[tuple[float, float]]:
    """Mean light of the pairs that were estimated; every flow is what its picture holds."""
    pairs: list[tuple[float, float]] = []

    def estimate(before: np.ndarray, after: np.ndarray) -> tuple[Flow, Flow]:
        pairs.append((float(before.max()), float(after.max())))
        return _flow_in(before), _flow_in(after)

    monkeypatch.setattr(key_frames, "estimate_flow", estimate)
    return pairs


def _flow_in(pixels: np.ndarray) -> Flow:
    return Flow(pixels[..., :2].copy(), pixels[..., 2].copy())


def read(key: int, windows: dict[int, Window] | None = None) -> KeyFrame:
    window = (windows or {}).get(key, DISPLAY)
    pixels = np.full((*window.shape, 3), key + 1, np.float32)
    return KeyFrame(100 + key, Image(pixels, window, DISPLAY), None)


def test_each_pair_is_estimated_once(seen):
    estimates = MotionEstimates(read, 3)
    for key in (0, 1, 2):
        estimates.flowing(key)
        estimates.moving(key, key > 0, key < 2)
    assert seen == [(1, 2), (2, 3)]


def test_there_is_nothing_before_the_first_and_after_the_last(seen):
    estimates = MotionEstimates(read, 2)
    first, last = (estimates.flowing(key).gbuffer for key in (0, 1))
    assert first is not None and last is not None
    assert first.to_previous is None and first.to_next is not None
    assert last.to_next is None and last.to_previous is not None
    assert MotionEstimates(read, 1).moving(0, True, True).gbuffer is None


def test_only_the_sides_that_are_asked_for_tell(seen):
    estimates = MotionEstimates(read, 3)
    back = estimates.moving(1, True, False).gbuffer
    assert back is not None and back.to_next is None
    assert (back.to_previous == 2).all()
    assert estimates.moving(1, False, False).gbuffer is None
    assert seen == [(1, 2)]  # the other pair was never needed


def test_flows_lie_on_their_own_frame(seen):
    windows = {0: Window(1, 1, 4, 3), 1: Window(3, 2, 5, 4)}
    estimates = MotionEstimates(lambda key: read(key, windows), 2)
    for key in (0, 1):
        gbuffer = estimates.moving(key, True, True).gbuffer
        assert gbuffer is not None and gbuffer.window == windows[key]
        vectors = gbuffer.to_next if key == 0 else gbuffer.to_previous
        assert vectors is not None and vectors.shape == (*windows[key].shape, 2)
        assert (vectors == key + 1).all()


def test_what_the_next_interval_needs_stays(seen):
    estimates = MotionEstimates(read, 4)
    for key in range(4):
        estimates.flowing(key)
    estimates.release_before(2)
    estimates.moving(2, True, True)
    assert len(seen) == 3
    estimates.moving(1, True, False)
    assert len(seen) == 4
