"""The kind of a shot's depth: measured in its first frame where nothing else tells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.io.channels import Role
from exwarp_cli.io.depth import DepthKind, DepthReading
from exwarp_cli.io.frames import read_raw
from exwarp_cli.io.shot import Shot, open_shot
from exwarp_cli.pipeline.depth_and_ids import with_depth_measured, with_world_positions
from tests.blender_layers import layer
from tests.unit.exr_files import write_single
from tests.unit.scenes import town


def shot(folder: Path, name: str, depth: np.ndarray, position: bool = True) -> Shot:
    view = town((64, 40)).view(1.0)
    where = view.gbuffer(motion=False).position
    planes = {
        **layer("", "RGBA", view.colour),
        **layer(name, "R", depth),
        **(layer("P", "XYZ", where) if position else {}),
    }
    write_single(folder / "a.0001.exr", planes)
    return open_shot(str(folder))


@pytest.fixture
def distance() -> np.ndarray:
    return town((64, 40)).view(1.0).depth


def test_an_inverse_depth_is_turned_round(tmp_path, distance):
    found = with_depth_measured(shot(tmp_path, "Z", 1 / distance))
    assert found.depth.kind is DepthKind.INVERSE and found.depth.measured
    read = read_raw(found, 1).gbuffer.depth
    assert read is not None
    np.testing.assert_array_equal(np.isinf(read), np.isinf(distance))
    solid = np.isfinite(distance)
    np.testing.assert_allclose(read[solid], distance[solid], rtol=1e-3)


def test_a_distance_stays_as_it_is(tmp_path, distance):
    found = with_depth_measured(shot(tmp_path, "Z", np.where(np.isinf(distance), 0, distance)))
    assert found.depth.kind is DepthKind.AXIS
    read = read_raw(found, 1).gbuffer.depth
    np.testing.assert_array_equal(read, distance.astype(np.float32))


@pytest.mark.parametrize("position", [True, False])
def test_negative_distances_count(tmp_path, distance, position):
    found = with_depth_measured(shot(tmp_path, "Z", -distance, position))
    assert found.depth.kind is DepthKind.NEGATIVE and "|z|" in found.depth.evidence
    read = read_raw(found, 1).gbuffer.depth
    np.testing.assert_array_equal(read, distance.astype(np.float32))


def test_without_positions_nothing_is_measured(tmp_path, distance):
    opened = shot(tmp_path, "Z", 1 / distance, position=False)
    assert with_depth_measured(opened) is opened


def test_what_is_known_stands(tmp_path, distance):
    opened = shot(tmp_path, "Z", 1 / distance)
    given = replace(opened, depth=DepthReading(DepthKind.RAY))
    assert with_depth_measured(given) is given
    blender = replace(opened, layout=replace(opened.layout, producer="Blender"))
    assert with_depth_measured(blender) is blender


def test_a_kind_that_is_given_stands(tmp_path, distance):
    opened = shot(tmp_path, "Z", 1 / distance)
    given = replace(opened, depth=DepthReading(DepthKind.NORMALISED))
    assert with_depth_measured(given) is given


def test_the_range_of_a_kind_that_is_given_is_measured(tmp_path, distance):
    # A graphics card's depth is an inverse that grows with the distance: its kind alone misleads.
    opened = shot(tmp_path, "Z", 40 / 39 * (1 - 1 / distance))
    found = with_depth_measured(replace(opened, depth=DepthReading(DepthKind.INVERSE)))
    read, solid = read_raw(found, 1).gbuffer.depth, np.isfinite(distance)
    assert read is not None
    np.testing.assert_allclose(read[solid], distance[solid], rtol=1e-2)


class TestPositions:
    def shot(self, folder: Path, times: tuple[float, ...], space: str) -> Shot:
        for i, time in enumerate(times):
            view = town((64, 40)).view(time)
            where = view.gbuffer(motion=False).position
            assert where is not None
            if space == "camera":
                x, y = np.meshgrid(np.arange(64) - 30.5, np.arange(40) - 18.0)
                far = np.where(np.isinf(view.depth), 0, view.depth)
                where = np.stack([x / 50 * far, -y / 50 * far, -far], -1).astype(np.float16)
            planes = {**layer("", "RGBA", view.colour), **layer("P", "XYZ", where)}
            write_single(folder / f"a.{i:04d}.exr", planes)
        return open_shot(str(folder))

    def test_relative_to_a_moving_camera_they_are_left_out_and_it_is_said(self, tmp_path):
        found = with_world_positions(self.shot(tmp_path, (0, 4), "camera"))
        assert Role.POSITION not in found.layout and Role.COLOUR in found.layout
        assert found.layout.incomplete == {Role.POSITION: "'P' is relative to the camera"}

    @pytest.mark.parametrize(
        ("times", "space"),
        [((0, 1), "world"), ((0, 4), "world"), ((0, 0), "camera"), ((0,), "camera")],
    )
    def test_others_stay(self, tmp_path, times, space):
        opened = self.shot(tmp_path, times, space)
        assert with_world_positions(opened) is opened

    def test_what_a_producer_writes_for_certain_is_not_looked_at(self, tmp_path):
        opened = self.shot(tmp_path, (0, 4), "camera")
        known = replace(opened, layout=replace(opened.layout, producer="Blender"))
        assert with_world_positions(known) is known
