"""Connected components: the partition is scipy's, numbers go by first pixels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy import ndimage

from tests.reference.features import components
from tests.unit.kernel_calls import labelled

TOUCH = np.ones((3, 3))


def assert_right(stencil: np.ndarray) -> None:
    """Labels number scipy's components of each id by their first pixels, and areas are theirs."""
    labels, areas = labelled(stencil)
    expected = np.zeros(stencil.shape, np.int64)
    for ident in np.unique(stencil[stencil > 0]):
        parts, _ = ndimage.label(stencil == ident, structure=TOUCH)
        expected = np.where(parts > 0, parts + expected.max(), expected)
    _, first, inverse = np.unique(expected, return_index=True, return_inverse=True)
    if (expected == 0).any():
        first[0] = -1  # background comes first wherever it is
    ranks = np.argsort(np.argsort(first)) + (not (expected == 0).any())
    expected = ranks[inverse].reshape(stencil.shape)
    np.testing.assert_array_equal(labels, expected)
    np.testing.assert_array_equal(areas, np.bincount(expected.ravel(), minlength=len(areas)))
    assert len(areas) == labels.max() + 1


def drawn(*rows: str) -> np.ndarray:
    """Digits are ids, a minus is a mixed pixel, a point is static."""
    values = {".": 0, "-": -1}
    return np.array([[values.get(c) if c in values else int(c) for c in r] for r in rows], np.int32)


SHAPES = st.tuples(st.integers(1, 12), st.integers(1, 12))


@settings(derandomize=True, max_examples=300)
@given(arrays.arrays(np.int32, SHAPES, elements=st.integers(-1, 2)))
def test_random_stencils_are_scipys(stencil):
    assert_right(stencil)


@pytest.mark.parametrize("density", [0.1, 0.4, 0.6, 0.9])
@pytest.mark.parametrize("idents", [1, 3])
def test_large_random_stencils_are_scipys(density, idents):
    rng = np.random.default_rng(5)
    stencil = rng.integers(1, idents + 1, (97, 83)) * (rng.random((97, 83)) < density)
    assert_right(stencil.astype(np.int32))


@settings(derandomize=True, max_examples=50)
@given(st.lists(st.tuples(*[st.integers(0, 30)] * 2, st.integers(1, 9), st.integers(-1, 3))))
def test_blobs_are_scipys(discs):
    rows, columns = np.mgrid[0:31, 0:31]
    stencil = np.zeros((31, 31), np.int32)
    for y, x, size, ident in discs:
        stencil[(rows - y) ** 2 + (columns - x) ** 2 < size**2] = ident
    assert_right(stencil)


def test_the_naive_twin_agrees():
    stencil = np.random.default_rng(6).integers(-1, 3, (14, 17)).astype(np.int32)
    labels, _ = labelled(stencil)
    for number, component in enumerate(components(stencil), 1):
        assert component == {(int(i), int(j)) for i, j in np.argwhere(labels == number)}
    assert number == labels.max()


def spiral(size: int) -> np.ndarray:
    """A path one pixel wide from the outside in, with gaps of one pixel."""
    out = np.zeros((size, size), np.int32)
    i, j, di, dj = 0, 0, 0, 1
    out[0, 0] = 1

    def free(y: int, x: int) -> bool:
        return 0 <= y < size and 0 <= x < size and out[y, x] == 0

    while True:
        ahead, beyond = (i + di, j + dj), (i + 2 * di, j + 2 * dj)
        blocked = not free(*ahead) or (min(beyond) >= 0 and max(beyond) < size and out[beyond])
        if blocked:
            di, dj = dj, -di
            ahead, beyond = (i + di, j + dj), (i + 2 * di, j + 2 * dj)
            if not free(*ahead) or (max(beyond) < size and out[beyond]):
                return out
        i, j = ahead
        out[i, j] = 1


@pytest.mark.parametrize("turns", range(4))
def test_a_spiral_is_one(turns):
    stencil = np.rot90(spiral(41), turns).copy()
    assert 700 < stencil.sum() < 1000
    labels, areas = labelled(stencil)
    np.testing.assert_array_equal(labels, stencil)
    assert areas[1] == stencil.sum()
    both = stencil + 2 * (1 - stencil)  # what is between the arms is a spiral too
    assert_right(both)


def test_combs_are_joined_from_the_last_row():
    stencil = np.zeros((40, 61), np.int32)
    stencil[:, ::2] = 1
    assert labelled(stencil)[0].max() == 31
    stencil[-1] = 1
    labels, _ = labelled(stencil)
    np.testing.assert_array_equal(labels, stencil)


def test_objects_of_different_ids_that_touch_are_apart():
    labels, areas = labelled(drawn("1122", "1122", "..33"))
    np.testing.assert_array_equal(labels, drawn("1122", "1122", "..33"))
    np.testing.assert_array_equal(areas, [2, 4, 4, 2])


def test_a_diagonal_touch_joins():
    assert labelled(drawn("1.1", ".1.", "1.1"))[0].max() == 1
    assert labelled(drawn("12", "21"))[0].max() == 2


def test_numbers_go_by_first_pixels():
    labels, _ = labelled(drawn("..5.", "7.5.", "....", "5..9"))
    np.testing.assert_array_equal(labels, drawn("..1.", "2.1.", "....", "3..4"))


def test_background_and_mixed_pixels_are_none():
    labels, areas = labelled(drawn("-.-", "1-1", ".-."))
    np.testing.assert_array_equal(labels, drawn("...", "1.2", "..."))
    np.testing.assert_array_equal(areas, [7, 1, 1])
    empty, areas = labelled(np.zeros((3, 5), np.int32))
    assert not empty.any() and areas.tolist() == [15]


def test_ids_use_the_whole_range():
    stencil = np.array([[2**31 - 1, -(2**31), 2**31 - 2]], np.int32)
    np.testing.assert_array_equal(labelled(stencil)[0], [[1, 0, 2]])
