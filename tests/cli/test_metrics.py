"""``--metrics`` of a run against ground truth."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import pytest

from tests.cli import shots
from tests.cli.shots import FORWARD
from tests.cli.street import Street

pytestmark = pytest.mark.usefixtures("unpainted_plots")

NEW = ("hdr_flip", "vmaf", "flicker")


def rows(folder: Path) -> dict[str, dict[str, str]]:
    text = (folder / "frames.csv").read_text()
    return {row["frame"]: row for row in csv.DictReader(text.splitlines())}


@pytest.fixture
def measured(upsample, plain_shot, plain_truth, tmp_path):
    """Run s6 on the shot; return the report and the rows of its frames."""

    def run(*options: object, name: str = "a", method: str = "s6"):
        report = tmp_path / f"{name}-report"
        result = upsample(
            *(plain_shot, tmp_path / name, "-m", method, *FORWARD),
            *("--ground-truth", plain_truth, "--report", report, *options),
        )
        return json.loads((report / "report.json").read_text()), rows(report), result

    return run


def test_only_what_is_chosen_is_measured(measured):
    document, table, result = measured("--metrics", "ssim,vmaf")
    quality = document["quality"]["all"]
    known = {name for name, value in quality.items() if value is not None}
    assert known == {"ssim", "vmaf", "frames"}
    assert 0 < quality["vmaf"] <= 100
    assert document["quality"]["holes"]["vmaf"] is None
    assert document["quality"]["holes"]["ssim"] is not None
    assert table["2"]["psnr_db"] == "" and table["2"]["vmaf"] != ""
    assert f"SSIM {quality['ssim']:.4f}, VMAF {quality['vmaf']:.2f}\n" in result.out


def test_the_default_leaves_the_others_null(measured):
    document, table, result = measured()
    quality = document["quality"]["all"]
    assert [quality[name] for name in NEW] == [None] * 3
    assert all(table["2"][name] == "" for name in NEW)
    assert f"PSNR {quality['psnr_db']:.2f} dB, SSIM" in result.out


def test_any_split_into_chunks_gives_the_same_scores(measured):
    _, whole, _ = measured("--metrics", "all")
    parts: dict[str, dict[str, str]] = {}
    for key in ("2-3", 1):
        parts |= measured("--metrics", "all", "--frames", key, name=f"part{key}")[1]
    assert set(parts) == set(whole)
    names = (*NEW, "hdr_flip_holes", "flicker_holes", "psnr_db")
    for number, row in whole.items():
        assert [parts[number][name] for name in names] == [row[name] for name in names]
    assert all(whole[number][name] for number in ("2", "3", "4", "6", "8") for name in NEW)


def test_frames_of_an_earlier_run_have_the_same_scores(measured):
    _, fresh, _ = measured("--metrics", "all")
    _, again, _ = measured("--metrics", "all", "--skip-existing")
    assert again["3"]["resumed"] == "true"
    for number in fresh:
        assert [again[number][name] for name in NEW] == [fresh[number][name] for name in NEW]


def test_what_compares_sees_what_the_run_saw(measured, exwarp, plain_truth, tmp_path):
    """The rendered frames of the shot are those of the truth, so that the videos are the same."""
    _, table, _ = measured("--metrics", "vmaf", "--no-tail")
    result = exwarp("compare", plain_truth, tmp_path / "a", "--metrics", "vmaf", "--json",
                    "--report", tmp_path / "compared")  # fmt: skip
    assert result.code == 0, result.err
    compared = rows(tmp_path / "compared")
    for number in ("2", "3", "4", "6", "7", "8"):
        assert compared[number]["vmaf"] == table[number]["vmaf"]


def test_repeating_frames_flickers_more_than_moving_them(measured):
    values = {
        method: measured("--metrics", "flicker", "--no-tail", name=method, method=method)[0]
        for method in ("hold", "s6", "softsplat")
    }
    flicker = {name: found["quality"]["all"]["flicker"] for name, found in values.items()}
    assert 0 < flicker["softsplat"] < flicker["s6"] < flicker["hold"]


def test_a_still_does_not_flicker(upsample, tmp_path):
    still = Street(48, 27, speed=0)
    keys = shots.sequence(tmp_path / "keys", street=still)
    truth = shots.truth(tmp_path / "truth", street=still)
    upsample(keys, tmp_path / "out", "-m", "hold", *FORWARD, "--ground-truth", truth,
             "--metrics", "flicker", "--report", tmp_path / "report")  # fmt: skip
    assert {row["flicker"] for row in rows(tmp_path / "report").values() if row["slot"] != "0"} == {
        "0.0", ""
    }  # fmt: skip


def test_a_truth_that_has_no_new_frame_is_reported(upsample, plain_shot, plain_truth, tmp_path):
    truth = tmp_path / "truth"
    truth.mkdir()
    shutil.copy(min(plain_truth.iterdir()), truth)
    arguments = (plain_shot, tmp_path / "out", "-m", "hold", *FORWARD, "--ground-truth", truth)
    output = upsample(*arguments).out
    assert "against ground truth: it has none of the frames between the rendered ones\n" in output


REFUSALS = {
    "unknown": (("--metrics", "psnr,lpips"), 2, "lpips"),
    "empty": (("--metrics", ""), 2, "no metric"),
    "no truth": (("--metrics", "psnr"), 2, "--ground-truth"),
}


@pytest.mark.parametrize("case", list(REFUSALS))
def test_refusals(exwarp, plain_shot, tmp_path, case):
    options, code, word = REFUSALS[case]
    exwarp("upsample", plain_shot, "-o", tmp_path / "out", "-m", "hold", *options).refused(
        code, word
    )
    assert not (tmp_path / "out").exists()


def test_frames_too_small_for_vmaf_are_refused_before_the_work(exwarp, tmp_path):
    small = Street(16, 16)
    keys = shots.sequence(tmp_path / "keys", street=small)
    truth = shots.truth(tmp_path / "truth", street=small)
    exwarp("upsample", keys, "-o", tmp_path / "out", "-m", "hold", "--ground-truth", truth,
           "--metrics", "vmaf", "--progress", "none").refused(3, "17 pixels", "16x16")  # fmt: skip
    assert not (tmp_path / "out").exists()
