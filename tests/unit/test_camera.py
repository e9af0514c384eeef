"""Recovering cameras: exact where the data is, robust where it is not, None where it must be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from exwarp_cli.domain.frame import GBuffer, Window
from exwarp_cli.synthesis.camera import (
    MIN_SAMPLES,
    camera_after,
    fit,
    pixels_at,
    scene_of,
    seen_by,
)
from tests.unit.scenes import SKY, View, town

CENTRE = np.array([63.5, 39.5])
FOCAL = 110.0


def turn(yaw: float, pitch: float) -> np.ndarray:
    a = np.array([[np.cos(yaw), 0, -np.sin(yaw)], [0, 1, 0], [np.sin(yaw), 0, np.cos(yaw)]])
    b = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    return b @ a


def projection(rotation: np.ndarray, place: tuple[float, float, float]) -> np.ndarray:
    intrinsics = np.array([[FOCAL, 0, CENTRE[0]], [0, FOCAL, CENTRE[1]], [0, 0, 1]])
    return intrinsics @ rotation @ np.column_stack([np.eye(3), -np.array(place)])


def project(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    image = points @ matrix.T
    return image[:, :2] / image[:, 2:]


def random_points(count: int = 800, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    points = rng.uniform((-6, -4, 4), (6, 4, 20), (count, 3))
    return np.column_stack([points, np.ones(count)])


MATRIX = projection(turn(0.1, -0.05), (0.4, -0.2, 0.3))


def error_of(camera: np.ndarray | None, points: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    assert camera is not None
    return np.linalg.norm(project(camera, points) - pixels, axis=-1)


class TestFit:
    @pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
    @pytest.mark.parametrize("shift", [0.0, 500.0])
    def test_exact_points_give_an_exact_camera_in_any_unit(self, scale, shift):
        points = random_points()
        pixels = project(MATRIX, points)
        world = points.copy()
        world[:, :3] = (points[:, :3] + shift) * scale
        camera = fit(world, pixels)
        assert error_of(camera, world, pixels).max() < 1e-4

    def test_it_predicts_points_that_it_has_not_seen(self):
        points, others = random_points(), random_points(300, 9)
        camera = fit(points, project(MATRIX, points))
        assert error_of(camera, others, project(MATRIX, others)).max() < 1e-4

    def test_a_fifth_of_outliers_does_not_matter(self):
        rng = np.random.default_rng(1)
        points = random_points()
        pixels = project(MATRIX, points)
        seen = pixels.copy()
        moving = rng.random(len(points)) < 0.2
        seen[moving] += rng.uniform(3, 12, (moving.sum(), 2))
        camera = fit(points, seen)
        assert error_of(camera, points, pixels).max() < 1e-4

    @pytest.mark.parametrize("share", [0.3, 0.4])
    def test_what_moves_as_one_does_not_take_the_camera_along(self, share):
        points = random_points(2000, 3)
        pixels = project(MATRIX, points)
        seen = pixels.copy()
        moving = points[:, 0] > np.quantile(points[:, 0], 1 - share)
        seen[moving] = project(projection(turn(0.1, -0.05), (1.2, 0.1, 0.3)), points[moving])
        camera = fit(points, seen, movers=True)
        assert error_of(camera, points, pixels).max() < 1e-4

    def test_points_without_a_value_are_left_out(self):
        points = random_points()
        pixels = project(MATRIX, points)
        points[::7, 0] = np.nan
        pixels[::5] = np.inf
        camera = fit(points, pixels)
        good = np.isfinite(points).all(axis=1) & np.isfinite(pixels).all(axis=1)
        assert error_of(camera, points[good], pixels[good]).max() < 1e-4

    def test_the_same_points_give_the_same_camera(self):
        points = random_points()
        pixels = project(MATRIX, points)
        first, second = fit(points, pixels), fit(points, pixels)
        assert first is not None and second is not None
        assert first.tobytes() == second.tobytes()

    @pytest.mark.parametrize("count", [0, 5, MIN_SAMPLES - 1])
    def test_too_few_points_are_no_camera(self, count):
        points = random_points(count)
        assert fit(points, project(MATRIX, points)) is None

    @pytest.mark.parametrize("normal", [(0, 0, 1), (0.3, 0.5, 1)])
    def test_points_of_one_plane_are_no_camera(self, normal):
        points = random_points()
        n = np.array(normal)
        points[:, 2] = (9 - points[:, :2] @ n[:2]) / n[2]
        assert fit(points, project(MATRIX, points)) is None

    def test_noise_is_no_camera(self):
        rng = np.random.default_rng(3)
        points = random_points()
        assert fit(points, rng.uniform(0, 100, (len(points), 2))) is None

    def test_one_point_many_times_is_no_camera(self):
        points = np.repeat(random_points(1), 200, axis=0)
        assert fit(points, project(MATRIX, points)) is None

    def test_what_lies_behind_the_camera_has_a_negative_depth(self):
        points = random_points()
        camera = fit(points, project(MATRIX, points))
        assert camera is not None
        assert (points @ camera.T)[:, 2].min() > 0
        assert (camera @ [0, 0, -5, 1])[2] < 0


def view(time: float = 0.0) -> View:
    return town().view(time)


def rigid(seen: View, gbuffer: GBuffer, time: float, use_ids: bool = True) -> np.ndarray:
    scene = scene_of(gbuffer)
    assert scene is not None
    stencil = gbuffer.stencil if use_ids else None
    camera = camera_after(scene, seen.motion_to(time, sky=False), stencil)
    assert camera is not None
    return seen_by(scene, camera)


def expected(seen: View, time: float) -> np.ndarray:
    """Motion that a static point would have at every pixel."""
    place = replace(
        seen.scene, quads=tuple(replace(q, velocity=0 * q.velocity) for q in seen.scene.quads)
    )
    # The box stands, at this view's time, where it is seen.
    quads = tuple(
        replace(still, origin=quad.corner(seen.time))
        for still, quad in zip(place.quads, seen.scene.quads, strict=True)
    )
    return replace(seen, scene=replace(place, quads=quads)).motion_to(time)


VARIANTS = {
    "positions and depth": {},
    "positions alone": {"depth": None},
    "depth alone": {"position": None},
}


class TestRigidMotion:
    @pytest.mark.parametrize("time", [-1.0, 1.0])
    @pytest.mark.parametrize("without", VARIANTS.values(), ids=VARIANTS)
    def test_it_is_exact_on_everything_static_and_on_the_sky(self, time, without):
        seen = view()
        found = rigid(seen, replace(seen.gbuffer(), **without), time)
        # Vectors, positions and depths are float32: 1e-4 px.
        np.testing.assert_allclose(found, expected(seen, time), rtol=0, atol=2e-4)

    def test_the_sky_moves_by_the_homography_of_the_turn(self):
        seen = view()
        camera = seen.scene.camera
        intrinsics = np.array(
            [[camera.focal, 0, CENTRE[0]], [0, camera.focal, CENTRE[1]], [0, 0, 1]]
        )
        turned = camera.rotation(1.0) @ camera.rotation(0.0).T
        homography = intrinsics @ turned @ np.linalg.inv(intrinsics)
        sky = seen.surface == SKY
        points = np.column_stack([seen.scene.grid[sky], np.ones(sky.sum())]) @ homography.T
        moved = points[:, :2] / points[:, 2:] - seen.scene.grid[sky]
        assert np.abs(moved).mean() > 0.5
        np.testing.assert_allclose(rigid(seen, seen.gbuffer(), 1.0)[sky], moved, rtol=0, atol=2e-4)

    @pytest.mark.parametrize("time", [-1.0, 1.0])
    def test_without_ids_a_box_on_a_sixth_of_the_surfaces_does_not_matter(self, time):
        seen = view()
        assert np.isin(seen.surface, (3, 4)).sum() / (seen.surface != SKY).sum() > 0.15
        found = rigid(seen, seen.gbuffer(), time, use_ids=False)
        np.testing.assert_allclose(found, expected(seen, time), rtol=0, atol=2e-4)

    def test_half_positions_still_fit(self):
        seen = view()
        buffer = seen.gbuffer()
        assert buffer.position is not None
        rounded = replace(buffer, position=buffer.position.astype(np.float16).astype(np.float32))
        found = rigid(seen, rounded, 1.0)
        assert np.abs(found - expected(seen, 1.0)).max() < 0.15
        sky = seen.surface == SKY
        assert np.abs(found - expected(seen, 1.0))[sky].max() < 0.05

    def test_garbage_vectors_imply_no_camera(self):
        seen = view()
        scene = scene_of(seen.gbuffer())
        assert scene is not None
        noise = np.random.default_rng(0).normal(0, 8, (*scene.depth.shape, 2)).astype(np.float32)
        assert camera_after(scene, noise, None) is None

    def test_unknown_vectors_imply_no_camera(self):
        seen = view()
        scene = scene_of(seen.gbuffer())
        assert scene is not None
        unknown = np.full((*scene.depth.shape, 2), np.nan, np.float32)
        assert camera_after(scene, unknown, None) is None


class TestScene:
    def test_nothing_known_gives_none(self):
        assert scene_of(GBuffer(Window(0, 0, 4, 3))) is None

    def test_positions_that_fit_no_camera_give_way_to_depth(self):
        buffer = view().gbuffer()
        noise = np.random.default_rng(1).normal(0, 5, (*buffer.window.shape, 3))
        found = scene_of(replace(buffer, position=noise.astype(np.float32)))
        assert found is not None and found.position.shape[0] == 0
        assert scene_of(replace(buffer, position=noise.astype(np.float32), depth=None)) is None

    @pytest.mark.parametrize("without", VARIANTS.values(), ids=VARIANTS)
    def test_background_is_known(self, without):
        seen = view()
        buffer = replace(seen.gbuffer(), **without)
        found = scene_of(buffer)
        assert found is not None
        np.testing.assert_array_equal(np.isinf(found.depth), seen.surface == SKY)
        np.testing.assert_array_equal(buffer.background, seen.surface == SKY)

    def test_points_are_homogeneous(self):
        seen = view()
        index = np.flatnonzero(seen.surface != SKY)[::50]
        by_position, by_depth = (
            scene_of(seen.gbuffer()),
            scene_of(replace(seen.gbuffer(), position=None)),
        )
        assert by_position is not None and by_depth is not None
        world = seen.world(0.0).reshape(-1, 3)[index]
        np.testing.assert_allclose(by_position.points(index)[:, :3], world, rtol=1e-6)
        assert (by_position.points(index)[:, 3] == 1).all()
        local = by_depth.points(index)
        np.testing.assert_allclose(1 / local[:, 3], seen.depth.ravel()[index], rtol=1e-6)
        np.testing.assert_array_equal(local[:, :2], seen.scene.grid.reshape(-1, 2)[index])

    def test_pixels_count_columns_first(self):
        assert pixels_at(np.array([0, 4, 14]), 5).tolist() == [[0, 0], [4, 0], [4, 2]]
