"""The predicted error of a frame: what is seen of its tiles, and how it is written."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exwarp_cli.domain.frame import Image, KeyFrame, Window
from exwarp_cli.domain.tiles import REASONS, TILE_ROWS, Risk, encode_level, tile_edges
from exwarp_cli.synthesis.mosaic import Tiles
from exwarp_cli.synthesis.predicted_error import (
    MIXED,
    WARPED,
    TileEvidence,
    beside_edges,
    evidence_of_sides,
    key_residual,
    predict_risk,
    terms_of,
)
from exwarp_cli.synthesis.warp import Warped, linear_to_srgb

WIDTH, HEIGHT = 64, 64
CANVAS = Window(0, 0, WIDTH, HEIGHT)
TILES = Tiles(CANVAS, CANVAS)
NOISE = np.random.default_rng(7).uniform(0.1, 0.9, (HEIGHT, WIDTH, 4)).astype(np.float32)
STILL = np.zeros((HEIGHT, WIDTH, 2), np.float32)


def tiles_of(count: int, values: int) -> st.SearchStrategy[tuple[int, ...]]:
    """Return tuples of so many numbers below a limit."""
    return st.binary(min_size=count, max_size=count).map(lambda b: tuple(n % values for n in b))


risks = st.integers(1, 20).flatmap(
    lambda columns: st.builds(
        Risk,
        st.floats(0, 255, width=32),
        st.just(columns),
        st.just(TILE_ROWS),
        tiles_of(TILE_ROWS * columns, 129),
        tiles_of(TILE_ROWS * columns, len(REASONS)),
    )
)


@given(risks)
def test_tiles_are_read_as_they_were_written(risk):
    assert Risk.parsed(risk.error, risk.text) == risk


@pytest.mark.parametrize("text", ["", "2x1:l10", "1x1:l10l10", "1x1:z10", "1x1:lzz", "1x1:l10,"])
def test_what_is_no_list_of_tiles_is_refused(text):
    with pytest.raises(ValueError):
        Risk.parsed(1.0, text)


@given(st.floats(0, 255))
def test_a_tile_keeps_its_error_to_four_per_cent(level):
    kept = Risk(level, 1, 1, (encode_level(level),), (0,)).levels
    assert kept == pytest.approx((level,), rel=0.045, abs=0.045)


@pytest.mark.parametrize("display", [CANVAS, Window(5, 3, 31, 17), Window(-9, -4, 90, 60)])
def test_means_are_those_of_each_tiles_pixels(display):
    tiles = Tiles(CANVAS, display)
    assert tiles.stride == 1
    (means,) = tiles.means([NOISE[..., 0]])
    down, across = tile_edges(display.height, TILE_ROWS), tile_edges(display.width, tiles.columns)
    for row, column in np.ndindex(means.shape):
        top, bottom = (display.y + down[row + i] for i in (0, 1))
        left, right = (display.x + across[column + i] for i in (0, 1))
        inside = NOISE[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0), 0]
        wanted = inside.mean(dtype=np.float64) if inside.size else 0
        assert means[row, column] == pytest.approx(wanted)


def warped(colour: np.ndarray, hole: np.ndarray | None = None) -> Warped:
    none = np.zeros((HEIGHT, WIDTH), np.bool_)
    depth = np.ones((HEIGHT, WIDTH), np.float32)
    return Warped(linear_to_srgb(colour), depth, none if hole is None else hole, none)


def seen(before: Warped, after: Warped, field: np.ndarray = STILL) -> TileEvidence:
    """Look at two sides whose light is not moved."""
    weight = np.zeros((HEIGHT, WIDTH), np.float32)
    return evidence_of_sides(TILES, (before, after), (before, after), weight, field, linear=False)


def test_equal_sides_show_no_error():
    found = seen(warped(NOISE), warped(NOISE))
    assert not found.light.any() and not found.motion.any() and not found.unseen.any()


def test_sides_that_disagree_are_seen_where_they_do():
    other = NOISE.copy()
    other[8:16, 16:24] = 1.0
    found = seen(warped(NOISE), warped(other))
    wanted = (255 * (linear_to_srgb(other) - linear_to_srgb(NOISE))[8:16, 16:24, :3]) ** 2
    assert found.light[1, 2] == pytest.approx(wanted.mean(), rel=1e-4)
    assert np.count_nonzero(found.light) == 1 and not found.motion.any()


def test_disagreement_beside_moving_edges_counts_as_motion():
    field = STILL.copy()
    field[:, 32:] = 9
    assert beside_edges(field)[:, 31:33].all() and not beside_edges(field)[:, :31].any()
    other = NOISE.copy()
    other[:, 31:33] = 1.0
    found = seen(warped(NOISE), warped(other), field)
    assert found.motion.any() and not found.light.any()


def test_only_what_neither_side_shows_is_unseen():
    left, right = (np.zeros((HEIGHT, WIDTH), np.bool_) for _ in range(2))
    left[:, :24], right[:, 16:] = True, True
    found = seen(warped(NOISE, left), warped(NOISE, right))
    assert (found.unseen[:, 2] == 1).all() and found.unseen.sum() == TILE_ROWS
    assert not found.light.any()


def key(colour: np.ndarray) -> KeyFrame:
    return KeyFrame(1, Image(colour, CANVAS, CANVAS), None)


def test_a_key_frame_that_is_the_other_one_shifted_predicts_it():
    motion = STILL + np.float32([3, -2])
    shifted = np.roll(NOISE, (2, -3), axis=(0, 1))
    found = key_residual(TILES, key(shifted), key(NOISE), motion)
    assert found.light.max() < 1e-6 and not found.motion.any()
    assert key_residual(TILES, key(shifted), key(NOISE), STILL).light.min() > 100


def test_motion_that_leads_nowhere_tells_nothing():
    for value in (np.nan, np.inf, 1e9):
        assert not key_residual(
            TILES, key(NOISE), key(NOISE), STILL + np.float32(value)
        ).light.any()


def test_broken_pixels_leave_every_number_finite():
    colour = NOISE.copy()
    colour[::3, ::3] = np.nan
    colour[1::3, ::3] = np.inf
    evidence = seen(warped(colour), warped(NOISE))
    terms = terms_of(TILES, evidence, key_residual(TILES, key(colour), key(NOISE), STILL), colour)
    risk = predict_risk(terms, MIXED, 0.5)
    assert np.isfinite(terms).all() and 0 < risk.error <= 255


def test_the_largest_cause_is_the_reason():
    tiles = np.zeros((6, TILE_ROWS, TILES.columns))
    tiles[1, 0, 0] = tiles[3, 0, 1] = tiles[2, 0, 2] = 500.0
    risk = predict_risk(tiles, MIXED, 0.5)
    assert [REASONS[reason] for reason in risk.reasons[:3]] == ["light", "holes", "motion"]


def test_errors_grow_with_the_time_since_the_key_frame_and_peak_halfway_between_two():
    tiles = np.ones((6, TILE_ROWS, TILES.columns))
    warps = [predict_risk(tiles, WARPED, time).error for time in (0.25, 0.5, 0.75)]
    mixes = [predict_risk(tiles, MIXED, time).error for time in (0.25, 0.5, 0.75)]
    assert warps == sorted(warps) and warps[0] < warps[2]
    assert mixes[0] == pytest.approx(mixes[2]) and mixes[0] < mixes[1]
