"""What a run says of its own frames: predicted errors, and the lists made of them."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli import cli
from exwarp_cli.domain.timeline import parse_frames
from tests.cli import shots
from tests.cli.reports import album, rows, unmeasured
from tests.cli.shots import VECTORS
from tests.cli.street import Street

pytestmark = pytest.mark.usefixtures("unpainted_plots")

COUNT = 5
STREET = Street(128, 72, speed=0.3)
SPOILT = 3
"""Key frame with a patch that no vector explains, as of a light that flashes."""

PATCH = slice(18, 36), slice(64, 96)


class Flashing(Street):
    """The street with a bright patch at one instant."""

    def colour(self, time: float) -> np.ndarray:
        out = super().colour(time)
        if time == SPOILT - 1:
            out[PATCH] = 1.0
        return out


@pytest.fixture(scope="module")
def keys(tmp_path_factory) -> Path:
    """Key frames of which one has a patch; read only."""
    folder = tmp_path_factory.mktemp("flashing") / "keys"
    street = Flashing(STREET.width, STREET.height, STREET.speed)
    return shots.sequence(folder, shots.blender4, range(1, COUNT + 1), street)


ASKED = ("-m", "softsplat", *VECTORS, "--cuts", "none")


@pytest.fixture(scope="module")
def whole(keys, tmp_path_factory) -> Path:
    """The folder of a run's report, beside its frames in "out"; read only."""
    root = tmp_path_factory.mktemp("whole")
    command = ("upsample", keys, "-o", root / "out", *ASKED, "--report", root / "report")
    assert cli.run([str(word) for word in (*command, "--threads", 3)]) == 0
    return root / "report"


@pytest.fixture
def run(upsample, keys, tmp_path):
    """Upsample with a report; return its folder."""

    def do(name: str, *options: object) -> Path:
        report = tmp_path / f"{name}-report"
        upsample(keys, tmp_path / name, *ASKED, "--report", report, *options)
        return report

    return do


def listed(report: Path) -> list[dict[str, str]]:
    with (report / "review.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def lists(report: Path) -> tuple[str, str]:
    return (report / "review.csv").read_text(), (report / "review.txt").read_text()


@pytest.mark.parametrize("method", ["softsplat", "s6"])
def test_a_frame_that_was_spoilt_on_purpose_comes_first(run, method):
    report = run(method, "-m", method, "--no-tail")
    after, before = (set(range(4 * k - 2, 4 * k + 1)) for k in (SPOILT, SPOILT - 1))
    wanted = after | before if method == "softsplat" else after
    first = listed(report)[0]
    assert int(first["frame"]) in wanted
    y, x = PATCH
    assert int(first["x"]) < x.stop and int(first["x"]) + int(first["width"]) > x.start
    assert int(first["y"]) < y.stop and int(first["y"]) + int(first["height"]) > y.start
    named = (report / "review.txt").read_text().strip()
    # With one key frame alone, the next interval is judged by the spoilt key frame as well.
    doubtful = set() if method == "softsplat" else {4 * SPOILT + i for i in (2, 3, 4)}
    numbers = set(parse_frames(named))
    assert numbers & wanted and numbers <= wanted | doubtful


def test_the_page_shows_the_list_and_the_map(whole):
    text = (whole / "report.html").read_text()
    assert "Worth a look" in text and "Places worth a look" in text
    document = album(whole)
    risks = [frame["risk"] for frame in document["frames"] if frame["kind"] != "key"]
    assert all(len(one["levels"]) == one["rows"] * one["columns"] for one in risks)
    found = json.loads((whole / "report.json").read_text())["review"]
    assert document["start"] == found["predicted_error"]["worst_frame"]


def test_a_run_that_goes_on_has_the_same_lists(run, whole, tmp_path):
    shutil.copytree(whole.parent / "out", tmp_path / "out")
    for number in (2, 7):
        (tmp_path / "out" / f"shot.{number:04d}.exr").unlink()
    again = run("out", "--skip-existing")
    assert lists(again) == lists(whole)
    names = ("frame", "predicted_error", "risk")
    found, expected = ([[row[n] for n in names] for row in rows(one)] for one in (again, whole))
    assert found == expected


def test_joined_chunks_have_the_lists_of_a_single_run(run, whole, exwarp, tmp_path):
    chunks = [run(part, "--frames", part) for part in ("1-2", "3", "4-5")]
    assert exwarp("merge-reports", *chunks, "-o", tmp_path / "joined").code == 0
    assert lists(tmp_path / "joined") == lists(whole)
    assert unmeasured(tmp_path / "joined")["review"] == unmeasured(whole)["review"]


def test_headers_keep_what_is_predicted(whole):
    for row in rows(whole):
        header, _ = shots.read(whole.parent / "out" / row["file"])
        if row["kind"] == "generated":
            assert header["exwarp:predictedError"] == pytest.approx(float(row["predicted_error"]))
            assert header["exwarp:risk"] == row["risk"]
        else:
            assert row["predicted_error"] == "" and "exwarp:risk" not in header


@pytest.mark.parametrize("method", ["hold", "blend"])
def test_methods_without_motion_say_nothing(run, method):
    report = run(method, "-m", method, "--no-tail")
    assert unmeasured(report)["review"] is None
    assert listed(report) == [] and (report / "review.txt").read_text() == ""
    assert "Worth a look" not in (report / "report.html").read_text()


def test_the_summary_has_one_line_of_it(upsample, keys, tmp_path):
    summary = upsample(keys, tmp_path / "out", "-m", "s6", *VECTORS, "--cuts", "none").out
    assert sum(line.startswith("predicted error") for line in summary.splitlines()) == 1


def test_the_forecast_does_not_depend_on_the_layers_beside(run):
    """Layers are moved in linear light, which tells nearly the same of the frame."""
    one, other = (rows(run(n, "--layers", n)) for n in ("beauty", "all"))
    for a, b in zip(one, other, strict=True):
        if a["predicted_error"]:
            assert float(b["predicted_error"]) == pytest.approx(
                float(a["predicted_error"]), rel=0.2
            )
