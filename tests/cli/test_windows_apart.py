"""Data windows that have no pixel in common with the display window."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli import shots
from tests.cli.shots import SMALL, colour_of, names

DISPLAY = shots.window(0, 0, 48, 27)


def write_shot(folder: Path, apart: tuple[int, ...]) -> Path:
    """Write frames 1 to 6, some of which lie beyond the display window's right edge."""
    for number in range(1, 7):
        data = shots.window(48 if number in apart else 0, 0, 48, 27)
        shots.write(
            folder / f"shot.{number:04d}.exr",
            {"": shots.plain_planes(SMALL, float(number))},
            shots.header(dataWindow=data, displayWindow=DISPLAY),
        )
    return folder


@pytest.mark.parametrize("command", [("inspect",), ("upsample", "-m", "hold"), ("upsample",)])
def test_all_of_them_are_refused_by_what_they_are(exwarp, tmp_path, command):
    keys = write_shot(tmp_path / "keys", apart=(1, 2, 3, 4, 5, 6))
    name, *options = command
    output = ("-o", tmp_path / "out", "--progress", "none") if name == "upsample" else ()
    result = exwarp(name, keys, *output, *options)
    result.refused(3, "the data window 48x27+48+0 of", "apart from its display window 48x27+0+0")
    assert "NaN" not in result.err and not (tmp_path / "out").exists()


def test_what_enters_later_is_measured_where_it_is_seen(exwarp, upsample, tmp_path):
    keys = write_shot(tmp_path / "keys", apart=(1, 2))
    found = exwarp("inspect", keys)
    assert found.code == 0
    assert "measured on frames 3-4" in " ".join(found.out.split())
    upsample(keys, tmp_path / "out", "-m", "s6")
    assert len(names(tmp_path / "out")) == 24
    assert colour_of(tmp_path / "out" / "shot.0010.exr").any()
