"""Pulse in reports: against ground truth, and against key frames where there is none."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli import shots
from tests.cli.reports import rows
from tests.cli.shots import FORWARD
from tests.matrix import spread
from tests.reference import pulse as naive

pytestmark = pytest.mark.usefixtures("unpainted_plots")


def report_of(folder: Path) -> dict:
    return json.loads((folder / "report.json").read_text())


def pulses(folder: Path) -> dict[str, str]:
    return {row["frame"]: row["pulse"] for row in rows(folder)}


def gradient(folder: Path, number: int) -> float:
    (path,) = folder.glob(f"*{number:04d}.exr")
    return naive.mean_gradient(shots.colour_of(path))


@pytest.fixture
def softened(upsample, plain_shot, tmp_path):
    """Run a method on the shot of three key frames; return the folder of its report."""

    def run(name: str, *options: object, method: str = "softsplat") -> Path:
        folder = tmp_path / f"{name}-report"
        upsample(
            *(plain_shot, tmp_path / name, "-m", method, *FORWARD),
            *("--report", folder, *options),
        )
        return folder

    return run


@pytest.mark.parametrize("method", ["softsplat", "s6"])
def test_without_truth_key_frames_are_the_reference(softened, tmp_path, method):
    folder = softened("a", method=method)
    found = pulses(folder)
    keys = {k: gradient(tmp_path / "a", k) for k in (1, 5, 9)}
    for number in (2, 4, 7, 10, 12):
        key, time = 4 * ((number - 1) // 4) + 1, (number - 1) % 4 / 4
        after = keys.get(key + 4, keys[key])
        reference = (1 - time) * keys[key] + time * after
        expected = 100 * (gradient(tmp_path / "a", number) / reference - 1)
        assert float(found[str(number)]) == pytest.approx(expected, abs=0.01)
    assert [found[str(k)] for k in keys] == ["", "", ""]
    document = report_of(folder)
    values = {number: float(value) for number, value in found.items() if value}
    worst = max(values, key=lambda number: abs(values[number]))
    assert document["pulse"] == {
        "mean": pytest.approx(np.mean(list(values.values()))),
        "worst": values[worst],
        "worst_frame": int(worst),
        "frames": 9,
        "against": "key frames",
    }
    assert document["quality"]["all"]["pulse"] is None, "that is against ground truth"
    assert document["quality"]["all"]["frames"] == 0
    page = (folder / "report.html").read_text()
    assert "against key frames" in page and "Sharpness" in page


def test_a_key_frame_behind_a_cut_is_no_reference(softened, tmp_path):
    found = pulses(softened("a", "--cuts", 2))
    for number in (2, 4):
        expected = 100 * (gradient(tmp_path / "a", number) / gradient(tmp_path / "a", 1) - 1)
        assert float(found[str(number)]) == pytest.approx(expected, abs=0.01)


def test_with_truth_it_is_the_reference(softened, plain_truth, tmp_path):
    folder = softened("a", "--ground-truth", plain_truth)
    found = pulses(folder)
    for number in (2, 6):
        expected = 100 * (gradient(tmp_path / "a", number) / gradient(plain_truth, number) - 1)
        assert float(found[str(number)]) == pytest.approx(expected, abs=0.01)
    document = report_of(folder)
    assert found["11"] != "", "beyond the truth, against the last key frame"
    assert (document["pulse"]["against"], document["pulse"]["frames"]) == ("ground truth", 6)
    assert document["quality"]["all"]["pulse"] == pytest.approx(document["pulse"]["mean"])


def test_repeated_frames_are_not_new(softened):
    folder = softened("a", method="hold")
    assert set(pulses(folder).values()) == {""} and report_of(folder)["pulse"] is None


def test_a_method_that_keeps_frames_softer_is_reported(softened, upsample, plain_shot, tmp_path):
    result = upsample(plain_shot, tmp_path / "a", "-m", "blend", "--metrics", "pulse", "--no-tail")
    (line,) = (line for line in result.out.splitlines() if line.startswith("pulse"))
    assert line.startswith("pulse against key frames (6 frames): -")


def test_without_a_report_nothing_is_measured(upsample, plain_shot, tmp_path):
    assert "pulse" not in upsample(plain_shot, tmp_path / "a", "-m", "s6", *FORWARD).out


def test_other_metrics_still_need_truth(exwarp, plain_shot, tmp_path):
    line = ("upsample", plain_shot, "-o", tmp_path / "a", "-m", "hold", "--metrics", "pulse,ssim")
    exwarp(*line).refused(2, "--ground-truth", "only pulse is measured without")


@pytest.mark.parametrize("threads", spread([2, 1], 1))
def test_a_resumed_run_tells_the_same(softened, tmp_path, threads):
    fresh = pulses(softened("a", "--threads", threads))
    again = softened("a", "--skip-existing")
    assert pulses(again) == fresh
    assert {row["resumed"] for row in rows(again)} == {"true"}
    next((tmp_path / "a").glob("*0007.exr")).unlink()
    assert pulses(softened("a", "--skip-existing")) == fresh


@pytest.mark.parametrize("method", spread(["softsplat", "s6"], 1))
def test_any_split_into_chunks_tells_the_same(exwarp, softened, tmp_path, method):
    single = softened("a", method=method)
    parts = [softened(f"part{k}", "--frames", k, method=method) for k in ("1-2", 3)]
    merged = tmp_path / "merged"
    assert exwarp("merge-reports", *parts, "-o", merged).code == 0
    assert pulses(merged) == pulses(single)
    assert report_of(merged)["pulse"] == report_of(single)["pulse"]


def test_a_negative_pulse_fails_by_its_magnitude(exwarp, softened, plain_truth, tmp_path):
    softened("a", "--no-tail", method="blend")
    compare = ("compare", plain_truth, tmp_path / "a", "--metrics", "pulse")
    passed = exwarp(*compare, "--json", "--fail-above", "generated.pulse=90")
    assert passed.code == 0, passed.err
    document = json.loads(passed.out)
    value = document["quality"]["generated"]["pulse"]
    assert -90 < value < -1
    (verdict,) = document["thresholds"]
    assert (verdict["value"], verdict["fails"], verdict["passed"]) == (value, "above", True)
    failed = exwarp(*compare, "--fail-above", "generated.pulse=0.5")
    assert failed.code == 8
    assert f"generated.pulse {value:+.6g} is farther from 0 than 0.5" in failed.err
    assert f"{value:+.2f}" in failed.out
    worst = exwarp(*compare, "--report", tmp_path / "compared", "--fail-above", "worst.pulse=0.5")
    assert worst.code == 8
    values = [float(value) for value in pulses(tmp_path / "compared").values()]
    assert f"worst.pulse {max(values, key=abs):+.6g} is" in worst.err
    assert "fails above ±0.5" in (tmp_path / "compared" / "report.html").read_text()
