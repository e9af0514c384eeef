"""Earth mover's distance: against numpy, scipy and the naive twin, and cases with known answers."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.stats import wasserstein_distance

from exwarp_cli.kernels._row_bands import set_threads
from exwarp_cli.kernels.frame_statistics import (
    BINS,
    ROWS_PER_STRIP,
    ValueDistribution,
    earth_movers_distances,
)
from tests.reference.features import distance
from tests.unit.kernel_calls import counted, extended


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> Iterator[None]:
    """Waking threads takes longer than what most cases here compute."""
    set_threads(1)
    yield
    set_threads(None)


SPAN = 64
"""Longest runs of pixels that count or do not count are about twice as long."""


def everything(values: np.ndarray) -> np.ndarray:
    return np.ones(values.shape[:2], bool)


def between(
    before: np.ndarray, after: np.ndarray, shown_before: np.ndarray, shown_after: np.ndarray
) -> np.ndarray:
    """Distance between two buffers, channel by channel."""
    return earth_movers_distances(
        ValueDistribution(before, shown_before), ValueDistribution(after, shown_after)
    )


def apart(before: np.ndarray, after: np.ndarray) -> float:
    """Distance between two lists of numbers."""
    pair = [np.asarray(values, np.float32).reshape(1, -1, 1) for values in (before, after)]
    return float(between(*pair, *map(everything, pair))[0])


def scene(seed: int, shift: float = 0.0) -> np.ndarray:
    """Three channels of different ranges over several bands, one of them with few values."""
    rng = np.random.default_rng(seed)
    shape = (2 * ROWS_PER_STRIP + 5, 31)
    fine = rng.normal(shift, 1, shape)
    far = rng.lognormal(3, 1, shape) + 100 * shift
    few = rng.choice([-1.0, 0.0, 0.25, 1.0], shape)
    return np.stack([fine, far, few], axis=-1).astype(np.float32)


def by_bins(before: np.ndarray, after: np.ndarray) -> float:
    """Return scipy's distance between the histograms of two lists."""
    ends = (min(before.min(), after.min()), max(before.max(), after.max()))
    weights = [np.histogram(one.astype(float), BINS, range=ends)[0] for one in (before, after)]
    edges = np.linspace(*ends, BINS + 1)
    centres = (edges[:-1] + edges[1:]) / 2
    return float(wasserstein_distance(centres, centres, *weights))


@pytest.mark.parametrize("seed", range(3))
def test_it_is_scipys_between_the_bins(seed):
    before, after = scene(seed), scene(seed + 10, 0.3)
    rng = np.random.default_rng(seed)
    masks = [rng.random(before.shape[:2]) < share for share in (0.7, 0.4)]
    found = between(before, after, *masks)
    for c in range(3):
        one, other = before[..., c][masks[0]], after[..., c][masks[1]]
        spread = max(one.max(), other.max()) - min(one.min(), other.min())
        assert abs(found[c] - by_bins(one, other)) <= 1e-6 * spread
        assert found[c] == pytest.approx(distance(one, other), rel=1e-12)
        assert found[c] > 0.001 * spread


def test_it_does_not_depend_on_threads():
    before, after = scene(1), scene(2)
    expected = between(before, after, everything(before), everything(after))
    try:
        set_threads(None)
        found = between(before, after, everything(before), everything(after))
    finally:
        set_threads(1)
    assert found.tobytes() == expected.tobytes()


FLOATS = arrays.arrays(
    np.float32,
    st.integers(1, 60),
    elements=st.one_of(
        st.floats(-1000, 1000, width=32),
        st.integers(-8, 8).map(float),
        st.integers(-256, 256).map(lambda k: k * 3 / 256),
        st.sampled_from([np.nan, np.inf, -np.inf]),
    ),
)


@settings(derandomize=True, max_examples=150)
@given(FLOATS)
def test_counts_are_numpys(values):
    known = values[np.isfinite(values)].astype(np.float64)
    if not len(known) or known.min() == known.max():
        return
    block = values.reshape(-1, 1, 1)
    (counts,) = counted(block, everything(block), np.array([[known.min(), known.max()]]), True)
    np.testing.assert_array_equal(counts.sum(axis=0)[0], np.histogram(known, BINS)[0])


@settings(derandomize=True, max_examples=100)
@given(FLOATS, FLOATS)
def test_it_is_a_distance_near_the_exact_one(before, after):
    found = apart(before, after)
    assert found == apart(after, before)
    known = [values[np.isfinite(values)].astype(np.float64) for values in (before, after)]
    if not all(map(len, known)):
        assert found == 0
        return
    both = np.concatenate(known)
    spread = both.max() - both.min()
    assert found == pytest.approx(distance(before, after), abs=1e-9 * spread)
    # Each value is moved by half a bin at most.
    assert abs(found - wasserstein_distance(*known)) <= spread / BINS * (1 + 1e-9)


@pytest.mark.parametrize("shift", [0.02, 0.5, 3.0])
def test_shifted_values_are_as_far_apart_as_the_shift(shift):
    values = np.random.default_rng(3).uniform(-1, 1, 5000).astype(np.float32)
    assert abs(apart(values, values + np.float32(shift)) - shift) < (2 + shift) / BINS


def test_turned_normals_are_as_far_apart_as_they_turned():
    """All normals lie in one plane; the distance of each component is its mean change."""
    angles = np.linspace(0.2, 0.8, 4000)
    before, after = (
        np.stack([np.cos(a), np.zeros_like(a), np.sin(a)], axis=-1)[None].astype(np.float32)
        for a in (angles, angles + 0.1)
    )
    found = between(before, after, everything(before), everything(after))
    expected = np.abs(after.astype(float) - before).mean(axis=(0, 1))
    spread = np.ptp(np.concatenate([before, after]), axis=(0, 1))
    assert found[1] == 0
    assert (np.abs(found - expected)[[0, 2]] < spread[[0, 2]] / BINS).all()


def test_equal_and_constant_buffers_are_not_apart():
    values = np.random.default_rng(4).normal(size=300)
    assert apart(values, values[::-1]) == 0
    assert apart(np.full(9, 4.5), np.full(5, 4.5)) == 0


def test_two_constants_are_as_far_apart_as_they_differ():
    assert apart(np.zeros(5), np.full(9, 4.5)) == 4.5 * (BINS - 1) / BINS


def test_what_is_empty_is_not_apart_and_leaves_other_channels_alone():
    assert apart(np.array([np.nan, np.inf]), np.arange(5.0)) == 0
    assert apart(np.arange(5.0), np.array([np.nan])) == 0
    before, after = scene(5), scene(6, 1.0)
    expected = between(before, after, everything(before), everything(after))
    before[..., 1] = np.nan
    after[..., 2] = before[..., 2] = 7
    found = between(before, after, everything(before), everything(after))
    np.testing.assert_array_equal(found, [expected[0], 0, 0])
    nothing = between(before, after, ~everything(before), everything(after))
    np.testing.assert_array_equal(nothing, 0)


def test_single_broken_values_and_hidden_ones_do_not_count():
    before, after = scene(7), scene(8, 0.5)
    expected = between(before[1:], after[1:], everything(before[1:]), everything(after[1:]))
    hidden = everything(before)
    hidden[0] = False
    after[0] = 1e30
    before[0, ::2], before[0, 1::2] = np.nan, -np.inf
    found = between(before, after, everything(before), hidden)
    np.testing.assert_array_equal(found, expected)


def test_extents_are_of_what_counts():
    values = scene(9)
    values[40, 3] = np.nan, np.inf, -np.inf
    values[2, 2] = 1e9
    mask = everything(values)
    mask[2, 2] = False
    mask[ROWS_PER_STRIP : 2 * ROWS_PER_STRIP] = False
    (ends,) = extended(values, mask)
    np.testing.assert_array_equal(ends[1], np.tile([np.inf, -np.inf], (3, 1)))
    first = values[:ROWS_PER_STRIP][mask[:ROWS_PER_STRIP]]
    np.testing.assert_array_equal(ends[0], np.stack([first.min(0), first.max(0)], axis=-1))


def test_the_largest_and_smallest_ranges_are_finite():
    huge = np.array([-3e38, 3e38], np.float32)
    assert apart(huge, huge[:1]) == pytest.approx(3e38, rel=0.01)
    tiny = np.array([0, 1e-45], np.float32)
    assert 0 < apart(tiny, tiny[:1]) < 1e-45


class TestValues:
    def test_what_is_known_of_them_is_what_is_found_afresh(self):
        """Compared with several buffers, of some channels the same range, of others not."""
        values = scene(11)
        mask = np.random.default_rng(11).random(values.shape[:2]) < 0.6
        one = ValueDistribution(values, mask)
        for seed, shift in ((12, 0.0), (13, 0.0), (14, 0.4)):
            other = scene(seed, shift)
            other[:3, 0] = np.array([[-9, 3, -2], [9, 500, 2], [0, 4, 0]])
            found = earth_movers_distances(one, ValueDistribution(other, everything(other)))
            fresh = between(values, other, mask, everything(other))
            assert found.tobytes() == fresh.tobytes()
            assert (
                found.tobytes()
                == earth_movers_distances(
                    ValueDistribution(other, everything(other)), one
                ).tobytes()
            )


@pytest.mark.parametrize("width", [1, 7, 8, 63, 64, 65, 331])
def test_rows_with_sky_between_are_counted_as_numpy_does(width):
    """Surfaces and sky in stretches of every length, where values lie at edges, too."""
    rng = np.random.default_rng(width)
    values = rng.choice(np.linspace(-1, 1, 4 * BINS + 1), (60, width, 3)).astype(np.float32)
    lengths = rng.integers(1, 2 * SPAN, values[..., 0].size)
    changes = np.repeat(np.arange(lengths.size) % 2, lengths)[: values[..., 0].size]
    shown = changes.reshape(values.shape[:2]).astype(bool)
    shown[3], shown[4:20] = True, False
    single = [0, SPAN - 1, SPAN, SPAN + 1, 2 * SPAN, width - 1]
    for i, at in enumerate(single, 5):
        shown[i, min(at, width - 1)] = True
    values[~shown] = 9
    ends = np.array([[-1.0, 1.0], [-1.0, 1.25], [-2.0, 1.0]])
    for counts in counted(values, shown, ends, True):
        for c in range(3):
            expected = np.histogram(values[shown][:, c], BINS, range=tuple(ends[c]))[0]
            np.testing.assert_array_equal(counts.sum(axis=0)[c], expected)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_extents_of_rows_that_count_whole_leave_out_what_is_not_finite(wrong):
    values = scene(16)
    expected = np.stack([values[:ROWS_PER_STRIP].min((0, 1)), values[:ROWS_PER_STRIP].max((0, 1))])
    at = np.argwhere((values > expected[0]) & (values < expected[1]))[::50]
    values[tuple(at.T)] = wrong
    for ends in extended(values, everything(values)):
        np.testing.assert_array_equal(ends[0].T, expected)


@pytest.mark.parametrize("low", [0.0, -1.0, 3.0, -40.0])
@pytest.mark.parametrize("spread", [1e-3, 1.0, 2.0, 5e8])
def test_values_at_the_edges_of_bins_are_counted_as_numpy_does(low, spread):
    """Where float32 does not tell the bin: edges themselves, and the numbers next to them."""
    ends = low, float(np.float32(low) + np.float32(spread))
    edges = np.linspace(*ends, BINS + 1).astype(np.float32)
    steps = np.arange(-4, 5, dtype=np.float32)[:, None] * np.spacing(np.abs(edges))
    values = np.clip(np.concatenate([(edges + steps).ravel(), edges]), *ends)
    block = values.reshape(-1, 1, 1)
    (counts,) = counted(block, everything(block), np.array([ends], float), True)
    expected = np.histogram(values.astype(float), BINS, range=ends)[0]
    np.testing.assert_array_equal(counts.sum(axis=0)[0], expected)


@pytest.mark.parametrize("ends", [(-1e-40, 2e-40), (-3e38, 3e38), (0.1, 0.7)])
def test_ends_that_float32_does_not_tell_apart_are_counted_as_numpy_does(ends):
    low, high = ends
    values = np.random.default_rng(5).uniform(low, high, 500).astype(np.float32)
    values = values[(values >= low) & (values <= high)]
    block = values.reshape(-1, 1, 1)
    (counts,) = counted(block, everything(block), np.array([ends]), True)
    expected = np.histogram(values.astype(float), BINS, range=ends)[0]
    np.testing.assert_array_equal(counts.sum(axis=0)[0], expected)
