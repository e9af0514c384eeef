"""Frames that say they are huge are refused before anything is made of them."""

from __future__ import annotations

import pytest

from tests.cli import shots
from tests.cli.shots import SMALL


@pytest.mark.parametrize("command", ["inspect", "features", "upsample", "compare"])
def test_more_than_allowed(exwarp, plain_shot, tmp_path, command):
    more = {"upsample": ("-o", tmp_path / "out"), "compare": (plain_shot,)}.get(command, ())
    pixels = SMALL.width * SMALL.height
    refused = exwarp(command, plain_shot, *more, "--max-pixels", 100)
    refused.refused(3, "shot.0001.exr", "100", "--max-pixels")
    assert not (tmp_path / "out").exists()
    assert exwarp(command, plain_shot, *more, "--max-pixels", 10 * pixels).code == 0


def test_windows_far_apart(exwarp, tmp_path):
    """Each of the two is small, and what holds both is not."""
    far = shots.header(
        dataWindow=shots.window(0, 100_000, 48, 27), displayWindow=shots.window(0, 0, 48, 27)
    )
    planes = shots.plain_planes(SMALL, 0)
    for number in (1, 2):
        shots.write(tmp_path / "keys" / f"shot.{number:04d}.exr", {"": planes}, far)
    refused = exwarp("inspect", tmp_path / "keys", "--max-pixels", 1_000_000)
    refused.refused(3, "48x100027", "--max-pixels")


def test_data_windows_that_change(exwarp, tmp_path):
    for number, (x, y) in enumerate([(0, 20_000), (20_000, 0), (0, 0)], start=1):
        head = shots.header(
            dataWindow=shots.window(x, y, 48, 27), displayWindow=shots.window(0, 0, 48, 27)
        )
        planes = shots.plain_planes(SMALL, 0)
        shots.write(tmp_path / "keys" / f"shot.{number:04d}.exr", {"": planes}, head)
    options = ("-m", "softsplat", "--motion", "forward", "--cuts", "none", "--progress", "none")
    bound = ("--max-pixels", 2_000_000)
    refused = exwarp("upsample", tmp_path / "keys", "-o", tmp_path / "out", *options, *bound)
    refused.refused(3, "frame 1 and the next one", "--max-pixels")
