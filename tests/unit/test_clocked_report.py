"""What a benchmark says of real time, from parts whose schedule is known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from exwarp_cli.report.gallery import Album
from exwarp_cli.report.plots import Figure
from exwarp_cli.research.bench.bench_report import bench_page, format_markdown
from exwarp_cli.research.bench.bench_tables import make_tables
from exwarp_cli.research.bench.real_time import SLOT_MS, measured_latencies, table_latencies
from exwarp_cli.research.bench.systems import CLOCKS
from tests.unit.test_bench_report import benchmark_of, document_of, frames, measured

SYSTEMS = ("exwarp", "oracle", "oracle-return", "s1", "s2", "s6")

PSNR = {
    "F": (20, 19, 18), "W1": (30, 25, 22), "W2": (None, 29, 24), "W3": (None, None, 28),
    "E2": (None, 40, 30), "W(E2)": (None, None, 31), "E3": (None, None, 32),
}  # fmt: skip

SLOT_SCORES = {
    name: [None if psnr is None else [psnr, psnr / 100] for psnr in values]
    for name, values in PSNR.items()
}


def clocked(clock: str, **about: Any) -> Any:
    """A benchmark of one sequence whose policy takes S3, then S1."""
    one = measured(**about)
    parts = [
        part
        | {"slot_scores": SLOT_SCORES}
        | {"systems": {name: frames("s6", "S6", 30.0) for name in (*SYSTEMS, "softsplat")}}
        for part in one.parts
    ]
    benchmark = benchmark_of(replace(one, parts=tuple(parts)))
    return replace(benchmark, settings=replace(benchmark.settings, clock=clock))


def row_of(clock: str, **about: Any) -> Any:
    return document_of(clocked(clock, **about))["real_time"]["rows"][0]


def test_rates_and_reasons_where_extrapolation_takes_two_slots():
    row = row_of("table3", width=1280, height=720)
    assert row["extrapolate_slots"] == 2
    found = {name: system["effective"] for name, system in row["systems"].items()}
    assert found == {
        "exwarp": 60,
        "oracle": 90,
        "oracle-return": 120,
        "s1": 60,
        "s2": 90,
        "s6": 120,
    }
    assert row["systems"]["exwarp"]["slots"] == {
        "warp": 1, "extrapolate": 1, "by path": 2, "late": 1, "busy": 1,
    }  # fmt: skip
    assert row["paths"]["S3"] == {
        "made_by": ["warp", "hold", "hold"], "dropped": [None, "late", "busy"], "new": 1,
    }  # fmt: skip


def test_quality_is_that_of_the_frames_that_are_repeated():
    systems = row_of("table3-720p")["systems"]
    assert systems["exwarp"]["psnr_db"] == pytest.approx((30 + 25 + 22 + 20 + 40 + 30) / 6)
    assert systems["s2"]["ssim"] == pytest.approx((20 + 40 + 31) / 300)


def test_oracles_know_the_clock():
    offline, late = (row_of(f"table3-{size}")["systems"] for size in ("480p", "720p"))
    # S3 shows 30, 40 and 32 dB in time; two slots of E leave it 30, 25 and 22, and S2 20, 40, 31.
    assert offline["oracle"]["decisions"]["paths"]["S3"] == 2
    assert late["oracle"]["decisions"]["paths"]["S2"] == 2
    assert late["oracle-return"]["decisions"]["paths"]["S6"] == 2
    assert late["oracle-return"]["return"] == pytest.approx(1.01 * 18)
    assert late["s2"]["return"] == pytest.approx(1.01 * -9 - 0.1)


def test_alpha_outweighs_a_small_gain():
    """S2 gains 0.02 dB at slot 3 and drops slot 1; S6 drops none."""
    even = {name: [[30.0, 0.3] for _ in range(3)] for name in PSNR} | {"W(E2)": [[30.02, 0.3]] * 3}
    benchmark = clocked("table3-720p")
    for part in benchmark.measured[0].parts:
        part["slot_scores"] = even
    systems = document_of(benchmark)["real_time"]["rows"][0]["systems"]
    assert systems["oracle"]["decisions"]["paths"]["S2"] == 2
    assert systems["oracle-return"]["decisions"]["paths"]["S6"] == 2


def test_latencies_of_the_papers_table():
    small, middle, large = (table_latencies(p) for p in (854 * 480, 1280 * 720, 1920 * 1080))
    assert [each.extrapolate_slots for each in (small, middle, large)] == [1, 2, 3]
    assert middle.warp_ms == pytest.approx((1.01 + 1.58 + 1.24 + 1.67) / 2)
    assert middle.extrapolate_ms == pytest.approx((12.12 + 12.59) / 2)
    assert table_latencies(426 * 240) == small
    assert table_latencies(3840 * 2160).extrapolate_ms == pytest.approx(4 * large.extrapolate_ms)
    between = table_latencies((1280 * 720 + 1920 * 1080) // 2)
    assert between.warp_ms == pytest.approx((middle.warp_ms + large.warp_ms) / 2)


def test_latencies_of_this_machine():
    steps = {
        "read": 50.0,
        "geometry": 1.0,
        "warp": 2.0,
        "holes": 0.5,
        "inputs": 4.0,
        "network": 8.0,
    }
    found = measured_latencies(steps)
    assert (found.warp_ms, found.extrapolate_ms) == (3.5, 15.5)
    assert measured_latencies({"geometry": 1.0, "warp": SLOT_MS}).extrapolate_slots is None


def test_measured_times_decide_what_is_late():
    benchmark = clocked("measured")
    timing = benchmark.measured[0].timing
    timing["steps_ms"] |= {"inputs": 0.0, "network": 30.0}
    row = document_of(benchmark)["real_time"]["rows"][0]
    assert row["latency_ms"] == {"warp": 5.0, "extrapolate": 35.0}
    assert row["systems"]["exwarp"]["slots"] == {
        "warp": 1, "extrapolate": 0, "by path": 2, "late": 1, "busy": 2,
    }  # fmt: skip


@pytest.mark.parametrize("clock", CLOCKS)
def test_tables_say_which_times_they_are_from(clock):
    benchmark = clocked(clock)
    benchmark.measured[0].timing["steps_ms"]["inputs"] = 1.0
    document = document_of(benchmark)
    text = format_markdown(document)
    assert f"(Figure 8, clock {clock})" in text and f"(Figure 9, clock {clock})" in text
    assert ("this machine's" in text) == (clock == "measured")
    for table in make_tables(document):
        if table.name.startswith("real_time"):
            keys = [column.key for column in table.columns]
            assert table.rows and len(set(keys)) == len(keys)
            assert all(row.keys() <= set(keys) for row in table.rows), table.name


def test_the_page_has_figures_under_the_clock():
    benchmark = clocked("table3-1080p")
    page = bench_page(benchmark, document_of(benchmark), [Album(("a",), "a", "a")])
    (section,) = (each for each in page.sections if each.title == "Real time")
    assert sum(isinstance(block, Figure) for block in section.blocks) == 3


def test_without_a_clock_nothing_is_said_of_it():
    document = document_of(benchmark_of(measured()))
    assert "real_time" not in document
    assert not [table for table in make_tables(document) if table.name.startswith("real_time")]
