"""The kind of a shot's depth: measured in its first frame where nothing else tells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.io.depth import DepthKind, DepthReading
from exwarp_cli.io.frames import read_raw
from exwarp_cli.io.shot import Shot, open_shot
from exwarp_cli.pipeline.depth_kind import with_depth_measured
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


def test_without_positions_nothing_is_measured(tmp_path, distance):
    opened = shot(tmp_path, "Z", 1 / distance, position=False)
    assert with_depth_measured(opened) is opened


def test_what_is_known_stands(tmp_path, distance):
    opened = shot(tmp_path, "Z", 1 / distance)
    told = replace(opened, depth=DepthReading.of(DepthKind.RAY))
    assert with_depth_measured(told) is told
    blender = replace(opened, layout=replace(opened.layout, producer="Blender"))
    assert with_depth_measured(blender) is blender
