"""NaN and infinities in any layer of a key frame: counted, and never in a frame that is made."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from tests.blender_layers import HALF, Planes, layer, multipart
from tests.cli import shots
from tests.cli.street import Street
from tests.matrix import combinations
from tests.stereo_layouts import LAYOUTS
from tests.stereo_shots import eyes_at, write_stereo

pytestmark = pytest.mark.usefixtures("unpainted_plots")

STREET = Street(48, 27)
SPOILT = 2
"""Number of the key frame that is spoilt."""

BLOCK = np.s_[8:14, 15:25]
"""Where: on the wall, the box and the floor."""

PIXELS = 60
VALUES = {"nan": np.nan, "inf": np.inf, "minus inf": -np.inf}
MADE = [number for number in range(2, 13) if number % 4 != 1]
"""Frames between the key frames, and after the last."""

LAYERS = {
    "Combined": ("RGB", "colour"),
    "Diffuse Direct": ("RGB", "ViewLayer.Diffuse Direct"),
    "Vector": ("XYZW", "motion"),
    "Depth": ("Z", "depth"),
    "Normal": ("XYZ", "normal"),
    "Position": ("XYZ", "position"),
    "Object Index": ("X", "stencil"),
    "Tangent": ("UV", "ViewLayer.Tangent"),
}
"""The letters of each layer, and what the report calls it."""


def passes(street: Street, time: float) -> list[Planes]:
    """Blender's passes, light, and a vector of no known meaning."""
    colour = street.colour(time)
    return [
        *shots.blender_passes(street, time),
        layer("Diffuse Direct", "RGB", colour[..., :3], HALF),
        layer("Tangent", "UV", np.full((*colour.shape[:2], 2), 0.25), HALF),
    ]


def spoilt(planes: Planes, name: str, letters: str, value: float) -> Planes:
    """Return a file's channels, some of which have a block of a value."""
    for letter in letters:
        plane = planes[f"{name}.{letter}"] = planes[f"{name}.{letter}"].copy()
        plane[BLOCK] = value
    return planes


def write(folder: Path, name: str, value: float, letters: str = "") -> Path:
    """Write three key frames, one of them with a layer spoilt."""

    def frame(path: Path, street: Street, time: float) -> None:
        groups = passes(street, time)
        if time == SPOILT - 1:
            groups = [
                spoilt(planes, name, letters or LAYERS[name][0], value)
                if next(iter(planes)).startswith(f"{name}.")
                else planes
                for planes in groups
            ]
        shots.write(path, multipart(groups))

    return shots.sequence(folder, frame, street=STREET)


def channels_of(path: Path) -> dict[str, np.ndarray]:
    """Return all channels of a file, by name."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {
            name: channel.pixels.copy()
            for part in file.parts
            for name, channel in part.channels.items()
        }


def require_finite(folder: Path, numbers: Iterable[int]) -> None:
    """Require frames without NaN, and without infinities in anything but a depth."""
    for number in numbers:
        for name, plane in channels_of(folder / f"shot.{number:04d}.exr").items():
            bad = np.isnan(plane) if "Depth" in name else ~np.isfinite(plane)
            assert not bad.any(), (number, name)


def counts_of(report: Path) -> dict[tuple[int, int, str, str], int]:
    """Return what report.json tells, by key frame, slot, view and channels."""
    document: dict[str, Any] = json.loads((report / "report.json").read_text())
    return {
        (one["key"], one["slot"], one["view"], one["channels"]): one["pixels"]
        for one in document["nonfinite"]
    }


class TestLayers:
    """A block of one layer, on every surface there is."""

    @pytest.mark.parametrize(
        ("name", "how"), combinations(list(LAYERS), [("s6", "nan"), ("softsplat", "minus inf")])
    )
    def test_no_frame_has_any(self, upsample, tmp_path, name, how):
        method, value = how
        keys = write(tmp_path / "keys", name, VALUES[value])
        options = ("-m", method, "--layers", "all", *shots.VECTORS)
        found = upsample(keys, tmp_path / "out", *options, "--report", tmp_path / "report")
        require_finite(tmp_path / "out", MADE)
        for key, number in ((1, 1), (2, 5), (3, 9)):
            before = shots.passed_through(keys / f"shot.{key:04d}.exr", 120)
            assert (tmp_path / "out" / f"shot.{number:04d}.exr").read_bytes() == before
        counted = {(SPOILT, 0, "", LAYERS[name][1]): PIXELS}
        if name == "Depth" and value != "nan":
            counted = {}  # how the background is written
        assert counts_of(tmp_path / "report") == counted
        line = f"NaN or infinite in 1 frame of the input: {LAYERS[name][1]} in {PIXELS} pixels"
        assert (line in found.out) == bool(counted)
        page = (tmp_path / "report" / "report.html").read_text()
        assert ("Not finite in the input" in page) == bool(counted)

    @pytest.mark.parametrize(
        ("method", "name"), combinations(["s1", "blend", "s3", "hold"], ["Vector", "Position"])
    )
    def test_nor_by_other_methods(self, upsample, network, tmp_path, method, name):
        keys = write(tmp_path / "keys", name, np.nan)
        options = ("-m", method, "--layers", "all", *shots.VECTORS)
        if method.startswith("s"):
            options = (*options, "--extrapolator", network)
        upsample(keys, tmp_path / "out", *options)
        require_finite(tmp_path / "out", MADE)

    @pytest.mark.parametrize("letters", ["G", "A"])
    def test_one_channel_of_the_colour_is_enough(self, upsample, tmp_path, letters):
        keys = write(tmp_path / "keys", "Combined", np.nan, letters)
        upsample(keys, tmp_path / "out", "-m", "s6", "--report", tmp_path / "r", *shots.VECTORS)
        require_finite(tmp_path / "out", range(6, 9))
        assert counts_of(tmp_path / "r") == {(SPOILT, 0, "", "colour"): PIXELS}

    def test_surfaces_take_what_is_beside_them(self, upsample, tmp_path):
        """The street stands still, so what was there is what is there."""
        still = Street(48, 27, speed=0)

        def frame(path: Path, street: Street, time: float) -> None:
            planes = multipart(passes(still, 0.0))
            spoilt(planes["ViewLayer.Normal"], "ViewLayer.Normal", "XYZ", np.nan)
            shots.write(path, planes)

        shots.sequence(tmp_path / "keys", frame)
        upsample(tmp_path / "keys", tmp_path / "out", "-m", "s6", "--layers", "Normal")
        true = still.geometry(0.0)["normal"]
        made = channels_of(tmp_path / "out" / "shot.0003.exr")
        normal = np.stack([made[f"ViewLayer.Normal.{c}"] for c in "XYZ"], axis=-1)
        rest = np.ones(normal.shape[:2], np.bool_)
        rest[BLOCK] = False
        assert (normal[rest] == true[rest].astype(np.float32)).all()
        assert (normal[BLOCK] == true[BLOCK]).all(axis=-1).mean() > 0.8


def test_motion_that_is_not_known_is_that_of_its_surroundings(upsample, tmp_path):
    """As good as whole vectors, to the eye, where a few of a surface's are missing."""
    sound = shots.sequence(tmp_path / "sound", lambda *a: shots.write(
        a[0], multipart(passes(a[1], a[2]))), street=STREET)  # fmt: skip
    upsample(sound, tmp_path / "good", "-m", "s6", *shots.VECTORS)
    for value in VALUES.values():
        keys = write(tmp_path / f"keys{value}", "Vector", value)
        upsample(keys, tmp_path / f"out{value}", "-m", "s6", *shots.VECTORS)
        for number in (6, 7, 8):
            name = f"shot.{number:04d}.exr"
            good = shots.colour_of(tmp_path / "good" / name)
            assert shots.psnr(good, shots.colour_of(tmp_path / f"out{value}" / name)) > 25


def test_slots_of_their_own_are_counted_by_slot(upsample, tmp_path):
    street = STREET

    def instant(path: Path, _: Street, time: float) -> None:
        planes = shots.slot_planes(street, time)
        if time == 1.5:
            spoilt(planes, "Normal", "XYZ", np.inf)
        shots.write(path, {"": planes})

    shots.sequence(tmp_path / "keys", shots.colour_only, street=street)
    shots.sequence(tmp_path / "slots", instant, range(1, 10), street, 0.25)
    more = ("--gbuffers", tmp_path / "slots", "--report", tmp_path / "r", *shots.VECTORS)
    upsample(tmp_path / "keys", tmp_path / "out", "-m", "s6", "--no-tail", *more)
    require_finite(tmp_path / "out", range(1, 10))
    assert counts_of(tmp_path / "r") == {(2, 2, "", "normal"): PIXELS}


def test_views_are_counted_apart(upsample, tmp_path):
    folder, eyes = write_stereo(tmp_path / "keys", "parts"), eyes_at(1.0)
    spoilt(eyes["right"], "Combined", "RGB", np.nan)
    LAYOUTS["parts"](folder / "shot.0002.exr", eyes, 2)
    options = ("--view", "all", "-m", "softsplat", "--report", tmp_path / "r", *shots.VECTORS)
    upsample(folder, tmp_path / "out", *options)
    require_finite(tmp_path / "out", range(6, 9))
    assert counts_of(tmp_path / "r") == {(2, 0, "right", "colour"): PIXELS}


def test_chunks_tell_what_the_whole_does(exwarp, upsample, tmp_path):
    keys, more = write(tmp_path / "keys", "Vector", np.nan), ("-m", "softsplat", *shots.VECTORS)
    upsample(keys, tmp_path / "a", *more, "--report", tmp_path / "whole")
    for chunk in ("1-2", "3"):
        options = (*more, "--frames", chunk, "--as-chunk")
        upsample(keys, tmp_path / "b", *options, "--report", tmp_path / "r")
    assert exwarp("merge-reports", tmp_path / "r").code == 0
    assert counts_of(tmp_path / "whole") == {(2, 0, "", "motion"): PIXELS}
    assert counts_of(tmp_path / "r") == counts_of(tmp_path / "whole")


@pytest.mark.parametrize("colour", [shots.colour_only, shots.plain], ids=["estimated", "vectors"])
@pytest.mark.parametrize("method", ["softsplat", "blend"])
def test_numbers_at_the_end_of_the_range(
    upsample, tmp_path, method, colour: Callable[[Path, Street, float], None]
):
    """Nothing that is finite becomes infinite on the way."""

    def frame(path: Path, street: Street, time: float) -> None:
        colour(path, street, time)
        _, planes = shots.read(path)
        planes = {n: p.astype(np.float32) for n, p in planes.items()}
        for letter, size in zip("RGB", (3e38, -3e38, 1e30), strict=True):
            planes[letter][BLOCK] = size * (-1) ** time
        shots.write(path, {"": planes}, shots.HEADER)

    shots.sequence(tmp_path / "keys", frame, street=STREET)
    upsample(tmp_path / "keys", tmp_path / "out", "-m", method)
    require_finite(tmp_path / "out", range(2, 5))
