"""The benches' goals: what misses one, how that is reported, and what is kept of it."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from pathlib import Path

import pytest

from tests.bench import __main__ as every
from tests.bench import goals, running
from tests.bench.bench_scaling import fitted
from tests.bench.goals import Figure
from tests.bench.running import environment, lend_memory, run
from tests.bench.timing import Ratio


def _figure(value: float, goal: float | None = 2.0) -> Figure:
    return Figure("kernels", "splat / cv2.remap", value, value, value, goal)


def _options(*arguments: str) -> argparse.Namespace:
    return goals.parser_of("tests.bench.any", None, rounds=7, threads=True).parse_args(arguments)


@pytest.mark.parametrize("value", [0.1, 2.0, 2.1, 2.399])
def test_up_to_a_fifth_above_its_goal_is_no_miss(value: float) -> None:
    assert not _figure(value).missed


@pytest.mark.parametrize("value", [2.401, 30.0, float("inf"), float("nan")])
def test_more_than_a_fifth_above_its_goal_is_a_miss(value: float) -> None:
    assert _figure(value).missed


def test_what_has_no_goal_is_never_missed() -> None:
    assert not _figure(1e9, None).missed


def test_the_check_names_each_offender_and_how_far_it_is_off(
    capsys: pytest.CaptureFixture[str],
) -> None:
    off = Figure("command", "s6 / codec floor", 2.2, 2.0, 2.5, 1.1)
    assert goals.finish([_figure(2.3), off, _figure(3.0)], _options("--check")) == 1
    assert capsys.readouterr().err.splitlines() == [
        "missed: command: s6 / codec floor: 2.2x, goal 1.1x, 100% above",
        "missed: kernels: splat / cv2.remap: 3x, goal 2x, 50% above",
    ]


def test_the_check_passes_where_all_goals_are_met(capsys: pytest.CaptureFixture[str]) -> None:
    assert goals.finish([_figure(2.3), _figure(9.0, None)], _options("--check")) == 0
    assert not capsys.readouterr().err


def test_without_the_check_a_miss_is_only_reported() -> None:
    assert goals.finish([_figure(3.0)], _options()) == 0


def test_figures_are_kept_and_read_again(tmp_path: Path) -> None:
    figures = [_figure(3.0), Figure("compile", "s6", 9.5, 9.0, 11.0, 10.0, "s")]
    file = tmp_path / "figures.json"
    assert goals.finish(figures, _options("--json", str(file))) == 0
    assert goals.read(file) == figures
    assert '"missed": true' in file.read_text()


def test_a_table_tells_its_goals(capsys: pytest.CaptureFixture[str]) -> None:
    ratios = {"splat": Ratio(3.0, 2.9, 3.2, 12.0), "mark": Ratio(1.0, 0.9, 1.1, 4.0)}
    figures = goals.table("kernels", "at 1080p", "cv2.remap", ratios, {"splat": 3.0})
    assert [figure.goal for figure in figures] == [3.0, None]
    assert [line.endswith("goal 3") for line in capsys.readouterr().out.splitlines()[3:]] == [
        True,
        False,
    ]


def test_a_goal_that_nothing_is_measured_for_is_refused() -> None:
    ratios = {"splat": Ratio(3.0, 2.9, 3.2, 12.0)}
    with pytest.raises(ValueError, match="goals without a measurement: splatt"):
        goals.table("kernels", "at 1080p", "cv2.remap", ratios, {"splatt": 3.0})


def _ran(monkeypatch: pytest.MonkeyPatch, found: dict[str, list[Figure] | None]) -> None:
    monkeypatch.setattr(every, "_run", lambda name: found[name])


def test_all_benches_are_judged_together(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    _ran(monkeypatch, {"kernels": [_figure(3.0)], "policy": [_figure(1.0)]})
    file = tmp_path / "figures.json"
    assert every.main(["kernels", "policy", "--check", "--json", str(file)]) == 1
    assert every.main(["policy", "--check"]) == 0
    assert every.main(["kernels"]) == 0
    assert len(goals.read(file)) == 2
    assert "missed  kernels: splat" in capsys.readouterr().out


def test_a_bench_that_fails_is_an_error_with_or_without_the_check(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _ran(monkeypatch, {"kernels": None, "policy": [_figure(1.0)]})
    assert every.main(["kernels", "policy"]) == 1
    assert capsys.readouterr().err == "failed: kernels\n"


@pytest.mark.parametrize("name", every.BENCHES)
def test_every_bench_can_be_judged(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    bench = importlib.import_module(f"tests.bench.bench_{name}")
    with pytest.raises(SystemExit, match="0"):
        bench.main(["--help"])
    output = capsys.readouterr().out
    assert "--check" in output
    assert "--json" in output


def test_rounds_and_threads_are_offered_where_they_mean_something() -> None:
    assert _options().rounds == 7
    assert _options().threads == os.cpu_count()
    assert _options("--rounds", "2", "--threads", "1").threads == 1
    alone = goals.parser_of("tests.bench.any", None).parse_args([])
    assert not {"rounds", "threads"} & vars(alone).keys()


def test_children_keep_bytecode_and_the_rest_of_the_environment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    monkeypatch.setenv("KEPT", "yes")
    found = environment({"MORE": "too"})
    assert "PYTHONDONTWRITEBYTECODE" not in found
    assert (found["KEPT"], found["MORE"]) == ("yes", "too")
    code = "import sys; sys.exit(sys.dont_write_bytecode)"
    run([sys.executable, "-c", code])


def test_an_unknown_bench_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        every.main(["kernel"])
    assert "there is no bench kernel; name command, compile" in capsys.readouterr().err


def test_a_straight_line_is_distinguished_from_a_bend() -> None:
    sizes = [3.0, 6.0, 12.0, 24.0]
    line, bent, r2 = fitted(sizes, [2 + 0.5 * size for size in sizes])
    assert line == pytest.approx([3.5, 5.0, 8.0, 14.0])
    assert bent == pytest.approx(0, abs=1e-9)
    assert r2 == pytest.approx(1)
    _, bent, r2 = fitted(sizes, [size**2 for size in sizes])
    assert bent > 0.3
    assert r2 < 0.99


def test_memory_comes_from_a_program_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    took: dict[str, float] = {}
    monkeypatch.setattr(running, "run", lambda c: took.update({c[-1]: run(c).peak_mb}))
    lend_memory(1 << 20)
    assert took[str(1 << 20)] > 0
