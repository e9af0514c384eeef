"""Vectors that are 0 throughout: refused while the picture moves, taken where nothing does."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.blender_layers import HALF, Planes, blender_depth, layer
from tests.cli import shots
from tests.cli.street import Street
from tests.matrix import combinations

MOVING, STILL = Street(96, 54, speed=2.0), Street(96, 54, speed=0.0)
ZERO = np.zeros((54, 96, 4))

Light = Callable[[np.ndarray, float], np.ndarray]


def steady(colour: np.ndarray, time: float) -> np.ndarray:
    return colour


def flickering(colour: np.ndarray, time: float) -> np.ndarray:
    """A lamp at the left goes on and off."""
    x = np.linspace(0, 1, colour.shape[1])[None, :, None]
    lamp = 1 + (2.5 * (1 - x) if int(time) % 2 else 0.3 * x)
    return np.concatenate([colour[..., :3] * lamp, colour[..., 3:]], axis=-1)


def shadowed(colour: np.ndarray, time: float) -> np.ndarray:
    """A soft shadow wanders over the picture."""
    y, x = np.mgrid[: colour.shape[0], : colour.shape[1]]
    far = np.hypot(x - 30 - 5 * time, y - 30)
    shade = np.clip(0.25 + (far - 8) / 4, 0.25, 1)[..., None]
    return np.concatenate([colour[..., :3] * shade, colour[..., 3:]], axis=-1)


def frames(
    folder: Path, street: Street, light: Light, beside: tuple[str, ...], motion: str = "Vector"
) -> Path:
    """Write four frames whose vectors are 0, with some geometry beside the colour."""
    for i in range(4):
        g = street.geometry(float(i))
        planes: Planes = layer("Combined", "RGBA", light(street.colour(float(i)), i), HALF)
        planes |= layer(motion, "XYZW", ZERO) if motion == "Vector" else layer(motion, "uv", ZERO)
        geometry = {
            "depth": layer("Depth", "Z", blender_depth(g["depth"])),
            "position": layer("Position", "XYZ", g["position"]),
            "ids": layer("IndexOB", "X", g["id"]),
        }
        for name in beside:
            planes |= geometry[name]
        shots.write(folder / f"shot.{i + 1:04d}.exr", {"": planes})
    return folder


BESIDE = [(), ("depth",), ("position",), ("depth", "position", "ids")]


@pytest.mark.parametrize("beside", BESIDE, ids=lambda names: "+".join(names) or "colour")
class TestVectorsOfZero:
    def test_a_panned_picture_is_refused_with_what_to_switch_off(self, exwarp, tmp_path, beside):
        keys = frames(tmp_path / "keys", MOVING, steady, beside)
        result = exwarp("upsample", keys, "-o", tmp_path / "out", "-m", "s6", "--progress", "none")
        words = ("are 0 throughout in frames 1-2", "while the picture moves", "motion blur was on")
        result.refused(4, *words, "Render Properties > Motion Blur")


@pytest.mark.parametrize(("beside", "light"), combinations(BESIDE, (flickering, shadowed, steady)))
def test_a_still_scene_runs_whatever_its_light_does(upsample, tmp_path, light, beside):
    keys = frames(tmp_path / "keys", STILL, light, beside)
    upsample(keys, tmp_path / "out", "-m", "softsplat")
    between = shots.colour_of(tmp_path / "out" / "shot.0003.exr")
    faded = (light(STILL.colour(0.0), 0) + light(STILL.colour(0.0), 1)) / 2
    assert shots.psnr(faded, between) > 30


def test_by_hand_they_are_taken(upsample, tmp_path):
    keys = frames(tmp_path / "keys", MOVING, steady, ("depth",))
    upsample(keys, tmp_path / "out", "-m", "s6", "--motion", "blender")


def test_methods_without_motion_do_not_mind(upsample, tmp_path):
    keys = frames(tmp_path / "keys", MOVING, steady, ("depth",))
    upsample(keys, tmp_path / "out", "-m", "blend")


def test_a_cut_between_still_shots_is_no_motion(upsample, tmp_path):
    keys = frames(tmp_path / "keys", STILL, steady, ("depth", "position"))
    other = Street(96, 54, speed=1.0)
    for number in (3, 4):
        g, colour = other.geometry(-20.0), other.colour(-20.0)
        planes = layer("Combined", "RGBA", colour, HALF) | layer("Vector", "XYZW", ZERO)
        planes |= layer("Depth", "Z", blender_depth(g["depth"]))
        planes |= layer("Position", "XYZ", g["position"])
        shots.write(keys / f"shot.{number:04d}.exr", {"": planes})
    result = upsample(keys, tmp_path / "out", "-m", "s6")
    assert "cut before key frame 3" in result.out


def test_the_message_names_the_setting_of_another_program(exwarp, tmp_path):
    keys = frames(tmp_path / "keys", MOVING, steady, ("depth",), motion="forward")
    result = exwarp("upsample", keys, "-o", tmp_path / "out", "-m", "s6", "--progress", "none")
    result.refused(4, "the motion channels u, v", "switch it off in the renderer's settings")
