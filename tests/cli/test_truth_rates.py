"""Ground truth at another rate, of another kind or length than the output: the same frames meet."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from tests.cli import shots
from tests.cli.conftest import run_quietly
from tests.cli.shots import FORWARD, SMALL
from tests.matrix import combinations

pytestmark = pytest.mark.usefixtures("unpainted_plots")

KEYS = range(1, 6)
SCORED = ("upsample", "-m", "s6", *FORWARD, "--metrics", "psnr", "--progress", "plain")


@pytest.fixture(scope="module")
def keys(tmp_path_factory) -> Path:
    """Five key frames, 1 to 5; read only."""
    return shots.sequence(tmp_path_factory.mktemp("rates") / "keys", shots.plain, KEYS, SMALL)


def truth_at(folder: Path, factor: int, first: int = 1, tail: bool = False) -> Path:
    """Write the truth at a factor, up to the last key frame or past it."""
    count = len(KEYS) * factor if tail else (len(KEYS) - 1) * factor + 1
    numbers = range(first, first + count)
    return shots.sequence(folder, shots.colour_only, numbers, SMALL, step=1 / factor)


def as_png(folder: Path, out: Path) -> Path:
    """Write a sequence as 16-bit PNG, sRGB-encoded."""
    out.mkdir()
    for name in shots.names(folder):
        linear = np.clip(shots.colour_of(folder / name)[..., :3], 0, 1)
        code = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        image = oiio.ImageBuf(np.ascontiguousarray(code, np.float32))
        image.set_write_format("uint16")
        assert image.write(str(out / name.replace(".exr", ".png")))
    return out


def rows(report: Path) -> dict[int, float]:
    """PSNR by output frame."""
    lines = [line.split(",") for line in (report / "frames.csv").read_text().splitlines()]
    number = lines[0].index("frame")
    psnr = lines[0].index("psnr_db")
    return {int(line[number]): float(line[psnr]) for line in lines[1:] if line[psnr]}


@pytest.fixture(scope="module")
def right(keys, tmp_path_factory) -> Callable[[int], dict[int, float]]:
    """Return the scores, by output frame, against the truth at the output's rate."""
    done: dict[int, dict[int, float]] = {}

    def scores(factor: int) -> dict[int, float]:
        if factor not in done:
            root = tmp_path_factory.mktemp("right")
            truth = ("--ground-truth", truth_at(root / "truth", factor), "--factor", factor)
            run_quietly(*SCORED, keys, "-o", root / "out", *truth, "--report", root / "report")
            done[factor] = rows(root / "report")
        return done[factor]

    return scores


@pytest.fixture
def run(exwarp, keys, tmp_path):
    """Upsample against a truth, and compare with it: the scores of both, by output frame."""

    def both(truth: Path, *options: object) -> tuple[dict[int, float], dict[int, float], str]:
        out, report = tmp_path / "out", tmp_path / "report"
        made = exwarp(
            *SCORED, keys, "-o", out, "--ground-truth", truth, "--report", report, *options
        )
        assert made.code == 0, made.err
        again = ("--metrics", "psnr", "--report", tmp_path / "compared")
        compared = exwarp("compare", truth, out, *again)
        assert compared.code == 0, compared.err
        return rows(report), rows(tmp_path / "compared"), made.err + compared.out

    return both


@pytest.mark.parametrize(
    ("place", "factor"), combinations([(1, False), (501, True), (1, True), (501, False)], [2, 3])
)
def test_of_a_faster_truth_the_frames_of_the_same_instant(run, right, tmp_path, place, factor):
    first, tail = place
    expected = right(factor)
    truth = truth_at(tmp_path / "truth", 2 * factor, first, tail)
    made, compared, output = run(truth, "--factor", factor)
    assert {n: made[n] for n in expected} == expected
    assert {n: compared[n] for n in expected} == pytest.approx(expected)
    assert f"has {2 * factor} frames for each key frame and the output {factor}" in output
    assert "those of the same instant are compared" in output


def test_of_a_slower_truth_what_there_is(run, right, tmp_path):
    made, compared, output = run(truth_at(tmp_path / "truth", 2))
    assert made == {n: right(4)[n] for n in (3, 7, 11, 15)}
    assert {n: compared[n] for n in made} == pytest.approx(made)
    assert "new frames at whose instant it has none are not scored" in output


def test_a_longer_truth_at_the_output_s_rate_is_taken_as_it_is(run, right, tmp_path):
    """Ten key frames' truth for five of them is as long as a faster one."""
    numbers = range(1, 38)
    truth = shots.sequence(tmp_path / "truth", shots.colour_only, numbers, SMALL, step=0.25)
    made, compared, output = run(truth)
    assert {n: made[n] for n in right(4)} == right(4)
    assert {n: compared[n] for n in right(4)} == pytest.approx(right(4))
    assert "for each key frame" not in output


def test_a_rate_that_no_new_frame_shares_is_refused(exwarp, keys, tmp_path):
    truth = truth_at(tmp_path / "truth", 4)
    options = ("--ground-truth", truth, "-m", "s6", "--factor", 5, "--progress", "none", *FORWARD)
    found = exwarp("upsample", keys, "-o", tmp_path / "out", *options)
    found.refused(3, "4 frames for each key frame and the output 5", "150 fps")
    assert shots.names(tmp_path / "out") == []


@pytest.mark.parametrize("first", [1, 501])
def test_compare_takes_a_tail_that_the_truth_has_not(run, tmp_path, first):
    made, compared, output = run(truth_at(tmp_path / "truth", 4, first))
    assert {n: compared[n] for n in made} == pytest.approx(made)
    assert sorted(compared) == list(range(1, 18))
    assert ("the last 3 frames of the longer sequence have no partner" in output) == (first > 1)


@pytest.mark.parametrize("first", [1, 501])
def test_compare_takes_png(run, tmp_path, first):
    truth = as_png(truth_at(tmp_path / "truth", 4, first), tmp_path / "png")
    made, compared, _ = run(truth)
    assert len(made) == 12
    assert {n: compared[n] for n in made} == pytest.approx(made)


def test_frames_that_were_not_made_here_are_compared_by_the_instant_too(exwarp, tmp_path):
    fast, slow = truth_at(tmp_path / "fast", 4), truth_at(tmp_path / "slow", 2)
    found = json.loads(exwarp("compare", fast, slow, "--json").out)
    assert (found["frames"], found["quality"]["all"]["psnr_db"]) == (9, 100)


def test_still_pictures_are_paired_by_number(exwarp, tmp_path):
    """Nothing tells rates apart where nothing moves."""
    still = [
        shots.sequence(tmp_path / n, shots.colour_only, range(1, k), SMALL, step=0.0)
        for n, k in (("a", 18), ("b", 10))
    ]
    found = json.loads(exwarp("compare", *still, "--json").out)
    assert (found["frames"], found["matched_by"]) == (9, "number")
