"""Frames of several resolutions in one sequence are named before any frame is made."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli import shots
from tests.cli.pictures import frame, write_still
from tests.cli.shots import FORWARD, names
from tests.cli.street import Street

HALF_SIZE = Street(24, 14)


@pytest.fixture
def mixed(tmp_path) -> Path:
    """Five frames, of which the fourth and the fifth have half the size."""
    folder = shots.sequence(tmp_path / "keys", shots.plain, street=shots.SMALL)
    for number in (4, 5):
        shots.plain(folder / f"shot.{number:04d}.exr", HALF_SIZE, float(number))
    return folder


@pytest.mark.parametrize("method", ["softsplat", "s6", "hold"])
def test_nothing_is_written(mixed, exwarp, tmp_path, method):
    out = tmp_path / "out"
    result = exwarp("upsample", mixed, "-o", out, "-m", method, *FORWARD, "--progress", "none")
    result.refused(3, "shot.0004.exr (and 1 more) is 24x14", "first frame is 48x27")
    result.refused(3, "at one resolution")
    assert not out.exists()


def test_inspect_says_so(mixed, exwarp):
    exwarp("inspect", mixed).refused(3, "shot.0004.exr (and 1 more) is 24x14")


def test_frames_that_are_not_asked_for_do_not_matter(mixed, exwarp, upsample, tmp_path):
    upsample(mixed, tmp_path / "s6", "-m", "s6", *FORWARD, "--frames", "1-2")
    assert len(names(tmp_path / "s6")) == 8
    options = ("-m", "softsplat", *FORWARD, "--progress", "none", "--frames", "1-3")
    result = exwarp("upsample", mixed, "-o", tmp_path / "out", *options)
    result.refused(3, "shot.0004.exr is 24x14")  # slots after 3 are made of 4, too
    assert not (tmp_path / "out").exists()


def test_keep_going_leaves_them_out(mixed, exwarp, tmp_path):
    options = ("-m", "s6", *FORWARD, "--keep-going", "--progress", "plain", "--threads", 1)
    result = exwarp("upsample", mixed, "-o", tmp_path / "out", *options)
    assert "left out" in result.err and "shot.0004.exr" in result.err
    assert {f"shot.{n:04d}.exr" for n in range(1, 13)} == set(names(tmp_path / "out"))


def test_a_pass_in_files_of_its_own(exwarp, tmp_path):
    for number in range(1, 5):
        shots.unreal(tmp_path / "keys", shots.SMALL, float(number), number)
    small = tmp_path / "small"
    shots.unreal(small, HALF_SIZE, 4.0, 4)
    (small / "P_SceneDepth.0004.exr").replace(tmp_path / "keys" / "P_SceneDepth.0004.exr")
    out = tmp_path / "out"
    result = exwarp("upsample", tmp_path / "keys", "-o", out, "-m", "s6", "--progress", "none")
    result.refused(3, "P_SceneDepth.0004.exr", "24x14")
    assert not out.exists()


def test_ground_truth(exwarp, tmp_path):
    keys = shots.sequence(tmp_path / "keys", shots.plain)
    truth = shots.truth(tmp_path / "truth")
    shots.plain(truth / "shot.0007.exr", HALF_SIZE, 2.5)
    out, options = tmp_path / "out", ("-m", "s6", *FORWARD, "--progress", "none")
    result = exwarp("upsample", keys, "-o", out, *options, "--ground-truth", truth)
    result.refused(3, "--ground-truth for frame 7 is 24x14")
    assert not out.exists()


def test_stills(exwarp, tmp_path):
    for number in range(4):
        picture = frame(number) if number < 3 else frame(number)[:, :-2]
        write_still(tmp_path / "keys" / f"pan.{number:04d}.png", picture)
    out = tmp_path / "out"
    result = exwarp("upsample", tmp_path / "keys", "-o", out, "--progress", "none")
    result.refused(3, "pan.0003.png is 62x48", "first frame is 64x48", "write all frames")
    assert not out.exists()


def test_a_header_that_begins_with_megabytes_of_names(exwarp, tmp_path):
    """Cryptomatte's manifests come before the display window."""
    folder = shots.sequence(tmp_path / "keys", shots.plain)
    shots.write(
        folder / "shot.0003.exr",
        {"": shots.plain_planes(HALF_SIZE, 3.0)},
        shots.header(**{"cryptomatte/1234567/manifest": "x" * 300_000}),
    )
    exwarp("inspect", folder).refused(3, "shot.0003.exr is 24x14")
