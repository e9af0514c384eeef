"""``exwarp bench``: its numbers are those of `upsample`, and nothing is measured twice."""

from __future__ import annotations

import csv
import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exwarp_cli import cli
from exwarp_cli.research.bench import benchmark, measurement
from tests.cli import shots
from tests.cli.conftest import run_quietly
from tests.cli.decisions.conftest import KEYS, SETTINGS, take
from tests.cli.documents import document_of
from tests.cli.pictures import write_still
from tests.cli.street import Street
from tests.unit import tiny_interpolators

QUICK = ("--jobs", 1, "--progress", "none", "--metrics", "psnr,ssim")
FEW = (*QUICK, "--systems", "exwarp,softsplat")
MINIATURE = Path(__file__).parents[2] / "data" / "miniature"


@pytest.fixture(scope="module", autouse=True)
def brief_timing() -> Iterator[None]:
    """Measure run times on two intervals, of which the first is not counted."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measurement, "TIMED_INTERVALS", 1)
        yield


@pytest.fixture
def bench(exwarp, uneven, truth, network, tmp_path):
    """Run a benchmark of the shot; return its document and folder."""

    def run(*options: object, name: str = "bench", code: int = 0) -> Any:
        keys, *rest = uneven["key"]
        out = tmp_path / name
        source = (keys, *rest, "--ground-truth", truth, "--extrapolator", network)
        result = exwarp("bench", *source, "-o", out, *(options or QUICK))
        if code:
            return result
        assert result.code == 0, result.err
        return json.loads((out / "bench.json").read_text()), out

    return run


@pytest.fixture(scope="session")
def few(tmp_path_factory, uneven, truth, network) -> Path:
    """The folder of a benchmark with few systems; read only."""
    out = tmp_path_factory.mktemp("few") / "bench"
    keys, *rest = uneven["key"]
    source = (keys, *rest, "--ground-truth", truth, "--extrapolator", network)
    run_quietly("bench", *source, "-o", out, *FEW)
    return out


@pytest.fixture
def again(few, tmp_path) -> Path:
    """A copy of it, where `bench` finds what was measured before."""
    return Path(shutil.copytree(few, tmp_path / "bench"))


@pytest.fixture(scope="session")
def whole(tmp_path_factory, line) -> Callable[[str], Path]:
    """Return the folder of a benchmark with most systems, by setting; read only."""
    root = tmp_path_factory.mktemp("bench")

    def find(setting: str) -> Path:
        out = root / setting
        if not out.exists():
            assert cli.run([str(argument) for argument in line(setting, out)]) == 0
        return out

    return find


@pytest.fixture(scope="session")
def line(uneven, truth, network, policies) -> Callable[[str, Path], tuple[object, ...]]:
    """Return the command line of a benchmark with most systems, by setting and folder."""

    def words(setting: str, out: Path) -> tuple[object, ...]:
        more = ("--extrapolator", network, "--policy", policies("watching"))
        more += ("--systems", "exwarp,oracle,s1,s2,s6,hold,softsplat,lookahead")
        more += ("--frames", {"key": "1-6", "slot": "2-4"}[setting])
        return ("bench", *uneven[setting], "--ground-truth", truth, "-o", out, *QUICK, *more)

    return words


def document_in(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "bench.json").read_text())


def parts_of(folder: Path) -> list[dict[str, Any]]:
    found = [json.loads(path.read_text()) for path in folder.glob("parts/*/[0-9]*.json")]
    return sorted(found, key=lambda part: part["key"])


def rows(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text().splitlines()))


def test_numbers_are_those_of_upsample(whole, judged, uneven, truth, tmp_path):
    (found,) = document_in(whole("key"))["quality"]
    done = {name: judged(name) for name in ("s2", "s6", "oracle", "watching")}
    given = ("-m", "hold", "--ground-truth", truth, "--metrics", "psnr,ssim")
    done["hold"] = take(uneven["key"], tmp_path / "hold", *given)
    for name, run in done.items():
        ours = found["systems"]["exwarp" if name == "watching" else name]
        for where in ("all", "holes", "dropped"):
            expected = run.report["quality"][where]
            for key in ("psnr_db", "ssim", "frames"):
                assert ours[where][key] == pytest.approx(expected[key], abs=1e-9), (name, where)


def test_so_are_those_of_each_frame_with_gbuffers_of_slots(whole, judged, uneven, truth, tmp_path):
    done = {name: judged(name, "slot").rows for name in ("s2", "s6", "oracle", "watching")}
    given = ("--ground-truth", truth, "--metrics", "psnr,ssim")
    for name in ("softsplat", "lookahead"):
        done[name] = take(uneven["slot"], tmp_path / name, "-m", name, *given).rows
    for name, theirs in done.items():
        for part in parts_of(whole("slot")):
            slots = part["systems"]["exwarp" if name == "watching" else name]
            of_key = [
                row for row in theirs if row["key"] == str(part["key"]) and row["slot"] != "0"
            ]
            for ours, row in zip(slots, of_key, strict=True):
                for metric in ("psnr_db", "ssim"):
                    for where, column in (("all", metric), ("holes", f"{metric}_holes")):
                        if row[column]:
                            expected = pytest.approx(float(row[column]), abs=1e-9)
                            assert ours[where][metric] == expected, (name, where)
        assert any(row["psnr_db_holes"] for row in theirs)


def test_truth_may_be_of_stills(exwarp, uneven, truth, tmp_path):
    stills = tmp_path / "stills"
    for name in shots.names(truth):
        header, _ = shots.read(truth / name)
        (left, top), (right, bottom) = header["displayWindow"]
        grey = np.full((bottom - top + 1, right - left + 1, 3), 99, np.uint8)
        write_still(stills / name.replace(".exr", ".png"), grey)
    given = (*uneven["key"], "--ground-truth", stills, "--systems", "hold", "--frames", "1")
    found = exwarp("bench", *given, "-o", tmp_path / "out", *QUICK)
    assert found.code == 0, found.err
    options = ("-m", "hold", "--ground-truth", stills, "--metrics", "psnr,ssim", "--frames", "1")
    done = take(uneven["key"], tmp_path / "hold", *options)
    measured = document_in(tmp_path / "out")["quality"][0]["systems"]["hold"]["all"]["psnr_db"]
    assert measured == pytest.approx(done.report["quality"]["all"]["psnr_db"], abs=1e-9)


@pytest.mark.parametrize("setting", SETTINGS)
def test_paths_are_those_of_upsample(whole, judged, setting):
    parts = parts_of(whole(setting))
    for chooser, name in (("exwarp", "watching"), ("oracle", "oracle")):
        taken, expected = [part["paths"][chooser] for part in parts], judged(name, setting).paths
        assert taken == [expected[part["key"] - 1] for part in parts]
        assert len(set(taken)) > 1
    effective = document_in(whole(setting))["fps"][0]["effective"]
    assert (effective["s1"], effective["s2"], effective["s6"]) == (60, 90, 120)


@pytest.mark.parametrize("setting", SETTINGS)
def test_features_are_those_that_upsample_decides_by(whole, judged, setting):
    ours = rows(whole(setting) / "features.csv")
    theirs = {row["key"]: row for row in judged("watching", setting).rows if row["slot"] == "1"}
    assert len(ours) == 3 * {"key": KEYS - 1, "slot": 3}[setting]
    assert {row["R"] for row in ours} == {str(32.0 * 18)}
    for mine in ours[::3]:
        row = theirs[mine["key"]]
        for name in ("N_d", "EMD_Wn", "EMD_Wp", "Var_x", "Var_y"):
            assert float(mine[name]) == pytest.approx(float(row[name]), abs=1e-5), name


def test_every_metric_of_a_frame_is_that_of_upsample(bench, uneven, truth, tmp_path):
    document, _ = bench(*QUICK[:-2], "--systems", "s6", "--frames", "1-2")
    given = ("-m", "s6", "--ground-truth", truth, "--frames", "1-2", "--metrics", "all")
    expected = take(uneven["key"], tmp_path / "out", *given).report["quality"]
    ours = document["quality"][0]["systems"]["s6"]
    assert None not in [expected["all"][name] for name in ("hdr_flip", "vmaf", "flicker", "pulse")]
    assert ours["all"] == pytest.approx(expected["all"], abs=1e-6)
    holes = {k: v for k, v in expected["holes"].items() if v is not None}
    assert {k: ours["holes"][k] for k in holes} == pytest.approx(holes, abs=1e-6)


def test_a_second_run_measures_nothing_and_writes_the_same(bench, few, again, monkeypatch):
    before = {path: path.read_bytes() for path in again.iterdir() if path.is_file()}

    def fail(*_: object) -> None:
        raise AssertionError("measured again")

    monkeypatch.setattr(benchmark, "measure", fail)
    monkeypatch.setattr(benchmark, "time_subject", fail)
    assert bench(*FEW)[0] == document_in(few)
    assert {path: path.read_bytes() for path in before} == before


def test_a_clock_adds_real_time_to_what_was_measured(exwarp, whole, line, tmp_path, monkeypatch):
    out = tmp_path / "bench"
    shutil.copytree(whole("key"), out)
    monkeypatch.setattr(benchmark, "measure", None)
    monkeypatch.setattr(benchmark, "time_subject", None)
    result = exwarp(*line("key", out), "--clock", "table3")
    assert result.code == 0, result.err
    before, document = document_in(whole("key")), document_in(out)
    (row,) = document.pop("real_time")["rows"]
    assert document == before
    # E takes less than a slot at this size: all is as offline.
    (offline,) = before["quality"]
    for name, system in row["systems"].items():
        assert system["effective"] == before["fps"][0]["effective"][name]
        for metric in ("psnr_db", "ssim"):
            assert system[metric] == pytest.approx(offline["systems"][name]["all"][metric])
        assert system["return"] == pytest.approx(offline["returns"][name]), name
    assert set(row["systems"]) == {"exwarp", "oracle", "s1", "s2", "s6"}
    assert len(rows(out / "real_time_slots.csv")) == 5
    for folder, marked in ((out, True), (whole("key"), False)):
        for file in ("bench.md", "report.html"):
            assert ("in real time" in (folder / file).read_text()) == marked


@pytest.mark.parametrize("kind", ["none", "openjd"])
def test_its_document_is_that_of_the_file(exwarp, uneven, truth, tmp_path, kind):
    how = ("--jobs", 1, "--metrics", "psnr", "--systems", "hold", "--progress", kind, "--json")
    line = ("bench", *uneven["key"], "--ground-truth", truth, "--frames", "1", *how)
    result = exwarp(*line, "-o", tmp_path / "bench")
    assert document_of(result, "exwarp.bench/1") == document_in(tmp_path / "bench")
    # Two more intervals are timed.
    assert ("openjd_status: 3 frames done" in result.err.splitlines()) == (kind == "openjd")


def test_each_key_interval_moves_the_bar(exwarp, uneven, truth, tmp_path, monkeypatch):
    """At the start of each interval, progress counts those before and has the time for the rest."""

    def measure(*given: Any) -> dict[str, Any]:
        sys.stderr.write(json.dumps({"event": "measuring"}) + "\n")
        return measured(*given)

    measured = benchmark.measure
    monkeypatch.setattr(benchmark, "measure", measure)
    how = ("--jobs", 1, "--metrics", "psnr", "--systems", "hold", "--progress", "json")
    line = ("bench", *uneven["key"], "--ground-truth", truth, "-o", tmp_path / "bench", *how)
    events = [json.loads(text) for text in exwarp(*line, "--frames", "1-3").err.splitlines()]
    seen = [one for one in events if one["event"] in ("measuring", "frame")]
    # Run times are measured first, on two of the same intervals.
    assert [one["event"] for one in seen] == ["frame"] * 2 + ["measuring", "frame"] * 3
    counted = [one for one in seen if one["event"] == "frame"]
    assert [(one["done"], one["total"]) for one in counted] == [(n, 5) for n in range(1, 6)]
    assert ["timing" in one["note"] for one in counted] == [True] * 2 + [False] * 3
    assert counted[2]["eta_s"] > 0 and counted[-1]["eta_s"] == 0
    events = [json.loads(text) for text in exwarp(*line, "--frames", "1-4").err.splitlines()]
    kept = [one["eta_s"] for one in events if one["event"] == "frame"]
    # The fourth interval is new, and timed with others than before.
    assert kept[-1] == 0 and len(kept) == 6


def test_what_fails_before_the_work_begins_has_no_progress(exwarp, tmp_path):
    line = ("bench", tmp_path / "nothing", "-o", tmp_path / "bench", "--progress", "json")
    events = [json.loads(text) for text in exwarp(*line).err.splitlines() if text[0] == "{"]
    assert [one["event"] for one in events] == ["fail"]


@pytest.fixture
def measured(monkeypatch) -> list[int]:
    """The key frames whose intervals this process measures from now on, from 0."""
    measure, found = benchmark.measure, list[int]()

    def counted(opened: Any, loaded: Any) -> dict[str, Any]:
        found.append(loaded.key)
        return measure(opened, loaded)

    monkeypatch.setattr(benchmark, "measure", counted)
    return found


def test_chunks_and_workers_find_what_one_process_finds(bench, few, measured):
    bench("--jobs", 2, *FEW[2:], "--frames", "1-3")
    joined, _ = bench(*FEW)
    assert measured == [3, 4]
    for key in ("quality", "holes", "features", "decisions", "fps", "extranet_procedure"):
        assert joined[key] == document_in(few)[key], key


def test_only_what_is_damaged_or_asked_for_anew_is_measured(bench, few, again, measured):
    part = next(iter(again.glob("parts/*/2.json")))
    part.write_text(part.read_text()[:100])
    assert bench(*FEW)[0]["quality"] == document_in(few)["quality"] and measured == [1]
    fewer, _ = bench(*QUICK, "--systems", "s3,hold", "--frames", "2")
    assert set(fewer["quality"][0]["systems"]) == {"s3", "hold"} and measured == [1, 1]


def test_another_card_is_another_network(bench, tmp_path):
    path = tmp_path / "net.onnx"
    found = []
    for more in ({}, {"encoding": "linear"}):
        model, card = tiny_interpolators.CARDS["untimed"]
        tiny_interpolators.put(path, model, card | more)
        options = (*QUICK, "--systems", "s6", "--frames", "2", "--interpolator", path)
        document, _ = bench(*options)
        assert document["systems"]["onnx:net"]["lookahead"]
        found.append(document["networks"]["onnx:net, card"])
    assert found[0] != found[1]


def test_a_lone_interval_with_gbuffers_of_every_slot(exwarp, line, tmp_path):
    result = exwarp(*line("slot", tmp_path / "bench"), "--frames", 2, "--systems", "exwarp")
    assert result.code == 0, result.err
    assert document_in(tmp_path / "bench")["sequences"][0]["intervals"] == 1


def test_every_nth_interval(bench):
    document, folder = bench(*QUICK, "--every", 2, "--systems", "s6")
    assert document["sequences"][0]["intervals"] == 3
    assert [row["key"] for row in rows(folder / "features.csv")][::3] == ["1", "3", "5"]


def test_tables_say_what_is_looked_ahead_and_what_the_paper_prints(exwarp, network, tmp_path):
    out = tmp_path / "bench"
    result = exwarp(
        "bench", MINIATURE, "--scenes", "variety-0074", "-o", out, *QUICK, "--setting", "both",
        "--every", 3,
        "--systems", "exwarp,s1,s3,softsplat,minterpolate",
        "--extrapolator", network, "--extranet", network,
    )  # fmt: skip
    assert result.code == 0, result.err
    assert "bench.md" in result.out and "report.html" in result.out
    document = json.loads((out / "bench.json").read_text())
    assert [row["setting"] for row in document["sequences"]] == ["slot", "key"]
    assert {row["intervals"] for row in document["sequences"]} == {1}
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
        (("--systems", " ,"), ("--systems is empty", "softsplat")),
        (("--metrics", "beauty"), ("--metrics", "'beauty'")),
        (("--predictor-clock", "fast"), ("--predictor-clock fast",)),
        (("--clock", "1GHz"), ("--clock", "table3", "measured")),
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


def test_scenes_of_one_name_size_and_setting_are_refused(exwarp, tmp_path):
    shutil.copytree(MINIATURE / "variety-0074", tmp_path / "data" / "variety-0074")
    line = ("bench", MINIATURE, tmp_path / "data", "--scenes", "variety-0074", "--systems", "s6")
    result = exwarp(*line, "-o", tmp_path / "bench", *QUICK)
    result.refused(2, "variety-0074", "one name, size and setting")


def test_two_interpolators_of_one_name_are_refused(bench, tmp_path):
    model, card = tiny_interpolators.CARDS["untimed"]
    given = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        path = tiny_interpolators.put(tmp_path / folder / "net.onnx", model, card)
        given += ["--interpolator", path]
    bench(*QUICK, *given, code=2).refused(2, "--interpolator", "net", "card")


def test_frames_too_small_for_vmaf_are_refused_before_any_work(exwarp, tmp_path):
    street, root = Street(24, 14), tmp_path
    keys = shots.sequence(root / "keys", shots.plain, range(1, 3), street)
    truth = shots.sequence(root / "truth", shots.colour_only, range(1, 6), street, step=0.25)
    line = ("bench", keys, *shots.FORWARD, "--ground-truth", truth, "-o", root / "bench")
    line += ("--progress", "none", "--jobs", 1, "--systems", "s6")
    exwarp(*line).refused(3, "24x14", "VMAF", "--metrics")
    assert not (root / "bench").exists()
    assert exwarp(*line, "--metrics", "psnr,ssim,flicker").code == 0


def test_terminated_it_says_so_at_once_and_its_workers_end(tmp_path):
    keys = shots.sequence(tmp_path / "keys", shots.plain, (1, 2, 3), shots.SMALL)
    truth = shots.truth(tmp_path / "truth", street=shots.SMALL)
    given = (keys, *shots.FORWARD, "--ground-truth", truth, "-o", tmp_path / "bench")
    how = ("--systems", "s6", "--metrics", "psnr", "--jobs", 2, "--progress", "plain")
    with start("-m", "exwarp_cli", "bench", *given, *how) as process:
        # The child that works, its two workers, and what tracks their semaphores.
        workers = until(lambda: len(children(process.pid)) > 3 and children(process.pid))
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 143 and "Traceback" not in err
    (error,) = (line for line in err.splitlines() if line.startswith("exwarp: error: "))
    assert "terminated" in error and "same command goes on" in error
    until(lambda: not any(map(is_running, workers)))


def test_workers_do_not_outlive_a_command_that_is_killed():
    begin = "from exwarp_cli.runtime.worker_pool import *; from time import sleep; "
    with start("-c", begin + "list(run_tasks(sleep, [(600,)] * 2, 2))") as it:
        workers = until(lambda: len(children(it.pid)) > 2 and children(it.pid))
        time.sleep(0.5)  # so that most often they are at work; sooner they have to end as well
        it.kill()
        it.communicate(timeout=60)
    until(lambda: not any(map(is_running, workers)))


def start(*arguments: object) -> subprocess.Popen[str]:
    line = [sys.executable, *map(str, arguments)]
    return subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def until(found: Callable[[], Any]) -> Any:
    """Wait for something to be there, a minute at most."""
    for _ in range(6000):
        if value := found():
            return value
        time.sleep(0.01)
    pytest.fail("it never came")


def children(pid: int) -> list[int]:
    """Processes that one has begun, and theirs: a command's own child begins the workers."""
    try:
        listed = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:  # it is gone
        return []
    found = [int(word) for word in listed]
    return found + [one for child in found for one in children(child)]


def is_running(pid: int) -> bool:
    """Whether a process lives; one that ended and was not reaped does not."""
    try:
        status = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return status.rpartition(")")[2].split()[0] != "Z"
