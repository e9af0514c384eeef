"""Ground truth of which a frame cannot be used: nothing that was made is lost for it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli import cli
from tests.blender_layers import HALF, layer
from tests.cli import shots
from tests.cli.shots import FORWARD, contents, names
from tests.cli.spoiling import remove, scribble, truncate

pytestmark = pytest.mark.usefixtures("unpainted_plots")

ODD = 7
"""Number of the frame: slot 2 of the second key frame."""

WHERE = f"shot.{ODD:04d}.exr"
PSNR = ("--metrics", "psnr")


def grow(path: Path) -> None:
    shots.colour_only(path, shots.Street(80, 45), 1.5)


def lack_colour(path: Path) -> None:
    shots.write(path, {"": layer("", "Z", np.ones((36, 64)))})


DAMAGES = {
    remove: str(ODD),
    grow: "80x45",
    truncate: WHERE,
    scribble: WHERE,
    lack_colour: WHERE,
}


@pytest.fixture
def truth(plain_truth, tmp_path) -> Path:
    """A copy of the truth, to be damaged."""
    return Path(shutil.copytree(plain_truth, tmp_path / "truth"))


@pytest.fixture(scope="module")
def undisturbed(plain_shot, plain_truth, tmp_path_factory) -> Path:
    """What is made with whole ground truth, and its report."""
    folder = tmp_path_factory.mktemp("undisturbed")
    options = ("--ground-truth", plain_truth, "--report", folder / "report", "--progress", "none")
    command = ("upsample", plain_shot, "-o", folder / "out", *FORWARD, *options, *PSNR)
    assert cli.run([str(part) for part in (*command, "-m", "s6")]) == 0
    return folder


def scored(report: Path) -> dict[int, float]:
    """PSNR by output frame."""
    lines = [line.split(",") for line in (report / "frames.csv").read_text().splitlines()]
    number, psnr = lines[0].index("frame"), lines[0].index("psnr_db")
    return {int(line[number]): float(line[psnr]) for line in lines[1:] if line[psnr]}


@pytest.mark.parametrize("damage", DAMAGES)
def test_it_ends_a_run_with_a_sentence_and_what_was_made_is_whole(
    exwarp, undisturbed, plain_shot, truth, tmp_path, damage
):
    damage(truth / WHERE)
    options = ("--ground-truth", truth, "-m", "s6", "--progress", "none", *FORWARD)
    result = exwarp("upsample", plain_shot, "-o", tmp_path / "out", *options)
    result.refused(3, DAMAGES[damage])
    made, whole = contents(tmp_path / "out"), contents(undisturbed / "out")
    if damage not in (remove, grow):  # which are seen before anything is made
        assert set(made) >= {f"shot.{number:04d}.exr" for number in (1, 2, 3, 4)}
    assert made.items() <= whole.items()


@pytest.mark.parametrize("damage", DAMAGES)
def test_with_keep_going_only_its_score_is_left_out(
    exwarp, upsample, undisturbed, plain_shot, truth, tmp_path, damage
):
    damage(truth / WHERE)
    report, out = tmp_path / "report", tmp_path / "out"
    options = ("--ground-truth", truth, "-m", "s6", "--progress", "none", *FORWARD, *PSNR)
    more = ("--keep-going", "--report", report)
    result = exwarp("upsample", plain_shot, "-o", out, *options, *more)
    assert result.code == 12, result.err
    assert contents(out) == contents(undisturbed / "out")
    message, end = result.err.splitlines()[-2:]
    assert message.startswith(f"exwarp: not scored frame {ODD}: ") and DAMAGES[damage] in message
    assert f"frame {ODD} was not scored, see above or left_out in report.json" in end
    assert f"not scored: frames {ODD}" in result.out
    (one,) = json.loads((report / "report.json").read_text())["left_out"]
    assert (one["key"], one["frames"], one["scores"]) == (2, [], [ODD])
    expected = scored(undisturbed / "report")
    assert scored(report) == {n: value for n, value in expected.items() if n != ODD}
    page = (report / "report.html").read_text()
    assert "Not scored" in page and "Left out" in page
    # Mended, the run is as if nothing had been.
    shots.colour_only(truth / WHERE, shots.Street(), 1.5)
    upsample(plain_shot, out, *options, "--report", report, "--skip-existing")
    assert scored(report) == expected


def test_the_first_frame_need_not_be_the_one_that_tells_the_size(
    exwarp, plain_shot, truth, tmp_path
):
    scribble(truth / "shot.0001.exr")
    options = ("--ground-truth", truth, "-m", "s6", "--progress", "none", *FORWARD)
    result = exwarp("upsample", plain_shot, "-o", tmp_path / "out", *options)
    result.refused(3, "shot.0001.exr")
    assert names(tmp_path / "out") == []
    result = exwarp("upsample", plain_shot, "-o", tmp_path / "out", *options, "--keep-going")
    assert result.code == 0, "the key frame's own instant is not scored"


def test_ends_of_an_interval_are_reported_too(exwarp, plain_shot, truth, tmp_path):
    """VMAF goes from key frame to key frame."""
    scribble(truth / "shot.0005.exr")
    options = ("--metrics", "psnr,vmaf,flicker", "-m", "s6", "--progress", "none", *FORWARD)
    more = ("--ground-truth", truth, "--keep-going", "--report", tmp_path / "report")
    result = exwarp("upsample", plain_shot, "-o", tmp_path / "out", *options, *more)
    assert result.code == 12, result.err
    left = json.loads((tmp_path / "report" / "report.json").read_text())["left_out"]
    assert [(one["key"], one["scores"]) for one in left] == [(1, [5]), (2, [5])]


def test_an_oracle_cannot_decide_without(exwarp, network, plain_shot, truth, tmp_path):
    scribble(truth / WHERE)
    options = ("-m", "oracle", "--extrapolator", network, "--progress", "none", *FORWARD)
    more = ("--ground-truth", truth, "--keep-going")
    result = exwarp("upsample", plain_shot, "-o", tmp_path / "out", *options, *more)
    assert result.code == 12 and "left out frames" in result.err


def test_what_is_not_finite_in_it_is_counted(upsample, plain_shot, truth, tmp_path):
    planes = layer("", "RGBA", shots.Street().colour(1.5), HALF)
    planes["G"][3:5, 4:10] = np.nan
    shots.write(truth / WHERE, {"": planes})
    options = ("--ground-truth", truth, "-m", "s6", "--report", tmp_path / "report", *FORWARD)
    upsample(plain_shot, tmp_path / "out", *options)
    document = json.loads((tmp_path / "report" / "report.json").read_text())
    (one,) = document["nonfinite"]
    assert (one["key"], one["slot"], one["channels"], one["pixels"]) == (2, 2, "ground truth", 12)
    assert ODD in scored(tmp_path / "report")
