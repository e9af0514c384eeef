"""A shadow that moves by itself: how a warp carries it on depends on the key frame before."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.cli import shots
from tests.cli.shots import VECTORS
from tests.cli.street import Street
from tests.matrix import FULL

COUNT = 4
LAST = COUNT * 4
"""Frames that the key frames become, with those after the last one."""


class Shaded(Street):
    """The street with the shadow of something that flies by."""

    def colour(self, time: float) -> np.ndarray:
        y, x = np.mgrid[: self.height, : self.width]
        away = np.hypot(x - 16 - 6 * time, y - 20 - 2 * time)
        light = 1 - 0.8 / (1 + np.exp(away - 9))
        return np.asarray(super().colour(time) * np.stack([light] * 3 + [1 + 0 * light], axis=-1))


STREET = Shaded(speed=0.3)


@pytest.fixture(scope="module")
def keys(tmp_path_factory) -> Path:
    """Key frames with vectors both ways; read only."""
    folder = tmp_path_factory.mktemp("shaded") / "keys"
    return shots.sequence(folder, shots.blender4, range(1, COUNT + 1), STREET)


@pytest.fixture(scope="module")
def slots(tmp_path_factory) -> Path:
    """G-buffers of all slots up to the last key frame; read only."""
    folder = tmp_path_factory.mktemp("shaded") / "slots"
    return shots.sequence(folder, shots.slot_gbuffer, range(1, LAST - 2), STREET, 0.25)


@pytest.fixture
def rest(keys, upsample, tmp_path) -> Callable[[int], Path]:
    """Upsample the key frames from one on alone, numbered as in the whole; return the folder."""

    def run(first: int) -> Path:
        folder, out = tmp_path / "rest", tmp_path / "alone"
        folder.mkdir()
        for number in range(first, COUNT + 1):
            shutil.copy(keys / f"shot.{number:04d}.exr", folder)
        upsample(folder, out, "-m", "s6", *VECTORS, "--start-frame", 4 * first - 3)
        return out

    return run


def frame(folder: Path, number: int) -> np.ndarray:
    return shots.colour_of(folder / f"shot.{number:04d}.exr")


def assert_nothing_carried(folder: Path, alone: Path) -> None:
    """Compare the slots after the third key frame."""
    for number in (10, 11, 12):
        np.testing.assert_array_equal(frame(folder, number), frame(alone, number))


def test_light_goes_on_after_the_second_key_frame(keys, upsample, rest, tmp_path):
    upsample(keys, tmp_path / "whole", "-m", "s6", *VECTORS)
    alone = rest(2)
    for slot in (1, 2, 3):
        truth = STREET.colour(1 + slot / 4)
        carried, plain = frame(tmp_path / "whole", 5 + slot), frame(alone, 5 + slot)
        assert np.abs(carried - truth).mean() < 0.9 * np.abs(plain - truth).mean()


@pytest.mark.parametrize(
    ("method", "setting", "options"),
    [
        *([("s6", "key", ()), ("softsplat", "slot", ())] if FULL else []),
        ("s6", "key", ("--layers", "all")),
        ("s6", "slot", ()),
        ("s5", "key", ()),
        ("causal", "key", ()),
        ("softsplat", "key", ()),
    ],
)
def test_any_split_gives_the_whole(
    keys, slots, network, upsample, tmp_path, method, setting, options
):
    model = ("--extrapolator", network) if method in ("s5", "causal") else ()
    geometry = ("--gbuffers", slots) if setting == "slot" else ()
    asked = ("-m", method, *VECTORS, *model, *geometry, *options)
    upsample(keys, tmp_path / "whole", *asked)
    for chunk in ("4", "2-3", "1"):
        upsample(keys, tmp_path / "parts", *asked, "--frames", chunk)
    assert shots.contents(tmp_path / "parts") == shots.contents(tmp_path / "whole")


@pytest.mark.parametrize("method", ["s6", "softsplat"])
def test_threads_change_nothing(keys, upsample, tmp_path, method):
    for count in (1, 3):
        upsample(keys, tmp_path / str(count), "-m", method, *VECTORS, "--threads", count)
    assert shots.contents(tmp_path / "1") == shots.contents(tmp_path / "3")


def test_nothing_is_carried_across_a_cut(keys, upsample, rest, tmp_path):
    upsample(keys, tmp_path / "cut", "-m", "s6", *VECTORS, "--cuts", "3")
    assert_nothing_carried(tmp_path / "cut", rest(3))


def test_nothing_is_carried_from_a_key_frame_that_cannot_be_read(keys, exwarp, rest, tmp_path):
    broken = Path(shutil.copytree(keys, tmp_path / "broken"))
    shots.truncate(broken / "shot.0002.exr")
    asked = ("-m", "s6", *VECTORS, "--keep-going")
    result = exwarp("upsample", broken, "-o", tmp_path / "out", *asked)
    assert result.code == 12, result.err
    assert_nothing_carried(tmp_path / "out", rest(3))


def test_nothing_is_carried_after_a_picture_that_was_held(keys, upsample, rest, tmp_path):
    held = Path(shutil.copytree(keys, tmp_path / "held"))
    shutil.copy(keys / "shot.0003.exr", held / "shot.0002.exr")
    upsample(held, tmp_path / "out", "-m", "s6", *VECTORS, "--cuts", "none")
    assert_nothing_carried(tmp_path / "out", rest(3))


@pytest.mark.parametrize("method", ["s6", "softsplat"])
def test_resuming_makes_again_what_another_older_key_frame_changes(
    keys, upsample, tmp_path, method
):
    """Of look-ahead methods that is the end alone, as only that is warped from one key frame."""
    changed = Path(shutil.copytree(keys, tmp_path / "changed"))
    asked = ("-m", method, *VECTORS, "--cuts", "none")
    upsample(changed, tmp_path / "out", *asked)
    shots.blender4(changed / "shot.0003.exr", Street(speed=0.3), 2.0)
    renewed = shots.changed_by(
        lambda: upsample(changed, tmp_path / "out", *asked, "--skip-existing"), tmp_path / "out"
    )
    before = () if method == "s6" else (2,)
    assert renewed == {9} | shots.generated(*before, 3, 4)
    upsample(changed, tmp_path / "anew", *asked)
    assert shots.contents(tmp_path / "out") == shots.contents(tmp_path / "anew")
