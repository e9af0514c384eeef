"""The oracles: by ground truth no path is better, and the report has what they weighed."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from statistics import mean

import pytest

from tests.cli import shots
from tests.cli.decisions.conftest import KEYS, SETTINGS, Done, take, write
from tests.reference.decisions import PATHS, SHOWN, E, Quality, W, mean_psnr, reward, total

ROUNDING = 1e-9
"""Of sums in another order: the oracles look at frames as they are written."""


def quality(judged: Callable[..., Done], key: int, setting: str) -> Quality:
    """PSNR and SSIM of every choice of an interval, from runs of all six paths."""
    found = {}
    for path, steps in SHOWN.items():
        rows = judged(path.lower(), setting).rows[4 * key + 1 : 4 * key + 4]
        for step, row in zip(steps, rows, strict=True):
            value = (float(row["psnr_db"]), float(row["ssim"]))
            assert found.setdefault(step, value) == value  # paths share what they share
    return found


def weighed(done: Done, key: int) -> dict[str, tuple[float, float]]:
    rows = [row for row in done.rows[4 * key + 1 : 4 * key + 4] if row["node"]]
    return {
        row["node"]: (float(row["output_warp"]), float(row["output_extrapolate"])) for row in rows
    }


@pytest.mark.parametrize("setting", SETTINGS)
class TestBest:
    def test_by_psnr(self, judged, setting):
        done = judged("oracle", setting)
        for key in range(KEYS - 1):
            known = quality(judged, key, setting)
            means = {path: mean_psnr(known, path) for path in PATHS}
            assert means[done.paths[key]] >= max(means.values()) - ROUNDING
            for node, scores in weighed(done, key).items():
                assert scores == pytest.approx([known[node, c][0] for c in (W, E)], abs=ROUNDING)
        runs = [judged(path.lower(), setting) for path in PATHS]
        values = [run.report["quality"]["all"]["psnr_db"] for run in runs]
        assert done.report["quality"]["all"]["psnr_db"] >= max(values) - ROUNDING

    def test_by_return(self, judged, setting):
        done = judged("oracle-return", setting)
        for key in range(KEYS - 1):
            known = quality(judged, key, setting)
            totals = {path: total(known, path) for path in PATHS}
            assert totals[done.paths[key]] >= max(totals.values()) - ROUNDING
            for node, rewards in weighed(done, key).items():
                expected = [reward(known, node, choice) for choice in (W, E)]
                assert rewards == pytest.approx(expected, abs=ROUNDING)

    def test_each_is_better_at_its_own(self, judged, setting):
        one, other = (judged(name, setting) for name in ("oracle", "oracle-return"))
        psnr = [done.report["quality"]["all"]["psnr_db"] for done in (one, other)]
        assert psnr[0] >= psnr[1]
        returns = [
            mean(total(quality(judged, k, setting), done.paths[k]) for k in range(KEYS - 1))
            for done in (one, other)
        ]
        assert returns[1] >= returns[0]


def test_after_the_truth_ends_it_is_warped(judged):
    for name in ("oracle", "oracle-return"):
        done = judged(name)
        assert done.paths[-1] == "S6"
        for row in done.rows[-3:]:
            assert (row["choice"], row["made_by"]) == ("warp", "warp")
            assert row["output_warp"] == row["psnr_db"] == ""


def test_the_report_names_it_and_no_policy(judged):
    report = judged("oracle").report
    assert report["method"] == "oracle" and report["policy"] is None
    assert report["lookahead"] is False
    assert sum(report["decisions"]["paths"].values()) == KEYS


def test_frames_of_a_path_are_recognised(judged, uneven, network, tmp_path):
    """The truth of each interval is what another path makes of it."""
    drawn = ("S2", "S3", "S4", "S5", "S1", "S6")
    truth = tmp_path / "truth"
    truth.mkdir()
    for number in range(1, 4 * KEYS - 2):
        name = f"shot.{number:04d}.exr"
        shutil.copy(judged(drawn[(number - 1) // 4].lower()).out / name, truth)
    for method in ("oracle", "oracle-return"):
        options = ("-m", method, "--extrapolator", network, "--ground-truth", truth)
        done = take(uneven["key"], tmp_path / method, *options)
        assert tuple(done.paths) == drawn
        assert done.report["quality"]["all"]["psnr_db"] > 60


@pytest.mark.parametrize(("method", "path"), [("oracle", "S2"), ("oracle-return", "S4")])
def test_they_differ(judged, uneven, network, truth, tmp_path, method, path):
    """S2 alone shows the better slot 1; but S4 is rewarded for E(F), which S2 shows unasked."""
    held, warped = (shots.colour_of(judged(name).out / "shot.0006.exr") for name in ("s1", "s6"))
    other = Path(shutil.copytree(truth, tmp_path / "truth"))
    mixed = shots.layer("", "RGBA", 0.52 * held + 0.48 * warped, shots.FLOAT)
    shots.write(other / "shot.0006.exr", {"": mixed})
    for name in ("shot.0007.exr", "shot.0008.exr"):
        shutil.copy(judged("s4").out / name, other)
    options = ("-m", method, "--extrapolator", network, "--frames", "2", "--ground-truth", other)
    assert take(uneven["key"], tmp_path / "out", *options).paths == [path]


class TestBytes:
    def test_chunks(self, judged, uneven, network, truth, upsample, tmp_path):
        keys, *rest = uneven["slot"]
        options = ("-m", "oracle", "--extrapolator", network, "--ground-truth", truth)
        upsample(keys, tmp_path / "part", *rest, *options, "--frames", "2,5-6")
        shots.require_part(tmp_path / "part", judged("oracle", "slot").out, 12)

    def test_another_truth_counts_for_its_interval_alone(
        self, judged, uneven, network, truth, tmp_path
    ):
        out = Path(shutil.copytree(judged("oracle").out, tmp_path / "out"))
        other = Path(shutil.copytree(truth, tmp_path / "truth"))
        write(tmp_path / "new", shots.colour_only, [0.0, 0.5])
        shutil.copy(tmp_path / "new" / "shot.0002.exr", other / "shot.0007.exr")
        options = ("-m", "oracle", "--extrapolator", network, "--skip-existing")
        done = take(uneven["key"], out, *options, "--ground-truth", other)
        fresh = [int(row["frame"]) for row in done.rows if row["resumed"] == "false"]
        assert fresh == [6, 7, 8]


class TestRefusals:
    @pytest.mark.parametrize("method", ["oracle", "oracle-return"])
    def test_without_ground_truth(self, uneven, network, exwarp, tmp_path, method):
        keys, *rest = uneven["key"]
        options = ("-m", method, "--extrapolator", network, "--progress", "none")
        result = exwarp("upsample", keys, "-o", tmp_path / "out", *rest, *options)
        result.refused(2, f"--method {method}", "--ground-truth", "--causal")
        assert not (tmp_path / "out").exists()
