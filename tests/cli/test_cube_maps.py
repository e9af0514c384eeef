"""Cube maps: six faces in one image, maybe with smaller levels. New frames have all of it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from tests.cli import shots
from tests.cli.shots import FORWARD, read
from tests.cli.street import Street

WIDTH, HEIGHT = 16, 96
STREET = Street(WIDTH, HEIGHT)


def still_planes() -> shots.Planes:
    """A picture in which nothing moves."""
    planes = shots.plain_planes(STREET, 0.0)
    return {k: v * 0 if k.startswith("forward") else v for k, v in planes.items()}


def write_cube(path: Path, levels: bool) -> None:
    """Write a tiled cube map, as OpenImageIO writes its levels."""
    path.parent.mkdir(parents=True, exist_ok=True)
    planes = still_planes()
    pixels = np.stack([plane.astype(np.float32) for plane in planes.values()], -1)
    out, level = oiio.ImageOutput.create(str(path)), 0
    while True:
        width, height = max(1, WIDTH >> level), max(1, HEIGHT >> level)
        spec = oiio.ImageSpec(width, height, len(planes), "float")
        spec.channelnames = tuple(planes)
        spec.tile_width = spec.tile_height = 16
        spec.attribute("textureformat", "CubeFace Environment")
        spec.attribute("openexr:levelmode", int(levels))
        assert out.open(str(path), spec, "AppendMIPLevel" if level else "Create")
        step = 1 << level
        assert out.write_image(np.ascontiguousarray(pixels[::step, ::step][:height, :width]))
        if not levels or width == height == 1:
            break
        level += 1
    out.close()


@pytest.mark.parametrize("levels", [False, True], ids=["one level", "all levels"])
def test_new_frames_keep_the_window_and_every_face(exwarp, upsample, tmp_path, levels):
    for number in (1, 2, 3):
        write_cube(tmp_path / "keys" / f"shot.{number:04d}.exr", levels)
    found = json.loads(exwarp("inspect", tmp_path / "keys", "--json").out)
    assert (found["width"], found["height"]) == (WIDTH, HEIGHT)
    upsample(tmp_path / "keys", tmp_path / "out", "-m", "s6", *FORWARD)
    expected = still_planes()
    for number in (2, 3, 4):
        header, planes = read(tmp_path / "out" / f"shot.{number:04d}.exr")
        for window in ("dataWindow", "displayWindow"):
            assert np.array(header[window]).tolist() == [[0, 0], [WIDTH - 1, HEIGHT - 1]]
        assert int(header["envmap"]) == 1
        for name in "RGB":
            assert np.abs(planes[name] - expected[name]).max() <= 0.002
