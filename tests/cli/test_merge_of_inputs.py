"""``exwarp merge-reports`` of other inputs and methods than renderings' usual ones."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.cli import shots
from tests.cli.pictures import frame, stills
from tests.cli.reports import album, rows, unmeasured
from tests.cli.shots import FORWARD, SMALL
from tests.stereo_shots import write_stereo
from tests.unit.tiny_interpolators import PAIR, convolution, put

pytestmark = pytest.mark.usefixtures("unpainted_plots")

TIMED = {"inputs": PAIR | {"timestep": "time"}, "name": "Tiny", "padding": {"multiple": 2}}
Shot = tuple[object, ...]


def of_stills(folder: Path) -> Shot:
    return stills(folder / "keys", map(frame, range(4))), "--factor", 2


def of_both_eyes(folder: Path) -> Shot:
    keys = write_stereo(folder / "keys", "single", range(1, 5))
    return keys, "-m", "s6", "--view", "all", "--layers", "all"


def of_a_network_of_others(folder: Path) -> Shot:
    keys = shots.sequence(folder / "keys", shots.colour_only, range(1, 5), SMALL)
    model = put(folder / "tiny.onnx", convolution(scale=2), TIMED)
    return keys, "-m", "onnx", "--interpolator", model


def without_frames(folder: Path) -> Shot:
    """From 24 to 60 fps without the tail, the last of four key frames falls to no output."""
    keys = shots.sequence(folder / "keys", numbers=range(1, 5))
    return keys, "-m", "blend", *FORWARD, "--fps", 24, "--to-fps", 60, "--no-tail"


def without_new_frames(folder: Path) -> Shot:
    """A cut at every key frame: all that is shown between them are repeats."""
    keys = shots.sequence(folder / "keys", numbers=range(1, 5))
    return keys, "-m", "hold", *FORWARD, "--cuts", "2,3,4"


CASES: list[Callable[[Path], Shot]] = [
    of_stills, of_both_eyes, of_a_network_of_others, without_frames, without_new_frames,
]  # fmt: skip


Document = dict[str, Any]


def is_as_it_is_called(case: Callable[[Path], Shot], found: Document) -> bool:
    """Return True if a case's report is of what it is called: else equality says little."""
    if case is of_stills:
        return bool(found["input"]["producer"] == "PNG images")
    if case is of_both_eyes:
        return len(found["views"]) == 2 and bool(found["layers"])
    if case is of_a_network_of_others:
        return bool(found["interpolator"]["name"] == "Tiny")
    return case is without_frames or (not found["frames"]["generated"] and len(found["cuts"]) == 3)


@pytest.mark.parametrize("case", CASES)
def test_chunks_tell_what_a_single_run_tells(exwarp, upsample, tmp_path, case):
    keys, *options = case(tmp_path)
    single, report = tmp_path / "single-report", tmp_path / "report"
    upsample(keys, tmp_path / "single", *options, "--report", single)
    assert is_as_it_is_called(case, unmeasured(single))
    for part in ("1,3", "2", "4"):
        more = ("--frames", part, "--report", report, "--as-chunk")
        upsample(keys, tmp_path / "parts", *options, *more)
    if case is without_frames:
        chunk = json.loads((report / "chunks" / "4" / "report.json").read_text())
        assert chunk["frames"]["written"] == 0
    result = exwarp("merge-reports", report)
    assert result.code == 0 and result.err == "", result.err
    assert unmeasured(report) == unmeasured(single)
    assert rows(report) == rows(single)
    if "data:image" in (single / "report.html").read_text():
        assert album(report) == album(single)
    assert shots.contents(tmp_path / "parts") == shots.contents(tmp_path / "single")
