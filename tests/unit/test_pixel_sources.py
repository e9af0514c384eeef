"""Layers that must not be mixed: what is not finite in them is taken from what is beside."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.domain.frame import nonfinite_pixels
from exwarp_cli.io.channels import Role
from exwarp_cli.io.shot import count_nonfinite
from exwarp_cli.synthesis.layer_retiming import PixelSources, unmoved_sources

SHAPE = (5, 7)
BROKEN = (np.nan, np.inf, -np.inf)


def sources(depth: np.ndarray | None = None) -> PixelSources:
    """A slot that shows a key frame of one depth as it is, or of others."""
    return unmoved_sources(SHAPE, np.ones(SHAPE, np.float32) if depth is None else depth)


def plane(kind: type = np.float32) -> np.ndarray:
    """Each pixel's own number."""
    return np.arange(SHAPE[0] * SHAPE[1]).reshape(SHAPE).astype(kind)


@pytest.mark.parametrize("kind", [np.float16, np.float32, np.uint32])
def test_what_is_whole_stays_as_it_is(kind):
    whole = plane(kind)
    sources().mend([whole])
    np.testing.assert_array_equal(whole, plane(kind))


@pytest.mark.parametrize("value", BROKEN)
@pytest.mark.parametrize("kind", [np.float16, np.float32])
def test_all_channels_come_from_one_whole_pixel_beside(kind, value):
    x, y, ids = plane(kind), plane(kind) + kind(100), plane(np.uint32)
    x[2, 3] = y[2, 4] = value
    sources().mend([x, y, ids])
    assert np.isfinite(x).all() and np.isfinite(y).all()
    for place in ((2, 3), (2, 4)):
        row, column = divmod(int(ids[place]), SHAPE[1])
        assert (row, column) not in ((2, 3), (2, 4))
        assert max(abs(row - place[0]), abs(column - place[1])) == 1
        assert x[place] == ids[place] and y[place] == ids[place] + 100
    rest = np.ones(SHAPE, np.bool_)
    rest[2, 3] = rest[2, 4] = False
    assert (x[rest] == plane(kind)[rest]).all() and (ids[rest] == plane(np.uint32)[rest]).all()


def test_it_is_that_of_the_same_surface():
    """Left of the pixel something near, right of it what it belongs to."""
    depth = np.full(SHAPE, 1.0, np.float32)
    depth[:, 3:] = 8.0
    x = plane()
    x[2, 3] = np.nan
    sources(depth).mend([x])
    assert x[2, 3] in (plane()[2, 4], plane()[1, 3], plane()[3, 3])


def test_on_the_background_and_where_nothing_is_whole_it_is_nothing():
    depth = np.full(SHAPE, 1.0, np.float32)
    depth[2, 3] = np.inf
    x, ids = plane(), plane(np.uint32)
    x[2, 3] = np.nan
    sources(depth).mend([x, ids])
    assert x[2, 3] == 0 and ids[2, 3] == 0
    x[:] = np.inf
    sources().mend([x])
    assert (x == 0).all()


def test_a_depth_may_be_infinite_and_what_is_unknown_is_so():
    x = plane()
    x[0], x[2, 3], x[4] = np.inf, np.nan, -np.inf
    depth = np.where(np.isfinite(x), x + 1, np.inf).astype(np.float32)
    sources(depth).mend([x], np.inf)
    assert (x[0] == np.inf).all() and x[2, 3] == np.inf and (x[4] == -np.inf).all()


@pytest.mark.parametrize("unknown", [None, np.full(SHAPE, np.nan, np.float32)])
def test_without_a_depth_all_surfaces_are_alike(unknown):
    x = plane()
    x[2, 3] = np.inf
    unmoved_sources(SHAPE, unknown).mend([x])
    assert x[2, 3] in plane()[1:4, 2:5] and x[2, 3] != plane()[2, 3]


@pytest.mark.parametrize("value", BROKEN)
@pytest.mark.parametrize("kind", [np.float16, np.float32])
def test_broken_pixels_are_found_in_both_types(kind, value):
    pixels = np.zeros((*SHAPE, 3), kind)
    assert not nonfinite_pixels(pixels).any()
    pixels[1, 2, 0] = pixels[1, 2, 2] = pixels[4, 6, 1] = value
    assert np.argwhere(nonfinite_pixels(pixels)).tolist() == [[1, 2], [4, 6]]
    assert count_nonfinite((pixels,)) == 2
    assert count_nonfinite(pixels[..., i] for i in range(3)) == 2
    assert count_nonfinite((pixels,), Role.DEPTH) == (2 if np.isnan(value) else 0)
    assert count_nonfinite((plane(np.uint32),)) == 0
