"""Versions of one picture are easily taken for frames: `sh010_v001.exr`, `sh010_v002.exr` …"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli import shots
from tests.cli.shots import SMALL

VERSIONS = ["sh010_v{:03d}", "sh010v{}", "v{}", "beauty_Ver{:02d}", "a version{}", "a_0101_v{}"]
FRAMES = ["sh010_v002.{:04d}", "dev{:03d}", "cover{}", "sh010_{:04d}", "0101_v2_{:03d}"]


def write_shot(folder: Path, name: str, count: int = 3) -> Path:
    for number in range(1, count + 1):
        shots.plain(folder / f"{name.format(number)}.exr", SMALL, float(number))
    return folder


@pytest.mark.parametrize("name", VERSIONS)
def test_it_is_said(exwarp, tmp_path, name):
    keys = write_shot(tmp_path / "keys", name)
    options = ("-m", "hold", "--progress", "plain", "--threads", 1)
    made = exwarp("upsample", keys, "-o", tmp_path / "out", *options)
    assert made.code == 0, made.err
    said = [line for line in made.err.splitlines() if "look like versions" in line]
    assert len(said) == 1
    assert "are taken for frames" in said[0] and "give the frames of one version" in said[0]
    found = exwarp("inspect", keys)
    assert "look like versions" in found.out
    assert "look like versions" in json.loads(exwarp("inspect", keys, "--json").out)["naming_note"]


@pytest.mark.parametrize("name", FRAMES)
def test_nothing_is_said_of_frames(exwarp, tmp_path, name):
    keys = write_shot(tmp_path / "keys", name)
    assert json.loads(exwarp("inspect", keys, "--json").out)["naming_note"] is None


def test_nothing_is_said_of_a_single_file(exwarp, tmp_path):
    keys = write_shot(tmp_path / "keys", "sh010_v{:03d}", count=1)
    assert json.loads(exwarp("inspect", keys, "--json").out)["naming_note"] is None
