"""What a depth channel holds: by world positions, by name, and as a distance."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from exwarp_cli.io.depth import (
    DEFAULT_READINGS,
    DepthKind,
    DepthReading,
    depth_reading_by_name,
    measure_depth_reading,
)
from tests.unit.scenes import town

NEAR, FAR = 1.0, 40.0


@cache
def geometry() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Distance along the axis and the ray (inf for sky), world positions, bool sky."""
    view = town((96, 60)).view(1.0)
    ray = np.linalg.norm(view.directions, axis=-1) * view.depth
    sky = np.isinf(view.depth)
    return view.depth, ray, np.where(sky[..., None], 0, view.world(1.0)), sky


def written(kind: str) -> np.ndarray:
    """Depth as renderers write it, background included."""
    z, ray, _, sky = geometry()
    with np.errstate(invalid="ignore"):
        values = {
            "axis": (z, 1e10),
            "centimetres": (100 * z, 65504.0),
            "ray": (ray, 0.0),
            "inverse": (1 / z, 0.0),
            "graphics card": (FAR / (FAR - NEAR) * (1 - NEAR / z), 1.0),
            "graphics card, reversed": (NEAR / (FAR - NEAR) * (FAR / z - 1), 0.0),
            "normalised": ((z - NEAR) / (FAR - NEAR), 1.0),
            "reversed": ((FAR - z) / (FAR - NEAR), 0.0),
        }[kind]
    return np.where(sky, values[1], values[0]).astype(np.float32)


def half(array: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore"):
        return array.astype(np.float16).astype(np.float32)


KINDS = {
    "axis": DepthKind.AXIS,
    "centimetres": DepthKind.AXIS,
    "ray": DepthKind.RAY,
    "inverse": DepthKind.INVERSE,
    "graphics card": DepthKind.INVERSE,
    "graphics card, reversed": DepthKind.INVERSE,
    "normalised": DepthKind.NORMALISED,
    "reversed": DepthKind.REVERSED,
}


class TestMeasured:
    @pytest.mark.parametrize("cast", [np.float32, half], ids=["float", "half"])
    @pytest.mark.parametrize("kind", KINDS)
    def test_every_kind(self, kind, cast):
        z, _, position, sky = geometry()
        depth = np.asarray(cast(written(kind)))
        found = measure_depth_reading(depth, np.asarray(cast(position)))
        assert found is not None and found.kind is KINDS[kind] and found.measured
        distance = found.distance(depth)
        if kind in ("axis", "centimetres", "ray"):
            assert distance is depth
        else:
            apart = np.abs(distance[~sky] / z[~sky] - 1)
            assert np.median(apart) < 0.01 and np.percentile(apart, 95) < 0.05
            assert np.isinf(distance[sky]).all()

    def test_the_order_alone_where_no_kind_fits(self):
        z, _, position, sky = geometry()
        depth = np.where(sky, 0, z**-3).astype(np.float32)
        found = measure_depth_reading(depth, position.astype(np.float32))
        assert found is not None and found.kind is DepthKind.INVERSE
        near_first = np.argsort(found.distance(depth)[~sky], kind="stable")
        assert (np.diff(z[~sky][near_first]) >= -1e-4).all()

    def test_a_distance_of_another_curve_is_left_alone(self):
        z, _, position, sky = geometry()
        depth = np.where(sky, 0, z**3).astype(np.float32)
        assert measure_depth_reading(depth, position.astype(np.float32)) is None

    def test_mixtures_at_silhouettes_do_not_matter(self):
        rng = np.random.default_rng(2)
        _, _, position, sky = geometry()
        mixed = rng.random(sky.shape) < 0.1
        spoiled = np.where(mixed[..., None], position + rng.normal(0, 3, position.shape), position)
        found = measure_depth_reading(written("reversed"), spoiled.astype(np.float32))
        assert found is not None and found.kind is DepthKind.REVERSED

    def test_positions_that_tell_nothing(self):
        z, _, position, _ = geometry()
        depth = written("axis")
        noise = np.random.default_rng(1).normal(0, 5, position.shape).astype(np.float32)
        assert measure_depth_reading(depth, noise) is None
        assert measure_depth_reading(depth, np.zeros_like(noise)) is None
        plane = town((96, 60)).view(0.0)
        wall = np.concatenate([plane.directions[..., :2] * 7, np.full((*z.shape, 1), 7.0)], -1)
        assert (
            measure_depth_reading(np.full(z.shape, 7, np.float32), wall.astype(np.float32)) is None
        )
        few = np.where(np.arange(z.size).reshape(z.shape)[..., None] < 150, position, 0)
        assert measure_depth_reading(depth, few.astype(np.float32)) is None

    def test_a_slanted_plane_does_not_fix_the_camera(self):
        directions = town((96, 60)).view(0.0).directions
        z = 1 / (0.15 - 0.05 * directions[..., 0])
        position = (directions * z[..., None]).astype(np.float32)
        for depth in (z, 1 / z, z**2):
            assert measure_depth_reading(depth.astype(np.float32), position) is None

    def test_an_orthographic_camera_tells_no_distance(self):
        y, x = np.mgrid[0:60, 0:96].astype(np.float64)
        z = 7 + 2 * np.sin(x / 9) * np.cos(y / 7)
        position = np.stack([0.1 * x, 0.1 * y, z], -1).astype(np.float32)
        assert measure_depth_reading(z.astype(np.float32), position) is None


class TestNamed:
    @pytest.mark.parametrize(
        "name", ["disparity.R", "A.Inverse Depth.Z", "inv_depth", "depth_inv.R"]
    )
    def test_inverse(self, name):
        assert depth_reading_by_name([name]) == DepthReading(DepthKind.INVERSE)

    @pytest.mark.parametrize("name", ["hitPz", "ray:hitPz", "X_WorldDepth.R"])
    def test_along_the_axis(self, name):
        assert depth_reading_by_name([name]).kind is DepthKind.AXIS

    @pytest.mark.parametrize("name", ["Z", "depth.Z", "zdepth.R", "investment.depth.Z"])
    def test_others_stay_unknown_and_as_they_are(self, name):
        found = depth_reading_by_name([name])
        assert found.kind is DepthKind.UNKNOWN and not found.measured
        depth = written("axis")
        assert found.distance(depth) is depth


@pytest.mark.parametrize("kind", [DepthKind.INVERSE, DepthKind.REVERSED, DepthKind.NORMALISED])
def test_without_positions_the_order_is_right(kind):
    names = {"inverse": "inverse", "reversed": "reversed", "normalised": "normalised"}
    z, _, _, sky = geometry()
    distance = DEFAULT_READINGS[kind].distance(written(names[kind.value]))
    assert np.isinf(distance[sky]).all() and np.isfinite(distance[~sky]).all()
    near_first = np.argsort(distance[~sky], kind="stable")
    assert (np.diff(z[~sky][near_first]) >= -1e-4).all()
    assert (distance[~sky] > 0).all()


@pytest.mark.parametrize("kind", [DepthKind.INVERSE, DepthKind.REVERSED])
def test_unusable_values_are_background(kind):
    depth = np.array([[0.0, -1.0, np.nan, -np.inf]], np.float32)
    assert np.isposinf(DEFAULT_READINGS[kind].distance(depth)).all()
