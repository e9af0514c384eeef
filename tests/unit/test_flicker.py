"""Flicker: against its naive twin, and where it is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exwarp_cli.metrics.temporal import compare_with_previous, display_error, frame_flicker
from exwarp_cli.pipeline.scoring import Steps, flicker_of
from tests.reference import flicker as naive

SIZE = (9, 12)
STILL = np.zeros((*SIZE, 2), np.float32)
SEEN = np.zeros(SIZE, bool)


def frame(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random((*SIZE, 3), dtype=np.float32)


@settings(derandomize=True, max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_transition_equals_the_difference_of_the_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    frames, truths = (frame(seed), frame(seed + 1)), (frame(seed + 2), frame(seed + 3))
    field = rng.normal(0, 3, (*SIZE, 2)).astype(np.float32)
    field[rng.random(SIZE) < 0.1] = np.nan
    hidden = rng.random(SIZE) < 0.2
    per_pixel, counted = naive.transition(frames, truths, field, hidden)
    found = compare_with_previous(
        display_error(truths[1], frames[1]), display_error(truths[0], frames[0]), field, hidden
    )
    np.testing.assert_array_equal(found.counted, counted)
    np.testing.assert_allclose(found.per_pixel[counted], per_pixel[counted], rtol=0, atol=1e-3)
    assert np.isfinite(found.per_pixel).all()
    mean = found.mean()
    assert (mean is None) == (not counted.any())
    assert mean is None or mean == pytest.approx(per_pixel[counted].mean(), abs=1e-3)


def test_an_error_that_stays_on_its_surface_does_not_flicker() -> None:
    """The truth moves by two pixels, and so does everything that is wrong with the test."""
    field = STILL + np.array([-2, 0], np.float32)
    now = np.roll(frame(1), 2, axis=1) * 255
    found = compare_with_previous(now, frame(1) * 255, field, SEEN)
    assert found.mean() == 0
    assert found.counted.sum() == SIZE[0] * (SIZE[1] - 2), "what came in from outside is left out"
    moved_on = compare_with_previous(frame(1) * 255, frame(1) * 255, field, SEEN).mean()
    assert moved_on is not None
    assert moved_on > 10, "without its motion the same error flickers"


def test_an_error_that_comes_and_goes_flickers_by_its_size() -> None:
    wrong = np.full((*SIZE, 3), -7, np.float32)
    assert compare_with_previous(wrong, None, STILL, SEEN).mean() == 7
    steps = Steps({1: STILL}, {1: SEEN}, followed=True)
    assert flicker_of({1: wrong}, {}, steps) == [(7, None)], "so does that to a rendered frame"
    assert compare_with_previous(wrong, wrong, STILL, SEEN).mean() == 0


def test_light_that_changes_in_the_truth_too_is_no_flicker() -> None:
    truths = frame(1) * np.float32(0.5), frame(1)
    errors = [display_error(truth, truth) for truth in truths]
    assert compare_with_previous(errors[1], errors[0], STILL, SEEN).mean() == 0


def test_hidden_pixels_do_not_count() -> None:
    wrong = np.zeros((*SIZE, 3), np.float32)
    wrong[0, 0] = 200
    hidden = SEEN.copy()
    hidden[0, 0] = True
    found = compare_with_previous(wrong, None, STILL, hidden)
    assert found.mean() == 0
    corner = SEEN.copy()
    corner[0, :2] = True
    assert found.mean(corner) == 0
    assert found.mean(hidden) is None
    assert compare_with_previous(wrong, None, STILL, ~SEEN).mean() is None


def test_a_frame_flickers_as_the_transitions_around_it() -> None:
    mask = SEEN.copy()
    mask[2:4] = True
    errors = {slot: np.full((*SIZE, 3), slot**2, np.float32) for slot in (1, 2, 3)}
    fields, hidden = dict.fromkeys(errors, STILL), dict.fromkeys(errors, SEEN)
    found = flicker_of(errors, {1: mask, 3: mask}, Steps(fields, hidden, followed=True))
    assert found == [(2, 1), (4, None), (7, 5)], "of the transitions 1, 3, 5 and 9"
    del errors[3]
    steps = Steps(fields, {**hidden, 1: ~SEEN}, followed=True)
    found = flicker_of(errors, dict.fromkeys(fields, mask), steps)
    assert found == [(3, None), (3, 3), (None, None)]
    assert frame_flicker([None, 4.0, None, None]) == [4, 4, None]
