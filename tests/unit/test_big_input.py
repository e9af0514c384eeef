"""The enlarged example of the benches: how its frames go on, and that its vectors follow."""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from tests.bench import big_input
from tests.bench.big_input import played

KEYS = Path(__file__).parents[2] / "examples" / "market" / "keys"


def test_frames_go_forth_and_back_and_forth() -> None:
    assert [now for now, _, _ in played(4, 9)] == [0, 1, 2, 3, 2, 1, 0, 1, 2]


def test_neighbours_are_what_is_shown_before_and_after() -> None:
    shown = played(4, 9)
    for (now, _, after), (following, before, _) in pairwise(shown):
        assert (after, before) == (following, now)


def test_as_many_frames_as_there_are_keep_their_own_vectors() -> None:
    assert all(before < now < after for now, before, after in played(4, 4))


@pytest.mark.skipif(sys.platform == "win32", reason="links")
def test_a_longer_sequence_takes_no_more_room(tmp_path: Path) -> None:
    arguments = [str(tmp_path), "--keys", str(KEYS), "--height", "36", "--count", "24"]
    assert big_input.main(arguments) == 0
    files = sorted(tmp_path.iterdir())
    assert len(files) == 24
    assert len({file.stat().st_ino for file in files}) == 16
    size = _channels(files[0])["ViewLayer.Depth.Z"].shape
    assert size == (36, 64)


def test_vectors_change_places_where_time_runs_backward(tmp_path: Path) -> None:
    arguments = [str(tmp_path), "--keys", str(KEYS), "--height", "180", "--count", "10"]
    assert big_input.main(arguments) == 0
    files = sorted(tmp_path.iterdir())
    there, turn, back = (_vectors(file) for file in (files[7], files[8], files[9]))
    rendered = _vectors(sorted(KEYS.glob("*.exr"))[7])
    np.testing.assert_array_equal(there, rendered)
    # X and Y lead back, Z and W on, with the reverse sign.
    np.testing.assert_array_equal(back, -rendered[[2, 3, 0, 1]])
    np.testing.assert_array_equal(turn[2:], -turn[:2])
    np.testing.assert_array_equal(_colour(files[9]), _colour(files[7]))


def test_an_input_is_made_in_another_compression(tmp_path: Path) -> None:
    arguments = [str(tmp_path), "--keys", str(KEYS), "--height", "36", "--count", "1"]
    assert big_input.main([*arguments, "--compression", "piz"]) == 0
    with OpenEXR.File(str(next(tmp_path.iterdir())), header_only=True) as file:
        found = {part.header["compression"] for part in file.parts}
    assert found == {OpenEXR.PIZ_COMPRESSION}


def _channels(file: Path) -> dict[str, np.ndarray]:
    with OpenEXR.File(str(file), separate_channels=True) as opened:
        return {name: c.pixels for part in opened.parts for name, c in part.channels.items()}


def _vectors(file: Path) -> np.ndarray:
    """Return [4, H, W] in the order X, Y, Z, W."""
    channels = _channels(file)
    return np.stack([channels[f"ViewLayer.Vector.{axis}"] for axis in "XYZW"])


def _colour(file: Path) -> np.ndarray:
    return _channels(file)["ViewLayer.Combined.G"]
