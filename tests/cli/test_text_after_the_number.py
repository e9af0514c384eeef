"""Frames whose names go on after the number: ``beauty_####_denoised.exr``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli import shots
from tests.cli.pictures import frame, write_still
from tests.cli.street import Street

TINY = Street(16, 9)


@pytest.fixture
def keys(tmp_path) -> Path:
    """Three key frames of a denoised beauty."""
    for time, number in enumerate((101, 102, 103)):
        path = tmp_path / f"keys/sh010_v002_{number:04d}_denoised.exr"
        shots.plain(path, TINY, time)
    return tmp_path / "keys"


def expected(text: str, first: int = 101, count: int = 12) -> list[str]:
    return [f"sh010_v002_{first + i:04d}{text}" for i in range(count)]


@pytest.mark.parametrize(
    "spec", ["", "sh010_v002_####_denoised.exr", "sh010_v002_0102_denoised.exr"]
)
def test_new_frames_keep_it(keys, upsample, tmp_path, spec):
    out, holes = tmp_path / "out", tmp_path / "holes"
    options = ("-m", "s6", *shots.FORWARD, "--write-holes", holes)
    upsample(keys / spec, out, *options)
    assert shots.names(out) == expected("_denoised.exr")
    assert set(shots.names(holes)) < set(expected("_denoised.exr"))
    for key, slot in ((101, 101), (102, 105), (103, 109)):
        written = out / f"sh010_v002_{slot:04d}_denoised.exr"
        source = keys / f"sh010_v002_{key:04d}_denoised.exr"
        assert written.read_bytes() == shots.passed_through(source, 120)


def test_a_run_is_finished_and_scored_by_such_names(keys, exwarp, upsample, tmp_path):
    out = tmp_path / "out"
    upsample(keys, out, "-m", "s6", *shots.FORWARD)
    before = shots.contents(out)
    (out / "sh010_v002_0103_denoised.exr").unlink()
    upsample(keys, out, "-m", "s6", *shots.FORWARD, "--skip-existing")
    assert shots.contents(out) == before
    compared = exwarp("compare", out, out, "--json")
    assert compared.code == 0, compared.err
    assert json.loads(compared.out)["quality"]["all"]["psnr_db"] == 100


def test_a_pattern_in_o_sets_the_text(keys, upsample, tmp_path):
    upsample(keys, tmp_path / "out/x.####_hi.exr", "-m", "s6", *shots.FORWARD)
    assert shots.names(tmp_path / "out")[:2] == ["x.0101_hi.exr", "x.0102_hi.exr"]
    source = keys / "sh010_v002_0101_denoised.exr"
    written = tmp_path / "out/x.0101_hi.exr"
    assert written.read_bytes() == shots.passed_through(source, 120)


def test_stills_have_it_too(upsample, tmp_path):
    for number in (1, 2):
        write_still(tmp_path / f"keys/a.{number:04d}_left.png", frame(number))
    upsample(tmp_path / "keys", tmp_path / "out", "-m", "blend")
    assert shots.names(tmp_path / "out")[:2] == ["a.0001_left.png", "a.0002_left.png"]
    upsample(tmp_path / "keys", tmp_path / "exr/b.####_left.exr", "-m", "blend")
    assert shots.names(tmp_path / "exr")[:2] == ["b.0001_left.exr", "b.0002_left.exr"]
    assert shots.colour_of(tmp_path / "exr/b.0002_left.exr").shape == (48, 64, 3)
