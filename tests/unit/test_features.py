"""Features of an instant: the naive twin, scenes with known answers, and what is missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from exwarp_cli.domain.decision import FEATURES, Features
from exwarp_cli.domain.frame import GBuffer, Window
from exwarp_cli.policy.state import BLOCK, MIN_PIXELS, observe
from tests.reference.features import features

HEIGHT, WIDTH = 70, 90
PARTS = ("depth", "normal", "position", "stencil", "to_previous", "to_next")


def instant(seed: int) -> GBuffer:
    """Random geometry under a strip of sky whose values would change every feature."""
    rng = np.random.default_rng(seed)
    shape = (HEIGHT, WIDTH)
    depth = rng.lognormal(2, 0.5, shape)
    normal = rng.normal((0.2 * seed, 0, 1), 0.3, (*shape, 3))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    position = rng.normal(seed, 4, (*shape, 3))
    stencil = (rng.random((14, 18)) < 0.3).repeat(5, 0).repeat(5, 1) * rng.integers(1, 4, shape)
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    motion = np.stack([np.sin(rows / 9), columns / 20], axis=-1) + rng.normal(0, 0.1, (*shape, 2))
    for values, sky in ((depth, np.inf), (position, 1e4), (normal, 9), (motion, 50), (stencil, 0)):
        values[: 20 + 3 * seed] = sky
    motion[30:50, 30:50] = np.nan
    parts = [values.astype(np.float32) for values in (depth, normal, position)]
    vectors = motion.astype(np.float32)
    return GBuffer(Window(-3, 5, WIDTH, HEIGHT), *parts, stencil.astype(np.int32), vectors)


def flat(motion: tuple[float, float] = (0, 0), size: tuple[int, int] = (64, 96)) -> GBuffer:
    """A wall with uniform motion."""
    window = Window(0, 0, size[1], size[0])
    normal = np.full((*size, 3), (0, 0, 1), np.float32)
    rows, columns = np.mgrid[0 : size[0], 0 : size[1]]
    position = np.stack([columns, rows, np.full(size, 7)], axis=-1).astype(np.float32)
    vectors = np.full((*size, 2), motion, np.float32)
    depth, stencil = np.full(size, 7, np.float32), np.zeros(size, np.int32)
    return GBuffer(window, depth, normal, position, stencil, vectors)


def count_objects(stencil: np.ndarray) -> int:
    height, width = stencil.shape
    return observe(GBuffer(Window(0, 0, width, height), stencil=stencil), None, 1).objects


@pytest.mark.parametrize("span", [1, 4])
@pytest.mark.parametrize("seed", range(3))
def test_they_are_the_naive_twins(seed, span):
    now, before = instant(seed), instant(seed + 1)
    found = observe(now, before, span)
    expected = features(vars(now), vars(before), span)
    np.testing.assert_allclose(found.values, expected, rtol=1e-9)
    assert (np.array(found.values) > 0).all()
    assert found.distance == np.median(now.depth[np.isfinite(now.depth)])


def test_values_are_in_the_order_of_their_names():
    found = Features(3, 0.1, 2.0, 4.0, 5.0, 640, 360, 8.0)
    named = dict(zip(FEATURES, found.values, strict=True))
    assert named == {
        "N_d": 3,
        "EMD_Wn": 0.1,
        "EMD_Wp": 2.0,
        "Var_x": 4.0,
        "Var_y": 5.0,
        "R": 640 * 360,
    }
    assert found.values[-1] == 230400


@pytest.mark.parametrize("motion", [(0, 0), (3.5, -20)])
def test_uniform_motion_has_no_variance(motion):
    found = observe(flat(motion), flat(motion), 1)
    assert found == Features(0, 0.0, 0.0, 0.0, 0.0, 96, 64, 7.0)


def test_halves_that_part_have_the_variance_of_their_motion():
    buffer = flat()
    assert buffer.to_previous is not None
    buffer.to_previous[:, :48] = (-6, 1)
    buffer.to_previous[:, 48:] = (6, 1)
    found = observe(buffer, None, 1)
    assert (found.var_x, found.var_y) == (36, 0)
    found = observe(buffer, None, 4)
    assert (found.var_x, found.var_y) == (36 / 16, 0)


def test_variance_is_that_of_blocks_and_not_of_pixels():
    buffer = flat()
    assert buffer.to_previous is not None
    buffer.to_previous[::2] += 8  # every block has the same mean
    assert BLOCK % 2 == 0
    assert observe(buffer, None, 1).var_x == 0


def test_what_moves_on_is_as_far_as_it_moved():
    before, now = flat(), flat()
    assert now.position is not None
    now.position[...] += np.array([3, 0, 0], np.float32)  # the mean of x, y and z is a third of it
    assert observe(now, before, 1).emd_position == pytest.approx(1.0, abs=100 / 256 / 3)
    assert observe(now, before, 4).emd_position == observe(now, before, 1).emd_position / 4
    assert observe(now, before, 1).emd_normal == 0


def test_the_first_instant_has_moved_from_nowhere():
    found = observe(instant(1), None, 1)
    assert (found.emd_normal, found.emd_position) == (0, 0)
    assert found == replace(observe(instant(1), instant(2), 1), emd_normal=0.0, emd_position=0.0)


def test_motion_to_the_next_instant_stands_in():
    buffer = instant(1)
    turned = replace(buffer, to_previous=None, to_next=buffer.to_previous)
    assert observe(turned, None, 1) == observe(buffer, None, 1)
    both = replace(buffer, to_next=np.zeros_like(buffer.to_previous))
    assert observe(both, None, 1) == observe(buffer, None, 1)


@pytest.mark.parametrize(
    ("part", "fields"),
    [
        ("normal", ["emd_normal"]),
        ("position", ["emd_position"]),
        ("stencil", ["objects"]),
        ("to_previous", ["var_x", "var_y"]),
    ],
)
def test_what_is_missing_is_0_and_nothing_else_changes(part, fields):
    now, before = instant(1), instant(2)
    whole = observe(now, before, 1)
    found = observe(now.without(part), before, 1)
    assert found == replace(whole, **{name: type(getattr(whole, name))(0) for name in fields})
    if part in ("normal", "position"):
        assert observe(now, before.without(part), 1) == found


def test_nothing_at_all_is_known_of_an_empty_buffer():
    empty = GBuffer(Window(0, 0, 5, 4))
    assert observe(empty, empty, 1) == Features(0, 0.0, 0.0, 0.0, 0.0, 5, 4, 0.0)


def test_sky_alone_has_no_features():
    sky = instant(1).without("stencil")
    assert sky.depth is not None
    sky.depth[:] = np.inf
    assert observe(sky, instant(2), 1) == Features(0, 0.0, 0.0, 0.0, 0.0, WIDTH, HEIGHT, 0.0)


class TestObjects:
    def squares(self, *areas: int, size: int = 40) -> np.ndarray:
        """Upright bars of these areas, all of one id."""
        out = np.zeros((size, size), np.int32)
        for column, area in enumerate(areas):
            out[:area, 2 * column] = 1
        return out

    def test_small_ones_are_left_out(self):
        assert MIN_PIXELS == 4
        assert count_objects(self.squares(1, 3, 4, 5, 40)) == 3

    def test_the_least_area_grows_with_the_frame(self):
        assert count_objects(self.squares(8, 9, 10, 400, size=300)) == 3  # 9 of 90,000 pixels

    def test_parts_of_one_object_count_each(self):
        stencil = np.zeros((40, 40), np.int32)
        stencil[5:10, 5:30] = 3
        assert count_objects(stencil) == 1
        stencil[:, 15] = 0
        assert count_objects(stencil) == 2
        stencil[5:10, 15] = 4
        assert count_objects(stencil) == 3


class TestDistance:
    def test_unusable_depth_does_not_count(self):
        buffer = flat()
        assert buffer.depth is not None
        buffer.depth[:20] = np.nan
        buffer.depth[20:40] = -5
        buffer.depth[40:60] = 0
        assert observe(buffer, None, 1).distance == 7
        buffer.depth[:] = np.nan
        assert observe(buffer, None, 1).distance == 0

    def test_positions_stand_in(self):
        buffer = flat().without("depth")
        assert buffer.position is not None
        buffer.position[...] = 10
        buffer.position[:, ::2] = (10, 16, 18)  # the mean is halfway between the two
        assert observe(buffer, None, 1).distance == 5
        buffer.position[:8] = np.nan
        buffer.position[8:16] = 0  # background
        assert observe(buffer, None, 1).distance == 5
        buffer.position[...] = np.nan
        assert observe(buffer, None, 1).distance == 0


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 3.4e38, -3.4e38])
@pytest.mark.parametrize("part", ["depth", "normal", "position", "to_previous"])
def test_unusable_values_never_reach_a_feature(part, value):
    for everywhere in (True, False):
        now, before = instant(1), instant(2)
        values = getattr(now, part)
        if everywhere:
            values[...] = value
        else:
            values[::3, ::2] = value
        for one, other in ((now, before), (before, now)):
            found = observe(one, other, 1)
            assert np.isfinite([*found.values, found.distance]).all()
            assert min(found.values) >= 0


@pytest.mark.parametrize("window", [Window(0, 0, WIDTH, HEIGHT), Window(-3, 5, HEIGHT, WIDTH)])
def test_other_windows_are_refused(window):
    with pytest.raises(ValueError, match="compared"):
        observe(instant(1), replace(instant(2), window=window), 1)


@pytest.mark.parametrize("span", [0, -1])
def test_a_span_of_nothing_is_refused(span):
    with pytest.raises(ValueError, match="1 or more"):
        observe(instant(1), None, span)


class TestBackground:
    @pytest.mark.parametrize("known", [PARTS, ("position", "normal"), ("normal",)])
    def test_each_part_tells(self, known):
        buffer = flat()
        assert buffer.depth is not None
        assert buffer.normal is not None and buffer.position is not None
        buffer.depth[:9], buffer.normal[:9], buffer.position[:9] = np.inf, 0, 0
        seen = buffer.without(*(part for part in PARTS if part not in known)).background
        assert seen[:9].all() and not seen[9:].any()

    def test_without_any_there_is_none(self):
        assert not flat().without("depth", "normal", "position").background.any()
