"""Passes that are cut to the pixels that are not 0: beyond their data window they are 0."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from tests.blender_layers import HALF, Planes, layer
from tests.cli import shots
from tests.cli.street import Street
from tests.unit.exr_files import write_parts

WIDTH, HEIGHT, SIZE, STEP = 64, 40, 12, 8
BEAUTY = ("rgba", "Combined")
DISPLAY = shots.window(0, 0, WIDTH, HEIGHT)


def square_shot(time: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the colour, and where the square is: it moves over a wall before a still camera."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    colour = np.stack([0.5 + 0.3 * np.sin(x * k + y / k) for k in (0.4, 0.7, 1.1)], -1)
    left = round(8 + STEP * time)
    square = (slice(14, 14 + SIZE), slice(left, left + SIZE))
    inner = np.arange(SIZE)
    colour[square] = 0.2 + 0.6 * ((inner[:, None] // 3 + inner[None] // 3) % 2)[..., None]
    shown = np.zeros((HEIGHT, WIDTH), bool)
    shown[square] = True
    return np.concatenate([colour, np.ones((HEIGHT, WIDTH, 1))], -1), shown


def square_parts(time: float) -> dict[str, Planes]:
    """Return the passes of the square: of the wall, vectors and ids are 0."""
    colour, shown = square_shot(time)
    return {
        "rgba": layer("", "RGBA", colour, HALF),
        "forward": layer("forward", "uv", shown[..., None] * [STEP, 0.0]),
        "Z": layer("", "Z", np.where(shown, 5.0, 9.0)),
        "id": layer("id", "X", shown.astype(float)),
    }


def street_parts(time: float) -> dict[str, Planes]:
    """Return the street's passes, whose sky is 0 in all of them."""
    street = Street(WIDTH, HEIGHT)
    parts = {}
    for planes in shots.blender_passes(street, time):
        name = next(iter(planes)).rsplit(".", 1)[0]
        parts[name] = planes
    far = parts["Depth"]["Depth.Z"]
    far[far > 1e9] = 0
    return parts


def trimmed(planes: Planes) -> tuple[Planes, Mapping]:
    """Cut channels to the pixels where one of them is not 0."""
    y, x = np.nonzero(np.any([plane != 0 for plane in planes.values()], axis=0))
    top, bottom, left, right = y.min(), y.max() + 1, x.min(), x.max() + 1
    cut = {name: plane[top:bottom, left:right].copy() for name, plane in planes.items()}
    return cut, {"dataWindow": shots.window(left, top, right - left, bottom - top)}


def write_keys(folder: Path, parts_at, trim: bool) -> Path:
    folder.mkdir()
    for key in range(3):
        parts = {
            name: trimmed(planes) if trim and name not in BEAUTY else (planes, {})
            for name, planes in parts_at(key).items()
        }
        whole = {n: (p, {"displayWindow": DISPLAY, **more}) for n, (p, more) in parts.items()}
        write_parts(folder / f"shot.{1 + key:04d}.exr", whole)
    return folder


@pytest.mark.parametrize("method", ["s6", "softsplat"])
@pytest.mark.parametrize(
    ("parts_at", "motion"),
    [(square_parts, "next=u,-v"), (street_parts, "previous=X,-Y next=-Z,W")],
)
def test_trimmed_passes_give_the_frames_of_full_ones(upsample, tmp_path, parts_at, motion, method):
    for name, trim in (("full", False), ("cut", True)):
        keys = write_keys(tmp_path / name, parts_at, trim)
        upsample(keys, tmp_path / f"out-{name}", "-m", method, "--motion", motion)
    for name in shots.names(tmp_path / "out-full"):
        full, cut = (shots.colour_of(tmp_path / f"out-{kind}" / name) for kind in ("full", "cut"))
        np.testing.assert_array_equal(full, cut)


def test_a_vector_file_cut_to_what_moves_leaves_the_rest_in_place(upsample, tmp_path):
    keys = write_keys(tmp_path / "keys", lambda t: {"rgba": square_parts(t)["rgba"]}, False)
    (tmp_path / "mv").mkdir()
    for key in range(3):
        cut, place = trimmed(square_parts(key)["forward"])
        whole = {"displayWindow": DISPLAY, **place}
        shots.write(tmp_path / f"mv/v.{1 + key:04d}.exr", {"": cut}, shots.header(**whole))
    options = ("--aov", f"motion={tmp_path / 'mv'}", "--motion", "next=u,-v")
    upsample(keys, tmp_path / "out", "-m", "s6", *options)
    got = shots.colour_of(tmp_path / "out/shot.0003.exr")
    true, shown = square_shot(0.5)
    assert shots.psnr(true[shown], got[shown]) > 40
    left_behind = square_shot(0)[1] & ~shown  # which no key frame so far has shown
    np.testing.assert_allclose(got[~shown & ~left_behind], true[~shown & ~left_behind], atol=1e-3)
