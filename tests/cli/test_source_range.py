"""New frames hold no colour that the rendered ones do not hold, whatever a network answers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli import shots
from tests.cli.shots import FORWARD, SMALL
from tests.cli.street import Street
from tests.unit.tiny_interpolators import PAIR, convolution, put
from tests.unit.tiny_models import filled_warp, save

KEYS, BLACK = 5, 4


def writer(change: Callable[[dict[str, np.ndarray], np.ndarray, float], None]) -> Any:
    """Write the plain shot after a change of its colour; no value is negative."""

    def frame(path: Path, street: Street, time: float) -> None:
        planes = shots.plain_planes(street, time)
        for letter in "RGB":
            planes[letter] = np.abs(planes[letter])
        change(planes, street.geometry(time)["id"] == 1, time)
        shots.write(path, {"": planes})

    return frame


def element(planes: dict[str, np.ndarray], inside: np.ndarray, time: float) -> None:
    """The moving box alone, on nothing."""
    for letter in "RGBA":
        planes[letter] = np.where(inside, planes[letter], 0).astype(np.float16)


def blackout(planes: dict[str, np.ndarray], inside: np.ndarray, time: float) -> None:
    """One key frame is black."""
    for letter in "RGB":
        planes[letter] *= np.float16(time != BLACK - 1)


def networks(folder: Path) -> dict[str, tuple[object, ...]]:
    """Options of networks that answer with negative and too bright colour, or spread it."""
    dark = save(folder / "dark.onnx", filled_warp(gain=-3))
    timed = {"inputs": PAIR | {"timestep": "time"}}
    odd = put(folder / "odd.onnx", convolution(), timed)
    return {
        **{name: ("-m", name, "--extrapolator", dark) for name in ("s1", "s3", "s4", "s5")},
        "onnx": ("-m", "onnx", "--interpolator", odd),
    }


@pytest.mark.parametrize("name", ["s1", "s3", "s4", "s5", "onnx"])
def test_an_element_gets_no_negatives_and_no_ghost(upsample, tmp_path, name):
    keys = shots.sequence(tmp_path / "keys", writer(element), range(1, KEYS + 1), SMALL)
    upsample(keys, tmp_path / "out", *networks(tmp_path)[name], *FORWARD)
    most = max(shots.colour_of(keys / file)[..., :3].max() for file in shots.names(keys))
    for file in shots.names(tmp_path / "out"):
        pixels = shots.colour_of(tmp_path / "out" / file)
        assert pixels.min() >= 0 and pixels[..., :3].max() <= most
        assert (pixels[pixels[..., 3] == 0] == 0).all(), file


@pytest.mark.parametrize("method", ["causal", "s3"])
def test_a_black_key_frame_makes_black_frames(upsample, tmp_path, method):
    """With the network that comes with ExWarp, which sees brighter frames before."""
    keys = shots.sequence(tmp_path / "keys", writer(blackout), range(1, KEYS + 1), SMALL)
    upsample(keys, tmp_path / "out", "-m", method, *FORWARD)
    for slot in range(4):
        pixels = shots.colour_of(tmp_path / "out" / f"shot.{4 * BLACK - 3 + slot:04d}.exr")
        assert (pixels[..., :3] == 0).all()
    after = shots.colour_of(tmp_path / "out" / f"shot.{4 * BLACK + 3:04d}.exr")
    assert np.median(after[..., :3]) > 0.1
