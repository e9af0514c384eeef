"""Alpha in another layer or part than the beauty's: taken, or named where several may be it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from tests.blender_layers import FLOAT, HALF, Planes, layer
from tests.cli import shots
from tests.cli.conftest import run_quietly
from tests.cli.street import Street
from tests.matrix import combinations

SPELLINGS: dict[str, Mapping[str, Mapping[str, str]]] = {
    "plain": {"": {"R": "R", "G": "G", "B": "B", "A": "A"}},
    "renderman": {"": {"R": "Ci.r", "G": "Ci.g", "B": "Ci.b", "A": "a"}},
    "alpha layer": {"": {"R": "R", "G": "G", "B": "B", "A": "Alpha.V"}},
    "alpha part": {"rgb": {"R": "R", "G": "G", "B": "B"}, "alpha": {"A": "A"}},
    "bare alpha": {"": {"R": "beauty.R", "G": "beauty.G", "B": "beauty.B", "A": "A"}},
}
"""Names of the channels by part and by what they hold."""


def writer(spelling: str, *more: str) -> Callable[[Path, Street, float], None]:
    """Return what writes a frame of the box on nothing; `more` are further alphas."""

    def write(path: Path, street: Street, time: float) -> None:
        g = street.geometry(time)
        matte = g["id"][..., None] * np.linspace(0.5, 1, street.width)[:, None]
        planes = layer("", "RGBA", np.concatenate([street.colour(time)[..., :3] * matte, matte], 2))
        kinds = {"A": FLOAT} | dict.fromkeys("RGB", HALF)
        parts: dict[str, Planes] = {
            part: {name: planes[letter].astype(kinds[letter]) for letter, name in names.items()}
            for part, names in SPELLINGS[spelling].items()
        }
        first = next(iter(parts.values()))
        first |= {name: planes["A"] for name in more}
        data = layer("Z", "Z", np.where(g["id"] > 0, g["depth"], 0)) | layer(
            "forward", "uv", g["following"] * g["id"][..., None] * [1, -1]
        )
        if list(parts) == [""]:
            first |= data
        else:
            parts["data"] = data
        shots.write(path, parts)

    return write


def channels_of(path: Path) -> set[str]:
    """Return the names of a file's channels, with their part where there are several."""

    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name for part in file.parts for name in part.channels}


def plane_of(path: Path, name: str) -> np.ndarray:

    with OpenEXR.File(str(path), separate_channels=True) as file:
        planes = {n: c.pixels for part in file.parts for n, c in part.channels.items()}
    return planes[name]


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Callable[[str, str], Path]:
    """Return the first interval's frames, by spelling and method; each made once, read only."""

    @cache
    def run(spelling: str, method: str) -> Path:
        root = tmp_path_factory.mktemp("made")
        keys = shots.sequence(root / "keys", writer(spelling), (1, 2), shots.SMALL)
        options = ("-m", method, *shots.FORWARD, "--frames", 1)
        run_quietly("upsample", keys, "-o", root / "out", *options)
        return root / "out"

    return run


@pytest.mark.parametrize(
    ("spelling", "method"),
    combinations([name for name in SPELLINGS if name != "plain"], ["s6", "softsplat"]),
)
def test_it_is_warped_with_the_colour_under_its_own_name(made, spelling, method):
    names = {letter: name for part in SPELLINGS[spelling].values() for letter, name in part.items()}
    for number in (2, 3, 4):
        got = made(spelling, method) / f"shot.{number:04d}.exr"
        plain = made("plain", method) / got.name
        assert channels_of(got) == set(names.values())
        assert plane_of(got, names["A"]).dtype == np.float32
        for letter, name in names.items():
            np.testing.assert_array_equal(plane_of(got, name), plane_of(plain, letter))
        assert plane_of(got, names["A"]).max() > 0.5 and plane_of(got, names["A"]).min() == 0


def test_of_several_none_is_taken_and_they_are_named(exwarp, upsample, tmp_path):
    keys = shots.sequence(tmp_path / "keys", writer("renderman", "Alpha.V"), (1, 2), shots.SMALL)
    said = "alpha is left out, as a, Alpha.V may each be it"
    result = exwarp("upsample", keys, "-o", tmp_path / "out", "-m", "s6", *shots.FORWARD)
    assert result.code == 0 and said in result.err
    assert channels_of(tmp_path / "out/shot.0002.exr") == {"Ci.r", "Ci.g", "Ci.b"}
    assert said in exwarp("inspect", keys).out
    chosen = tmp_path / "map.toml"
    chosen.write_text('[channels]\ncolour = ["Ci.r", "Ci.g", "Ci.b", "Alpha.V"]\n')
    result = upsample(keys, tmp_path / "b", "-m", "s6", *shots.FORWARD, "--channel-map", chosen)
    assert "alpha is left out" not in result.err
    assert channels_of(tmp_path / "b/shot.0002.exr") == {"Ci.r", "Ci.g", "Ci.b", "Alpha.V"}


def test_a_matte_of_another_name_is_no_alpha(exwarp, tmp_path):
    def write(path: Path, street: Street, time: float) -> None:
        planes = shots.plain_planes(street, time)
        planes["hero_mask.A"] = planes.pop("A")
        shots.write(path, {"": planes})

    keys = shots.sequence(tmp_path / "keys", write, (1, 2), shots.SMALL)
    row = next(line for line in exwarp("inspect", keys).out.splitlines() if "colour" in line)
    assert "R, G, B" in row and "hero_mask" not in row
