"""Motion of one surface each at silhouettes: against the naive twin, and cases with known ends."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.kernels.silhouettes import SAME_DEPTH, SEARCH_RADIUS
from tests.reference import edges as naive
from tests.unit.kernel_calls import NO_IDS, edges_found, projected, settled
from tests.unit.test_kernels_edges import SHAPE, SQUARE, patches, square


def placed(rigid: np.ndarray) -> np.ndarray:
    """World positions that the camera (X, Y, Z) sees away from their pixels by `rigid`."""
    rows, columns = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]]
    moved = columns + rigid[..., 0], rows + rigid[..., 1], np.ones(SHAPE)
    return np.stack(moved, axis=-1).astype(np.float32)


def shifted(right: float, down: float) -> np.ndarray:
    """Cameras that see points (X, Y, 1, 1) and background so far from where this frame does."""
    near = np.array([[1, 0, right, 0], [0, 1, down, 0], [0, 0, 1, 0]], float)
    far = near.copy()
    far[:, 3] = 1
    return np.stack([near, far])


def unmixed(
    vectors: np.ndarray, depth: np.ndarray, stencil: np.ndarray = NO_IDS, known: bool = True
) -> np.ndarray:
    """Settle vectors where what stands still moves by (1, 1)."""
    cameras = shifted(1, 1) if known else np.full((2, 3, 4), np.nan)
    found, _ = settled((vectors, None), None, depth, np.stack([cameras, cameras]), stencil)
    return found


class TestBesideTheNaiveTwin:
    @pytest.mark.parametrize("seed", range(4))
    @pytest.mark.parametrize("with_ids", [False, True])
    @pytest.mark.parametrize("with_places", [False, True])
    def test_it_is_the_same(self, seed, with_ids, with_places):
        rng = np.random.default_rng(seed)
        depth, stencil = patches(seed)
        ids = stencil if with_ids else NO_IDS
        places = placed(rng.normal(0, 3, (*SHAPE, 2)))
        places[rng.random(SHAPE) < 0.05] = np.nan
        places[rng.random(SHAPE) < 0.05, 2] = -1  # behind the camera
        cameras = np.stack([shifted(0.5, -1), shifted(-2, 1.5)])
        cameras[..., :3] += rng.normal(0, 0.003, (2, 2, 3, 3))
        where = places if with_places else None
        motions = [projected(where, depth, near, far[:, :3])[0] for near, far in cameras]
        vectors = [motion + rng.normal(0, 0.2, motion.shape) for motion in motions]
        for way in vectors:
            way[rng.random(SHAPE) < 0.1] += 4
            way[rng.random(SHAPE) < 0.05] = np.nan
        given = tuple(way.astype(np.float32) for way in vectors)
        found = settled(given, where, depth, cameras, ids)
        (edge,) = edges_found(depth, ids)
        surfaces = depth, stencil if with_ids else None, edge
        for way, motion, out in zip(given, motions, found, strict=True):
            expected = naive.unmix(way, motion, surfaces, 0.25, (SAME_DEPTH, SEARCH_RADIUS))
            np.testing.assert_array_equal(out, expected)
            assert (out != way).any()

    def test_either_way_alone_is_the_same(self):
        depth, stencil = patches(5)
        vectors = np.random.default_rng(5).normal(0, 1, (2, *SHAPE, 2)).astype(np.float32)
        cameras = np.stack([shifted(0.5, 0), shifted(0, 0.5)])
        both = settled((vectors[0], vectors[1]), None, depth, cameras, stencil)
        before = settled((vectors[0], None), None, depth, cameras, stencil)
        after = settled((None, vectors[1]), None, depth, cameras, stencil)
        np.testing.assert_array_equal(both[0], before[0])
        np.testing.assert_array_equal(both[1], after[1])
        assert before[1].size == after[0].size == 0

    def test_zeros_keep_their_sign_in_the_background(self):
        """-0 times x, at the frame's left: what the projection itself has there."""
        cameras = shifted(0, 0)
        cameras[1, 0, :3] = -1, -0.0, -0.0
        depth = np.full(SHAPE, np.inf, np.float32)
        expected = projected(None, depth, cameras[0], cameras[1, :, :3])[0]
        given = np.ones((*SHAPE, 2), np.float32)
        found, _ = settled((given, None), None, depth, np.stack([cameras] * 2))
        assert found.tobytes() == expected.tobytes()
        assert np.signbit(found[0, 0, 0])


def test_infinite_motion_inside_a_surface_is_not_static():
    rigid = np.ones((*SHAPE, 2), np.float32)
    vectors = rigid.copy()
    vectors[3, 4], vectors[5, 6, 1] = (np.inf, 1), -np.inf
    rigid[7, 8] = np.inf
    depth, cameras = np.full(SHAPE, 3, np.float32), np.stack([shifted(0, 0)] * 2)
    found, _ = settled((vectors, None), placed(rigid), depth, cameras)
    np.testing.assert_array_equal(found, vectors)


def scene(behind: float = 8.0) -> tuple[np.ndarray, ...]:
    """A square that moves by (5, 0) before a wall that the camera moves by (1, 1).

    The renderer's filter has mixed the vectors at the silhouette.
    """
    exact = np.ones((*SHAPE, 2), np.float32)
    exact[SQUARE] = (5, 0)
    depth = square(behind=behind)
    (edge,) = edges_found(depth)
    vectors = exact.copy()
    vectors[edge] = (3, 0.5)
    return vectors, depth, exact


def test_a_moving_square_gets_its_own_motion_up_to_its_rim():
    vectors, depth, exact = scene()
    np.testing.assert_array_equal(unmixed(vectors, depth), exact)


def test_background_follows_the_cameras():
    vectors, depth, exact = scene(behind=np.inf)
    vectors[np.isinf(depth)] = 0  # as renderers write it
    np.testing.assert_array_equal(unmixed(vectors, depth), exact)


def test_without_cameras_the_inside_decides():
    vectors, depth, exact = scene()
    np.testing.assert_array_equal(unmixed(vectors, depth, known=False), exact)


def test_static_pixels_take_the_cameras_exact_motion():
    places = placed(np.random.default_rng(1).normal(0, 3, (*SHAPE, 2)))
    cameras, depth = np.stack([shifted(0, 0)] * 2), square()
    (rigid,) = projected(places, depth, cameras[0, 0], cameras[0, 1, :, :3])
    vectors = rigid + np.float32(0.1)
    found, _ = settled((vectors, None), places, depth, cameras)
    np.testing.assert_array_equal(found, rigid)
    (edge,) = edges_found(depth)
    moving, _ = settled((vectors, None), places, depth, cameras, np.ones(SHAPE, np.int32))
    np.testing.assert_array_equal(moving[~edge], vectors[~edge])


@pytest.mark.parametrize(("ident", "moves"), [(0, False), (7, True)])
def test_thin_structures_are_static_unless_an_id_moves(ident, moves):
    depth, stencil = np.full(SHAPE, 8, np.float32), np.zeros(SHAPE, np.int32)
    depth[:, 9], stencil[:, 9] = 2, ident
    vectors = np.ones((*SHAPE, 2), np.float32)
    vectors[:, 8:11] = (3, 0.5)
    found = unmixed(vectors, depth, stencil)
    assert (found[:, 9] == ((3, 0.5) if moves else (1, 1))).all()
    assert (np.delete(found, 9, axis=1) == 1).all()
