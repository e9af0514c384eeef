"""``exwarp bench``: its numbers are those of `upsample`, and nothing is measured twice."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest

from exwarp_cli.pipeline.bench import work
from tests.cli.decisions.conftest import KEYS

QUICK = ("--jobs", 1, "--progress", "none", "--metrics", "psnr,ssim")
MINIATURE = Path(__file__).parents[2] / "data" / "miniature"


@pytest.fixture
def bench(exwarp, uneven, truth, network, tmp_path):
    """Run a benchmark of the shot; return its document and folder."""

    def run(*options: object, setting: str = "key", name: str = "bench", code: int = 0) -> Any:
        keys, *rest = uneven[setting]
        out = tmp_path / name
        source = (keys, *rest, "--ground-truth", truth, "--extrapolator", network)
        result = exwarp("bench", *source, "-o", out, *(options or QUICK))
        if code:
            return result
        assert result.code == 0, result.err
        return json.loads((out / "bench.json").read_text()), out

    return run


def rows(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text().splitlines()))


@pytest.mark.parametrize("setting", ["key", "slot"])
def test_numbers_are_those_of_upsample(bench, upsample, uneven, truth, network, tmp_path, setting):
    document, _ = bench(*QUICK, setting=setting)
    (found,) = document["quality"]
    keys, *rest = uneven[setting]
    for method in ("exwarp", "s1", "s2", "s4", "s6", "softsplat", "oracle", "blend", "hold"):
        report = tmp_path / f"report-{method}"
        model = (
            () if method in ("s6", "softsplat", "blend", "hold") else ("--extrapolator", network)
        )
        upsample(
            keys, tmp_path / method, "-m", method, *rest, *model,
            "--ground-truth", truth, "--report", report, "--frames", f"1-{KEYS - 1}",
            "--metrics", "psnr,ssim",
        )  # fmt: skip
        expected = json.loads((report / "report.json").read_text())
        ours = found["systems"][method]
        for where in ("all", "holes", "dropped"):
            assert ours[where] == pytest.approx(expected["quality"][where], abs=1e-9), method
        effective = document["fps"][0]["effective"][method]
        assert effective == pytest.approx(expected["fps"]["effective"])
        if method in ("exwarp", "oracle"):
            taken = document["decisions"][0][method]
            assert taken["paths"] == expected["decisions"]["paths"]
            assert taken["warp_share"] == pytest.approx(expected["decisions"]["warp_share"])


def test_every_metric_of_a_frame_is_that_of_upsample(bench, upsample, uneven, truth, tmp_path):
    document, _ = bench("--jobs", 1, "--progress", "none", "--systems", "s6,softsplat,exwarp")
    keys, *rest = uneven["key"]
    report = tmp_path / "report"
    upsample(
        keys, tmp_path / "out", "-m", "s6", *rest, "--ground-truth", truth, "--report", report,
        "--frames", f"1-{KEYS - 1}", "--metrics", "all",
    )  # fmt: skip
    expected = json.loads((report / "report.json").read_text())["quality"]
    ours = document["quality"][0]["systems"]["s6"]
    assert None not in [expected["all"][name] for name in ("hdr_flip", "vmaf", "flicker")]
    assert ours["all"] == pytest.approx(expected["all"], abs=1e-6)
    holes = {k: v for k, v in expected["holes"].items() if v is not None}
    assert {k: ours["holes"][k] for k in holes} == pytest.approx(holes, abs=1e-6)


def test_a_second_run_measures_nothing_and_writes_the_same(bench, monkeypatch):
    first, folder = bench()
    before = {path: path.read_bytes() for path in folder.iterdir() if path.is_file()}

    def fail(*_: object) -> None:
        raise AssertionError("measured again")

    monkeypatch.setattr(work, "measure", fail)
    monkeypatch.setattr(work, "time_subject", fail)
    second, _ = bench()
    assert second == first
    assert {path: path.read_bytes() for path in before} == before


def test_chunks_into_one_folder_are_the_whole(bench, monkeypatch):
    whole, _ = bench(name="whole")
    for frames in ("1-2", f"3-{KEYS}"):
        bench(*QUICK, "--frames", frames, name="chunks")
    monkeypatch.setattr(work, "measure", None)
    joined, _ = bench(name="chunks")
    for key in ("quality", "holes", "features", "decisions", "fps", "extranet_procedure"):
        assert joined[key] == whole[key], key


def test_workers_find_what_one_process_finds(bench):
    alone, _ = bench(name="alone")
    shared, _ = bench("--jobs", 2, *QUICK[2:], name="shared")
    assert shared["quality"] == alone["quality"]


def test_a_damaged_part_and_other_settings_are_measured_again(bench):
    first, folder = bench()
    part = next(iter(folder.glob("parts/*/2.json")))
    part.write_text(part.read_text()[:100])
    again, _ = bench()
    assert again["quality"] == first["quality"]
    fewer, _ = bench(*QUICK, "--systems", "s6,hold")
    assert set(fewer["quality"][0]["systems"]) == {"s6", "hold"}


def test_every_nth_interval(bench):
    document, folder = bench(*QUICK, "--every", 2, "--systems", "s6")
    assert document["sequences"][0]["intervals"] == 3
    assert [row["key"] for row in rows(folder / "features.csv")][::3] == ["1", "3", "5"]


def test_tables_say_what_is_looked_ahead_and_what_the_paper_prints(exwarp, network, tmp_path):
    out = tmp_path / "bench"
    result = exwarp(
        "bench", MINIATURE, "--scenes", "variety-0074", "-o", out, *QUICK, "--setting", "both",
        "--extrapolator", network, "--extranet", network,
    )  # fmt: skip
    assert result.code == 0, result.err
    assert "bench.md" in result.out and "report.html" in result.out
    document = json.loads((out / "bench.json").read_text())
    assert [row["setting"] for row in document["sequences"]] == ["slot", "key"]
    assert {row["intervals"] for row in document["sequences"]} == {3}
    by_system = {(r["setting"], r["system"]): r for r in rows(out / "comparison.csv")}
    softsplat, ours = by_system["slot", "softsplat"], by_system["slot", "exwarp"]
    assert (softsplat["kind"], float(softsplat["waits_ms"])) == ("look-ahead", 1000 / 30)
    assert (ours["kind"], float(ours["waits_ms"])) == ("causal", 0.0)
    # The same network in ExtraNet's place, on its path.
    imported = by_system["slot", "extranet"]
    assert imported["psnr_db"] == by_system["slot", "s1"]["psnr_db"]
    assert by_system["slot", "extranet-s3"]["psnr_db"] == by_system["slot", "s3"]["psnr_db"]
    # A render of Blender tells its time; slot G-buffers hold colour, so theirs is unknown.
    assert document["render_time"][0]["key_frame_s"] > 0
    assert document["runtime"][0]["gbuffer_ms"] is None
    assert document["runtime"][0]["hole_marking_ms"] > 0
    assert document["runtime"][1]["hole_marking_ms"] is None
    text = (out / "bench.md").read_text()
    for table in ("Table III", "Figure 2", "Figure 4", "Table VI", "Table VII", "Figure 8",
                  "Figure 9", "synthesis table", "ExtraNet's procedure"):  # fmt: skip
        assert table in text
    assert "nan" not in text and "None" not in text


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--scenes", "lab"), ("--ground-truth", "--scenes")),
        (("--systems", "s7"), ("--systems", "'s7'", "softsplat")),
        (("--metrics", "beauty"), ("--metrics", "'beauty'")),
        (("--clock", "fast"), ("--clock fast",)),
    ],
)
def test_options_that_make_no_sense(bench, options, words):
    result = bench(*QUICK, *options, code=2)
    result.refused(2, *words)


def test_a_sequence_needs_its_truth_and_a_data_set_none_of_its_options(exwarp, uneven, tmp_path):
    keys, *_ = uneven["key"]
    out = ("-o", tmp_path / "bench", "--progress", "none")
    exwarp("bench", keys, *out).refused(3, str(keys), "--ground-truth")
    exwarp("bench", MINIATURE, "--gbuffers", keys, *out).refused(2, "--gbuffers", "data set")
    twice = (MINIATURE, MINIATURE, "--scenes", "variety-0074")
    exwarp("bench", *twice, *out).refused(2, "twice")


def test_two_interpolators_of_one_name_are_refused(bench, tmp_path):
    result = bench(*QUICK, "--interpolator", tmp_path / "none.onnx", code=3)
    result.refused(3, "none.onnx")
